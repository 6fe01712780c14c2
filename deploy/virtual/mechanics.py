"""What a body and its motors share: MuJoCo's model and state, the supply, and the goals that are on their way."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import mujoco
import numpy as np
import numpy.typing as npt

from controller.rig import Rig
from deploy.virtual.drive import Mode
from deploy.virtual.twin import Twin
from deploy.virtual.twin_body import PLAY
from sim_models.body import Layout

Play: TypeAlias = tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]
"""Angle and rate of the play between a motor and its encoder."""


@dataclass(eq=False)
class Mechanics:
    """Hold a body as it is now.

    Args:
        twin: how its physics differ
        model: MuJoCo's, with the twin's differences
        data: MuJoCo's
        layout: where the rig's joints are in both
        plays: of each joint, or None if it has none, (njoint,)
        supply_v: supply of the servos, as loaded [V]
        time_ns: how far the body has moved [ns]
        commands: goals that the twin's latency holds up: when due [ns], joint, mode, goal
    """

    twin: Twin
    model: Any
    data: Any
    layout: Layout
    plays: tuple[Play | None, ...]
    supply_v: float
    time_ns: int = 0
    commands: deque[tuple[int, int, Mode, float]] = field(default_factory=deque)

    @property
    def delay_ns(self) -> int:
        """Return how long a goal is held up [ns]."""
        return round(self.twin.command_latency_s * 1e9)


def plays_of(rig: Rig, model: Any, data: Any) -> tuple[Play | None, ...]:  # noqa: ANN401  MuJoCo's types lack their fields
    """Return where the play of each joint is kept, None of one that has none.

    Args:
        rig: the rig
        model: MuJoCo's
        data: MuJoCo's
    """
    plays: list[Play | None] = []
    for joint in rig.joints:
        number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint.mjcf_joint + PLAY)
        if number < 0:
            plays.append(None)
        else:
            plays.append((data.qpos[int(model.jnt_qposadr[number]) :], data.qvel[int(model.jnt_dofadr[number]) :]))
    return tuple(plays)
