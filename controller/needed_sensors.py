"""Which sensors a run can not do without, driven by the host loop or by firmware."""

from __future__ import annotations

from typing import Final

from controller.controller import Controller
from controller.rig import Rig

_POSE_TERMINALS: Final = ("px", "py", "goal_met", "heading_error")


def needed_sensors(rig: Rig, controller: Controller) -> frozenset[int]:
    """Return the numbers of the sensors that must stay fresh: those that the controller or the tilt guard reads.

    Args:
        rig: the rig
        controller: the controller

    Returns:
        their places in the rig's list
    """
    terminals = {terminal.name for terminal in controller.inputs}
    names: set[str] = set()
    if terminals & set(_POSE_TERMINALS):
        names |= {"x", "y", "heading"}
    if "pz" in terminals:
        names.add("z")
    if rig.safety.tilt_rad_max > 0.0:
        names |= {"roll", "pitch"}
    return frozenset(
        number for number, sensor in enumerate(rig.sensors) if sensor.name in names or sensor.terminal in terminals
    )
