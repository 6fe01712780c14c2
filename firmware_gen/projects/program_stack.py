"""How much stack a controller's program takes beyond what every image has room for."""

from __future__ import annotations

from typing import Final

from controller.operations import BY_OPCODE
from controller.program import Program
from firmware_gen.transpiler.unit import Unit, operands_of

_INCLUDED: Final = 256
"""So many bytes of values and memory are in a board's usual stack."""
_ALIGNED: Final = 8


def program_stack(unit: Unit) -> int:
    """Return what a board's stack needs on top of its usual size, for the program's step and its selftest.

    The step keeps at most all values that are still needed on the stack, and the selftest the program's memory.

    Args:
        unit: the controller

    Returns:
        a multiple of 8 [bytes]
    """
    needed = unit.state_bytes + 4 * _live_values(unit.controller.program)
    return -(-max(0, needed - _INCLUDED) // _ALIGNED) * _ALIGNED


def _live_values(program: Program) -> int:
    """Return how many values are needed at once, at most: inputs from the start, outputs to the end, no constants."""
    ninput, first = len(program.inputs), len(program.inputs) + len(program.constants)
    rows = program.instructions.tolist()
    last: dict[int, int] = {}
    for number, row in enumerate(rows):
        last |= dict.fromkeys(operands_of(BY_OPCODE[row[0]], row), number)
    last |= dict.fromkeys(program.outputs.tolist(), len(rows))
    changes = [0] * (len(rows) + 2)
    for register, until in last.items():
        if register < ninput or register >= first:
            changes[max(0, register - first)] += 1
            changes[until + 1] -= 1
    live = most = 0
    for change in changes:
        live += change
        most = max(most, live)
    return most
