"""Films: a motion as one wide picture or as an MP4, seen from the side."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from controller.errors import InputError, RunError
from controller.rig import Rig
from sim_models.body import Scene, body_layout, build_model
from sim_models.offscreen import Offscreen, look_sideways
from sim_models.simulation import Simulation
from sim_models.standing import standing_height
from sim_models.statistics import HOP_CLEARANCE_M

FloatArray = npt.NDArray[np.float64]

_PANEL_PX: Final = (300, 380)  # width, height of a pose in a strip
_PANEL_M: Final = 0.36  # what its height shows of a body …
_TALL_M: Final = 0.22  # … that stands no taller; of a taller one more, in proportion
_VIDEO_PX: Final = (1280, 480)
_MARGIN_M: Final = 0.22  # kept free before and behind the way in a video
_REST_M: Final = 0.003  # a base that moves less stands
_PAPER: Final = (240, 240, 242)
_INK: Final = (40, 44, 50)
_AIR: Final = (190, 40, 20)
_GOAL: Final = (20, 120, 55)


@dataclass(frozen=True, eq=False)
class Motion:
    """Hold what a body did, as a film needs it.

    Args:
        rig: the rig
        time_s: instants, evenly spaced [s], (n,)
        base: x, y, z [m], heading, roll, pitch [rad] of the base, (n, 6)
        joint_rad: joint angles [rad], (n, njoint)
        clearance_m: height of the lowest foot [m], (n,)
        goal: x, y of the goal [m]
        scene: what stood in the body's way, as `build_model` takes it
    """

    rig: Rig
    time_s: FloatArray
    base: FloatArray
    joint_rad: FloatArray
    clearance_m: FloatArray
    goal: tuple[float, float]
    scene: Scene | None = None


def motion_of(simulation: Simulation) -> Motion:
    """Return the motion of a simulation.

    Args:
        simulation: the simulation

    Returns:
        The motion.
    """
    names = ("x", "y", "z", "heading", "roll", "pitch")
    base = np.stack([simulation.channel(name) for name in names], axis=1).astype(np.float64)
    joints = [simulation.channel(joint.name) for joint in simulation.rig.joints]
    direction = base[0, 3] + simulation.goal_bearing
    goal = base[0, :2] + simulation.goal_dist * np.array([math.cos(direction), math.sin(direction)])
    return Motion(
        rig=simulation.rig,
        time_s=simulation.time_s,
        base=base,
        joint_rad=np.stack(joints, axis=1).astype(np.float64),
        clearance_m=simulation.channel("clearance").astype(np.float64),
        goal=(float(goal[0]), float(goal[1])),
        scene=simulation.scene,
    )


def write_strip(motion: Motion, path: str | Path, poses: int = 10) -> None:
    """Draw a motion as one wide picture: poses side by side, at the tops of hops and between them.

    Args:
        motion: the motion
        path: a PNG file
        poses: how many

    Raises:
        InputError: the path is not that of a PNG file in a folder
        RunError: there is no OpenGL here
    """
    target = _checked(path, ".png")
    chosen = choose_poses(motion.clearance_m[: moving_instants(motion)], poses - 1)
    chosen.append(len(motion.time_s) - 1)
    width, height = _PANEL_PX
    strip = Image.new("RGB", (width * len(chosen), height), "white")
    size = _size(motion.rig)
    with _Stage(motion, _PANEL_PX, size * _PANEL_M) as stage:
        for place, k in enumerate(chosen):
            # above the middle of the base: the lamp leans over its front
            picture = stage.pose(k, motion.base[k, 0] + 0.01 * size, 0.135 * size)
            strip.paste(_captioned(picture, motion, k), (place * width, 0))
    draw = ImageDraw.Draw(strip)
    for place in range(1, len(chosen)):
        draw.line([(place * width, 0), (place * width, height)], fill="white", width=2)
    strip.save(target)


def write_video(motion: Motion, path: str | Path) -> None:
    """Write a motion as an MP4 at its own speed, the camera standing still.

    Args:
        motion: the motion
        path: an MP4 file

    Raises:
        InputError: the path is not that of an MP4 file in a folder
        RunError: there is no OpenGL here, or the encoder fails
    """
    target = _checked(path, ".mp4")
    width, height = _VIDEO_PX
    ends = np.append(motion.base[:, 0], motion.goal[0])
    size = _size(motion.rig)
    low, high = float(ends.min()) - size * _MARGIN_M, float(ends.max()) + size * _MARGIN_M
    span = max(high - low, size * 1.0)
    scale = span * height / width
    with _Stage(motion, _VIDEO_PX, scale) as stage:
        frames = (
            np.asarray(_captioned(stage.pose(k, (low + high) / 2, 0.4 * scale), motion, k))
            for k in range(len(motion.time_s))
        )
        _encode(frames, target, 1.0 / motion.rig.period_s)


def _size(rig: Rig) -> float:
    """Return how much larger than a small body a rig's is drawn, at least 1."""
    tall = standing_height(mujoco.MjSpec.from_file(str(rig.body)))
    return max(1.0, tall / _TALL_M)


def moving_instants(motion: Motion) -> int:
    """Return how many instants pass until the base comes to rest for good.

    Args:
        motion: the motion

    Returns:
        1 at least, all of them at most.
    """
    away = np.abs(motion.base[:, :3] - motion.base[-1, :3]).max(axis=1)
    moving = np.flatnonzero(away > _REST_M)
    return min(int(moving[-1]) + 2, len(away)) if len(moving) else 1


def choose_poses(clearance_m: FloatArray, poses: int) -> list[int]:
    """Choose the instants of a strip: first and last, and evenly in between the highest and the lowest by turns.

    Args:
        clearance_m: height of the lowest foot at each instant [m], (n,)
        poses: how many, at least 3

    Returns:
        Increasing indices, at most `poses` of them.
    """
    n = len(clearance_m)
    if n <= poses:
        return list(range(n))
    edges = np.linspace(1, n - 1, poses - 1).round().astype(int)
    chosen = [0]
    for turn, (start, stop) in enumerate(itertools.pairwise(edges)):
        part = clearance_m[start:stop]
        # in a part without a hop, its middle
        if np.ptp(part) < HOP_CLEARANCE_M / 2:
            chosen.append(int((start + stop) // 2))
        else:
            chosen.append(int(start + (np.argmax(part) if turn % 2 == 0 else np.argmin(part))))
    return [*chosen, n - 1]


class _Stage:
    """Pose a rig's body and draw it."""

    def __init__(self, motion: Motion, size: tuple[int, int], height_m: float) -> None:
        self._motion = motion
        self._model = build_model(motion.rig, scene=motion.scene)
        self._data = mujoco.MjData(self._model)
        self._layout = body_layout(self._model, motion.rig)
        self._camera = look_sideways(self._model, height_m)
        goal = int(self._model.body("goal").mocapid[0])
        self._data.mocap_pos[goal, :2] = motion.goal
        self._offscreen = Offscreen(self._model, *size)

    def __enter__(self) -> _Stage:
        return self

    def __exit__(self, *_: object) -> None:
        self._offscreen.close()

    def pose(self, k: int, center_x: float, center_z: float) -> npt.NDArray[np.uint8]:
        """Draw instant k with a point of the xz plane in the middle of the picture."""
        base = self._motion.base[k]
        self._data.qpos[:3] = base[:3]
        self._data.qpos[3:7] = _quaternion(*base[3:])
        self._data.qpos[self._layout.qpos] = self._motion.joint_rad[k]
        mujoco.mj_forward(self._model, self._data)
        self._camera.lookat[:] = (center_x, base[1], center_z)
        return self._offscreen.picture(self._data, self._camera)


def _quaternion(heading: float, roll: float, pitch: float) -> FloatArray:
    """Turn about z, then the new y, then the new x."""
    total = np.array([1.0, 0.0, 0.0, 0.0])
    for angle, axis in ((heading, (0.0, 0.0, 1.0)), (pitch, (0.0, 1.0, 0.0)), (roll, (1.0, 0.0, 0.0))):
        turn, product = np.empty(4), np.empty(4)
        mujoco.mju_axisAngle2Quat(turn, np.array(axis), angle)
        mujoco.mju_mulQuat(product, total, turn)
        total = product
    return total


def _captioned(picture: npt.NDArray[np.uint8], motion: Motion, k: int) -> Image.Image:
    """Write time, distance to the goal and, in the air, clearance on a picture."""
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    large, small = ImageFont.load_default(22), ImageFont.load_default(15)
    draw.rounded_rectangle((6, 5, 158, 79), 6, fill=_PAPER)
    draw.text((12, 8), f"{motion.time_s[k]:.2f} s", fill=_INK, font=large)
    away = math.hypot(motion.goal[0] - motion.base[k, 0], motion.goal[1] - motion.base[k, 1])
    draw.text((12, 36), f"{100 * away:.1f} cm to goal", fill=_GOAL, font=small)
    if motion.clearance_m[k] >= HOP_CLEARANCE_M:
        draw.text((12, 56), f"{1000 * motion.clearance_m[k]:.0f} mm in the air", fill=_AIR, font=small)
    return image


def _encode(frames: Iterator[npt.NDArray[np.uint8]], target: Path, fps: float) -> None:
    """Write frames as H.264."""
    try:
        from imageio.v2 import get_writer
    except ModuleNotFoundError:
        raise RunError("films need imageio; install it with `pip install 'servolve[report]'`") from None
    try:
        writer: Any = get_writer(target, fps=fps, codec="libx264", quality=8, macro_block_size=16)
        with writer:
            for frame in frames:
                writer.append_data(frame)
    except (OSError, ValueError) as error:
        raise RunError(f"{target}: the film cannot be written ({' '.join(str(error).split())})") from None


def _checked(path: str | Path, suffix: str) -> Path:
    """Refuse a path that cannot become a film before the work begins."""
    target = Path(path)
    if target.suffix.lower() != suffix:
        raise InputError(f"{target}: the name of this picture or film must end in {suffix}; rename it")
    if not target.parent.is_dir():
        raise InputError(f"{target}: there is no folder {target.parent}; create it first")
    if target.is_dir():
        raise InputError(f"{target}: this is a folder; give the name of a file")
    return target
