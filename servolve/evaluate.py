"""`servolve eval`: a controller's clamped outputs for given terminals, bit by bit."""

from __future__ import annotations

import re
import struct
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
import numpy.typing as npt
from cyclopts import Parameter

from controller.controller import Controller
from controller.controller_file import load_controller
from controller.decimals import parse_decimal
from controller.errors import InputError
from controller.native import NativeProgram
from controller.reference import run_program

Floats = npt.NDArray[np.float32]

BYTES_MAX: Final = 1 << 28

_BITS: Final = re.compile(r"0x[0-9a-fA-F]{8}")
_SPECIAL: Final = re.compile(r"([+-]?)(nan|inf|infinity)", re.IGNORECASE)
_MAGNITUDES: Final = {"nan": 0x7FC00000, "inf": 0x7F800000, "infinity": 0x7F800000}


def evaluate(
    controller: Path,
    *,
    inputs: Path,
    backend: Annotated[Literal["reference", "vm", "c"], Parameter(show_choices=True)] = "vm",
) -> int:
    """Print a controller's clamped outputs, each as its float32 bits in hex, for given terminals.

    Rows of the CSV are successive steps. A first row of terminal names sets the order of the columns; without one they
    are in the controller's order. Cells are decimal numbers, nan, inf, or float32 bits as 0x3f800000. Filter and slew
    limit are not applied.

    Args:
        controller: a *.controller.toml, or a run folder
        inputs: the CSV file
        backend: what computes: the slow reference, the virtual machine, or generated and compiled C
    """
    loaded = load_controller(controller)
    rows = read_inputs(inputs, [terminal.name for terminal in loaded.inputs])
    outputs = clamp(loaded, run_backend(loaded, rows, backend))
    lines = [",".join(output.name for output in loaded.outputs)]
    lines += [",".join(f"0x{bits:08x}" for bits in row) for row in outputs.view(np.uint32).tolist()]
    sys.stdout.write("\n".join(lines) + "\n")
    return 0


def run_backend(controller: Controller, rows: Floats, backend: str) -> Floats:
    """Evaluate successive steps on one of the back ends.

    Args:
        controller: the controller
        rows: terminals, (nstep, ninput)
        backend: "reference", "vm" or "c"

    Returns:
        the program's outputs, unclamped, (nstep, noutput)

    Raises:
        InputError: the back end is not available
        RunError: the generated C does not compile
    """
    if backend == "reference":
        return run_program(controller.program, controller.period_s, rows)
    if backend == "vm":
        return NativeProgram(controller.program).run(controller.period_s, rows)
    from firmware_gen import compile_controller

    with compile_controller(controller) as compiled:
        return compiled.run(rows)


def clamp(controller: Controller, values: Floats) -> Floats:
    """Clamp program outputs as the control cycle does: NaN becomes neutral, then [low, high].

    Args:
        controller: the controller
        values: (nstep, noutput)

    Returns:
        the same, in each output's own unit, never NaN
    """
    low, high, neutral = (
        np.array([getattr(output, name) for output in controller.outputs], np.float32)
        for name in ("low", "high", "neutral")
    )
    values = np.where(np.isnan(values), neutral, values)
    return np.where(values < low, low, np.where(values > high, high, values))


def read_inputs(path: Path, names: Sequence[str]) -> Floats:
    """Read a CSV file of terminals.

    Args:
        path: the file
        names: the controller's terminals, in order

    Returns:
        terminals in that order, (nstep, ninput)

    Raises:
        InputError: it can not be read, or a cell is wrong; says line and column
    """
    lines = _read_text(path).splitlines()
    rows = [(number, [cell.strip() for cell in line.split(",")]) for number, line in enumerate(lines, start=1)]
    rows = [(number, cells) for number, cells in rows if cells != [""]]
    order = list(range(len(names)))
    if rows and _is_header(rows[0][1], names):
        order = _header(path, rows[0][0], rows[0][1], names)
        del rows[0]
    if not names:
        # a step without terminals is an empty line
        return np.empty((len(lines), 0), np.float32)
    words = np.empty((len(rows), len(names)), np.uint32)
    for i, (number, cells) in enumerate(rows):
        if len(cells) != len(names):
            expected = ",".join(names[j] for j in order)
            raise InputError(f"{path}, line {number}: has {len(cells)} cells; write {len(names)}: {expected}")
        for j, cell in enumerate(cells):
            bits = _parse_cell(cell)
            if bits is None:
                raise InputError(
                    f"{path}, line {number}, column {j + 1} ({names[order[j]]}): '{cell[:40]}' is no float32; "
                    "write a decimal number, nan, inf, or its bits as 0x3f800000"
                )
            words[i, order[j]] = bits
    return words.view(np.float32)


def _read_text(path: Path) -> str:
    try:
        if path.is_dir():
            raise InputError(f"{path}: is a folder; name a CSV file")
        if path.stat().st_size > BYTES_MAX:
            raise InputError(f"{path}: is larger than {BYTES_MAX} bytes; split it")
        return path.read_text(encoding="utf-8-sig")
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file; name an existing CSV file") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not UTF-8 text (byte {error.start}); save it as CSV") from None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise InputError(f"{path}: can not be read ({reason}); name a readable CSV file") from None


def _is_header(cells: Sequence[str], names: Sequence[str]) -> bool:
    """Return whether a first row names terminals: some cell does and is no number (or all do), or none is a number."""
    words = [cell.strip('"') for cell in cells if _parse_cell(cell) is None]
    return set(cells) == set(names) or len(words) == len(cells) or any(word in names for word in words)


def _header(path: Path, line: int, cells: Sequence[str], names: Sequence[str]) -> list[int]:
    """Return the terminal index of each column."""
    cells = [cell.strip('"') for cell in cells]
    place = f"{path}, line {line}"
    for j, cell in enumerate(cells, start=1):
        if cell not in names:
            raise InputError(f"{place}, column {j}: '{cell[:40]}' is no terminal; the controller has {','.join(names)}")
        if cells.index(cell) != j - 1:
            raise InputError(f"{place}, column {j}: terminal '{cell}' stands twice; remove a column")
    for name in names:
        if name not in cells:
            raise InputError(f"{place}: terminal '{name}' is missing; add a column for it")
    return [names.index(cell) for cell in cells]


def _parse_cell(cell: str) -> int | None:
    """Return the float32 bits of a cell, None if it is no number or beyond the largest float."""
    if _BITS.fullmatch(cell):
        return int(cell, 16)
    special = _SPECIAL.fullmatch(cell)
    if special:
        return _MAGNITUDES[special[2].lower()] | (0x80000000 if special[1] == "-" else 0)
    try:
        bits: int = struct.unpack("<I", struct.pack("<f", parse_decimal(cell)))[0]
    except (ValueError, OverflowError):
        return None
    return bits
