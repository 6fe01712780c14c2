"""`servolve deploy`: run a controller on a rig, virtual or real."""

from __future__ import annotations

import os
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Final

from cyclopts import Parameter
from rich.console import Console

from controller import Controller, Rig, load_controller, load_rig
from controller.errors import InputError
from controller.native import pack_cycle
from controller.rig_file import rig_names
from deploy.checks import check_controller
from deploy.connection import connect_ports, connect_virtual
from deploy.drivable import require_drivable
from deploy.host_loop import RunOptions, run_controller
from deploy.logs.log import RunLog
from deploy.logs.summary import summary
from deploy.realtime import realtime
from deploy.stop_request import StopRequest
from servolve.announcer import Announcer
from servolve.run_meta import GOAL_M, check_length, check_run, run_meta, run_seconds
from servolve.run_rig import rig_of
from servolve.run_table import exit_status, not_told, tell, warn
from servolve.virtual_options import virtual_options

VIRTUAL: Final = "virtual"


def deploy(
    controller: Path,
    /,
    *,
    rig: str | None = None,
    port: str = VIRTUAL,
    sensor_port: str | None = None,
    arm: Annotated[bool, Parameter(negative="")] = False,
    goal: float = GOAL_M,
    seconds: float | None = None,
    derate: float = 1.0,
    twin: Path | None = None,
    fault: Annotated[tuple[str, ...], Parameter(negative="")] = (),
    seed: int = 0,
    log: Path | None = None,
    real_time: Annotated[bool, Parameter(name="--realtime", negative="")] = False,
    json_: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> int:
    """Run a controller on a rig: check, arm, home, run; torque off on every way out.

    A real port needs --arm; without it the rig is only read and what was read is printed. Ctrl-C, the keys q and space,
    and a line $E,...*HH of the sensor node stop the run.

    Args:
        controller: a controller file, or a run folder (its best)
        rig: name that `servolve rig list` prints, or path of a rig file; left out: the one it was evolved on
        port: "virtual", a serial device, or socket://HOST:PORT
        sensor_port: serial device or socket of the sensor node
        arm: allow torque on a real port
        goal: distance of the goal ahead of the start [m]
        seconds: length of the run; left out: as long as a rollout of the controller's evolution, or 6 [s]
        derate: part of the rig's torque ceiling that is allowed; 0.5 is wise on a first run
        twin: twin file, which makes the virtual rig's physics differ from the simulation's
        fault: what goes wrong on the virtual rig, as drop=0.01, corrupt=0.01 or dead=2@3.0, or a file of faults; may be
            repeated
        seed: seed of the virtual rig's faults and noise
        log: MCAP file to record
        real_time: ask the operating system for real-time priority and locked memory
        json_: print one JSON object

    Returns:
        exit status; 0: done; a fault, or a stop, is told as an error
    """
    program = load_controller(controller)
    about = rig_of(controller, program, rig)
    _require_drivable(about, program)
    virtual = port == VIRTUAL
    check_run(goal, seconds, derate)
    _check_arguments(virtual, bool(twin or fault or seed), sensor_port, real_time)
    body = virtual_options(twin, fault, seed)
    seconds = run_seconds(program, seconds)
    check_length(about, seconds)
    options = RunOptions(goal, 0.0, seconds, arm or virtual, derate)
    console = Console(stderr=True)
    with ExitStack() as stack:
        stop = stack.enter_context(StopRequest())
        record = stack.enter_context(RunLog(log or os.devnull, 0 if virtual else time.time_ns()))
        record.write("/meta", 0.0, run_meta(program, about, options, port, body if virtual else None))
        if virtual:
            link = stack.enter_context(connect_virtual(body.rig(about), stop.reason))
        else:
            link = stack.enter_context(connect_ports(about, port, sensor_port, stop.reason))
        if real_time:
            for refused in stack.enter_context(realtime()):
                console.print(f"servolve: warning: {refused}", highlight=False)

        pack_cycle(program, about)  # refuses a controller that does not fit, before anything is said of it
        known = check_controller(about, program)
        warn(console, known)
        announcer = None if virtual else stack.enter_context(Announcer(console, about.name))
        outcome = run_controller(link, about, program, options, record, announcer)
        seen = link.witness.verdict(goal, 0.0) if link.witness else {}
    told = {"controller": program.name, "rig": about.name, "port": port} | summary(outcome, options, seen)
    told["log"] = None if log is None else str(log)
    warn(console, not_told(outcome, known))
    tell(console, about, outcome, told, json_, options.arm)
    return exit_status(outcome)


def _require_drivable(rig: Rig, program: Controller) -> None:
    """Refuse a rig that is not to be built, and recommend another only to a controller that fits it."""
    if rig.simulated_only and not any(_fits(program, load_rig(name)) for name in rig_names()):
        raise InputError(
            f"rig {rig.name}: exists in simulation only, and {program.name} fits no rig that can be built; evolve a"
            " controller on one of those that `servolve rig list` shows with servos"
        )
    require_drivable(rig)


def _fits(program: Controller, rig: Rig) -> bool:
    """Tell whether a rig can be built and a controller runs on it."""
    if rig.simulated_only:
        return False
    try:
        pack_cycle(program, rig)
    except InputError:
        return False
    return True


def _check_arguments(virtual: bool, pretended: bool, sensor_port: str | None, real_time: bool) -> None:
    if pretended and not virtual:
        raise InputError("--twin, --fault and --seed: act on the virtual rig only; leave them out, or --port")
    if virtual and sensor_port is not None:
        raise InputError("--sensor-port: the virtual rig brings its own sensor node; leave it out, or give --port")
    if virtual and real_time:
        raise InputError("--realtime: the virtual rig runs in lock step, in its own time; leave it out, or give --port")
