"""The host loop's limits of what a joint may do, as the counts that the firmware compares."""

from __future__ import annotations

import math
from typing import Final

from controller.rig import Joint, Rig
from controller.terminals import joint_scale

_JUMP_RAD: Final = 0.2
_JUMP_SPEED: Final = 1.2
"""How far an encoder may be from its last reading, beside what the servo does at so many times its no-load speed: as
in the host loop."""

_RATE_SLACK: Final = 1.001
_ANY: Final = 2**32 - 1


def jump_counts(joint: Joint) -> tuple[float, float]:
    """Return how far an encoder may be from its last reading, and how much farther by each microsecond since [counts].

    Args:
        joint: the joint
    """
    scale = abs(joint_scale(joint))
    return _JUMP_RAD / scale, 1e-6 * _JUMP_SPEED * joint.product.no_load_speed_rad_s / scale


def tracking_counts(rig: Rig, joint: Joint) -> int:
    """Return how far from its goal a joint in position mode may be for long [counts].

    Args:
        rig: the rig
        joint: the joint
    """
    return math.floor(rig.safety.tracking_rad_max / abs(joint_scale(joint)))


def step_counts(rig: Rig, joint: Joint, rate: float) -> int:
    """Return how far apart the goals of two periods may be [counts].

    Args:
        rig: the rig
        joint: the joint
        rate: largest rate that they should have [rad/s], of a joint that is driven by its speed [rad/s^2]; 0: any
    """
    if rate == 0.0:
        return _ANY
    unit = abs(joint_scale(joint)) if joint.mode == "position" else joint.product.velocity_unit_rad_s
    return min(math.floor(_RATE_SLACK * (rate * rig.period_s / unit + 1.0)), _ANY)
