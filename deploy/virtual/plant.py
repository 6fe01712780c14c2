"""The body behind the virtual servos: MuJoCo, moved in whole steps, with the twin's differences."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import mujoco
import numpy as np
import numpy.typing as npt

from controller.errors import InputError, RunError
from controller.rig import Joint, Rig
from deploy.virtual.servo import Drive
from deploy.virtual.twin import Twin
from sim_models.body import (
    Pose,
    base_force,
    base_pose,
    base_rotation,
    body_layout,
    build_model,
    clearance,
    settled_data,
)
from sim_models.servo import servo_parameters, set_servo, set_torque

TIMESTEP_S: Final = 0.001
"""Step of the virtual rig's physics: finer than the rollouts' [s]."""

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
        self.model: Any = build_model(rig, form="free", timestep_s=timestep_s, lean=True)
        self.supply_v = twin.supply_v or rig.supply_v
        self.twin = twin
        self._change_model()
        self.data: Any = settled_data(self.model, rig)
        self.layout = body_layout(self.model, rig)
        self.shafts = tuple(JointShaft(self, joint, index) for index, joint in enumerate(rig.joints))
        self.time_ns = 0
        self._pose = (-1, Pose(0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        self._friction = np.array(self.model.dof_frictionloss[self.layout.dof])
        self._held = [start == "settled"] * len(rig.joints)
        self._delay_ns = round(twin.command_latency_s * 1e9)
        self._commands: deque[tuple[int, int, float]] = deque()  # (due [ns], actuator, goal [rad])
        for actuator, held in zip(self.layout.actuator, self._held, strict=True):
            set_torque(self.model, int(actuator), held)

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
                _, actuator, goal = self._commands.popleft()
                self.data.ctrl[actuator] = goal
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

    def aim(self, index: int, goal_rad: float) -> None:
        """Set where a servo drives its joint to.

        Args:
            index: joint
            goal_rad: angle [rad]
        """
        if self._held[index]:
            return
        actuator = int(self.layout.actuator[index])
        if self._delay_ns:
            self._commands.append((self.time_ns + self._delay_ns, actuator, goal_rad))
        else:
            self.data.ctrl[actuator] = goal_rad

    def drive(self, index: int, joint: Joint, drive: Drive) -> None:
        """Change how a servo drives its joint.

        Args:
            index: joint
            joint: the rig's joint
            drive: by its registers
        """
        if self._held[index] and not drive.on:
            return
        self._held[index] = False
        parameters = servo_parameters(
            joint.product, drive.p_gain, drive.d_gain, drive.pwm_limit, self.supply_v, self.twin.torque_scale
        )
        actuator = int(self.layout.actuator[index])
        set_servo(self.model, actuator, replace(parameters, kp=parameters.kp * self.twin.p_gain_scale))
        set_torque(self.model, actuator, drive.on)

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

    def _change_model(self) -> None:
        twin, model = self.twin, self.model
        model.geom_friction[:, 0] *= twin.friction_scale
        model.body_mass[:] *= twin.mass_scale
        model.body_inertia[:] *= twin.mass_scale
        model.dof_frictionloss[:] *= twin.joint_friction_scale
        model.dof_damping[:] *= twin.joint_damping_scale
        model.dof_armature[:] *= twin.armature_scale
        mujoco.mj_setConst(model, mujoco.MjData(model))

    def _stick(self) -> None:
        """Raise the friction of joints that stand (Stribeck)."""
        twin = self.twin
        for index, dof in enumerate(self.layout.dof):
            speed = float(self.data.qvel[dof]) / twin.stiction_speed_rad_s
            excess = (twin.stiction_scale - 1.0) * math.exp(-speed * speed)
            self.model.dof_frictionloss[dof] = self._friction[index] * (1.0 + excess)


class JointShaft:
    """Give a virtual servo its joint, counted as its encoder counts.

    Args:
        plant: the body
        joint: the rig's joint
        index: its place in the rig
    """

    def __init__(self, plant: Plant, joint: Joint, index: int) -> None:
        self._plant = plant
        self._joint = joint
        self._index = index
        self._qpos = int(plant.layout.qpos[index])
        self._dof = int(plant.layout.dof[index])
        self._actuator = int(plant.layout.actuator[index])
        self._ticks_per_rad = joint.sign * joint.product.ticks_per_turn / (2.0 * math.pi)
        self._on = False

    def ticks(self) -> float:
        """Return the angle [ticks]."""
        return self._joint.zero_tick + self._ticks_per_rad * float(self._plant.data.qpos[self._qpos])

    def speed(self) -> float:
        """Return the angular velocity [rad/s]."""
        return self._joint.sign * float(self._plant.data.qvel[self._dof])

    def torque(self) -> float:
        """Return the motor's torque [N m]."""
        return self._joint.sign * float(self._plant.data.actuator_force[self._actuator]) if self._on else 0.0

    def duty(self) -> float:
        """Return the PWM duty, -1 to 1: what makes this torque at this speed."""
        if not self._on or self._plant.supply_v <= 0.0:
            return 0.0
        product, twin = self._joint.product, self._plant.twin
        stall = product.stall_torque_nm * twin.torque_scale
        share = self.torque() / stall + self.speed() / product.no_load_speed_rad_s
        return min(1.0, max(-1.0, share * product.voltage_v / self._plant.supply_v))

    def supply(self) -> float:
        """Return the supply voltage [V]."""
        return self._plant.supply_v

    def drive(self, drive: Drive) -> None:
        """Change how the servo drives the joint.

        Args:
            drive: by its registers
        """
        self._on = drive.on
        self._plant.drive(self._index, self._joint, drive)

    def aim(self, ticks: float) -> None:
        """Set where the servo drives the joint to.

        Args:
            ticks: encoder count
        """
        self._plant.aim(self._index, (ticks - self._joint.zero_tick) / self._ticks_per_rad)
