"""What registers of an X servo do to each other and to its motion when a master writes them.

Source: ROBOTIS e-Manual, _includes/en/dxl/control_table_opmode_six_2.md and _includes/en/dxl/control_table_goal_pwm.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Set
from typing import Final

from deploy.virtual.control_table import ControlTable
from deploy.virtual.x_motion import CURRENT, GOAL_OF_MODE, POSITION, PWM, REVERSE, XMotion

GOALS: Final = frozenset({"goal_pwm", "goal_current", "goal_velocity", "goal_position"})

_GAINS: Final = (
    "velocity_i_gain",
    "velocity_p_gain",
    "position_d_gain",
    "position_i_gain",
    "position_p_gain",
    "feedforward_2nd_gain",
    "feedforward_1st_gain",
)

RESTORED: Final = (*_GAINS, "profile_acceleration", "profile_velocity")
"""What of the RAM a backup brings back at the start. The manual names no list: an estimate."""

_DRIVE: Final = frozenset(
    {*_GAINS, "torque_enable", "pwm_limit", "pwm_slope", "goal_pwm", "goal_current", "drive_mode", "operating_mode"}
)
_AIM: Final = frozenset({"operating_mode", "drive_mode", "homing_offset", "pwm_limit"})
_LIMITS: Final[Mapping[str, str]] = {
    "goal_pwm": "pwm_limit",
    "goal_current": "current_limit",
    "goal_velocity": "velocity_limit",
}


def reset_goals(table: ControlTable, motion: XMotion) -> None:
    """Set the goals to what they are when the power comes or the mode changes: none that moves the shaft.

    The manual's note has goal PWM and goal current return to their limits: so they do as limits, but where they are
    what the mode is aimed at, the servo would run away.

    Args:
        table: the servo's registers, changed in place
        motion: its motion
    """
    table["goal_pwm"] = 0 if motion.mode == PWM else table["pwm_limit"]
    if "goal_current" in table.lines:
        table["goal_current"] = 0 if motion.mode == CURRENT else table["current_limit"]
    table["goal_velocity"] = 0
    table["goal_position"] = motion.position()


def take_effect(table: ControlTable, motion: XMotion, names: Set[str], before: Mapping[str, int]) -> None:
    """Let registers act that have been written.

    Args:
        table: the servo's registers, changed in place
        motion: its motion
        names: the registers
        before: what operating mode, drive mode and torque enable were
    """
    switched = table["torque_enable"] != before["torque_enable"]
    if table["operating_mode"] != before["operating_mode"]:
        _change_mode(table, motion)
    elif (table["drive_mode"] ^ before["drive_mode"]) & REVERSE:
        motion.forget_turns()
        motion.settle()
        table["goal_position"] = motion.position()
    elif switched:
        if motion.mode == POSITION and table["torque_enable"]:
            motion.forget_turns()
        motion.settle()
    aimed_at = GOAL_OF_MODE.get(motion.mode, "goal_position")
    _limit_goals(table, names, aimed_at)
    if names & _DRIVE:
        motion.drive()
    # a profile must not begin anew for what does not change it
    if switched or aimed_at in names or names & _AIM or (motion.mode == CURRENT and "goal_pwm" in names):
        motion.aim()


def _change_mode(table: ControlTable, motion: XMotion) -> None:
    """Set gains, profile and goals as a change of the operating mode does."""
    for name in _GAINS:
        table[name] = table.lines[name].initial
    table["profile_velocity"] = 0
    table["profile_acceleration"] = 0
    motion.forget_turns()
    motion.settle()
    reset_goals(table, motion)


def _limit_goals(table: ControlTable, names: Set[str], aimed_at: str) -> None:
    """Bring goals within limits that were written: what limits is the limit, what is aimed at stays, or less."""
    for goal, limit in _LIMITS.items():
        if limit in names:
            high = table[limit]
            aims = goal in (aimed_at, "goal_velocity")
            table[goal] = min(max(table[goal], -high), high) if aims else high
