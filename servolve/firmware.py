"""`servolve firmware`: a controller on a rig on a board, as a C project that one can build and flash."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from controller import load_controller
from controller.errors import InputError
from firmware_gen.projects.board import board_names, load_board
from firmware_gen.projects.build import build_project, require_path, require_tools
from firmware_gen.projects.image_size import image_size
from firmware_gen.projects.project import make_project, write_project
from servolve.firmware_run import AskedRun, plan_run, run_image
from servolve.run_meta import GOAL_M
from servolve.run_rig import rig_of


def firmware(
    controller: Path,
    /,
    *,
    rig: str | None = None,
    board: str | None = None,
    out: Path,
    fast_sync_read: Annotated[bool, Parameter(negative="")] = False,
    build: Annotated[bool, Parameter(negative="")] = False,
    run: Annotated[bool, Parameter(negative="")] = False,
    goal: float = GOAL_M,
    seconds: float | None = None,
    derate: float = 1.0,
    twin: Path | None = None,
    fault: Annotated[tuple[str, ...], Parameter(negative="")] = (),
    seed: int = 0,
    log: Path | None = None,
    force: Annotated[bool, Parameter(negative="")] = False,
    json_: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> int:
    """Write a controller as firmware: a CMake project of C99 that drives the rig's servos from a microcontroller.

    The folder builds by itself; its README.md says how, and how to wire, flash and run it.

    Args:
        controller: a controller file, or a run folder (its best)
        rig: name that `servolve rig list` prints, or path of a rig file; left out: the one it was evolved on
        board: name of a board, or path of a folder with a board.toml; a wrong name is answered with the list
        out: the folder to write to
        fast_sync_read: let one status packet answer for all servos, which takes less time on the line; Dynamixel 2.0
        build: build it too, with CMake
        run: build it and run it on the virtual rig, in lock step, as `deploy` runs the host loop: board host as a
            process of this computer, the others under QEMU
        goal: of a run: distance of the goal ahead of the start [m]
        seconds: of a run: its length; left out: as long as a rollout of the controller's evolution, or 6 [s]
        derate: of a run: part of the rig's torque ceiling that is allowed
        twin: of a run: twin file, which makes the virtual rig's physics differ from the simulation's
        fault: of a run: what goes wrong on the virtual rig, as drop=0.01 or dead=2@3.0, or a file of faults; may be
            repeated
        seed: of a run: seed of the virtual rig's faults and noise
        log: of a run: MCAP file to record
        force: write although other files are there
        json_: print one JSON object

    Returns:
        exit status; 0: written, and built and run if that was asked for
    """
    if board is None:
        raise InputError(f"--board is missing; give it one of {', '.join(board_names())}, or a board's folder")
    chosen = load_board(board)
    loaded = load_controller(controller)
    about = rig_of(controller, loaded, rig)
    project = make_project(loaded, about, chosen, fast_sync_read)
    asked = AskedRun(goal, seconds, derate, twin, fault, seed, log)
    if not run and asked != AskedRun():
        raise InputError("--goal, --seconds, --derate, --twin, --fault, --seed and --log: are of a run; add --run")
    plan = plan_run(chosen.machine, loaded, about, asked) if run else None
    build = build or run
    if build:
        require_tools(chosen)
        require_path(out)
    write_project(project, out, force)
    told: dict[str, Any] = {"out": str(out), "board": chosen.name, "rig": about.name, "controller": loaded.name}
    if build:
        image = build_project(out, chosen)
        told |= {"image": str(image), **image_size(image)}
    if plan:
        if not json_:
            _tell(told, out)
        return run_image(Path(told["image"]), plan, told, json_)
    if json_:
        print(json.dumps(told | {"files": list(project.files)}))
    else:
        _tell(told, out)
    return 0


def _tell(told: dict[str, Any], out: Path) -> None:
    print(out / "README.md")
    if "image" in told:
        print(f"{told['image']}: {told['text_bytes']} bytes of text, {told['ram_bytes']} bytes of RAM")
