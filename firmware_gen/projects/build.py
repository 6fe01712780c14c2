"""Build a firmware project by the commands of its own README."""

from __future__ import annotations

import itertools
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
from firmware_gen.projects.project import BUILD, drop_build, make_project, write_project

_SECONDS_MAX: Final = 600.0
_TOLD_MAX: Final = 400
_UNBUILDABLE: Final = frozenset(';$#"\\<>|[]')
"""Characters that CMake, or what it writes, does not keep as they are in a path."""
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
        InputError: a tool is missing, or the folder's path is none for CMake
        RunError: it does not build
    """
    require_tools(board)
    require_path(folder)
    build = folder / BUILD
    if not _is_set_up(folder):
        drop_build(folder)
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


def require_path(folder: Path) -> None:
    """Check that CMake can build in a folder.

    Args:
        folder: the project's

    Raises:
        InputError: its path has a character that CMake does not take
    """
    for character in str(folder.absolute()):
        if character in _UNBUILDABLE or not character.isprintable():
            raise InputError(
                f"{folder}: CMake builds nothing under a path with {character!r}; give --out another folder"
            )


def _is_set_up(folder: Path) -> bool:
    """Tell whether CMake has come to the end of setting up this very folder, with a program that is still there."""
    build = folder / BUILD
    try:
        cache = (build / "CMakeCache.txt").read_text(encoding="utf-8", errors="replace")
        values = dict(line.split("=", 1) for line in cache.splitlines() if "=" in line)
        here = Path(values["CMAKE_HOME_DIRECTORY:INTERNAL"]).samefile(folder)
    except (OSError, KeyError, ValueError):
        return False
    maker = shutil.which(values.get("CMAKE_MAKE_PROGRAM:FILEPATH", ""))
    return here and maker is not None and any((build / name).is_file() for name in ("build.ninja", "Makefile"))


def _run(command: Sequence[str]) -> None:
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, errors="replace", check=False, timeout=_SECONDS_MAX
        )
    except subprocess.TimeoutExpired:
        raise RunError(f"{' '.join(command)}: took more than {_SECONDS_MAX:g} s; look at what it does") from None
    if done.returncode != 0:
        told = _first_failure((done.stdout + done.stderr).splitlines())
        raise RunError(f"{' '.join(command)}: failed: {told}; run it by hand to see all that it says")


def _first_failure(lines: Sequence[str]) -> str:
    """Return what a compiler, a linker, Ninja or CMake says of what failed."""
    told = [line for line in lines if line.strip()]
    for word in ("undefined reference", "overflowed", "error:", "***"):
        found = next((line for line in told if word in line), None)
        if found is not None:
            return found.strip()
    start = next((number for number, line in enumerate(told) if line.startswith("CMake Error")), None)
    if start is None:
        return told[-1].strip() if told else "it says nothing"
    # the sentence follows on indented lines
    told = [told[start], *itertools.takewhile(lambda line: line.startswith(" "), told[start + 1 :])]
    return " ".join(" ".join(told).split())[:_TOLD_MAX]
