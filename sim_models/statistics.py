"""What a rollout comes to: the fields of `Rollouts.statistics`, and the definitions that other rooms share."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

HIT_M: Final = 0.015
"""Within this of the goal is a hit [m]. Source: Gritz & Hahn 1997, §3.6."""

HOP_CLEARANCE_M: Final = 0.010
"""A hop lifts every foot at least so far off the floor [m]."""

LANDED_M: Final = 0.002
"""A hop is over once a foot is lower than this [m]."""

STATUS_DONE: Final = 0
STATUS_DIVERGED: Final = 1
STATUS_ERROR: Final = 2

FIELDS: Final = (
    ("final_error", "m", "distance of the base from the goal, in the plane, at the end"),
    ("final_px", "m", "goal - base along the heading at the end"),
    ("min_error", "m", "smallest distance from the goal"),
    ("min_abs_px", "m", "smallest |px|"),
    ("end_tilt", "rad", "angle of the base to the vertical at the end"),
    ("max_tilt", "rad", "its largest value"),
    ("end_speed", "m/s", "largest speed of the base during the last 0.2 s"),
    ("end_joint_error", "rad", "mean |angle - neutral| of the joints at the end"),
    ("end_joint_speed", "rad/s", "mean |rate| of the joints at the end"),
    ("max_clearance", "m", "largest height of the lowest foot above the floor"),
    ("path", "m", "horizontal path of the base"),
    ("ground_path", "m", "the part of it in periods that begin and end with a foot lower than 2 mm: sliding"),
    ("path_after_hit", "m", "the part of the path after first_hit_step"),
    ("joint_path_after_hit", "rad", "mean path of the joints after first_hit_step"),
    ("peak_torque", "1", "largest |load| of any joint, 1 is its limit"),
    (
        "status",
        "",
        "0 done, 1 diverged (a bad number), 2 MuJoCo raised an error; unless 0, the end's values are infinite",
    ),
    ("fallen", "", "which stop condition ended it: 0 none, 1 tilt, 2 head, 3 flight"),
    ("head_touched", "", "1 if the head touched anything"),
    ("upright_end", "", "1 if not fallen and end_tilt is at most 0.35 rad"),
    ("alive_steps", "", "control periods completed"),
    ("hops", "", "times that all feet rose to 10 mm, with a landing (a foot below 2 mm) between"),
    ("first_hit_step", "", "first control instant within 0.015 m of the goal (the papers' hit), or -1"),
    ("arrive_step", "", "control instant since which the base has stayed within 0.015 m of the goal, or -1"),
    ("idle_steps", "", "control instants before arrive_step, or the end, at which the base was slower than 0.02 m/s"),
)
"""Name, unit and meaning of each field, in the order of `sv_statistics` in `native/rollout.h`."""

STATISTICS: Final = np.dtype([(name, "<i4" if unit == "" else "<f4") for name, unit, _ in FIELDS])
"""One rollout's statistics; everything is seen at control instants."""


def count_hops(clearance: npt.ArrayLike) -> int:
    """Count hops in a record of clearances, as the rollouts do.

    Args:
        clearance: height of the lowest foot at successive control instants [m], (nstep,)

    Returns:
        The number of excursions to `HOP_CLEARANCE_M`.
    """
    hops, airborne = 0, False
    for height in np.asarray(clearance, float):
        if not airborne and height >= HOP_CLEARANCE_M:
            hops, airborne = hops + 1, True
        elif airborne and height < LANDED_M:
            airborne = False
    return hops
