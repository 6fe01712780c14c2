"""Films: a motion as one picture of poses or as an MP4, seen from the side between start and goal."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from controller.errors import InputError, RunError
from controller.rig import Rig
from sim_models.body import Scene, body_layout, build_model
from sim_models.framing import frame_of, look
from sim_models.offscreen import Offscreen
from sim_models.simulation import Simulation
from sim_models.standing import standing_height
from sim_models.statistics import HOP_CLEARANCE_M

FloatArray = npt.NDArray[np.float64]

_PANEL_PX: Final = 300  # height of a pose in a strip
_STRIP_ASPECT_MAX: Final = 5.0
_VIDEO_PX: Final = (1280, 480)
_FRAMED_EVERY: Final = 4  # instants, of which one decides what all pictures show
_TEXT_PX: Final = 24
_TALL_M: Final = 0.22  # a body that stands no taller has marks of the smallest size
_NOWHERE_M: Final = 1e-6  # a goal as near lies in no direction
_ALL_THE_TIME: Final = 0.9  # of a motion: who rests later than this is not seen at rest
_REST_M: Final = 0.003  # a base that moves less stands
_REST_RAD: Final = 0.05  # … and what turns less does not turn
_START_RGBA: Final = [0.16, 0.17, 0.20, 1.0]
_GOAL_RGBA: Final = [0.10, 0.55, 0.25, 1.0]
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
    """Draw a motion as one picture of poses, at the tops of hops and between them, all seen from one place.

    Start and goal are in every pose, the goal to the right of the start, so that it is seen how far the body has come.

    Args:
        motion: the motion
        path: a PNG file
        poses: how many at most

    Raises:
        InputError: the path is not that of a PNG file in a folder
        RunError: there is no OpenGL here
    """
    target = _checked(path, ".png")
    with _Stage(motion, _PANEL_PX) as stage:
        width, height = stage.size
        rows, columns = strip_layout(len(strip_instants(motion, poses)), width / height)
        chosen = strip_instants(motion, rows * columns)
        strip = Image.new("RGB", (columns * width, rows * height), "white")
        for place, k in enumerate(chosen):
            corner = (place % columns * width, place // columns * height)
            strip.paste(_captioned(stage.pose(k), motion, k), corner)
    draw = ImageDraw.Draw(strip)
    for column in range(1, columns):
        draw.line([(column * width, 0), (column * width, strip.height)], fill="white", width=4)
    for row in range(1, rows):
        draw.line([(0, row * height), (strip.width, row * height)], fill="white", width=4)
    strip.save(target)


def strip_instants(motion: Motion, poses: int) -> list[int]:
    """Choose the instants of a strip among those in which the body moves, and the last one.

    Args:
        motion: the motion
        poses: how many

    Returns:
        Increasing indices, at most `poses` of them.
    """
    n, moving = len(motion.time_s), moving_instants(motion)
    if moving > _ALL_THE_TIME * n or poses < 4:
        return choose_poses(motion.clearance_m, poses)
    return [*choose_poses(motion.clearance_m[:moving], poses - 1), n - 1]


def strip_layout(poses: int, aspect: float) -> tuple[int, int]:
    """Lay poses out in as few rows as do not make the picture too wide for a page.

    Args:
        poses: how many at most
        aspect: width over height of one

    Returns:
        rows and columns, all of which are filled.
    """
    rows = next(rows for rows in range(1, poses + 1) if poses // rows * aspect <= rows * _STRIP_ASPECT_MAX)
    return rows, poses // rows


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
    n = len(motion.time_s)
    with _Stage(motion, _VIDEO_PX[1], _VIDEO_PX[0]) as stage:
        frames = (np.asarray(_captioned(stage.pose(k), motion, k)) for k in range(n))
        _encode(frames, target, 1.0 / motion.rig.period_s)


def moving_instants(motion: Motion) -> int:
    """Return how many instants pass until the body comes to rest for good: its base, its angles and its joints.

    Args:
        motion: the motion

    Returns:
        1 at least, all of them at most.
    """
    away = np.abs(motion.base[:, :3] - motion.base[-1, :3]).max(axis=1)
    angles = np.concatenate([motion.base[:, 3:], motion.joint_rad], axis=1)
    # a turn is no turn: what counts is where it points
    turned = np.abs(np.angle(np.exp(1j * (angles - angles[-1])))).max(axis=1)
    moving = np.flatnonzero((away > _REST_M) | (turned > _REST_RAD))
    return min(int(moving[-1]) + 2, len(away)) if len(moving) else 1


def choose_poses(clearance_m: FloatArray, poses: int) -> list[int]:
    """Choose the instants of a strip: first and last, and evenly in between the highest and the lowest by turns.

    Args:
        clearance_m: height of the lowest foot at each instant [m], (n,)
        poses: how many

    Returns:
        Increasing indices, at most `poses` of them.
    """
    n = len(clearance_m)
    if n <= poses:
        return list(range(n))
    if poses < 3:
        return [0, n - 1][:poses]
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
    """Pose a rig's body between its start and its goal, and draw it.

    The picture's height is given; its width too, or else it is as wide as what the frame holds.
    """

    def __init__(self, motion: Motion, height: int, width: int | None = None) -> None:
        self._motion = motion
        start = motion.base[0, :2]
        way = np.asarray(motion.goal) - start
        direction = math.atan2(way[1], way[0]) if math.hypot(*way) > _NOWHERE_M else float(motion.base[0, 3])
        self._model = build_model(motion.rig, scene=lambda spec: _mark(spec, motion, direction))
        self._data = mujoco.MjData(self._model)
        self._layout = body_layout(self._model, motion.rig)
        framed = sorted({*range(0, len(motion.time_s), _FRAMED_EVERY), len(motion.time_s) - 1})
        frame = frame_of(self._model, map(self._posed, framed), (start[0], start[1]), direction)
        aspect = frame.width_m / frame.height_m
        if width is None:
            width = round(height * aspect / 2) * 2
        elif aspect > width / height:
            frame = replace(frame, height_m=frame.width_m * height / width)
        self.size = (width, height)
        self._camera = look(self._model, frame)
        self._offscreen = Offscreen(self._model, *self.size)

    def __enter__(self) -> _Stage:
        return self

    def __exit__(self, *_: object) -> None:
        self._offscreen.close()

    def pose(self, k: int) -> npt.NDArray[np.uint8]:
        """Draw instant k."""
        return self._offscreen.picture(self._posed(k), self._camera)

    def _posed(self, k: int) -> mujoco.MjData:
        """Return the body as it was at instant k."""
        base = self._motion.base[k]
        self._data.qpos[:3] = base[:3]
        self._data.qpos[3:7] = _quaternion(*base[3:])
        self._data.qpos[self._layout.qpos] = self._motion.joint_rad[k]
        mujoco.mj_forward(self._model, self._data)
        return self._data


def _mark(spec: mujoco.MjSpec, motion: Motion, direction: float) -> None:
    """Put the motion's scene, a post where the body started, and its goal into the body's world."""
    if motion.scene is not None:
        motion.scene(spec)
    size = max(1.0, standing_height(spec) / _TALL_M)
    turn = _quaternion(direction, 0.0, 0.0).tolist()
    _add_post(spec, "film_start", (float(motion.base[0, 0]), float(motion.base[0, 1])), turn, size, _START_RGBA)
    goal = spec.body("goal")
    if goal is None:
        _add_post(spec, "film_goal", motion.goal, turn, size, _GOAL_RGBA)
    else:
        # its flag stands behind it, from wherever it is seen
        goal.pos, goal.quat = [*motion.goal, goal.pos[2]], turn


def _add_post(
    spec: mujoco.MjSpec, name: str, place: tuple[float, float], turn: list[float], size: float, rgba: list[float]
) -> None:
    """Add a line on the floor, across the way, with a post at its far end."""
    body = spec.worldbody.add_body(name=name, pos=[*place, 0.0005], quat=turn)
    box = mujoco.mjtGeom.mjGEOM_BOX
    for part, half, pos in (
        ("line", [0.0015, 0.1, 0.0005], [0.0, 0.0, 0.0]),
        ("post", [0.0015, 0.0015, 0.03], [0.0, 0.1, 0.03]),
    ):
        geom = body.add_geom(name=f"{name}_{part}", type=box, contype=0, conaffinity=0, mass=0.0, rgba=rgba)
        geom.size, geom.pos = [size * one for one in half], [size * one for one in pos]


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
    away = math.hypot(motion.goal[0] - motion.base[k, 0], motion.goal[1] - motion.base[k, 1])
    words = [(f"{motion.time_s[k]:.2f} s", _INK), (f"{100 * away:.1f} cm to goal", _GOAL)]
    if motion.clearance_m[k] >= HOP_CLEARANCE_M:
        words.append((f"{1000 * motion.clearance_m[k]:.0f} mm in the air", _AIR))
    font, x, y = ImageFont.load_default(_TEXT_PX), 10.0, 6.0
    for text, colour in words:
        left, top, right, bottom = draw.textbbox((x, y), text, font=font)
        draw.rounded_rectangle((left - 4, top - 3, right + 4, bottom + 3), 4, fill=_PAPER)
        draw.text((x, y), text, fill=colour, font=font)
        x += draw.textlength(text, font=font) + 18
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
