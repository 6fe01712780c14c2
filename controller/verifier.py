"""The bounds that running a program relies on: nothing runs unverified."""

from __future__ import annotations

from typing import Final

import numpy as np

from controller.errors import InputError
from controller.operations import BY_NAME, BY_OPCODE
from controller.program import Program

# as runtime/sv_program.h
INPUT_MAX: Final = 64
OUTPUT_MAX: Final = 32
INSTRUCTION_MAX: Final = 8192
CONSTANT_MAX: Final = 8192
STATE_MAX: Final = 4096


def verify(program: Program) -> None:
    """Check a program as `sv_verify` does: sizes, opcodes, operands before use, one owner a state slot.

    Args:
        program: the program

    Raises:
        InputError: it breaks a bound
    """
    sizes = (
        ("inputs", len(program.inputs), 0, INPUT_MAX),
        ("constants", len(program.constants), 0, CONSTANT_MAX),
        ("instructions", len(program.instructions), 0, INSTRUCTION_MAX),
        ("state slots", program.nstate, 0, STATE_MAX),
        ("outputs", len(program.outputs), 1, OUTPUT_MAX),
    )
    for what, size, low, high in sizes:
        if not low <= size <= high:
            raise InputError(f"the program has {size} {what}; the machine takes {low} to {high}, write a smaller one")
    if not np.isfinite(program.constants).all():
        raise InputError("the program has a constant that is not finite; write finite numbers")
    _verify_instructions(program)
    for i, register in enumerate(program.outputs.tolist()):
        if register >= program.nregister:
            raise InputError(f"output {i + 1} reads register {register}, which does not exist; lower the source again")


def _verify_instructions(program: Program) -> None:
    load, store = BY_NAME["load"].opcode, BY_NAME["store"].opcode
    register = len(program.inputs) + len(program.constants)
    owned: set[int] = set()
    loaded: set[int] = set()
    stored: set[int] = set()
    for i, row in enumerate(program.instructions.tolist()):
        where, remedy = f"instruction {i}", "lower the source again"
        operation = BY_OPCODE.get(row[0])
        if operation is None:
            raise InputError(f"{where} has opcode {row[0]}, which is no operation; {remedy}")
        if any(operand >= register + i for operand in row[1 : 1 + operation.arity]):
            raise InputError(f"{where} reads a register before it is written; {remedy}")
        if operation.nstate == 0:
            continue
        first = row[1 + operation.arity]
        slots = set(range(first, first + operation.nstate))
        if first + operation.nstate > program.nstate:
            raise InputError(f"{where} owns a state slot that does not exist; {remedy}")
        if slots & owned or (operation.opcode not in (load, store) and slots & loaded):
            raise InputError(f"{where} uses a state slot that another one owns; {remedy}")
        if operation.opcode == load:
            loaded |= slots
        else:
            owned |= slots
            if operation.opcode == store:
                stored |= slots
    if not loaded <= stored:
        raise InputError("a value of the step before is loaded but never stored; lower the source again")
