"""`servolve log`: what a board's console has sent, as the log of a run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Final

import numpy as np
from cyclopts import Parameter
from rich.console import Console

from controller import Controller, Rig, load_controller, load_rig, parse_controller
from controller.errors import InputError
from controller.rig_file import parse_rig, rig_names
from deploy.firmware.dump import DumpedRun, dumped_runs, lost_cycles, write_run
from deploy.firmware.records import FORMAT
from deploy.host_loop import Outcome, RunOptions
from deploy.logs.log import RunLog
from deploy.logs.summary import summary
from firmware_gen.projects.fingerprints import rig_fingerprint
from servolve.run_meta import run_meta
from servolve.run_rig import rig_of
from servolve.run_table import tell

_BYTES_MAX: Final = 1 << 30
_PROJECT: Final = "servolve.json"


def log(
    console: Path,
    /,
    *,
    out: Path,
    project: Path | None = None,
    controller: Path | None = None,
    rig: str | None = None,
    run: int | None = None,
    json_: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> int:
    """Turn what a board's console has sent into a log as `deploy` records it, for replay and compare.

    Record the console with any terminal program that keeps bytes as they come, as: cat /dev/ttyUSB1 > console.bin

    Args:
        console: file with the recorded bytes
        out: MCAP file to write
        project: folder of the firmware's project, which keeps rig and controller
        controller: instead of the project: the controller that is in the firmware, or a run folder (its best)
        rig: of such a controller: name that `servolve rig list` prints, or path of a rig file; left out: the one it was
            evolved on
        run: which run of the recording, from 1; left out: the last
        json_: print one JSON object

    Returns:
        exit status; 0: written, whatever became of the run
    """
    loaded, about = _made_from(project, controller, rig)
    runs, damaged = dumped_runs(_read(console), about, loaded)
    chosen = _choose(console, runs, run)
    _check_origin(console, chosen, about, loaded)
    options = _asked(chosen, about)
    with RunLog(out) as record:
        record.write("/meta", 0.0, run_meta(loaded, about, options, "firmware", None))
        outcome = write_run(chosen, about, loaded, record.write)
    _report(chosen, about, loaded, options, outcome, damaged, out, json_)
    return 0


def _made_from(project: Path | None, controller: Path | None, rig: str | None) -> tuple[Controller, Rig]:
    """Return controller and rig of the firmware."""
    if (project is None) == (controller is None):
        raise InputError("--project or --controller: one of them is needed; give the folder of the firmware's project")
    if controller is not None:
        loaded = load_controller(controller)
        return loaded, rig_of(controller, loaded, rig)
    assert project is not None
    if rig is not None:
        raise InputError("--rig: the project says which; leave it out")
    path = project / _PROJECT
    try:
        kept = json.loads(path.read_text())
        texts = kept["controller"]["text"], kept["rig"]["text"]
        name = kept["rig"]["name"]
        folder = load_rig(name).path.parent if name in rig_names() else project
        return parse_controller(texts[0], f"{path}: controller"), parse_rig(texts[1], folder / f"{name}.rig.toml")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give the folder of a firmware project") from None
    except (ValueError, KeyError, TypeError):
        raise InputError(f"{path}: is not what servolve firmware writes; write the project again") from None


def _read(path: Path) -> bytes:
    try:
        if path.stat().st_size > _BYTES_MAX:
            raise InputError(f"{path}: is larger than {_BYTES_MAX >> 20} MiB; cut out the run that you want")
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give the path of a console's recording") from None


def _choose(path: Path, runs: list[DumpedRun], number: int | None) -> DumpedRun:
    if not runs:
        raise InputError(f"{path}: holds no run; record the board's console byte by byte, from before the start on")
    if number is None:
        return runs[-1]
    if not 1 <= number <= len(runs):
        raise InputError(f"--run {number}: the recording holds {len(runs)}; give 1 to {len(runs)}")
    return runs[number - 1]


def _check_origin(path: Path, run: DumpedRun, rig: Rig, controller: Controller) -> None:
    """Refuse a recording of firmware that was made from other files."""
    if run.hello is not None and run.hello.format != FORMAT:
        raise InputError(
            f"{path}: its records have format {run.hello.format}, and this servolve reads format {FORMAT}; use the "
            "servolve that made the firmware"
        )
    if run.hello is not None and run.hello.rig != rig_fingerprint(rig, controller):
        raise InputError(
            f"{path}: is of firmware that was made from another rig or controller than {rig.name} and "
            f"{controller.name}; give those that servolve.json of its project holds"
        )


def _asked(run: DumpedRun, rig: Rig) -> RunOptions:
    """Return what the run was asked to do; 0 where that was not recorded."""
    if run.started is None:
        return RunOptions(0.0, 0.0, 0.0, True, 1.0)
    asked = run.started
    seconds = round(asked.periods * rig.period_s, 9)
    goal, bearing, derate = (float(str(np.float32(x))) for x in (asked.goal_dist, asked.goal_bearing, asked.derate))
    return RunOptions(goal, bearing, seconds, bool(asked.armed), derate)


def _report(
    run: DumpedRun,
    rig: Rig,
    controller: Controller,
    options: RunOptions,
    outcome: Outcome,
    damaged: int,
    out: Path,
    as_json: bool,
) -> None:
    console = Console(stderr=True)
    told = {"controller": controller.name, "rig": rig.name, "complete": run.complete, "damaged": damaged}
    told |= {"lost_cycles": lost_cycles(run.records), "log": str(out)}
    told |= {name: value for name, value in summary(outcome, options, {}).items() if name != "bus_sha256"}
    if as_json:
        print(json.dumps(told))
        return
    for what, sentence in (
        (
            run.hello is None,
            f"its boot was not recorded, so whether it is of {controller.name} on {rig.name} is not known",
        ),
        (run.started is None, "its start was not recorded, so goal and length are not known: replay will differ"),
        (not run.complete, "its end was not recorded; figures are of what was"),
        (damaged > 0, f"pieces of the recording that are damaged: {damaged}"),
        (told["lost_cycles"], f"control periods that are missing: {told['lost_cycles']}; replay needs them all"),
    ):
        if what:
            console.print(f"servolve: warning: {sentence}", highlight=False, markup=False, soft_wrap=True)
    tell(console, rig, outcome, told, False, options.arm)
    if outcome.reason and (options.arm or not outcome.done):  # a dry run that is done has said so
        console.print(f"ended by: {outcome.reason}", highlight=False, markup=False, soft_wrap=True)
    print(out)
