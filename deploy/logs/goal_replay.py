"""Replay commanded goals in simulation, each at the time at which it reached the servos, and sample the body."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from controller.rig import Rig
from deploy.logs.comparison import Array, Track

STEP_S: Final = 0.001
"""Simulation step [s]. Steps count from the log's time 0; what arrives within a step acts from its beginning."""


@dataclass(frozen=True, eq=False)
class Start:
    """Hold the state that a run begins from, at rest but for the creep of joints under load.

    Args:
        time_s: when that was [s]
        joint_rad: joint angles [rad], (njoint,)
        joint_vel: joint velocities [rad/s], (njoint,); None: as the body settles
        held_rad: goals standing at the servos [rad], (njoint,)
        base: base position [m] and roll, pitch, yaw [rad], (6,), as a virtual rig's judge saw them; None: the body
            stands under `held_rad` until it has settled on its feet
    """

    time_s: float
    joint_rad: Array
    joint_vel: Array | None
    held_rad: Array
    base: Array | None


@dataclass(frozen=True, eq=False)
class GoalWrites:
    """Hold goals and when they reached the servos.

    Args:
        time_s: ascending [s], (ngoal,)
        angle_rad: goal angles [rad], (ngoal, njoint)
    """

    time_s: Array
    angle_rad: Array


@dataclass(frozen=True, eq=False)
class SampleTimes:
    """Say when to look.

    Args:
        joint_s: at the joints, ascending [s], (nsample,)
        pose_s: at the base, ascending [s], (npose,)
        force_s: at the contact force, ascending [s], (nforce,)
    """

    joint_s: Array
    pose_s: Array
    force_s: Array


def replay_goals(rig: Rig, start: Start, goals: GoalWrites, samples: SampleTimes) -> Track:
    """Drive the rig's nominal simulation, base free, with logged goals; it sees nothing else of the run.

    Args:
        rig: the rig, with the gains that its servos were given
        start: where it begins
        goals: what the servos were told
        samples: when to look; before the start it is there that the body is

    Returns:
        what the simulation did, in the frame of its start
    """
    body = _Body(rig, start)
    # samples first: what arrives at an instant acts from then on
    looks = (samples.joint_s, samples.pose_s, samples.force_s, goals.time_s)
    agenda = sorted((float(t), kind, index) for kind, times in enumerate(looks) for index, t in enumerate(times))
    joint_rad = np.empty((len(samples.joint_s), len(rig.joints)))
    position_m = np.empty((len(samples.pose_s), 3))
    tilt_rad, clearance_m = np.empty((2, len(samples.pose_s)))
    force_n = np.empty(len(samples.force_s))
    for t, kind, index in agenda:
        body.advance(t)
        if kind == 0:
            joint_rad[index] = body.joint_rad()
        elif kind == 1:
            position_m[index], tilt_rad[index], clearance_m[index] = body.base()
        elif kind == 2:
            force_n[index] = body.force_n()
        else:
            body.aim(goals.angle_rad[index])
    return Track(joint_rad, position_m, tilt_rad, clearance_m, force_n)


class _Body:
    """The simulated body at the last step that has begun."""

    def __init__(self, rig: Rig, start: Start) -> None:
        # MuJoCo is not on every machine that drives servos
        import mujoco

        from sim_models.body import SETTLE_S, base_pose, body_layout, build_model

        self._model = build_model(rig, form="free", timestep_s=STEP_S, lean=True)
        self._data = mujoco.MjData(self._model)
        self._layout = body_layout(self._model, rig)
        self._step = _step_at(start.time_s)
        self._data.qpos[self._layout.qpos] = start.joint_rad
        self.aim(start.held_rad)
        if start.base is None:
            mujoco.mj_step(self._model, self._data, round(SETTLE_S / STEP_S))
            self._data.qvel[:] = 0.0
            self._data.qacc_warmstart[:] = 0.0
        else:
            self._data.qpos[:3] = start.base[:3]
            self._data.qpos[3:7] = _quaternion(*start.base[3:])
        if start.joint_vel is not None:
            self._data.qvel[self._layout.dof] = start.joint_vel
        mujoco.mj_forward(self._model, self._data)
        pose = base_pose(self._model, self._data)
        self._start = (pose.x, pose.y, pose.heading)

    def aim(self, goal_rad: Array) -> None:
        """Let goals arrive at the servos."""
        self._data.ctrl[self._layout.actuator] = goal_rad

    def advance(self, t: float) -> None:
        """Move to the step that begins at a time or holds it."""
        import mujoco

        step = _step_at(t)
        if step > self._step:
            mujoco.mj_step(self._model, self._data, step - self._step)
            self._step = step

    def joint_rad(self) -> Array:
        """Return the joints' angles [rad], (njoint,)."""
        angles: Array = self._data.qpos[self._layout.qpos]
        return angles

    def base(self) -> tuple[Array, float, float]:
        """Return position in the frame of the start [m], tilt [rad] and clearance of the lowest foot [m]."""
        from sim_models.body import base_pose, clearance

        pose = base_pose(self._model, self._data)
        x, y = to_start_frame(np.array([pose.x]), np.array([pose.y]), self._start)
        position = np.array([x[0], y[0], pose.z])
        return position, tilt(pose.roll, pose.pitch), clearance(self._model, self._data, self._layout)

    def force_n(self) -> float:
        """Return the contact force on the base, as its load cell sums it [N]."""
        from sim_models.body import base_force

        return base_force(self._model, self._data)


def _step_at(t: float) -> int:
    return math.floor(t / STEP_S + 1e-6)


def _quaternion(roll: float, pitch: float, yaw: float) -> Array:
    """Return the rotation about x, then y, then z, as w, x, y, z."""
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(angle / 2), math.sin(angle / 2)) for angle in (roll, pitch, yaw))
    return np.array(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def to_start_frame(x: Array, y: Array, start: tuple[float, float, float]) -> tuple[Array, Array]:
    """Express positions in the frame of the base at the start: x forward, y to the left.

    Args:
        x: [m], (n,)
        y: [m], (n,)
        start: x [m], y [m] and heading [rad] of the base at the start

    Returns:
        x and y in that frame [m], (n,) each
    """
    cosine, sine = math.cos(start[2]), math.sin(start[2])
    forward, left = x - start[0], y - start[1]
    return cosine * forward + sine * left, cosine * left - sine * forward


def tilt(roll: float, pitch: float) -> float:
    """Return the angle between the base's normal and the vertical [rad].

    Args:
        roll: about x [rad]
        pitch: about y [rad]
    """
    return math.acos(max(-1.0, min(1.0, math.cos(roll) * math.cos(pitch))))
