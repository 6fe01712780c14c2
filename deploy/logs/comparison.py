"""What a comparison of a rig run with its simulation found: data that the command line prints and the report draws."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from controller.rig import Rig

Array = npt.NDArray[np.float64]

HOP_CLEARANCE_M = 0.010
"""A hop is the base clear of the floor by this much, on all feet."""


@dataclass(frozen=True, eq=False)
class Track:
    """Hold what one side did, rig or simulation, at the comparison's times.

    Args:
        joint_rad: joint angles, NaN where a servo did not answer [rad], (nsample, njoint)
        position_m: centre of the base, in the frame of the start [m], (npose, 3)
        tilt_rad: angle between the base's normal and the vertical [rad], (npose,)
        clearance_m: height of the lowest foot over the floor, NaN where nobody can tell [m], (npose,)
        force_n: base contact force [N], (nforce,)
    """

    joint_rad: Array
    position_m: Array
    tilt_rad: Array
    clearance_m: Array
    force_n: Array


@dataclass(frozen=True)
class JointError:
    """Say how far one joint of the rig was from the simulation's.

    Args:
        name: of the joint
        samples: encoder samples compared
        rmse_deg: root mean square of the difference [deg]
        max_deg: largest difference [deg]
        max_time_s: when that was, after the first cycle [s]
    """

    name: str
    samples: int
    rmse_deg: float
    max_deg: float
    max_time_s: float


@dataclass(frozen=True)
class Outcome:
    """Say how a run ended, as far as that side can tell; None: it can not.

    Args:
        distance_m: from the base's centre to the goal, on the floor, at the end [m]
        hops: times that all feet were clear of the floor by `HOP_CLEARANCE_M`
        clearance_m: largest such clearance [m]
        tilt_rad: of the base at the end [rad]
        travel_m: from the start to the end, on the floor [m]
    """

    distance_m: float | None
    hops: int | None
    clearance_m: float | None
    tilt_rad: float | None
    travel_m: float | None


@dataclass(frozen=True, eq=False)
class LoopTiming:
    """Hold how punctual the host loop was.

    Args:
        period_s: control period that the rig asks for [s]
        start_s: when each cycle began, after the first [s], (ncycle,)
        read_s: from asking the servos to their last answer [s], (ncycle,)
        compute_s: the control cycle itself [s], (ncycle,)
        write_s: from there until the goals were sent [s], (ncycle,)
        overruns: cycles that began, or ended, more than their slack late (deadline misses)
        missed_replies: answers of a servo that were awaited in vain
        ages_s: age of each sensor's value when a cycle used it [s], (ncycle,) each
    """

    period_s: float
    start_s: Array
    read_s: Array
    compute_s: Array
    write_s: Array
    overruns: int
    missed_replies: int
    ages_s: Mapping[str, Array]


@dataclass(frozen=True, eq=False)
class Comparison:
    """Hold a run on a rig beside the same goals replayed in simulation.

    All times count from the first cycle of the run [s].

    Args:
        log: file that was compared
        complete: whether that file was closed properly
        rig: as embedded in the log
        controller_text: as embedded in the log
        meta: what else the log says of itself (versions, goal, twin…)
        events: state changes and faults, as ``(time [s], text)``
        goal_m: distance and bearing of the goal at the start ([m], [rad]), or None
        time_s: when the encoders were sampled, (nsample,)
        goal_time_s: when goals arrived at the servos, (ngoal,)
        goal_rad: those goals [rad], (ngoal, njoint)
        pose_time_s: times of the base poses, (npose,)
        force_time_s: times of the forces, (nforce,)
        real: the rig's track
        sim: the simulation's
        joints: differences, one a joint
        base_rms_m: root mean square distance between the two bases' paths [m], or None
        pose_source: where the rig's base pose comes from: "truth" (the virtual rig's judge), "sensors" or "none"
        real_outcome: how the rig ended
        sim_outcome: how the simulation ended
        timing: of the host loop
    """

    log: Path
    complete: bool
    rig: Rig
    controller_text: str
    meta: Mapping[str, Any]
    events: tuple[tuple[float, str], ...]
    goal_m: tuple[float, float] | None
    time_s: Array
    goal_time_s: Array
    goal_rad: Array
    pose_time_s: Array
    force_time_s: Array
    real: Track
    sim: Track
    joints: tuple[JointError, ...]
    base_rms_m: float | None
    pose_source: str
    real_outcome: Outcome
    sim_outcome: Outcome
    timing: LoopTiming

    @property
    def rmse_deg_max(self) -> float:
        """Return the root mean square error of the joint that agrees least [deg]."""
        return max(joint.rmse_deg for joint in self.joints)


def joint_errors(names: tuple[str, ...], time_s: Array, real_rad: Array, sim_rad: Array) -> tuple[JointError, ...]:
    """Measure how far each joint of the rig was from the simulation's.

    Args:
        names: of the joints
        time_s: of the samples [s], (nsample,)
        real_rad: the rig's angles, NaN where a servo did not answer [rad], (nsample, njoint)
        sim_rad: the simulation's angles [rad], (nsample, njoint)

    Returns:
        one entry a joint; NaN errors where a joint has no sample at all
    """
    found = []
    for name, error in zip(names, np.degrees(real_rad - sim_rad).T, strict=True):
        seen = np.flatnonzero(np.isfinite(error))
        if len(seen) == 0:
            found.append(JointError(name, 0, math.nan, math.nan, math.nan))
            continue
        worst = seen[np.argmax(np.abs(error[seen]))]
        found.append(
            JointError(
                name,
                len(seen),
                float(np.sqrt(np.mean(error[seen] ** 2))),
                float(abs(error[worst])),
                float(time_s[worst]),
            )
        )
    return tuple(found)


def count_hops(clearance_m: Array) -> int:
    """Count the rises of the lowest foot above `HOP_CLEARANCE_M`, each ended by a landing.

    Args:
        clearance_m: height of the lowest foot over the floor, NaN where unknown [m], (nsample,)

    Returns:
        hops; a foot that dips below the threshold without coming near the floor does not end one
    """
    hops, airborne = 0, False
    for clearance in clearance_m:
        if not airborne and clearance >= HOP_CLEARANCE_M:
            hops, airborne = hops + 1, True
        elif airborne and clearance < 0.2 * HOP_CLEARANCE_M:
            airborne = False
    return hops
