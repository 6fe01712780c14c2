"""Calibrate joints: where their zero is, and how far they travel, from counts that the servos report.

A count means what the servo reports, its homing offset applied. Travel is followed from sample to sample, so that a
joint that passes the encoder's wrap is seen to do so, instead of seeming to have turned nearly once around.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from controller.errors import InputError
from controller.rig import Joint
from controller.terminals import joint_scale
from deploy.commissioning.lerobot import MotorCalibration

MARGIN_RAD: Final = 0.02
"""How far inside the recorded travel a limit lies: a servo that presses against its stop is overloaded."""

TRAVEL_RAD_MIN: Final = 0.1
"""Less travel than this is a joint that nobody moved."""

HOMING_MAX: Final = 2047
"""Largest magnitude of a homing offset with its sign in bit 11."""

_DIGITS: Final = 4
_HOMING_SIGN: Final = {"dynamixel-x330": 1, "dynamixel-x430": 1, "feetech-sts": -1}
"""Present position = encoder + sign * homing offset. Source: e-Manual, X series, Homing Offset (20); LeRobot,
`_get_half_turn_homings` of both buses; measured on an STS3215 too (feetech-cli 0.1.8)."""


@dataclass(frozen=True)
class Travel:
    """Hold how far a joint has been, in counts without wrap: 4,100 is 4 past a whole turn.

    Args:
        low: smallest
        high: largest
        last: the newest
    """

    low: int
    high: int
    last: int


def begin_travel(count: int) -> Travel:
    """Return the travel of a joint that has not moved yet.

    Args:
        count: where it stands
    """
    return Travel(count, count, count)


def extend_travel(travel: Travel, count: int, ticks_per_turn: float) -> Travel:
    """Return the travel with one sample more, taken before the joint can turn by half a turn.

    Args:
        travel: so far
        count: as the servo reports it
        ticks_per_turn: counts of a turn
    """
    turns = round((count - travel.last) / ticks_per_turn)
    last = round(count - turns * ticks_per_turn)
    return Travel(min(travel.low, last), max(travel.high, last), last)


def calibrate_joint(
    joint: Joint,
    *,
    at: int | None = None,
    travel: Travel | None = None,
    middle: bool = False,
    margin_rad: float = MARGIN_RAD,
) -> dict[str, int | float]:
    """Return the keys of a joint's table that a calibration changes.

    Args:
        joint: the joint as its rig file has it
        at: count where it stands at its neutral angle; None: the zero stays
        travel: how far it can go; None: the limits stay
        middle: whether the middle of the travel is angle 0
        margin_rad: how far inside the travel the limits lie [rad]

    Returns:
        key => value

    Raises:
        InputError: the travel crosses the wrap, or leaves out the neutral angle, or there is none
    """
    scale = joint_scale(joint)
    zero = joint.zero_tick if at is None else round(at - joint.neutral_rad / scale)
    if travel is None:
        if not joint.unlimited:
            ends = [zero + angle / scale for angle in (joint.low_rad, joint.high_rad)]
            _refuse_wrap(joint, Travel(math.floor(min(ends) + 0.5), math.ceil(max(ends) - 0.5), 0))
        _refuse_zero(joint, zero)
        return {} if at is None else {"zero_tick": zero}
    if joint.unlimited:
        raise InputError(f"joint {joint.name}: may turn for ever, so its travel can not be recorded; leave it out")
    if (travel.high - travel.low) * abs(scale) < max(TRAVEL_RAD_MIN, 2.0 * margin_rad):
        raise InputError(
            f"joint {joint.name}: travelled {(travel.high - travel.low) * abs(scale):.3f} rad only; move it from stop "
            "to stop while the range is recorded, or name the joints to calibrate with --joints"
        )
    _refuse_wrap(joint, travel)
    if middle:
        zero = round(0.5 * (travel.low + travel.high))
    _refuse_zero(joint, zero)
    ends = sorted((count - zero) * scale for count in (travel.low, travel.high))
    low, high = _round_in(ends[0] + margin_rad, ends[1] - margin_rad)
    if not low <= joint.neutral_rad <= high:
        raise InputError(
            f"joint {joint.name}: its travel is {low:g} to {high:g} rad and leaves out neutral_rad "
            f"{joint.neutral_rad:g}; stand it there and add --neutral, or add --middle to put angle 0 in the middle"
        )
    return {"zero_tick": zero, "low_rad": low, "high_rad": high}


def imported_travel(joint: Joint, motor: MotorCalibration, held_offset: int | None) -> Travel:
    """Return the range of a LeRobot calibration in counts that the servo reports as it is set now.

    Args:
        joint: the joint
        motor: its calibration
        held_offset: homing offset that the servo holds, or None if it has no such register [counts]

    Raises:
        InputError: the servo can not have that range, or holds another setting
    """
    sign = _HOMING_SIGN.get(joint.product.family)
    count_max = joint.product.count_max
    if motor.homing_offset and (sign is None or held_offset is None):
        raise InputError(
            f"joint {joint.name}: homing_offset {motor.homing_offset} is for a servo that has such a register, and "
            f"its {joint.product.name} has none; record the range with --range instead"
        )
    if sign == 1 and motor.drive_mode & 1:
        raise InputError(
            f"joint {joint.name}: drive_mode {motor.drive_mode} turns its {joint.product.name} around, which rigs do "
            "with sign; write 0 to its drive_mode and record the range with --range instead"
        )
    if sign == -1 and abs(motor.homing_offset) > HOMING_MAX:
        raise InputError(
            f"joint {joint.name}: homing_offset {motor.homing_offset} is more than the {HOMING_MAX} that "
            f"its {joint.product.name} holds; record the range with --range and add --center"
        )
    if motor.range_min < 0 or motor.range_max > count_max:
        raise InputError(
            f"joint {joint.name}: range {motor.range_min} to {motor.range_max} is outside 0 to {count_max}, what "
            f"its {joint.product.name} counts; record the range with --range instead"
        )
    travel = Travel(motor.range_min, motor.range_max, motor.range_min)
    return _normalized(joint, travel, (sign or 0) * ((held_offset or 0) - motor.homing_offset))


def exported_motor(joint: Joint, limits: tuple[int, int], settings: Mapping[str, int]) -> MotorCalibration:
    """Return a joint's calibration in LeRobot's terms.

    Args:
        joint: the joint
        limits: smallest and largest count of its travel
        settings: what the servo holds, as far as it was asked: "homing_offset", "drive_mode"
    """
    # LeRobot reads a Dynamixel's drive mode from its register, and turns a Feetech's counts around itself
    dynamixel = _HOMING_SIGN.get(joint.product.family) == 1
    drive_mode = settings.get("drive_mode", 0) if dynamixel else int(joint.sign < 0)
    return MotorCalibration(joint.id, drive_mode, settings.get("homing_offset", 0), *limits)


def centred_offset(joint: Joint, travel: Travel, held_offset: int) -> int:
    """Return the homing offset that puts the middle of a travel in the middle of the counts, far from the wrap.

    Args:
        joint: the joint
        travel: how far it goes, as reported with `held_offset`
        held_offset: homing offset that the servo holds

    Returns:
        the offset, of the smallest magnitude

    Raises:
        InputError: the servo can not be centred
    """
    if not can_centre(joint):
        raise InputError(
            f"joint {joint.name}: the loop needs its {joint.product.name} without homing offset; mount its horn so "
            "that the middle of the travel is in the middle of its counts"
        )
    turn = round(joint.product.ticks_per_turn)
    if travel.high - travel.low >= turn - 1:
        raise InputError(
            f"joint {joint.name}: travelled {travel.high - travel.low} counts, a whole turn or more; record it again "
            "from stop to stop, or make the joint unlimited"
        )
    offset = (travel.low + travel.high) // 2 + held_offset - joint.product.center_tick
    offset = (offset + turn // 2) % turn - turn // 2
    return max(offset, -HOMING_MAX)  # half a turn can not be held: one count less is as good


def shifted(joint: Joint, travel: Travel, held_offset: int, offset: int) -> Travel:
    """Return a travel as the servo reports it once it holds another homing offset.

    Args:
        joint: the joint
        travel: as reported with `held_offset`
        held_offset: homing offset before
        offset: homing offset afterwards
    """
    return _normalized(joint, travel, _HOMING_SIGN[joint.product.family] * (offset - held_offset))


def can_centre(joint: Joint) -> bool:
    """Return whether a servo may be given a homing offset: elsewhere it acts only in part, or does not exist.

    Args:
        joint: the joint
    """
    return _HOMING_SIGN.get(joint.product.family) == -1


def _normalized(joint: Joint, travel: Travel, shift: int) -> Travel:
    """Shift a travel, and turn it by whole turns until its middle is a count."""
    turn = round(joint.product.ticks_per_turn)
    shift -= turn * math.floor((0.5 * (travel.low + travel.high) + shift) / turn)
    return Travel(travel.low + shift, travel.high + shift, travel.last + shift)


def _refuse_wrap(joint: Joint, travel: Travel) -> None:
    count_max = joint.product.count_max
    if travel.low < 0 or travel.high > count_max:
        middle = round(0.5 * (travel.low + travel.high)) % round(joint.product.ticks_per_turn)
        remedy = f"mount its horn so that the middle of the travel, now {middle}, is near {joint.product.center_tick}"
        if can_centre(joint):
            remedy = f"add --center to re-home the servo, or {remedy}"
        raise InputError(
            f"joint {joint.name}: its travel goes from {travel.low} to {travel.high}, across the encoder's wrap at "
            f"{count_max}; {remedy}"
        )


def _refuse_zero(joint: Joint, zero: int) -> None:
    count_max = joint.product.count_max
    if not 0 <= zero <= count_max:
        raise InputError(
            f"joint {joint.name}: its zero would be at tick {zero}, outside 0 to {count_max}; mount its horn so that "
            f"angle 0 is near {joint.product.center_tick}"
        )


def _round_in(low: float, high: float) -> tuple[float, float]:
    """Round limits to a few digits, towards each other: a limit must not lie beyond what was recorded."""
    unit = 10.0**-_DIGITS
    return round(math.ceil(low / unit) * unit, _DIGITS), round(math.floor(high / unit) * unit, _DIGITS)
