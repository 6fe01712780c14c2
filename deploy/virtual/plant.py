"""The body behind the virtual servos: MuJoCo, moved in whole steps, with the twin's differences."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Any, Final, Literal

import mujoco
import numpy as np
import numpy.typing as npt

from controller.errors import InputError, RunError
from controller.rig import Rig
from deploy.virtual.drive import Mode
from deploy.virtual.shaft import JointShaft
from deploy.virtual.twin import Twin
from sim_models.body import (
    Pose,
    Scene,
    base_force,
    base_pose,
    base_rotation,
    body_layout,
    build_model,
    clearance,
    settled_data,
)

TIMESTEP_S: Final = 0.001
"""Step of the virtual rig's physics: finer than the rollouts' [s]."""

_INPUTS: Final = mujoco.mjtCtrlInput.mjINPUT_POS | mujoco.mjtCtrlInput.mjINPUT_VEL | mujoco.mjtCtrlInput.mjINPUT_FF

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
        self.supply_v = twin.supply_v or rig.supply_v
        self.twin = twin
        settled = self._build(rig, timestep_s)
        self.model: Any = self._build(rig, timestep_s, lambda spec: _add_inputs(spec, rig))
        self.data: Any = mujoco.MjData(self.model)
        self.data.qpos[:] = settled_data(settled, rig).qpos
        mujoco.mj_forward(self.model, self.data)
        self.layout = body_layout(self.model, rig)
        self.shafts = tuple(
            JointShaft(self, joint, index, held=start == "settled") for index, joint in enumerate(rig.joints)
        )
        self.time_ns = 0
        self._pose = (-1, Pose(0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        self._friction = np.array(self.model.dof_frictionloss[self.layout.dof])
        self._delay_ns = round(twin.command_latency_s * 1e9)
        self._commands: deque[tuple[int, int, Mode, float]] = deque()  # (due [ns], joint, mode, goal)

    def step(self, count: int) -> None:
        """Move the body.

        Args:
            count: physics steps

        Raises:
            RunError: the physics diverged
        """
        stiction = self.twin.stiction_scale != 1.0
        while count > 0:
            while self._commands and self._commands[0][0] <= self.time_ns:
                _, index, mode, goal = self._commands.popleft()
                self.shafts[index].take(mode, goal)
            if stiction:
                self._stick()
            block = 1 if stiction or self._commands else count
            mujoco.mj_step(self.model, self.data, block)
            self.time_ns += block * self.step_ns
            count -= block
        if not math.isfinite(self.data.qpos[2]) or self.data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
            raise RunError(
                f"the virtual rig's physics diverged at {self.time_ns * 1e-9:.3f} s; give the twin a smaller timestep_s"
            )

    def command(self, index: int, mode: Mode, goal: float) -> None:
        """Give a joint's motor a goal, after the twin's latency.

        Args:
            index: joint
            mode: what the goal is
            goal: by the mode
        """
        if self._delay_ns:
            self._commands.append((self.time_ns + self._delay_ns, index, mode, goal))
        else:
            self.shafts[index].take(mode, goal)

    def measure(self, name: str) -> float:
        """Return what a sensor of a name measures now, SI.

        Args:
            name: "x", "y", "z", "heading", "roll", "pitch" or "force"
        """
        if name == "force":
            return base_force(self.model, self.data)
        if self._pose[0] != self.time_ns:
            self._pose = (self.time_ns, base_pose(self.model, self.data))
        return float(getattr(self._pose[1], name))

    def truth(self) -> Truth:
        """Return the state for judges."""
        rotation = base_rotation(self.model, self.data)
        roll = math.atan2(rotation[2, 1], rotation[2, 2])
        pitch = math.asin(min(1.0, max(-1.0, -rotation[2, 0])))
        yaw = math.atan2(rotation[1, 0], rotation[0, 0])
        return Truth(
            t=self.time_ns * 1e-9,
            base_pos=np.array(self.data.qpos[:3]),
            base_rpy=np.array([roll, pitch, yaw]),
            feet_clearance_m=clearance(self.model, self.data, self.layout),
            joint_rad=np.array(self.data.qpos[self.layout.qpos]),
            joint_vel=np.array(self.data.qvel[self.layout.dof]),
        )

    def _build(self, rig: Rig, timestep_s: float, scene: Scene | None = None) -> mujoco.MjModel:
        """Compile the body with the twin's differences."""
        twin = self.twin
        model: Any = build_model(rig, form="free", timestep_s=timestep_s, lean=True, scene=scene)
        model.geom_friction[:, 0] *= twin.friction_scale
        model.body_mass[:] *= twin.mass_scale
        model.body_inertia[:] *= twin.mass_scale
        model.dof_frictionloss[:] *= twin.joint_friction_scale
        model.dof_damping[:] *= twin.joint_damping_scale
        model.dof_armature[:] *= twin.armature_scale
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return model

    def _stick(self) -> None:
        """Raise the friction of joints that stand (Stribeck)."""
        twin = self.twin
        for index, dof in enumerate(self.layout.dof):
            speed = float(self.data.qvel[dof]) / twin.stiction_speed_rad_s
            excess = (twin.stiction_scale - 1.0) * math.exp(-speed * speed)
            self.model.dof_frictionloss[dof] = self._friction[index] * (1.0 + excess)


def _add_inputs(spec: mujoco.MjSpec, rig: Rig) -> None:
    """Give each servo's motor the inputs of every mode: angle, velocity and torque."""
    for joint in rig.joints:
        product = joint.product
        spec.actuator(joint.name).set_to_dcmotor(
            [0.0, 0.0],
            0.0,
            nominal=[product.voltage_v, product.stall_torque_nm, product.no_load_speed_rad_s],
            saturation=[product.stall_torque_nm, 0.0, 0.0],
            controller=[1.0, 0.0, 1.0, 0.0, 0.0, product.voltage_v],
            ctrlspec=int(_INPUTS),
        )
