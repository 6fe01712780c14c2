"""What pictures of a motion show: the plane through start and goal, from the side, with all of the body's way in it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

ELEVATION_RAD: Final = -0.12
"""How the camera looks at the floor: a little from above."""

_MARGIN: Final = 0.05  # of the height of what is shown, kept free on every side …
_HEADROOM: Final = 0.12  # … and above it for text
_ASPECT_MIN: Final = 1.6  # room for text in one line
_ASPECT_MAX: Final = 3.2
_AWAY_MAX_M: Final = 3.0  # beyond start and goal; who leaves further leaves the picture
_CORNERS: Final = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))


@dataclass(frozen=True)
class Frame:
    """Say what a picture shows.

    Args:
        direction_rad: from start to goal, which is to the right in the picture, about z from x [rad]
        center: the point in its middle [m]
        width_m: [m]
        height_m: [m]
    """

    direction_rad: float
    center: tuple[float, float, float]
    width_m: float
    height_m: float


def frame_of(
    model: mujoco.MjModel, poses: Iterator[mujoco.MjData], start: tuple[float, float], direction_rad: float
) -> Frame:
    """Return the frame that holds every body of a model in each of some poses.

    Args:
        model: the model; what is fixed to its world itself, as the floor, may stand out of the frame
        poses: the poses, after `mj_forward`; of one object that changes in between too
        start: x, y of a point of the plane that is seen [m]
        direction_rad: the plane's direction, to the right in the picture [rad]
    """
    geoms = np.flatnonzero(model.geom_bodyid != 0)
    along = np.array([math.cos(direction_rad), math.sin(direction_rad), 0.0])
    depth = np.array([-along[1], along[0], 0.0])
    # what is farther away stands higher in a picture that is seen from above
    up = -math.sin(ELEVATION_RAD) * depth + math.cos(ELEVATION_RAD) * np.array([0.0, 0.0, 1.0])
    origin = np.array([*start, 0.0])
    local = model.geom_aabb[geoms, None, :3] + _CORNERS * model.geom_aabb[geoms, None, 3:]
    seen = []
    for data in poses:
        turned = np.einsum("gij,gkj->gki", data.geom_xmat[geoms].reshape(-1, 3, 3), local)
        points = (data.geom_xpos[geoms, None] + turned - origin).reshape(-1, 3)
        points = points[np.isfinite(points).all(axis=1)]
        seen.append(np.stack([points @ along, points @ up], axis=1).clip(-_AWAY_MAX_M, _AWAY_MAX_M))
    corners = np.concatenate(seen)
    low, high = corners.min(axis=0), corners.max(axis=0)
    margin = _MARGIN * (high[1] - low[1])
    low, high = low - margin, high + margin + (0.0, _HEADROOM * (high[1] - low[1]))
    middle, size = (low + high) / 2, high - low
    height = max(size[1], size[0] / _ASPECT_MAX)
    width = max(size[0], height * _ASPECT_MIN)
    # what is added above and below a flat scene goes above: the floor stays where it is
    lift = middle[1] + (height - size[1]) / 2
    center = origin + middle[0] * along + np.array([0.0, 0.0, lift / math.cos(ELEVATION_RAD)])
    return Frame(direction_rad, (float(center[0]), float(center[1]), float(center[2])), float(width), float(height))


def look(model: mujoco.MjModel, frame: Frame) -> mujoco.MjvCamera:
    """Set a model up to be seen as a frame says, without perspective: a metre is as long near as far.

    Args:
        model: the model, whose free camera is changed
        frame: what is seen

    Returns:
        The camera.
    """
    model.vis.global_.orthographic = 1
    model.vis.global_.fovy = frame.height_m
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.distance = 2.0 + frame.width_m
    camera.azimuth = 90.0 + math.degrees(frame.direction_rad)
    camera.elevation = math.degrees(ELEVATION_RAD)
    camera.orthographic = 1
    camera.lookat[:] = frame.center
    return camera
