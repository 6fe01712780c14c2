"""Look at a virtual rig as a judge does: what really happened, for the log and the summary, never for the loop."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from deploy.logs.comparison import count_hops

if TYPE_CHECKING:
    from deploy.virtual.plant import Truth
    from deploy.virtual.rig import VirtualRig


class Witness:
    """Remember how a virtual rig's body moved.

    Args:
        virtual: the rig
    """

    def __init__(self, virtual: VirtualRig) -> None:
        self._virtual = virtual
        self._seen: list[Truth] = []

    def look(self) -> Mapping[str, Any]:
        """Look now; return the fields of a `/truth` message."""
        truth = self._virtual.truth()
        self._seen.append(truth)
        names = [joint.name for joint in self._virtual.rig.joints]
        return {
            "base_pos": _rounded(truth.base_pos),
            "base_rpy": _rounded(truth.base_rpy),
            "feet_clearance_m": round(float(truth.feet_clearance_m), 9),
            "joint_rad": dict(zip(names, _rounded(truth.joint_rad), strict=True)),
            "joint_vel": dict(zip(names, _rounded(truth.joint_vel), strict=True)),
        }

    @property
    def t(self) -> float:
        """Return the rig's time of what was last seen: on the line, the rig is ahead of the host [s]."""
        return self._seen[-1].t

    def verdict(self, goal_dist: float, goal_bearing: float) -> Mapping[str, Any]:
        """Return what was seen in all.

        Args:
            goal_dist: distance of the goal from the first place seen [m]
            goal_bearing: its direction from the heading there [rad]

        Returns:
            hops, largest clearance [m], distance to the goal at the end [m], tilt at the end [rad]
        """
        if not self._seen:
            return {}
        first, last = self._seen[0], self._seen[-1]
        course = float(first.base_rpy[2]) + goal_bearing
        goal = (first.base_pos[0] + goal_dist * math.cos(course), first.base_pos[1] + goal_dist * math.sin(course))
        clearance = [float(truth.feet_clearance_m) for truth in self._seen]
        roll, pitch = float(last.base_rpy[0]), float(last.base_rpy[1])
        return {
            "hops": count_hops(np.array(clearance)),
            "max_clearance_m": max(clearance),
            "final_error_m": math.hypot(goal[0] - last.base_pos[0], goal[1] - last.base_pos[1]),
            "final_tilt_rad": math.acos(math.cos(roll) * math.cos(pitch)),
        }


def _rounded(values: Any) -> list[float]:  # noqa: ANN401  an array of float64
    return [round(float(value), 9) for value in values]
