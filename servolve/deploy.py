"""`servolve deploy`: run a controller on a rig, virtual or real."""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from cyclopts import Parameter
from rich.console import Console
from rich.table import Table

from controller import Controller, Rig, controller_text, load_controller, load_rig
from controller.errors import InputError, RunError
from controller.native import pack_cycle
from controller.rig_file import rig_names
from deploy.checks import Finding, check_controller
from deploy.connection import connect_ports, connect_virtual
from deploy.drivable import require_drivable
from deploy.host_loop import Outcome, RunOptions, run_controller
from deploy.log import RunLog
from deploy.log_topics import FORMAT
from deploy.period import Connection
from deploy.realtime import realtime
from deploy.stop_request import StopRequest
from deploy.summary import summary
from deploy.torque import unsure_sentence
from servolve.announcer import Announcer
from servolve.reading_table import reading_table
from servolve.run_rig import rig_of

if TYPE_CHECKING:
    from deploy.virtual.twin import Twin

VIRTUAL: Final = "virtual"
GOAL_M: Final = 0.4
SECONDS: Final = 6.0
_PACKAGES: Final = ("servolve", "dynamixel-sdk", "mujoco-core", "numpy", "mcap")


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
    _check_arguments(virtual, goal, seconds, derate, bool(twin or fault or seed), sensor_port, real_time)
    if seed < 0:
        raise InputError(f"--seed {seed}: is negative; give a whole number from 0")
    if seconds is None:
        seconds = float(program.provenance.get("time_limit_s", SECONDS))
    if seconds < about.period_s:
        raise InputError(f"--seconds {seconds:g}: is less than a control period of {about.period_s:g} s; give more")
    other = _load_twin(twin)
    options = RunOptions(goal, 0.0, seconds, arm or virtual, derate)
    console = Console(stderr=True)
    with ExitStack() as stack:
        stop = stack.enter_context(StopRequest())
        record = stack.enter_context(RunLog(log or os.devnull, 0 if virtual else time.time_ns()))
        faults = _faults(fault)
        meta = _meta(program, about, options, port, other, faults, seed)
        record.write("/meta", 0.0, meta)
        if virtual:
            link = stack.enter_context(_virtual(about, other, faults, seed, stop))
        else:
            link = stack.enter_context(connect_ports(about, port, sensor_port, stop.reason))
        if real_time:
            for refused in stack.enter_context(realtime()):
                console.print(f"servolve: warning: {refused}", highlight=False)

        pack_cycle(program, about)  # refuses a controller that does not fit, before anything is said of it
        known = check_controller(about, program)
        _warn(console, known)
        announcer = None if virtual else stack.enter_context(Announcer(console, about.name))
        outcome = run_controller(link, about, program, options, record, announcer)
        seen = link.witness.verdict(goal, 0.0) if link.witness else {}
    told = {"controller": program.name, "rig": about.name, "port": port} | summary(outcome, options, seen)
    told["log"] = None if log is None else str(log)
    _warn(console, _not_told(outcome, known))
    _tell(console, about, outcome, told, json_, options.arm)
    if outcome.done and not outcome.faulty:
        return 0
    unsure = unsure_sentence(outcome.unsure) if outcome.unsure else outcome.reason
    raise RunError(outcome.reason if unsure == outcome.reason else f"{outcome.reason}; {unsure}")


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


def _check_arguments(
    virtual: bool,
    goal: float,
    seconds: float | None,
    derate: float,
    pretended: bool,
    sensor_port: str | None,
    real_time: bool,
) -> None:
    if not -100.0 <= goal <= 100.0:
        raise InputError(f"--goal {goal:g}: is no distance in reach; give metres")
    if seconds is not None and not 0.0 < seconds <= 86400.0:
        raise InputError(f"--seconds {seconds:g}: is not between 0 and 86400; give the length of the run")
    if not 0.0 < derate <= 1.0:
        raise InputError(f"--derate {derate:g}: is not above 0 and at most 1; give a part of the torque ceiling")
    if pretended and not virtual:
        raise InputError("--twin, --fault and --seed: act on the virtual rig only; leave them out, or --port")
    if virtual and sensor_port is not None:
        raise InputError("--sensor-port: the virtual rig brings its own sensor node; leave it out, or give --port")
    if virtual and real_time:
        raise InputError("--realtime: the virtual rig runs in lock step, in its own time; leave it out, or give --port")


def _load_twin(twin: Path | None) -> Twin | None:
    if twin is None:
        return None
    from deploy.virtual.twin import load_twin

    return load_twin(twin)


def _faults(specs: tuple[str, ...]) -> tuple[str, ...]:
    """Return the faults, with those of files."""
    if not specs:
        return ()
    from deploy.virtual.faults import fault_specs

    return fault_specs(specs)


@contextmanager
def _virtual(
    rig: Rig, twin: Twin | None, faults: tuple[str, ...], seed: int, stop: StopRequest
) -> Iterator[Connection]:
    # only the virtual rig needs MuJoCo
    from deploy.virtual.faults import parse_fault
    from deploy.virtual.rig import VirtualRig

    body = VirtualRig(rig, seed=seed, twin=twin, faults=[parse_fault(text) for text in faults])
    with connect_virtual(body, stop.reason) as link:
        yield link


def _meta(
    controller: Controller,
    rig: Rig,
    options: RunOptions,
    port: str,
    twin: Twin | None,
    faults: tuple[str, ...],
    seed: int,
) -> dict[str, Any]:
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
    if port == VIRTUAL:
        meta |= {"seed": seed, "faults": list(faults), "twin": None if twin is None else twin.text}
    return meta


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def _not_told(outcome: Outcome, known: Sequence[Finding]) -> list[Finding]:
    """Return the findings that nothing else says: those known before are told, the first error is how the run ended."""
    first = next((finding for finding in outcome.findings if finding.level == "error"), None)
    return [finding for finding in outcome.findings if finding is not first and finding not in known]


def _warn(console: Console, findings: Sequence[Finding]) -> None:
    for finding in findings:
        console.print(f"servolve: {finding.level}: {finding.text}", highlight=False, markup=False, soft_wrap=True)


def _tell(console: Console, rig: Rig, outcome: Outcome, told: Mapping[str, Any], as_json: bool, armed: bool) -> None:
    if as_json:
        print(json.dumps(told))
        return
    if not armed:
        console.print(reading_table(outcome.readings))
        for sensor in rig.sensors:
            value = outcome.pose.get(sensor.name)
            shown = "-" if value is None else f"{value:.4g}"
            console.print(f"sensor {sensor.name}: {shown}", highlight=False)
        if outcome.done:
            console.print(outcome.reason, highlight=False)
    elif outcome.cycles:
        console.print(_figures(told))


def _figures(told: Mapping[str, Any]) -> Table:
    table = Table(show_header=False)
    for name, unit in (
        ("state", ""),
        ("cycles", ""),
        ("missed_deadlines", ""),
        ("missed_replies", ""),
        ("bus_bytes", ""),
        ("goal_m", "m"),
        ("final_px_m", "m"),
        ("final_error_m", "m"),
        ("final_tilt_rad", "rad"),
        ("hops", ""),
        ("max_clearance_m", "m"),
        ("log", ""),
    ):
        value = told[name]
        if value is not None:
            label = name.removesuffix("_m").removesuffix("_rad").replace("_", " ")
            table.add_row(label, f"{value:.3f} {unit}" if isinstance(value, float) else str(value))
    return table
