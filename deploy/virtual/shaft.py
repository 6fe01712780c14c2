"""A joint's servo motor and its encoder: how a drive acts on MuJoCo's ``dcmotor``.

The motor is compiled with three inputs, angle, velocity and torque, and each mode uses the one that it needs; in
voltage mode it is the torque of the stalled motor, which its back-EMF then lessens. So a mode changes while the body
moves, by rewriting gains.

What the motor's own controller lacks, an integral, a dead zone, a voltage that rises slowly, gears with play between
motor and encoder, is reckoned before each physics step. Drives without it cost nothing.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

from controller.rig import Joint
from deploy.virtual.drive import Drive, Law, Mode
from deploy.virtual.mechanics import Mechanics
from sim_models.servo import ServoParameters, set_servo, set_torque

_HAND: Final = Drive(on=True, mode="position", law=Law(kp=1.0 / 0.12))
"""How a joint in velocity mode is held as by hand: full torque from 0.12 rad on."""

_ANGLE, _VELOCITY, _TORQUE = 0, 1, 2


class JointShaft:
    """Give a virtual servo its joint, counted as its encoder counts.

    Args:
        body: the body
        joint: the rig's joint
        index: its place in the rig
        held: whether it is held as by hand until its servo is first switched on
    """

    def __init__(self, body: Mechanics, joint: Joint, index: int, held: bool) -> None:
        self._body = body
        self._joint = joint
        self._index = index
        self._twin = body.twin.joint(joint.name)
        data = body.data
        self._qpos = data.qpos[int(body.layout.qpos[index]) :]
        self._qvel = data.qvel[int(body.layout.dof[index]) :]
        self._actuator = int(body.layout.actuator[index])
        self._inputs = data.ctrl[int(body.model.actuator_ctrladr[self._actuator]) :]
        self._play = body.plays[index]
        self._ticks_per_rad = joint.sign * joint.product.ticks_per_turn / (2.0 * math.pi)
        self._zero = joint.zero_tick + self._ticks_per_rad * self._twin.encoder_bias_rad
        self._held = held
        self._drive = Drive(on=False, mode="position", law=Law())
        self._stepped = False
        self._goal = self.ticks()
        self._feedforward = 0.0
        self._integral = 0.0
        self._volts = 0.0
        if joint.mode == "velocity":
            self._write(_HAND)
        self._inputs[_ANGLE] = joint.neutral_rad
        set_torque(body.model, self._actuator, held)

    # what the servo sees and does

    def ticks(self) -> float:
        """Return the angle, over all turns [ticks]."""
        return self._zero + self._ticks_per_rad * self.angle()

    def speed(self) -> float:
        """Return the angular velocity [rad/s]."""
        return self._joint.sign * self.rate()

    def torque(self) -> float:
        """Return the motor's torque [N m]."""
        driven = self._drive.on or self._drive.brake
        return self._joint.sign * float(self._body.data.actuator_force[self._actuator]) if driven else 0.0

    def duty(self) -> float:
        """Return the PWM duty, -1 to 1: what makes this torque at this speed."""
        if not self._drive.on or self._body.supply_v <= 0.0:
            return 0.0
        product, twin = self._joint.product, self._twin
        stall = product.stall_torque_nm * twin.torque_scale * twin.torque_constant_scale
        share = self.torque() / stall + self.speed() / product.no_load_speed_rad_s * twin.torque_constant_scale
        return min(1.0, max(-1.0, share * product.voltage_v / self._body.supply_v))

    def current(self) -> float:
        """Return the motor's current, signed as the torque [A]."""
        product = self._joint.product
        return product.stall_current_a * self.torque() / (product.stall_torque_nm * self._twin.torque_constant_scale)

    def supply(self) -> float:
        """Return the supply voltage at the servo [V]."""
        return self._body.supply_v

    def drive(self, drive: Drive) -> None:
        """Change how the servo drives the joint.

        Args:
            drive: by its registers
        """
        drive = replace(drive, slope_v_s=drive.slope_v_s * self._twin.voltage_slope_scale)
        if drive.mode != self._drive.mode:
            self._integral = self._feedforward = 0.0
            # a goal of the old mode means nothing in the new one
            self._goal = self.ticks() if drive.mode == "position" else 0.0
        if not drive.on:
            self._volts = self._integral = self._feedforward = 0.0
        self._drive = drive
        if self._held and not drive.on:
            return
        self._held = False
        self._write(drive)
        self._stepped = self._play is not None or _needs_steps(drive)
        self._apply()
        set_torque(self._body.model, self._actuator, drive.on or drive.brake)

    def aim(self, value: float) -> None:
        """Set where the servo drives the joint to.

        Args:
            value: by the drive's mode: an angle [ticks], a velocity [rad/s] or a duty
        """
        delay_ns = self._body.delay_ns
        if delay_ns:
            self._body.commands.append((self._body.time_ns + delay_ns, self._index, self._drive.mode, value))
        else:
            self.take(self._drive.mode, value)

    def feedforward(self, duty: float) -> None:
        """Add a duty to what the law gives.

        Args:
            duty: -1 to 1
        """
        self._feedforward = duty
        if not self._held:
            self._apply()

    # what the plant does

    def hold(self) -> None:
        """Be held at neutral, as by hand, until the servo is switched on; one that is on already holds itself."""
        if self._drive.on:
            return
        self._held = True
        self._stepped = False
        self._write(_HAND)
        self._inputs[_VELOCITY] = self._inputs[_TORQUE] = 0.0
        self._inputs[_ANGLE] = self._joint.neutral_rad
        set_torque(self._body.model, self._actuator, True)

    def angle(self) -> float:
        """Return the angle of the encoder's shaft [rad]."""
        return float(self._qpos[0]) + (0.0 if self._play is None else float(self._play[0][0]))

    def rate(self) -> float:
        """Return the angular velocity of the encoder's shaft [rad/s]."""
        return float(self._qvel[0]) + (0.0 if self._play is None else float(self._play[1][0]))

    def take(self, mode: Mode, value: float) -> None:
        """Let a goal act that `aim` gave, unless the mode has changed since.

        Args:
            mode: of the drive when it was given
            value: as `aim` has it
        """
        if mode != self._drive.mode:
            return
        self._goal = value
        if not self._held:
            self._apply()

    def refresh(self) -> None:
        """Drive with the supply as it is now."""
        if not self._held:
            self._write(self._drive)
            self._apply()

    def slip(self, ticks: float) -> None:
        """Let the encoder count further than before, as one does whose magnet slipped.

        Args:
            ticks: how much
        """
        self._zero += ticks
        if not self._held:
            self._apply()

    @property
    def stepped(self) -> bool:
        """Return whether the drive needs `step` before each physics step."""
        return self._stepped

    def step(self, dt: float) -> None:
        """Reckon what the motor's own controller lacks.

        Args:
            dt: physics step [s]
        """
        drive, law, inputs = self._drive, self._drive.law, self._inputs
        sign, rate = self._joint.sign, self.rate()
        error = proportional = added = 0.0
        if drive.mode == "position":
            error = (self._goal - self._zero) / self._ticks_per_rad - self.angle()
            error -= min(max(error, -law.dead_zone_rad), law.dead_zone_rad)
            proportional = law.kp * self._twin.p_gain_scale * error - law.kd * self._twin.d_gain_scale * rate
            added = math.copysign(law.punch, error) if error else 0.0
            # the motor holds its own shaft's angle, which play may part from the encoder's
            inputs[_ANGLE] = float(self._qpos[0]) + error
        elif drive.mode == "velocity":
            error = sign * self._goal - rate
            proportional = law.kp * error
        else:
            added = sign * self._goal
        added += self._integral + sign * self._feedforward
        duty = proportional + added
        if abs(duty) < law.duty_max or duty * error < 0.0:
            # a law that is at its limit does not wind up
            self._integral += law.ki * error * dt
        if drive.slope_v_s > 0.0:
            volts = min(max(duty, -law.duty_max), law.duty_max) * self._body.supply_v
            change = drive.slope_v_s * dt
            self._volts = min(max(volts, self._volts - change), self._volts + change)
            added = self._volts / self._body.supply_v if self._body.supply_v > 0.0 else 0.0
        inputs[_TORQUE] = self._torque_per_duty * added

    # inside

    def _write(self, drive: Drive) -> None:
        """Write a drive into the model's motor."""
        body, product, law, twin = self._body, self._joint.product, drive.law, self._twin
        # both as the datasheet has them at the output; the constant is torque per current too, in units of its own
        nominal = product.voltage_v / product.no_load_speed_rad_s
        r = nominal * product.voltage_v / (product.stall_torque_nm * twin.torque_scale)
        k = nominal * twin.torque_constant_scale
        stall = product.stall_torque_nm * twin.torque_scale * twin.torque_constant_scale
        # MuJoCo reads a voltage limit of 0 as none: no PWM at all is a gain of 0 instead
        self._torque_per_duty = k / r * body.supply_v if drive.on and law.duty_max > 0.0 else 0.0
        kp, kd = 0.0, k * k / r  # the motor's own back-EMF, which MuJoCo's controller cancels
        self._velocity_scale = 0.0
        if drive.slope_v_s > 0.0:
            pass  # the law's voltage is reckoned at each step
        elif drive.mode == "position":
            kp = self._torque_per_duty * law.kp * twin.p_gain_scale
            kd += self._torque_per_duty * law.kd * twin.d_gain_scale
        elif drive.mode == "velocity":
            kd += self._torque_per_duty * law.kp
            self._velocity_scale = self._torque_per_duty * law.kp / kd
        limits = (stall * body.supply_v / product.voltage_v, stall * drive.torque_max, stall * law.torque_share_max)
        set_servo(
            body.model,
            self._actuator,
            ServoParameters(
                resistance=r,
                motor_constant=k,
                kp=kp,
                kd=kd,
                voltage_max=law.duty_max * body.supply_v,
                torque_max=min(limits),
            ),
        )

    def _apply(self) -> None:
        """Write the goal where the mode reads it."""
        sign, inputs, drive = self._joint.sign, self._inputs, self._drive
        inputs[_VELOCITY] = sign * self._goal * self._velocity_scale if drive.mode == "velocity" else 0.0
        if drive.mode == "position":
            inputs[_ANGLE] = (self._goal - self._zero) / self._ticks_per_rad
        if not self._stepped:
            duty = self._feedforward + (self._goal if drive.mode == "voltage" else 0.0)
            inputs[_TORQUE] = sign * self._torque_per_duty * duty


def _needs_steps(drive: Drive) -> bool:
    """Return whether a drive asks for more than the motor's own controller does."""
    law = drive.law
    return drive.on and (law.ki != 0.0 or law.dead_zone_rad > 0.0 or law.punch > 0.0 or drive.slope_v_s > 0.0)
