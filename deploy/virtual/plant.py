"""The body behind the virtual servos: MuJoCo, moved in whole steps, with the twin's differences."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final, Literal

import mujoco
import numpy as np
import numpy.typing as npt

from controller.errors import InputError, RunError
from controller.rig import Rig
from deploy.virtual.mechanics import Mechanics, plays_of
from deploy.virtual.shaft import JointShaft
from deploy.virtual.twin import Twin, check_twin
from deploy.virtual.twin_body import twinned_model
from sim_models.body import (
    Pose,
    base_force,
    base_pose,
    base_rotation,
    body_layout,
    clearance,
    settled_data,
)

TIMESTEP_S: Final = 0.001
"""Step of the virtual rig's physics: finer than the rollouts' [s]."""

JAMMED_NM: Final = 100.0
"""Dry friction of a joint whose horn is stuck: no servo moves it [N m]."""

Start = Literal["settled", "limp"]


@dataclass(frozen=True, eq=False)
class Truth:
    """Hold what only a judge may see.

    Args:
        t: time [s]
        base_pos: centre of the base [m], (3,)
        base_rpy: roll, pitch, yaw of the base [rad], (3,)
        feet_clearance_m: height of the lowest foot [m]
        joint_rad: joint angles [rad], (njoint,)
        joint_vel: joint velocities [rad/s], (njoint,)
    """

    t: float
    base_pos: npt.NDArray[np.float64]
    base_rpy: npt.NDArray[np.float64]
    feet_clearance_m: float
    joint_rad: npt.NDArray[np.float64]
    joint_vel: npt.NDArray[np.float64]


class Plant:
    """Move a rig's body.

    Args:
        rig: the rig
        twin: how its physics differ
        start: "settled": the body stands at its neutral pose, and each joint is held there, as by hand, until its servo
            is first switched on; "limp": nobody holds it
    """

    def __init__(self, rig: Rig, twin: Twin, start: Start) -> None:
        timestep_s = twin.timestep_s or TIMESTEP_S
        self.step_ns = round(timestep_s * 1e9)
        if abs(self.step_ns * 1e-9 - timestep_s) > 1e-15 or round(rig.period_s * 1e9) % self.step_ns:
            raise InputError(
                f"{rig.name}: a physics step of {timestep_s:g} s does not divide the period of {rig.period_s:g} s; "
                "choose another timestep_s"
            )
        check_twin(twin, (joint.name for joint in rig.joints), rig.name)
        self._open_circuit_v = twin.open_circuit_v(rig.supply_v)
        self._twin = twin
        self._rig = rig
        settled: Any = twinned_model(rig, twin, timestep_s, inputs=False)
        self._model: Any = twinned_model(rig, twin, timestep_s, inputs=True)
        self._data: Any = mujoco.MjData(self._model)
        self._layout = body_layout(self._model, rig)
        _copy_pose(settled, settled_data(settled, rig), self._model, self._data)
        self._standing = np.array(self._data.qpos)
        plays = plays_of(rig, self._model, self._data)
        self._body = Mechanics(twin, self._model, self._data, self._layout, plays, self._open_circuit_v)
        self.shafts = tuple(
            JointShaft(self._body, joint, index, held=start == "settled") for index, joint in enumerate(rig.joints)
        )
        self._pose = (-1, Pose(0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        self._free_friction = np.array(self._model.dof_frictionloss[self._layout.dof])
        self._free_solref = np.array(self._model.dof_solref[self._layout.dof])
        self._free_solimp = np.array(self._model.dof_solimp[self._layout.dof, :2])
        self._friction = self._free_friction.copy()

    @property
    def time_ns(self) -> int:
        """Return how far the body has moved [ns]."""
        return self._body.time_ns

    def step(self, count: int) -> None:
        """Move the body.

        Args:
            count: physics steps

        Raises:
            RunError: the physics diverged
        """
        dt = self.step_ns * 1e-9
        body, commands = self._body, self._body.commands
        every = self._twin.stiction_scale != 1.0 or self._twin.supply_ohm > 0.0
        stepped = [shaft for shaft in self.shafts if shaft.stepped]
        while count > 0:
            while commands and commands[0][0] <= body.time_ns:
                _, index, mode, goal = commands.popleft()
                self.shafts[index].take(mode, goal)
            if every:
                self._stick()
                self._sag()
            for shaft in stepped:
                shaft.step(dt)
            block = 1 if every or stepped or commands else count
            mujoco.mj_step(self._model, self._data, block)
            body.time_ns += block * self.step_ns
            count -= block
        if not math.isfinite(self._data.qpos[2]) or self._data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
            raise RunError(
                f"the virtual rig's physics diverged at {self.time_ns * 1e-9:.3f} s; give the twin a smaller timestep_s"
            )

    def set_supply(self, volts: float | None) -> None:
        """Change the supply's voltage without load.

        Args:
            volts: [V]; None: as it was at the beginning
        """
        self._open_circuit_v = self._twin.open_circuit_v(self._rig.supply_v) if volts is None else volts
        self._set_voltage(self._open_circuit_v)

    def jam(self, index: int, stuck: bool) -> None:
        """Jam a joint, or free it.

        Args:
            index: joint
            stuck: whether it can not move
        """
        dof = self._layout.dof[index]
        self._friction[index] = JAMMED_NM if stuck else self._free_friction[index]
        self._model.dof_frictionloss[dof] = self._friction[index]
        # friction is soft by nature: what is jammed creeps as little as the step allows
        self._model.dof_solref[dof] = (2e-9 * self.step_ns, 1.0) if stuck else self._free_solref[index]
        self._model.dof_solimp[dof, :2] = 0.9999 if stuck else self._free_solimp[index]

    def set_upright(self) -> None:
        """Put the body back where it stood, at rest, as a person would; joints without torque are held again."""
        self._data.qpos[:] = self._standing
        self._data.qvel[:] = 0.0
        self._data.qacc_warmstart[:] = 0.0
        for shaft in self.shafts:
            shaft.hold()
        mujoco.mj_forward(self._model, self._data)

    def measure(self, name: str) -> float:
        """Return what a sensor of a name measures now, SI.

        Args:
            name: "x", "y", "z", "heading", "roll", "pitch" or "force"
        """
        if name == "force":
            return base_force(self._model, self._data)
        if self._pose[0] != self.time_ns:
            self._pose = (self.time_ns, base_pose(self._model, self._data))
        return float(getattr(self._pose[1], name))

    def truth(self) -> Truth:
        """Return the state for judges."""
        rotation = base_rotation(self._model, self._data)
        roll = math.atan2(rotation[2, 1], rotation[2, 2])
        pitch = math.asin(min(1.0, max(-1.0, -rotation[2, 0])))
        yaw = math.atan2(rotation[1, 0], rotation[0, 0])
        return Truth(
            t=self.time_ns * 1e-9,
            base_pos=np.array(self._data.qpos[:3]),
            base_rpy=np.array([roll, pitch, yaw]),
            feet_clearance_m=clearance(self._model, self._data, self._layout),
            joint_rad=np.array([shaft.angle() for shaft in self.shafts]),
            joint_vel=np.array([shaft.rate() for shaft in self.shafts]),
        )

    def _stick(self) -> None:
        """Raise the friction of joints that stand (Stribeck)."""
        twin = self._twin
        for index, dof in enumerate(self._layout.dof):
            speed = float(self._data.qvel[dof]) / twin.stiction_speed_rad_s
            excess = (twin.stiction_scale - 1.0) * math.exp(-speed * speed)
            self._model.dof_frictionloss[dof] = self._friction[index] * (1.0 + excess)

    def _sag(self) -> None:
        """Let the supply sag under the currents that the motors draw."""
        if self._twin.supply_ohm > 0.0:
            # a bridge at half duty draws half the motor's current; what a motor gives back is lost
            drawn = sum(max(0.0, shaft.duty() * shaft.current()) for shaft in self.shafts)
            self._set_voltage(max(0.0, self._open_circuit_v - self._twin.supply_ohm * drawn))

    def _set_voltage(self, volts: float) -> None:
        if volts != self._body.supply_v:
            self._body.supply_v = volts
            for shaft in self.shafts:
                shaft.refresh()


def _copy_pose(source: Any, settled: Any, model: Any, data: Any) -> None:  # noqa: ANN401  MuJoCo's types lack their fields
    """Put a body where one without play has settled."""
    for number in range(source.njnt):
        here = model.joint(source.joint(number).name).qposadr[0]
        there = source.jnt_qposadr[number]
        width = 7 if source.jnt_type[number] == mujoco.mjtJoint.mjJNT_FREE else 1
        data.qpos[here : here + width] = settled.qpos[there : there + width]
    mujoco.mj_forward(model, data)
