"""Bring a rig slowly to its neutral pose, then wait for rest and fresh sensors."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final, TypeAlias

from controller.homing import homing_goal, homing_near, homing_periods, homing_speed
from deploy.joint_counts import joint_count
from deploy.period import FaultError, Period, Periods

_REST_PERIODS: Final = 10
_REST_SPEED_RAD_S: Final = 0.06
_REST_S_MAX: Final = 10.0

Goals: TypeAlias = Callable[[int], Sequence[int]]
"""Gives the goals of a period by its number [counts], (njoint,)."""


def home(periods: Periods) -> None:
    """Move every joint to neutral at the rig's homing speed, and return once it rests there.

    Args:
        periods: of the run

    Raises:
        FaultError: something is wrong, or the rig does not come to rest
        StopRunError: a person wants the run to stop
        RunError: the run can not be recorded any more
    """
    rig = periods.rig
    if rig.joints[0].mode == "position":
        goals, nmove, rate = _positions(periods)
    else:
        goals, nmove, rate = _speeds(periods)
    resting = 0
    periods.start()
    for k in range(nmove + math.ceil(_REST_S_MAX / rig.period_s)):
        done = periods.walk(k, lambda k=k: goals(k), rate)  # type: ignore[misc]
        if done.fault:
            raise FaultError(done.fault)
        periods.heed_stop()
        resting = resting + 1 if k >= nmove and _at_rest(periods, done) else 0
        if resting == _REST_PERIODS:
            return
    raise FaultError(
        f"the rig did not come to rest in neutral within {_REST_S_MAX:g} s; look for what moves or blocks it"
    )


def _positions(periods: Periods) -> tuple[Goals, int, float]:
    """Return goals that go straight to neutral, in how many periods, and their rate [rad/s]."""
    rig, start = periods.rig, periods.goals
    rate = rig.safety.homing_rad_s
    neutral = tuple(joint_count(joint, joint.neutral_rad) for joint in rig.joints)
    nmove = max(
        homing_periods(joint, a, b, rate * rig.period_s) for joint, a, b in zip(rig.joints, start, neutral, strict=True)
    )

    def goals(k: int) -> Sequence[int]:
        return tuple(homing_goal(a, b, k, nmove) for a, b in zip(start, neutral, strict=True))

    return goals, nmove, rate


def _speeds(periods: Periods) -> tuple[Goals, int, float]:
    """Return speeds that end in neutral, after how many periods at the least, and no rate: they may change at once."""
    rig = periods.rig

    def goals(_: int) -> Sequence[int]:
        rate = rig.safety.homing_rad_s
        return tuple(
            homing_speed(joint, count, rate)
            for joint, count in zip(rig.joints, periods.io.position_counts(), strict=True)
        )

    return goals, 1, 0.0


def _at_rest(periods: Periods, done: Period) -> bool:
    rig, io = periods.rig, periods.io
    ages = io.ages_s()[3 * len(rig.joints) :]
    moving = any(
        abs(count) > max(1, round(_REST_SPEED_RAD_S / joint.product.velocity_unit_rad_s))
        for joint, count in zip(rig.joints, io.velocity_counts(), strict=True)
    )
    away = rig.joints[0].mode == "velocity" and any(
        not homing_near(joint, count) for joint, count in zip(rig.joints, io.position_counts(), strict=True)
    )
    return (
        all(reply.status == "data" for reply in done.replies.values())
        and not moving
        and not away
        and all(ages[number] <= rig.sensors[number].age_s_max for number in periods.needed)
    )
