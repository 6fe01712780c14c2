"""A joint's servo motor and its encoder: how a drive acts on MuJoCo's ``dcmotor``.

The motor is compiled with three inputs, angle, velocity and torque, and each mode uses the one that it needs; in
voltage mode it is the torque of the stalled motor, which its back-EMF then lessens. So a mode changes while the body
moves, by rewriting gains.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from controller.rig import Joint
from deploy.virtual.drive import Drive, Law, Mode
from sim_models.servo import ServoParameters, set_servo, set_torque

if TYPE_CHECKING:
    from deploy.virtual.plant import Plant

HAND: Final = Drive(on=True, mode="position", law=Law(kp=1.0 / 0.12))
"""How a joint is held as by hand: full torque from 0.12 rad on."""

_ANGLE, _VELOCITY, _TORQUE = 0, 1, 2


class JointShaft:
    """Give a virtual servo its joint, counted as its encoder counts.

    Args:
        plant: the body
        joint: the rig's joint
        index: its place in the rig
        held: whether it is held as by hand until its servo is first switched on
    """

    def __init__(self, plant: Plant, joint: Joint, index: int, held: bool) -> None:
        self._plant = plant
        self._joint = joint
        self._index = index
        self._qpos = int(plant.layout.qpos[index])
        self._dof = int(plant.layout.dof[index])
        self._actuator = int(plant.layout.actuator[index])
        self._inputs = plant.data.ctrl[int(plant.model.actuator_ctrladr[self._actuator]) :]
        self._ticks_per_rad = joint.sign * joint.product.ticks_per_turn / (2.0 * math.pi)
        self._drive: Drive | None = None
        self._held = held
        self._mode: Mode = "position"
        self._goal = 0.0
        self._feedforward = 0.0
        self._inputs[_ANGLE] = joint.neutral_rad
        if joint.mode == "velocity":
            self._set(HAND)
        set_torque(plant.model, self._actuator, held)

    def ticks(self) -> float:
        """Return the angle, over all turns [ticks]."""
        return self._joint.zero_tick + self._ticks_per_rad * float(self._plant.data.qpos[self._qpos])

    def speed(self) -> float:
        """Return the angular velocity [rad/s]."""
        return self._joint.sign * float(self._plant.data.qvel[self._dof])

    def torque(self) -> float:
        """Return the motor's torque [N m]."""
        driven = self._drive is not None and (self._drive.on or self._drive.brake)
        return self._joint.sign * float(self._plant.data.actuator_force[self._actuator]) if driven else 0.0

    def duty(self) -> float:
        """Return the PWM duty, -1 to 1: what makes this torque at this speed."""
        if self._drive is None or not self._drive.on or self._plant.supply_v <= 0.0:
            return 0.0
        product, twin = self._joint.product, self._plant.twin
        stall = product.stall_torque_nm * twin.torque_scale
        share = self.torque() / stall + self.speed() / product.no_load_speed_rad_s
        return min(1.0, max(-1.0, share * product.voltage_v / self._plant.supply_v))

    def current(self) -> float:
        """Return the motor's current, signed as the torque [A]."""
        product = self._joint.product
        return product.stall_current_a * self.torque() / product.stall_torque_nm

    def supply(self) -> float:
        """Return the supply voltage at the servo [V]."""
        return self._plant.supply_v

    def drive(self, drive: Drive) -> None:
        """Change how the servo drives the joint.

        Args:
            drive: by its registers
        """
        self._drive = drive
        if self._held and not drive.on:
            return
        self._held = False
        changed = drive.mode != self._mode
        self._set(drive)
        if changed:
            # a goal of the old mode means nothing in the new one
            self._goal = self.ticks() if drive.mode == "position" else 0.0
            self._apply()
        set_torque(self._plant.model, self._actuator, drive.on or drive.brake)

    def aim(self, value: float) -> None:
        """Set where the servo drives the joint to.

        Args:
            value: by the drive's mode: an angle [ticks], a velocity [rad/s] or a duty
        """
        self._plant.command(self._index, self._mode, value)

    def take(self, mode: Mode, value: float) -> None:
        """Let a goal act that `aim` gave, unless the mode has changed since.

        Args:
            mode: of the drive when it was given
            value: as `aim` has it
        """
        if not self._held and mode == self._mode:
            self._goal = value
            self._apply()

    def feedforward(self, duty: float) -> None:
        """Add a duty to what the law gives.

        Args:
            duty: -1 to 1
        """
        self._feedforward = duty
        if not self._held:
            self._apply()

    # inside

    def _set(self, drive: Drive) -> None:
        """Write a drive into the model's motor."""
        plant, product, law = self._plant, self._joint.product, drive.law
        k = product.voltage_v / product.no_load_speed_rad_s
        r = k * product.voltage_v / (product.stall_torque_nm * plant.twin.torque_scale)
        # MuJoCo reads a voltage limit of 0 as none: no PWM at all is a gain of 0 instead
        self._torque_per_duty = k / r * plant.supply_v if drive.on and law.duty_max > 0.0 else 0.0
        brake = k * k / r
        gain = self._torque_per_duty * law.kp
        kp, kd = 0.0, brake
        self._velocity_scale = 0.0
        if drive.mode == "position":
            kp, kd = gain * plant.twin.p_gain_scale, brake + self._torque_per_duty * law.kd
        elif drive.mode == "velocity":
            kd = brake + gain
            self._velocity_scale = gain / kd
        stall = product.stall_torque_nm * plant.twin.torque_scale
        set_servo(
            plant.model,
            self._actuator,
            ServoParameters(
                resistance=r,
                motor_constant=k,
                kp=kp,
                kd=kd,
                voltage_max=law.duty_max * plant.supply_v,
                torque_max=min(
                    stall * plant.supply_v / product.voltage_v, stall * drive.torque_max, stall * law.torque_share_max
                ),
            ),
        )
        self._mode = drive.mode

    def _apply(self) -> None:
        """Write the goal where the mode reads it."""
        sign, inputs = self._joint.sign, self._inputs
        torque = sign * self._torque_per_duty * self._feedforward
        inputs[_VELOCITY] = 0.0
        if self._mode == "position":
            inputs[_ANGLE] = (self._goal - self._joint.zero_tick) / self._ticks_per_rad
        elif self._mode == "velocity":
            inputs[_VELOCITY] = sign * self._goal * self._velocity_scale
        else:
            torque += sign * self._torque_per_duty * self._goal
        inputs[_TORQUE] = torque
