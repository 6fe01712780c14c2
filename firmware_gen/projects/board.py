"""Boards: folders with a `board.toml`, found by looking; a new one is a new folder."""

from __future__ import annotations

import re
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final

from controller.errors import InputError
from controller.toml_table import Table, read_toml

BOARDS: Final = Path(__file__).resolve().parents[1] / "boards"
FORMS: Final = ("cmake", "arduino")
"""What a project can be."""

_FILE: Final = "board.toml"
_TOOLCHAIN: Final = "toolchain.cmake"


@dataclass(frozen=True)
class Flash:
    """Describe one way to write an image to a board.

    Args:
        target: name of the build target, as "flash"
        tool: the program that does it, which is its Debian package too
        command: its arguments; {elf} and {bin} stand for the image
    """

    target: str
    tool: str
    command: tuple[str, ...]


@dataclass(frozen=True)
class Board:
    """Describe one board, as its `board.toml` does.

    Args:
        name: of its folder
        folder: where its files are
        core: name of the folder beside it with files that it shares with other boards of its core, or ""
        form: "cmake": a project that CMake builds; "arduino": a library for the Arduino IDE and PlatformIO
        title: what it is called
        chip: what it computes with
        sources: C files in its folder that belong to the firmware
        compiler: the compiler's command
        elf: name of the linked image: "firmware" and a suffix, as "firmware.elf"
        machine: what runs the image without the board: "twin", a machine of qemu-system-arm, or "" for nothing
        flags: for compiling and linking
        link_flags: for linking; {board} stands for the folder
        wiring: what to connect, in Markdown
        power: how to feed board and servos, in Markdown
        flash: ways to write the image, best first
    """

    name: str
    folder: Path
    core: str
    form: str
    title: str
    chip: str
    sources: tuple[str, ...]
    compiler: str
    elf: str
    machine: str
    flags: tuple[str, ...]
    link_flags: tuple[str, ...]
    wiring: str
    power: str
    flash: tuple[Flash, ...]

    @property
    def files(self) -> tuple[Path, ...]:
        """Return all files that belong to it, sorted by name; its own stand before those of its core."""
        return _files(self.folder, self.core)


def board_names() -> tuple[str, ...]:
    """Return the names of the boards that come with servolve, sorted."""
    return tuple(sorted(path.parent.name for path in BOARDS.glob(f"*/{_FILE}")))


def load_board(name_or_path: str | Path) -> Board:
    """Read a board.

    Args:
        name_or_path: one of `board_names()`, or a folder with a `board.toml`

    Returns:
        the board

    Raises:
        InputError: there is no such board, or its file is wrong
    """
    folder = BOARDS / name_or_path if str(name_or_path) in board_names() else Path(name_or_path)
    path = folder / _FILE
    if not path.is_file():
        raise InputError(
            f"board '{name_or_path}' is not known; choose one of {', '.join(board_names())}, or give the path of a "
            f"folder with a {_FILE}"
        )
    return _board(read_toml(path, "board file"), folder.resolve())


def _board(top: Table, folder: Path) -> Board:
    top.refuse_unknown(("format", "board", "flash"))
    head = top.table("board")
    head.refuse_unknown([field.name for field in fields(Board) if field.name not in ("name", "folder", "flash")])
    form = _form(head)
    core = head.name_value("core") if "core" in head.values else ""
    if core and not (folder.parent / core).is_dir():
        head.fail("core", f"there is no folder {core} beside the board's; add it, or correct the name")
    present = {path.name for path in _files(folder, core)}
    if form == "cmake" and _TOOLCHAIN not in present:
        raise InputError(f"{folder}: has no {_TOOLCHAIN}; add one that names the compiler, or an empty one")
    sources = _texts(head, "sources")
    for source in sources:
        if source not in present:
            head.fail("sources", f"there is no file {source} in the board's folder; add it, or correct the name")
    return Board(
        name=folder.name,
        folder=folder,
        core=core,
        form=form,
        title=head.text_value("title"),
        chip=head.text_value("chip"),
        sources=sources,
        compiler=head.text_value("compiler"),
        elf=_elf(head) if form == "cmake" else head.text_value("elf"),
        machine=head.text_value("machine"),
        flags=_texts(head, "flags"),
        link_flags=_texts(head, "link_flags"),
        wiring=head.text_value("wiring").strip(),
        power=head.text_value("power").strip(),
        flash=tuple(_flash(table) for table in top.tables("flash")),
    )


def _files(folder: Path, core: str) -> tuple[Path, ...]:
    found: dict[str, Path] = {}
    for place in (folder.parent / core, folder) if core else (folder,):
        found |= {path.name: path for path in place.iterdir() if path.is_file() and not path.name.startswith(".")}
    return tuple(found[name] for name in sorted(found))


def _form(head: Table) -> str:
    form = head.text_value("form") if "form" in head.values else FORMS[0]
    if form not in FORMS:
        head.fail("form", f"form is '{form}'; choose one of {', '.join(FORMS)}")
    return form


def _elf(head: Table) -> str:
    elf = head.text_value("elf")
    if not re.fullmatch(r"firmware[A-Za-z0-9_.-]*", elf):
        head.fail("elf", f"elf is '{elf}'; write firmware and what shall follow, as firmware.elf")
    return elf


def _flash(table: Table) -> Flash:
    table.refuse_unknown([field.name for field in fields(Flash)])
    return Flash(table.name_value("target"), table.text_value("tool"), _texts(table, "command"))


def _texts(table: Table, key: str) -> tuple[str, ...]:
    values: Any = table.values.get(key)
    if not isinstance(values, list) or not all(isinstance(value, str) for value in values):
        table.fail(key, f'{key} is no list of texts; write one, as ["-O2"]')
    return tuple(values)
