"""What the registers of a Feetech servo make its shaft do: modes, profile, homing, turns.

An STS counts 4096 to the turn and shows present = (encoder - homing offset) modulo 4096, measured on an STS3215
(feetech-cli 0.1.8); with bit 4 of its phase register set, or with both angle limits 0, it shows all turns since its
power came. An SCS has a potentiometer over 300 degrees and no offset.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Set
from dataclasses import replace
from typing import Final, Literal

from controller.products import Product
from controller.servo_law import Law, position_law, velocity_law
from deploy.virtual.byte_table import ByteTable
from deploy.virtual.drive import Drive, Shaft
from deploy.virtual.drive import Mode as DriveMode
from deploy.virtual.profile import Profile

Mode = Literal["position", "wheel", "pwm", "step"]

DAMPING: Final = 2
MULTI_TURN: Final = 0x10
_TURN: Final = 4096
_OFFSET_MAX: Final = 2047
_MODES: Final[tuple[Mode, ...]] = ("position", "wheel", "pwm", "step")
_DRIVES: Final[Mapping[Mode, DriveMode]] = {
    "position": "position",
    "wheel": "velocity",
    "pwm": "voltage",
    "step": "position",
}
# the SDK writes the sign of a PWM in bit 10, the memory table has it in bit 11
_PWM_SIGN: Final = 0x0C00
_PWM_BITS: Final = 0x03FF
_GOALS: Final = frozenset({"goal_position", "goal_time", "goal_speed", "acceleration"})
_AIMED: Final = frozenset({"goal_position", "homing_offset", "phase", "min_angle_limit", "max_angle_limit"})


class FeetechMotion:
    """Move a shaft as the registers of a Feetech servo say.

    Args:
        product: which servo
        table: its registers
        shaft: what it turns
    """

    def __init__(self, product: Product, table: ByteTable, shaft: Shaft) -> None:
        self._product = product
        self._table = table
        self._shaft = shaft
        self._sts = "homing_offset" in table.lines
        self._ticks_per_rad = product.ticks_per_turn / (2.0 * math.pi)
        self.power_up()

    def power_up(self) -> None:
        """Begin with the turn that the shaft is in, torque off, the goal where the shaft is."""
        ticks = self._shaft.ticks()
        self._base = ticks // _TURN * _TURN if self._sts else 0.0
        self.profile = Profile(ticks)
        self._target = ticks
        self._cruise = 0.0
        self._wheel_speed = 0.0
        self._mode = self.mode()
        self._was_on = False
        self.moving = False
        self._table["goal_position"] = self.position()
        self.drive(1.0)

    def mode(self) -> Mode:
        """Return what goals mean: an SCS with both angle limits 0 is in PWM mode."""
        if self._sts:
            return _MODES[self._table["operating_mode"]]
        return "pwm" if self._no_limits() else "position"

    def position(self) -> int:
        """Return the present position [counts]."""
        ticks = self._shaft.ticks()
        if not self._sts:
            return self._potentiometer(ticks)
        count = round(ticks - self._base) - self._table["homing_offset"]
        return round(count / self._table["angular_resolution"]) if self._multi_turn() else count % _TURN

    def speed(self) -> int:
        """Return the present speed [counts/s]."""
        return round(self._shaft.speed() * self._ticks_per_rad)

    def changed(self, names: Set[str], duty_max: float) -> None:
        """Act on registers that were written.

        Args:
            names: the registers
            duty_max: what protection leaves of the duty
        """
        if self.mode() != self._mode:
            self._mode = self.mode()
            self._wheel_speed = 0.0
            self._target = self._shaft.ticks()
        elif names & _AIMED and (self._mode == "position" or "goal_position" in names):
            self._aim_at(self._table["goal_position"])
        as_before = self._was_on == (self._table["torque_enable"] == 1) and duty_max == self._duty_max
        if as_before and names <= _GOALS:
            self._follow()
        else:
            self.drive(duty_max)

    def home(self, position: int) -> None:
        """Set the homing offset so that the place where the shaft is has a position; nothing moves.

        Args:
            position: what it is to be [counts]
        """
        ticks = self._shaft.ticks()
        offset = (round(ticks - self._base) - position + _TURN // 2) % _TURN - _TURN // 2
        self._table["homing_offset"] = max(offset, -_OFFSET_MAX)
        self._table["goal_position"] = self.position()
        self._target = ticks
        self.profile.jump(ticks)

    def forget_turns(self) -> None:
        """Count turns from the one that the shaft is in; nothing moves."""
        ticks = self._shaft.ticks()
        self._base = ticks // _TURN * _TURN
        self._table["goal_position"] = self.position()

    def drive(self, duty_max: float) -> None:
        """Drive the shaft by the registers as they are now.

        Args:
            duty_max: what protection leaves of the duty
        """
        table, shaft = self._table, self._shaft
        torque = table["torque_enable"]
        on = torque == 1
        if on and not self._was_on:
            self.profile.jump(shaft.ticks())
            self._wheel_speed = 0.0
            if self._mode == "position":
                self._aim_at(table["goal_position"])
        self._was_on = on
        self._duty_max = duty_max
        self._law = self._limited(duty_max)
        shaft.drive(Drive(on=on, mode=_DRIVES[self._mode], law=self._law, brake=torque == DAMPING))
        self._follow()

    def step(self, dt: float) -> None:
        """Move the profile.

        Args:
            dt: time step [s]
        """
        if self._mode == "wheel":
            self._spin(dt)
            return
        velocity, acceleration = self._bounds()
        if velocity == 0.0 and acceleration > 0.0:
            velocity = self._fastest()
        self.moving = self.profile.step(self._target, velocity, acceleration, dt)
        self._shaft.aim(self.profile.position)

    # inside

    def _follow(self) -> None:
        """Begin to move as the goals say."""
        if self._mode in ("position", "step"):
            self.moving = self._was_on and self._bounds() != (0.0, 0.0)
            if not self.moving:
                self.profile.jump(self._target)
            self._shaft.aim(self.profile.position)
        elif self._mode == "wheel":
            self._spin(0.0)
        else:
            self.moving = False
            limit = self._law.duty_max
            self._shaft.aim(max(-limit, min(limit, self._pwm())))

    def _limited(self, duty_max: float) -> Law:
        product, counts = self._product, self._table.counts()
        law = velocity_law(product, counts) if self._mode == "wheel" else position_law(product, counts)
        return replace(law, duty_max=min(law.duty_max, duty_max * counts["max_torque"] / 1000.0))

    def _no_limits(self) -> bool:
        return self._table["min_angle_limit"] == 0 and self._table["max_angle_limit"] == 0

    def _multi_turn(self) -> bool:
        return bool(self._table["phase"] & MULTI_TURN) or self._no_limits()

    def _potentiometer(self, ticks: float) -> int:
        """Return where the potentiometer stands; where it has no track, its nearer end."""
        turn, end = self._product.ticks_per_turn, self._product.count_max
        count = round(ticks % turn)
        return count if count <= end else end if count < 0.5 * (turn + end) else 0

    def _aim_at(self, goal: int) -> None:
        """Set where the shaft has to go: from where it is now, by the difference of goal and present position."""
        table, ticks = self._table, self._shaft.ticks()
        if self._mode == "step":
            # steps count from where the last ones lead to
            self._target = (self._target if self._was_on else ticks) + goal
        else:
            if not self._no_limits():
                goal = min(max(goal, table["min_angle_limit"]), table["max_angle_limit"])
            if not self._sts:
                turn = self._product.ticks_per_turn
                self._target = goal + turn * round((ticks - 0.5 * self._product.count_max) / turn)
            elif self._multi_turn():
                self._target = self._base + table["homing_offset"] + goal * table["angular_resolution"]
            else:
                self._target = self._base + round(ticks - self._base) + goal - self.position()
        self._cruise = self._cruise_speed(abs(self._target - self.profile.position))

    def _cruise_speed(self, distance: float) -> float:
        """Return the speed at which the way takes the goal time [ticks/s], 0 if there is none."""
        seconds = 1e-3 * self._table.word("goal_time")
        if seconds <= 0.0:
            return 0.0
        acceleration = self._acceleration()
        if acceleration <= 0.0:
            return distance / seconds
        # distance = v t - v**2 / a; where even full acceleration is too slow, that
        spare = (acceleration * seconds) ** 2 - 4.0 * acceleration * distance
        return 0.5 * (acceleration * seconds - math.sqrt(spare)) if spare > 0.0 else math.sqrt(acceleration * distance)

    def _acceleration(self) -> float:
        lines = self._table.lines
        if "acceleration" not in lines:
            return 0.0
        return self._table["acceleration"] * lines["acceleration"].scale * self._ticks_per_rad

    def _bounds(self) -> tuple[float, float]:
        """Return the profile's velocity [ticks/s] and acceleration [ticks/s2], 0: none; a speed goes before a time."""
        return float(abs(self._table["goal_speed"])) or self._cruise, self._acceleration()

    def _fastest(self) -> float:
        """Return how fast the motor can turn [ticks/s]."""
        product = self._product
        return product.no_load_speed_rad_s * self._shaft.supply() / product.voltage_v * self._ticks_per_rad

    def _spin(self, dt: float) -> None:
        """Bring the wheel's speed nearer to its goal."""
        goal = float(self._table["goal_speed"]) if self._was_on else 0.0
        change = self._acceleration() * dt
        if self._acceleration() > 0.0:
            goal = min(max(goal, self._wheel_speed - change), self._wheel_speed + change)
        self._wheel_speed = goal
        self.moving = self._was_on and goal != self._table["goal_speed"]
        self._shaft.aim(goal / self._ticks_per_rad)

    def _pwm(self) -> float:
        word = self._table.word("goal_time")
        duty = (word & _PWM_BITS) / 1000.0
        return -duty if word & _PWM_SIGN else duty
