"""`servolve firmware`: a controller on a rig on a board, as a C project that one can build and flash."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from controller import load_controller
from controller.errors import InputError
from firmware_gen.board import board_names, load_board
from firmware_gen.build import build_project, require_tools
from firmware_gen.image_size import image_size
from firmware_gen.project import make_project, write_project
from servolve.run_rig import rig_of


def firmware(
    controller: Path,
    /,
    *,
    rig: str | None = None,
    board: str | None = None,
    out: Path,
    build: Annotated[bool, Parameter(negative="")] = False,
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
        build: build it too, with CMake
        force: write although other files are there
        json_: print one JSON object

    Returns:
        exit status; 0: written, and built if that was asked for
    """
    if board is None:
        raise InputError(f"--board is missing; give it one of {', '.join(board_names())}, or a board's folder")
    chosen = load_board(board)
    loaded = load_controller(controller)
    about = rig_of(controller, loaded, rig)
    project = make_project(loaded, about, chosen)
    if build:
        require_tools(chosen)
    write_project(project, out, force)
    told: dict[str, Any] = {"out": str(out), "board": chosen.name, "rig": about.name, "controller": loaded.name}
    if build:
        image = build_project(out, chosen)
        told |= {"image": str(image), **image_size(image)}
    if json_:
        print(json.dumps(told | {"files": list(project.files)}))
    else:
        _tell(told, out)
    return 0


def _tell(told: dict[str, Any], out: Path) -> None:
    print(out / "README.md")
    if "image" in told:
        print(f"{told['image']}: {told['text_bytes']} bytes of text, {told['ram_bytes']} bytes of RAM")
