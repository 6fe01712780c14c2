"""The arithmetic of homing, of a speed's last look at its joint's end, and of derating: as the firmware has it."""

from __future__ import annotations

import math
from ctypes import byref

from controller.library import SvAxis, library
from controller.rig import Joint
from controller.terminals import joint_scale


def homing_periods(joint: Joint, start: int, neutral: int, step_rad: float) -> int:
    """Return how many periods a straight move to neutral takes.

    Args:
        joint: the joint
        start: where it begins [counts]
        neutral: where it ends [counts]
        step_rad: how far it may go in a period [rad]
    """
    return int(library().sv_homing_periods(joint_scale(joint), start, neutral, step_rad))


def homing_goal(start: int, neutral: int, k: int, nmove: int) -> int:
    """Return the goal of one period of a straight move, rounded half to even [counts].

    Args:
        start: where it begins [counts]
        neutral: where it ends, less than 65536 away [counts]
        k: number of the period, from 0
        nmove: periods of the move
    """
    return int(library().sv_homing_goal(start, neutral, k, nmove))


def homing_near(joint: Joint, count: int) -> bool:
    """Return whether a joint that is driven by its speed is in neutral.

    Friction, or the load that it bears, may stop it a little earlier.

    Args:
        joint: the joint
        count: where it is [counts]
    """
    return bool(library().sv_homing_near(byref(_axis(joint)), count))


def homing_speed(joint: Joint, count: int, rate_rad_s: float) -> int:
    """Return the speed that brings a joint to neutral, slower as it comes near [velocity counts].

    Args:
        joint: the joint
        count: where it is [counts]
        rate_rad_s: its fastest [rad/s]
    """
    return int(library().sv_homing_speed(byref(_axis(joint)), count, rate_rad_s))


def speed_inside(joint: Joint, count: int, speed: int, age_s: float, period_s: float) -> int:
    """Return a speed, or 0 where it may have carried the joint to an end of its travel by the end of the period.

    Args:
        joint: the joint
        count: where it was when it was last read [counts]
        speed: what is commanded [velocity counts]
        age_s: how long ago that was, infinite if never [s]
        period_s: control period [s]
    """
    age_us = math.floor(min(1e6 * age_s + 1e-3, 2.0**31 - 1.0)) if math.isfinite(age_s) else -1
    return int(library().sv_speed_inside(byref(_axis(joint)), count, speed, age_us, round(1e6 * period_s)))


def derated(ceiling: int, part: float) -> int:
    """Return a part of a torque ceiling [counts].

    Args:
        ceiling: all of it [counts]
        part: how much of it is allowed, rounded to float32, in (0, 1]
    """
    return int(library().sv_derate(ceiling, part))


def _axis(joint: Joint) -> SvAxis:
    return SvAxis(
        joint.zero_tick,
        joint_scale(joint),
        joint.sign * joint.product.velocity_unit_rad_s,
        joint.speed_rad_s_max,
        joint.neutral_rad,
        joint.low_rad,
        joint.high_rad,
        int(joint.unlimited),
    )
