"""Run a firmware image on the virtual rig: `servolve firmware … --run`, with the table and the log of `deploy`."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from rich.console import Console

from controller import Controller, Rig
from controller.errors import InputError
from deploy.checks import check_controller
from deploy.firmware.commands import commands
from deploy.host_loop import RunOptions
from deploy.logs.log import RunLog, check_log_path
from deploy.logs.summary import summary
from deploy.stop_request import StopRequest
from servolve.run_meta import GOAL_M, check_length, check_run, run_meta, run_seconds
from servolve.run_table import exit_status, not_told, tell, warn
from servolve.virtual_options import VirtualOptions, virtual_options

if TYPE_CHECKING:
    from deploy.firmware.machine import Firmware

TWIN: Final = "twin"
"""The machine that is a process of this computer; all others are QEMU's."""


@dataclass(frozen=True)
class AskedRun:
    """Say what a run of firmware shall be, as `servolve deploy` is asked.

    Args:
        goal: distance of the goal ahead of the start [m]
        seconds: length of the run, or None: as long as a rollout of the controller's evolution [s]
        derate: part of the rig's torque ceiling that is allowed
        twin: twin file, or None
        fault: what goes wrong on the virtual rig
        seed: seed of the virtual rig's faults and noise
        log: MCAP file to record, or None
    """

    goal: float = GOAL_M
    seconds: float | None = None
    derate: float = 1.0
    twin: Path | None = None
    fault: tuple[str, ...] = ()
    seed: int = 0
    log: Path | None = None


@dataclass(frozen=True)
class PlannedRun:
    """Hold a run that can be made.

    Args:
        machine: what runs the image
        controller: what is in it
        rig: what it drives
        options: what the run shall be
        virtual: what the virtual rig shall be
        log: MCAP file to record, or None
    """

    machine: str
    controller: Controller
    rig: Rig
    options: RunOptions
    virtual: VirtualOptions
    log: Path | None


def plan_run(machine: str, controller: Controller, rig: Rig, asked: AskedRun) -> PlannedRun:
    """Refuse what can not be run before anything is built.

    Args:
        machine: what runs the image, as the board's file says: "twin", a machine of QEMU, "" for nothing
        controller: what is in it
        rig: what it drives
        asked: what the run shall be

    Returns:
        the run

    Raises:
        InputError: the run is none that can be meant, or nothing here runs the image
    """
    if not machine:
        raise InputError("--run: nothing here runs an image of this board; choose board host, or flash it")
    if machine != TWIN:
        from deploy.firmware.qemu import require_emulator

        require_emulator(machine)
    check_run(asked.goal, asked.seconds, asked.derate)
    if asked.log is not None:
        check_log_path(asked.log)
    virtual = virtual_options(asked.twin, asked.fault, asked.seed)
    seconds = run_seconds(controller, asked.seconds)
    check_length(rig, seconds)
    options = RunOptions(asked.goal, 0.0, seconds, True, asked.derate)
    commands(options, rig.period_s)
    virtual.check(rig)
    return PlannedRun(machine, controller, rig, options, virtual, asked.log)


def run_image(image: Path, run: PlannedRun, known: Mapping[str, Any], as_json: bool) -> int:
    """Run an image on the virtual rig in lock step; print how it went as `deploy` does.

    Args:
        image: what was built
        run: what the run shall be
        known: figures of the build, which a JSON object tells as well
        as_json: whether to print one JSON object

    Returns:
        exit status; 0: done; a fault, or a stop, is told as an error

    Raises:
        RunError: the firmware has ended by a fault or a stop, has died, or does not end
    """
    from deploy.firmware.run import run_firmware  # needs MuJoCo, as all that moves a virtual rig

    console = Console(stderr=True)
    rig, controller, options, port = run.rig, run.controller, run.options, f"firmware {run.machine}"
    warnings = check_controller(rig, controller)
    with ExitStack() as stack:
        stop = stack.enter_context(StopRequest())
        virtual = run.virtual.rig(rig)
        firmware = stack.enter_context(closing(_machine(image, run.machine)))
        record = stack.enter_context(RunLog(run.log or os.devnull))
        record.write("/meta", 0.0, run_meta(controller, rig, options, port, run.virtual))
        warn(console, warnings)
        outcome, witness = run_firmware(virtual, firmware, controller, options, record, stop.reason)
        seen = witness.verdict(options.goal_dist, options.goal_bearing)
    told = {**known, "controller": controller.name, "rig": rig.name, "port": port}
    told |= summary(outcome, options, seen) | {"log": None if run.log is None else str(run.log)}
    warn(console, not_told(outcome, warnings))
    tell(console, rig, outcome, told, as_json, True)
    return exit_status(outcome)


def _machine(image: Path, machine: str) -> Firmware:
    """Return what runs an image, not yet booted."""
    if machine == TWIN:
        from deploy.firmware.twin import TwinProcess

        return TwinProcess(image)
    from deploy.firmware.qemu import Qemu

    return Qemu(image, machine)
