"""Convert between a joint's angle or speed and its servo's counts, with the control cycle's rounding and limits."""

from __future__ import annotations

from controller.rig import Joint
from controller.terminals import joint_scale


def joint_angle(joint: Joint, count: int) -> float:
    """Return the angle at an encoder count [rad].

    Args:
        joint: the joint
        count: encoder counts
    """
    return (count - joint.zero_tick) * joint_scale(joint)


def joint_count(joint: Joint, angle: float) -> int:
    """Return the encoder count nearest to an angle, within the joint's limits.

    Args:
        joint: the joint
        angle: [rad]
    """
    low, high = count_limits(joint)
    return min(max(joint.zero_tick + round(angle / joint_scale(joint)), low), high)


def count_limits(joint: Joint) -> tuple[int, int]:
    """Return the smallest and the largest encoder count within the limits of a joint that has limits [counts].

    Args:
        joint: the joint
    """
    ends = [joint.zero_tick + round(angle / joint_scale(joint)) for angle in (joint.low_rad, joint.high_rad)]
    return min(ends), max(ends)


def joint_speed(joint: Joint, count: int) -> float:
    """Return the speed of a velocity count [rad/s].

    Args:
        joint: the joint
        count: velocity counts
    """
    return count * joint.sign * joint.product.velocity_unit_rad_s


def speed_count(joint: Joint, speed: float) -> int:
    """Return the velocity count nearest to a speed, within the joint's fastest.

    Args:
        joint: the joint
        speed: [rad/s]
    """
    limited = min(max(speed, -joint.speed_rad_s_max), joint.speed_rad_s_max)
    return round(limited / (joint.sign * joint.product.velocity_unit_rad_s))


def goal_limits(joint: Joint) -> tuple[int, int]:
    """Return the smallest and the largest goal that a joint's mode allows, of an angle or a speed [counts].

    Args:
        joint: the joint
    """
    if joint.mode == "position":
        return count_limits(joint)
    fastest = abs(speed_count(joint, joint.speed_rad_s_max))
    return -fastest, fastest
