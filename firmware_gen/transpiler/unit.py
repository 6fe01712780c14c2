"""What one pair of generated files is made from."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from dataclasses import dataclass
from typing import Final

import numpy as np

from controller import Controller, program_hash
from controller.cycle import slew_step
from controller.operations import BY_OPCODE, Operation
from firmware_gen.transpiler.literals import literal
from firmware_gen.transpiler.names import check_c_name, local_prefix, mangle, unit_name
from firmware_gen.transpiler.runtime_functions import (
    RuntimeFunction,
    called_functions,
    operations_of,
    read_runtime_functions,
)

GENERATOR_VERSION: Final = 3
"""Changes whenever the same controller gives other files."""


@dataclass(frozen=True)
class Unit:
    """Hold a controller on its way to C.

    Args:
        name: what every symbol and both files begin with
        controller: the controller
        program_hash: of its program
        fingerprint: 32 bits of a hash of all that the files depend on, which header and source compare
        expressions: one C expression for each instruction, (ninstruction,)
        functions: the runtime functions that they call, callees first
        operation_counts: how often each operation occurs, in the order of the table
        operation_bounds: arithmetic operations and comparisons of one evaluation of each, at most
    """

    name: str
    controller: Controller
    program_hash: str
    fingerprint: int
    expressions: tuple[str, ...]
    functions: tuple[RuntimeFunction, ...]
    operation_counts: dict[str, int]
    operation_bounds: dict[str, int]

    @property
    def worst_case(self) -> int:
        """Return the arithmetic operations and comparisons of one step, at most."""
        return sum(count * self.operation_bounds[name] for name, count in self.operation_counts.items())

    @property
    def state_bytes(self) -> int:
        """Return the size of the state structure [bytes]."""
        held = len(self.controller.outputs) if self.follows else 0
        return 4 * (max(self.controller.program.nstate, 1) + held)

    @property
    def follows(self) -> bool:
        """Return whether commands have a memory: a filter or a slew limit."""
        return bool(np.float32(self.controller.filter) != 1 or np.float32(slew_step(self.controller)) > 0)


def make_unit(controller: Controller, name: str | None = None) -> Unit:
    """Collect what the generated files of a controller say.

    Args:
        controller: a verified controller
        name: a C identifier, or None for the controller's name, mangled

    Returns:
        the unit

    Raises:
        InputError: the name is not a C identifier
    """
    prefix = check_c_name(unit_name(controller.name), controller.name) if name is None else check_c_name(name)
    functions = read_runtime_functions()
    expressions = tuple(_expressions(controller, prefix))
    counts = Counter(BY_OPCODE[op].name for op in controller.program.instructions["op"].tolist())
    used = [operation for operation in BY_OPCODE.values() if counts[operation.name]]
    digest = program_hash(controller.program)
    return Unit(
        name=prefix,
        controller=controller,
        program_hash=digest,
        fingerprint=_fingerprint(prefix, controller, digest),
        expressions=expressions,
        functions=tuple(called_functions(expressions, functions)),
        operation_counts={operation.name: counts[operation.name] for operation in used},
        operation_bounds={operation.name: operations_of(operation.c, functions) for operation in used},
    )


def operands_of(operation: Operation, row: tuple[int, ...]) -> tuple[int, ...]:
    """Return the operand registers of an instruction.

    Args:
        operation: its operation
        row: op, a, b, c
    """
    return row[1 : 1 + operation.arity]


def register_texts(controller: Controller, name: str) -> list[str]:
    """Return the C text of every register: inputs, constants, results.

    Args:
        controller: the controller
        name: what the unit's symbols begin with

    Returns:
        (nregister,)
    """
    program = controller.program
    inputs = [f"{local_prefix(name)}{mangle(terminal)}" for terminal in program.inputs]
    constants = [literal(value) for value in program.constants]
    return inputs + constants + [f"v{i}" for i in range(len(program.instructions))]


def _expressions(controller: Controller, name: str) -> list[str]:
    registers = register_texts(controller, name)
    period = literal(np.float32(controller.period_s))
    expressions = []
    for row in controller.program.instructions.tolist():
        operation = BY_OPCODE[row[0]]
        values = dict(zip("abc", (registers[i] for i in operands_of(operation, row)), strict=False))
        state = f"&state->s[{row[1 + operation.arity]}]" if operation.nstate else ""
        expressions.append(operation.c.format(**values, s=state, dt=period))
    return expressions


def _fingerprint(name: str, controller: Controller, digest: str) -> int:
    interface = [
        GENERATOR_VERSION,
        name,
        controller.name,
        digest,
        controller.period_s,
        controller.filter,
        controller.slew_rad_s,
        [[i.name, i.unit, i.low, i.high] for i in controller.inputs],
        [[o.name, o.kind, o.unit, o.low, o.high, o.neutral] for o in controller.outputs],
    ]
    return int.from_bytes(hashlib.sha256(json.dumps(interface).encode()).digest()[:4], "big")
