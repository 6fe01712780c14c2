"""How an X servo's registers drive its shaft: modes, gains, limits, profiles, and what it measures of the motion.

Sources: ROBOTIS e-Manual, _includes/en/dxl/control_table_{opmode_six_2,position_pid_gain,velocity_pi_gain,
profile_velocity,profile_acceleration,drivemode,homingoffset,moving_status}.md. What the feedforward gains multiply is
not published: velocity and acceleration in ticks a control period of 1 ms, as the position D gain, is an estimate.
"""

from __future__ import annotations

import math
from typing import Final

from controller.products import Product
from controller.servo_law import Law, position_law, velocity_law
from deploy.virtual.control_table import ControlTable
from deploy.virtual.drive import Drive, Shaft
from deploy.virtual.trajectory import Sample, Trajectory, in_time, rest, to_position, to_velocity

CURRENT, VELOCITY, POSITION, EXTENDED, CURRENT_POSITION, PWM = 0, 1, 3, 4, 5, 16
POSITION_MODES: Final = frozenset({POSITION, EXTENDED, CURRENT_POSITION})
GOAL_OF_MODE: Final = {CURRENT: "goal_current", VELOCITY: "goal_velocity", PWM: "goal_pwm"}
"""Mode => what it is aimed at, where that is not the goal position."""

REVERSE: Final = 1
TIME_BASED: Final = 4
TIME_MS_MAX: Final = 32737
"""Longest time of a time-based profile, where one by velocity takes 32767 [ms]."""
HOMING_OFFSET_MAX: Final = 1024
"""Position mode ignores larger offsets. Source: e-Manual, control_table_homingoffset.md."""

IN_POSITION_TICKS: Final = 20
"""Deviation that counts as none: an estimate, the vendor's own examples take it."""

FOLLOWING_ERROR_TICKS: Final = 200
"""Deviation from the trajectory that counts as an error: an estimate."""

_GAINS: Final = (
    "position_p_gain",
    "position_i_gain",
    "position_d_gain",
    "velocity_p_gain",
    "velocity_i_gain",
    "pwm_limit",
    "goal_pwm",
)

_MS: Final = 1e-3
_FEEDFORWARD: Final = 4.0


class XMotion:
    """Drive a shaft by the registers of an X servo.

    Args:
        product: which servo
        table: its registers
        shaft: what it turns
    """

    def __init__(self, product: Product, table: ControlTable, shaft: Shaft) -> None:
        self._product = product
        self._table = table
        self._shaft = shaft
        self._turn = round(product.ticks_per_turn)
        self._tick_rad = 2.0 * math.pi / product.ticks_per_turn
        self._turned = 0  # whole turns that the present position does not count [ticks]
        self._plan = rest(0.0)
        self._t_s = 0.0
        self._done = True
        self._fed = False
        # an XL430 has a load instead
        current = table.lines.get("present_current")
        self._current_unit_a = current.scale if current else 0.0
        self.start()

    def start(self) -> None:
        """Begin anew, as when the power comes: turns are forgotten."""
        self._plan = rest(self._raw())
        self._finish()
        self.forget_turns()

    @property
    def moving(self) -> bool:
        """Return whether a profile is on its way, and `step` needed."""
        return not self._done

    @property
    def mode(self) -> int:
        """Return the operating mode."""
        return self._table["operating_mode"]

    def position(self) -> int:
        """Return what the present position is [ticks]."""
        return round(self._raw()) - self._turned + self._offset()

    def velocity(self) -> int:
        """Return what the present velocity is [counts]."""
        return round(self._way() * self._shaft.speed() / self._product.velocity_unit_rad_s)

    def forget_turns(self) -> None:
        """Count the present position within one turn."""
        self._turned = round(self._raw()) // self._turn * self._turn

    def drive(self) -> None:
        """Let torque, mode, gains and limits act as the registers have them."""
        self._shaft.drive(self._drive())

    def aim(self) -> None:
        """Let the goal act as the registers have it, by a new profile where they ask for one."""
        table, mode = self._table, self.mode
        if mode in POSITION_MODES:
            self._begin(self._to_goal(self._now()))
        elif mode == VELOCITY:
            self._begin(self._to_velocity(self._now()))
        else:
            self._begin(rest(0.0))
            goal = table[GOAL_OF_MODE[mode]]
            duty = goal / self._product.duty_full if mode == PWM else math.copysign(self._duty_max(), goal)
            self._shaft.aim(self._way() * duty)

    def settle(self) -> None:
        """Take up the profile where the shaft is, at rest: torque comes, or the mode is another."""
        self._plan = rest(self._raw())
        self._finish()

    def step(self, dt: float) -> None:
        """Move along the profile.

        Args:
            dt: time step [s]
        """
        self._t_s += dt
        sample = self._now()
        if self._t_s >= self._plan.end_s:
            self._finish()
        self._follow(sample)

    def measure_state(self) -> None:
        """Bring load, velocity and position up to date: what a master reads in every cycle."""
        table, shaft, way = self._table, self._shaft, self._way()
        table["present_position"] = self.position()
        table["present_velocity"] = self.velocity()
        if self._current_unit_a:
            table["present_current"] = round(way * shaft.current() / self._current_unit_a)
        else:
            table["present_load"] = round(way * 1000.0 * shaft.duty())

    def measure(self) -> None:
        """Bring all registers that tell of the motion up to date."""
        self.measure_state()
        table, mode = self._table, self.mode
        sample, moving = self._plan.at(self._t_s), not self._done
        position = table["present_position"]
        table["present_pwm"] = round(self._way() * self._shaft.duty() * self._product.duty_full)
        table["moving"] = int(moving or abs(table["present_velocity"]) > table["moving_threshold"])
        counts = 1.0 if mode == VELOCITY else self._tick_rad / self._product.velocity_unit_rad_s
        table["velocity_trajectory"] = round(sample.velocity * counts)
        status = moving << 1 | self._plan.kind << 4
        reckoned = position
        if mode in POSITION_MODES:
            reckoned = round(sample.position) - self._turned + self._offset()
            near = abs(position - table["goal_position"]) <= IN_POSITION_TICKS
            lost = table["torque_enable"] and abs(position - reckoned) > FOLLOWING_ERROR_TICKS
            status |= int(near and not moving) | bool(lost) << 3
        table["position_trajectory"] = reckoned
        table["moving_status"] = status

    # inside

    def _way(self) -> int:
        return -1 if self._table["drive_mode"] & REVERSE else 1

    def _raw(self) -> float:
        """Return the encoder's angle over all turns, in the servo's direction [ticks]."""
        return self._way() * self._shaft.ticks()

    def _offset(self) -> int:
        offset = self._table["homing_offset"]
        return offset if abs(offset) <= HOMING_OFFSET_MAX or self.mode != POSITION else 0

    def _now(self) -> Sample:
        return self._plan.at(self._t_s)

    def _duty_max(self) -> float:
        return min(self._table["pwm_limit"], abs(self._table["goal_pwm"])) / self._product.duty_full

    def _torque_max(self) -> float:
        """Return the torque that the goal current leaves, over the stall torque."""
        amperes = abs(self._table["goal_current"]) * self._table.lines["goal_current"].scale
        return min(1.0, amperes / self._product.stall_current_a)

    def _drive(self) -> Drive:
        table, product, mode = self._table, self._product, self.mode
        on = table["torque_enable"] != 0
        slope = table["pwm_slope"] * table.lines["pwm_slope"].scale if "pwm_slope" in table.lines else 0.0
        if mode == PWM:
            return Drive(on, "voltage", Law(duty_max=table["pwm_limit"] / product.duty_full), slope_v_s=slope)
        if mode == CURRENT:
            return Drive(on, "voltage", Law(duty_max=self._duty_max()), self._torque_max(), slope)
        counts = {name: table[name] for name in _GAINS}
        if mode == VELOCITY:
            return Drive(on, "velocity", velocity_law(product, counts), slope_v_s=slope)
        torque_max = self._torque_max() if mode == CURRENT_POSITION else 1.0
        return Drive(on, "position", position_law(product, counts), torque_max, slope)

    def _to_goal(self, start: Sample) -> Trajectory:
        table = self._table
        goal = float(table["goal_position"] - self._offset() + self._turned)
        velocity, acceleration = table["profile_velocity"], table["profile_acceleration"]
        if table["drive_mode"] & TIME_BASED:
            return in_time(start, goal, velocity * _MS, acceleration * _MS)
        lines = table.lines
        return to_position(
            start,
            goal,
            velocity * lines["profile_velocity"].scale / self._tick_rad,
            acceleration * lines["profile_acceleration"].scale / self._tick_rad,
        )

    def _to_velocity(self, start: Sample) -> Trajectory:
        """Return the ramp to the goal velocity, in velocity counts."""
        table = self._table
        goal, acceleration = table["goal_velocity"], table["profile_acceleration"]
        if table["drive_mode"] & TIME_BASED:
            return to_velocity(start, goal, acceleration * _MS)
        if not acceleration:
            return to_velocity(start, goal, 0.0)
        lines = table.lines
        change = abs(goal - start.velocity) * lines["goal_velocity"].scale
        return to_velocity(start, goal, change / (acceleration * lines["profile_acceleration"].scale))

    def _begin(self, plan: Trajectory) -> None:
        self._plan = plan
        self._t_s = 0.0
        self._done = plan.end_s <= 0.0 or not self._table["torque_enable"]
        if self._done:
            self._finish()
            if self.mode in POSITION_MODES or self.mode == VELOCITY:
                self._follow(self._now())

    def _finish(self) -> None:
        self._t_s = max(self._t_s, self._plan.end_s)
        self._done = True

    def _follow(self, sample: Sample) -> None:
        """Aim the shaft at a sample of the profile."""
        way, table = self._way(), self._table
        if self.mode == VELOCITY:
            self._shaft.aim(way * sample.velocity * self._product.velocity_unit_rad_s)
            return
        self._shaft.aim(way * sample.position)
        first, second = table["feedforward_1st_gain"], table["feedforward_2nd_gain"]
        fed = bool((first or second) and not self._done)
        if fed or self._fed:
            pwm = first * sample.velocity * _MS + second * sample.acceleration * _MS * _MS if fed else 0.0
            self._shaft.feedforward(way * pwm / _FEEDFORWARD / self._product.duty_full)
        self._fed = fed


def profile_takes(table: ControlTable, name: str, value: int) -> bool:
    """Return whether a register may have a value in the drive mode that the servo is in.

    Args:
        table: the servo's registers
        name: of the register
        value: count, within the register's own range
    """
    timed = name in ("profile_velocity", "profile_acceleration") and table["drive_mode"] & TIME_BASED
    return not timed or value <= TIME_MS_MAX
