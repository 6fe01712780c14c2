"""Pieces of a rig's data as C text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np

from controller.register import Register
from firmware_gen.transpiler.literals import literal

_ENCODINGS: Final = {
    "unsigned": "SV_UNSIGNED",
    "twos": "SV_TWOS",
    "sign15": "SV_SIGN15",
    "sign11": "SV_SIGN11",
    "sign10": "SV_SIGN10",
}


def register_c(line: Register | None) -> str:
    """Write a register as `sv_register`.

    Args:
        line: of a control table, or None where a servo has no such register
    """
    if line is None:
        return "{0, 0, SV_UNSIGNED}"
    return f"{{{line.address}, {line.size}, {_ENCODINGS[line.encoding]}}}"


def field_lines(values: Iterable[tuple[str, object]]) -> list[str]:
    """Write the fields of a structure, a line each.

    Args:
        values: name and value, the latter as C
    """
    return [f"    .{name} =" + f" {value},".replace(" \n", "\n") for name, value in values]


def row_lines(values: Iterable[tuple[str, str]]) -> list[str]:
    """Write the rows of a table, each with what it is about.

    Args:
        values: row as C, and its comment
    """
    rows = [(f"    {text},", name) for text, name in values]
    width = max(len(text) for text, _ in rows)
    return [f"{text:<{width}}  // {name}" for text, name in rows]


def pair_c(block: Sequence[int]) -> str:
    """Write a block as `sv_block`.

    Args:
        block: address and size
    """
    return f"{{{block[0]}, {block[1]}}}"


def float_c(value: float) -> str:
    """Write a number as the float32 nearest to it.

    Args:
        value: the number
    """
    return literal(np.float32(value))


def microseconds(seconds: float) -> int:
    """Return a duration as the firmware counts it [us].

    Args:
        seconds: the duration [s]
    """
    return round(1e6 * seconds)
