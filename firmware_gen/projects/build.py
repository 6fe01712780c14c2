"""Build a firmware project by the commands of its own README."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Final

from controller import Controller
from controller.errors import InputError, RunError
from controller.rig import Rig
from firmware_gen.projects.board import Board, load_board
from firmware_gen.projects.project import make_project, write_project

_SECONDS_MAX: Final = 600.0
_PACKAGES: Final = MappingProxyType({"cc": "gcc", "arm-none-eabi-gcc": "gcc-arm-none-eabi"})


def build_firmware(controller: Controller, rig: Rig, board: str | Board, out: Path) -> Path:
    """Write a firmware project and build it.

    Args:
        controller: the controller
        rig: the rig
        board: the board, or its name
        out: the project's folder; what was written there before is replaced

    Returns:
        path of the linked image; for the board "host" it is a program

    Raises:
        InputError: the firmware can not drive the rig, the controller does not fit it, or a tool is missing
        RunError: it does not build
    """
    found = load_board(board) if isinstance(board, str) else board
    write_project(make_project(controller, rig, found), out)
    return build_project(out, found)


def build_project(folder: Path, board: Board) -> Path:
    """Build the firmware project in a folder.

    Args:
        folder: the project's
        board: its board

    Returns:
        path of the linked image

    Raises:
        InputError: a tool is missing
        RunError: it does not build
    """
    require_tools(board)
    build = folder / "build"
    if not (build / "CMakeCache.txt").is_file():
        maker = ["-G", "Ninja"] if shutil.which("ninja") else []
        _run(["cmake", "-S", str(folder), "-B", str(build), *maker])
    _run(["cmake", "--build", str(build)])
    return build / board.elf


def require_tools(board: Board) -> None:
    """Check that what builds a board's firmware is installed.

    Args:
        board: the board

    Raises:
        InputError: something is missing, or this program does not build it
    """
    if board.form == "arduino":
        raise InputError(
            f"board {board.name}: its library is built by the Arduino IDE or PlatformIO, as its README.md says; "
            "leave out --build"
        )
    for tool in ("cmake", board.compiler):
        if shutil.which(tool) is None:
            package = _PACKAGES.get(tool, tool)
            raise InputError(f"board {board.name}: there is no {tool}; install it, as with: apt-get install {package}")
    if shutil.which("ninja") is None and shutil.which("make") is None:
        raise InputError(
            f"board {board.name}: there is neither ninja nor make; install one, as with: apt-get install ninja-build"
        )


def _run(command: Sequence[str]) -> None:
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, errors="replace", check=False, timeout=_SECONDS_MAX
        )
    except subprocess.TimeoutExpired:
        raise RunError(f"{' '.join(command)}: took more than {_SECONDS_MAX:g} s; look at what it does") from None
    if done.returncode != 0:
        told = [line.strip() for line in (done.stdout + done.stderr).splitlines() if line.strip()]
        named = ("undefined reference", "overflowed", "error:", "Error")
        first = next((line for word in named for line in told if word in line), told[-1] if told else "it says nothing")
        raise RunError(f"{' '.join(command)}: failed: {first}; run it by hand to see all that it says")
