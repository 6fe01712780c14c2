"""Convert between a joint's angle and its servo's encoder counts, with the control cycle's rounding and limits."""

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
    """Return the smallest and the largest goal that the joint's limits allow [counts].

    Args:
        joint: the joint
    """
    ends = [joint.zero_tick + round(angle / joint_scale(joint)) for angle in (joint.low_rad, joint.high_rad)]
    return min(ends), max(ends)
