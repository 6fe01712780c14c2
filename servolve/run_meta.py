"""What a run's log says of itself, and what may be asked of a run."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Final

from controller import Controller, Rig, controller_text
from controller.errors import InputError
from deploy.host_loop import RunOptions
from deploy.logs.log_topics import FORMAT
from servolve.virtual_options import VirtualOptions

GOAL_M: Final = 0.4
SECONDS: Final = 6.0
_PACKAGES: Final = ("servolve", "dynamixel-sdk", "mujoco-core", "numpy", "mcap")


def run_meta(
    controller: Controller, rig: Rig, options: RunOptions, port: str, virtual: VirtualOptions | None
) -> dict[str, Any]:
    """Return the fields of `/meta`.

    Args:
        controller: the controller
        rig: the rig
        options: what was asked for
        port: "virtual", the port's path, or who ran instead of the host
        virtual: what the virtual rig was asked to be; None on a real one
    """
    meta: dict[str, Any] = {
        "format": FORMAT,
        "rig": rig.name,
        "rig_text": rig.text,
        "controller": controller.name,
        "controller_text": controller_text(controller),
        "goal_dist": options.goal_dist,
        "goal_bearing": options.goal_bearing,
        "period_s": rig.period_s,
        "port": port,
        "seconds": options.seconds,
        "derate": options.derate,
        "versions": _versions(),
    }
    if virtual is not None:
        twin = None if virtual.twin is None else virtual.twin.text
        meta |= {"seed": virtual.seed, "faults": list(virtual.faults), "twin": twin}
    return meta


def run_seconds(controller: Controller, seconds: float | None) -> float:
    """Return how long a run takes: as asked, else as long as a rollout of the controller's evolution [s].

    Args:
        controller: the controller
        seconds: what was asked for, or None [s]
    """
    return float(controller.provenance.get("time_limit_s", SECONDS)) if seconds is None else seconds


def check_run(goal: float, seconds: float | None, derate: float) -> None:
    """Refuse a run that nobody can mean.

    Args:
        goal: distance of the goal [m]
        seconds: length of the run, or None [s]
        derate: part of the torque ceiling that is allowed

    Raises:
        InputError: one of them is out of range
    """
    if not -100.0 <= goal <= 100.0:
        raise InputError(f"--goal {goal:g}: is no distance in reach; give metres")
    if seconds is not None and not 0.0 < seconds <= 86400.0:
        raise InputError(f"--seconds {seconds:g}: is not between 0 and 86400; give the length of the run")
    if not 0.0 < derate <= 1.0:
        raise InputError(f"--derate {derate:g}: is not above 0 and at most 1; give a part of the torque ceiling")


def check_length(rig: Rig, seconds: float) -> None:
    """Refuse a run without a period.

    Args:
        rig: the rig
        seconds: length of the run [s]

    Raises:
        InputError: it is shorter than a period
    """
    if seconds < rig.period_s:
        raise InputError(f"--seconds {seconds:g}: is less than a control period of {rig.period_s:g} s; give more")


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found
