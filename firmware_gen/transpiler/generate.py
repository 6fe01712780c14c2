"""Controllers to C files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from controller import Controller
from controller.errors import InputError
from firmware_gen.transpiler.header import header_text
from firmware_gen.transpiler.source import source_text
from firmware_gen.transpiler.unit import Unit, make_unit


@dataclass(frozen=True)
class Generated:
    """Hold the text of a pair of files.

    Args:
        unit: what they are made from
        header: text of ``<name>.h``
        source: text of ``<name>.c``
    """

    unit: Unit
    header: str
    source: str


@dataclass(frozen=True)
class Transpiled:
    """Hold where a pair of files was written.

    Args:
        unit: what they are made from
        header: path of ``<name>.h``
        source: path of ``<name>.c``
    """

    unit: Unit
    header: Path
    source: Path


def generate(controller: Controller, name: str | None = None, short: bool = False) -> Generated:
    """Write a controller as C99 text: the same controller and name, the same bytes.

    Args:
        controller: a verified controller
        name: what files and symbols begin with, or None for the controller's name
        short: whether the selftest is an image's, a tenth of the size: it compares a hash of the program's answers

    Returns:
        the texts

    Raises:
        InputError: the name is not a C identifier
    """
    unit = make_unit(controller, name)
    return Generated(unit, header_text(unit, short), source_text(unit, short))


def transpile(controller: Controller, out_dir: Path | str, name: str | None = None) -> Transpiled:
    """Write a controller as ``<name>.h`` and ``<name>.c``.

    Args:
        controller: a verified controller
        out_dir: folder, made if it is not there
        name: what files and symbols begin with, or None for the controller's name

    Returns:
        the paths

    Raises:
        InputError: the name is not a C identifier, or the files can not be written
    """
    generated = generate(controller, name)
    folder = Path(out_dir)
    header, source = (folder / f"{generated.unit.name}{suffix}" for suffix in (".h", ".c"))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        header.write_text(generated.header, encoding="utf-8", newline="\n")
        source.write_text(generated.source, encoding="utf-8", newline="\n")
    except OSError as error:
        raise InputError(f"{error.filename}: {error.strerror}; choose a folder that can be written") from None
    return Transpiled(generated.unit, header, source)
