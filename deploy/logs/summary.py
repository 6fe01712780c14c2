"""Say in a few numbers how a run went: for the table and the JSON that the command line prints."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

from deploy.host_loop import Outcome, RunOptions

TILT_UPRIGHT_RAD: Final = 0.35
"""A base that tilts no more than this stands upright."""

_POSE: Final = ("x", "y", "heading")


def summary(outcome: Outcome, options: RunOptions, seen: Mapping[str, Any]) -> dict[str, Any]:
    """Return what is worth telling of a run.

    Args:
        outcome: of the host loop
        options: what was asked for
        seen: verdict of a virtual rig's witness; empty on a real one

    Returns:
        field => number, text or None
    """
    fields: dict[str, Any] = {
        "state": outcome.state.value,
        "done": outcome.done,
        "reason": outcome.reason,
        "fault": outcome.reason if outcome.faulty else None,
        "findings": [finding.text for finding in outcome.findings],
        "torque_unsure": [joint.name for joint in outcome.unsure],
        "cycles": outcome.cycles,
        "missed_deadlines": outcome.missed_deadlines,
        "missed_replies": outcome.missed_replies,
        "bus_bytes": outcome.bus_bytes,
        "bus_sha256": outcome.bus_sha256,
        "goal_m": options.goal_dist,
        "final_px_m": None,
        "wire_error_m": None,
        "final_error_m": None,
        "final_tilt_rad": None,
        "upright": None,
        "hops": None,
        "max_clearance_m": None,
    }
    fields |= _by_wire(outcome, options)
    fields |= {name: round(value, 6) for name, value in seen.items()}
    tilt = fields["final_tilt_rad"]
    if tilt is not None:
        fields["upright"] = bool(tilt <= TILT_UPRIGHT_RAD)
    return fields


def _by_wire(outcome: Outcome, options: RunOptions) -> dict[str, Any]:
    """Return where the run ended as the sensor node saw it."""
    start, end = outcome.start_pose, outcome.pose
    fields: dict[str, Any] = {}
    if all(name in start for name in _POSE):
        course = start["heading"] + options.goal_bearing
        ahead = start["x"] + options.goal_dist * math.cos(course) - end["x"]
        left = start["y"] + options.goal_dist * math.sin(course) - end["y"]
        px = ahead * math.cos(end["heading"]) + left * math.sin(end["heading"])
        fields |= {"final_px_m": round(px, 6), "wire_error_m": round(math.hypot(ahead, left), 6)}
    if "roll" in end and "pitch" in end:
        fields["final_tilt_rad"] = round(math.acos(math.cos(end["roll"]) * math.cos(end["pitch"])), 6)
    return fields
