"""A controller on a rig on a board as a folder of C that builds by itself: the same input, the same bytes."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Final

from controller import Controller, controller_text
from controller.errors import InputError
from controller.generate_runtime import PATH as RUNTIME_TABLE
from controller.rig import Rig
from firmware_gen.projects.arduino_library import library_files
from firmware_gen.projects.board import Board
from firmware_gen.projects.fingerprints import program_fingerprint, rig_fingerprint
from firmware_gen.projects.plain import plain
from firmware_gen.projects.program_glue import glue_source
from firmware_gen.projects.program_stack import program_stack
from firmware_gen.projects.project_cmake import cmake_text
from firmware_gen.projects.project_readme import readme_text
from firmware_gen.projects.rig_config import rig_header, rig_source
from firmware_gen.projects.rig_sizes import sizes_files, sizes_of
from firmware_gen.transpiler.generate import generate
from firmware_gen.transpiler.unit import GENERATOR_VERSION, Unit, make_unit

MANIFEST: Final = "servolve.json"
BUILD: Final = "build"
"""Folder in a project that its README builds in."""
RUNTIME: Final = Path(__file__).resolve().parents[1] / "runtime"
CONTROLLER_RUNTIME: Final = RUNTIME_TABLE.parent
SHARED: Final = (
    "sv_cycle.c",
    "sv_cycle.h",
    "sv_float.c",
    "sv_homing.c",
    "sv_homing.h",
    "sv_math.h",
    "sv_program.h",
    "sv_schedule.c",
    "sv_schedule.h",
)
"""Files of the controller's runtime that the firmware is built from, as host loop and simulation are."""

_PART: Final = ".servolve-part"
"""Ends the name of a file that is being written."""
_TOOLCHAIN: Final = "board/toolchain.cmake"
_RESERVED: Final = frozenset({"main", "program", "rig", "servolve", "sv"})


@dataclass(frozen=True)
class Project:
    """Hold the files of a firmware project.

    Args:
        board: the board
        unit: the controller and its names in C
        files: path in the project's folder => contents
    """

    board: Board
    unit: Unit
    files: Mapping[str, str]


def make_project(controller: Controller, rig: Rig, board: Board, fast_sync_read: bool = False) -> Project:
    """Write all files of a firmware project, as texts.

    Args:
        controller: the controller
        rig: the rig
        board: the board
        fast_sync_read: whether one status packet answers for all servos, which is shorter; the host loop asks for one
            each

    Returns:
        the project

    Raises:
        InputError: the firmware can not drive the rig, the controller does not fit it, or the servos answer one by one
    """
    rig_c = rig_source(rig, controller, fast_sync_read)
    unit = _unit(controller, board)
    generated = generate(controller, unit.name, short=board.form != "arduino")
    sizes = sizes_of(rig, controller)
    files = {
        f"src/{unit.name}.c": generated.source,
        f"src/{unit.name}.h": generated.header,
        "src/program.c": glue_source(unit),
        "src/rig.c": rig_c,
        "src/rig.h": rig_header(rig, unit),
    }
    for path in sorted(RUNTIME.glob("*.[ch]")):
        folder = "src" if path.name == "main.c" else "runtime"
        files[f"{folder}/{path.name}"] = path.read_text(encoding="utf-8")
    for name in SHARED:
        path = CONTROLLER_RUNTIME / name
        files[f"runtime/{name}"] = path.read_text(encoding="utf-8")
    files |= {f"runtime/{name}": text for name, text in sizes_files(sizes, rig, fast_sync_read).items()}
    for path in board.files:
        files[f"board/{path.name}"] = path.read_text(encoding="utf-8")
    if board.form == "arduino":
        files = library_files(controller, rig, unit, files)
    else:
        files["CMakeLists.txt"] = cmake_text(board, _sources(board, files), program_stack(unit))
    files["README.md"] = readme_text(controller, rig, board)
    files[MANIFEST] = _manifest(controller, rig, board, unit, asdict(sizes), files)
    return Project(board, unit, dict(sorted(files.items())))


def _sources(board: Board, files: Mapping[str, str]) -> list[str]:
    """Return which of a project's files are compiled."""
    other = {f"board/{path.name}" for path in board.files if path.suffix == ".c" and path.name not in board.sources}
    return sorted(path for path in files if path.endswith(".c") and path not in other)


def write_project(project: Project, folder: Path, force: bool = False) -> None:
    """Write a project into a folder; what was written there before and not changed since is replaced.

    Args:
        project: the project
        folder: where to, made if it is not there
        force: whether other files that are there may be overwritten

    Raises:
        InputError: other files are there, or it can not be written
    """
    try:
        before = _written_before(folder)
        if not force:
            _refuse_others(folder, before)
        if before.get(_TOOLCHAIN) != frozenset({_digest_of(project.files.get(_TOOLCHAIN, ""))}):
            drop_build(folder)
        # from here to the end the manifest knows both what was there and what is to come
        _put(folder / MANIFEST, _unfinished(project, before))
        for path in before:
            (folder / (path + _PART)).unlink(missing_ok=True)
        for path in sorted(before.keys() - project.files.keys()):
            if _digest(folder / path) in before[path]:
                (folder / path).unlink()
        for path, text in project.files.items():
            if path != MANIFEST:
                _put(folder / path, text)
        _put(folder / MANIFEST, project.files[MANIFEST])
    except OSError as error:
        where = error.filename if error.filename is not None else folder
        raise InputError(f"{where}: {error.strerror}; give --out a folder that can be written") from None


def _put(place: Path, text: str) -> None:
    """Write a file that is not this text already: all of it or nothing; a link's target is somebody else's."""
    if not place.is_symlink() and place.is_file() and place.read_bytes() == text.encode():
        return
    place.parent.mkdir(parents=True, exist_ok=True)
    part = place.with_name(place.name + _PART)
    part.write_text(text, encoding="utf-8", newline="\n")
    part.replace(place)


def _unfinished(project: Project, before: Mapping[str, frozenset[str]]) -> str:
    """Return the manifest while files are written: who breaks in can write again, over all that is named here."""
    told = json.loads(project.files[MANIFEST])
    return json.dumps(told | {"replaces": {path: sorted(digests) for path, digests in sorted(before.items())}})


def drop_build(folder: Path) -> None:
    """Remove what CMake was set up for in a project; it would go on with another compiler, or another folder's files.

    Args:
        folder: the project's
    """
    build = folder / BUILD
    if (build / "CMakeCache.txt").is_file() and not build.is_symlink():
        shutil.rmtree(build)


def _refuse_others(folder: Path, before: Mapping[str, frozenset[str]]) -> None:
    """Refuse a folder that holds what this has not written, or what somebody has changed since."""
    if not folder.exists():
        return
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_dir() and not path.is_symlink():
            continue
        if before and name.split("/", 1)[0] == BUILD and name != BUILD:
            continue
        if name.removesuffix(_PART) != name and name.removesuffix(_PART) in {*before, MANIFEST}:
            continue
        if name not in before and name != MANIFEST:
            raise InputError(f"{folder}: holds other files ({plain(name)}); give --out another folder, or give --force")
        if name != MANIFEST and (path.is_symlink() or _digest(path) not in before[name]):
            raise InputError(
                f"{path}: was changed since it was written; keep it elsewhere, or give --force to overwrite it"
            )
    if not before and (folder / MANIFEST).exists():
        raise InputError(f"{folder / MANIFEST}: is not of this program; give --out another folder, or give --force")


def _written_before(folder: Path) -> dict[str, frozenset[str]]:
    """Return the files that this program wrote into a folder, with the digests of what it wrote."""
    try:
        told = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
        files = {path: {str(digest)} for path, digest in told["files"].items()}
        for path, digests in told.get("replaces", {}).items():
            files.setdefault(path, set()).update(map(str, digests))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}
    return {path: frozenset(digests) for path, digests in files.items() if _inside(path)}


def _inside(path: str) -> bool:
    """Tell whether a path stays in the folder that it is relative to."""
    parts = PurePosixPath(path).parts
    return 0 < len(parts) <= 3 and not path.startswith("/") and ".." not in parts


def _digest_of(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""


def _unit(controller: Controller, board: Board) -> Unit:
    """Return the controller with its names in C, which clash with none of the project's."""
    taken = _RESERVED | {path.stem for path in board.files}
    try:
        unit = make_unit(controller)
    except InputError:
        return make_unit(controller, "controller")
    if unit.name.lower() in taken or unit.name.startswith(("sv_", "servolve_")):
        return make_unit(controller, "controller")
    return unit


def _manifest(
    controller: Controller, rig: Rig, board: Board, unit: Unit, sizes: Mapping[str, int], files: Mapping[str, str]
) -> str:
    told: dict[str, Any] = {
        "format": 1,
        "generator": GENERATOR_VERSION,
        "board": board.name,
        "machine": board.machine,
        "rig": {"name": rig.name, "fingerprint": rig_fingerprint(rig, controller), "text": rig.text},
        "controller": {
            "name": controller.name,
            "symbols": unit.name,
            "fingerprint": program_fingerprint(controller),
            "text": controller_text(controller),
        },
        "sizes": sizes,
        "files": {path: _digest_of(text) for path, text in sorted(files.items())},
    }
    return json.dumps(told, indent=2, ensure_ascii=True) + "\n"
