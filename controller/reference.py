"""The slow reference: programs and the control cycle in plain Python on numpy.float32, the judge of all back ends."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from controller.errors import InputError
from controller.operations import BY_OPCODE
from controller.program import Program
from controller.verifier import verify

Floats = npt.NDArray[np.float32]


class ReferenceProgram:
    """Run a program step by step.

    Args:
        program: the program, verified here
        dt: period [s]
    """

    def __init__(self, program: Program, dt: float) -> None:
        verify(program)
        self._program = program
        self._dt = np.float32(dt)
        self._state = np.zeros(program.nstate, np.float32)
        self._constants: list[np.float32] = list(program.constants)
        self._outputs: list[int] = program.outputs.tolist()
        self._steps: list[tuple[Callable[..., Any], list[int], Floats | None]] = []
        for row in program.instructions.tolist():
            operation = BY_OPCODE[row[0]]
            operands = row[1 : 1 + operation.arity]
            state = None
            if operation.nstate:
                first = row[1 + operation.arity]
                state = self._state[first : first + operation.nstate]
            self._steps.append((operation.reference, list(operands), state))

    def reset(self) -> None:
        """Return to the start: all state 0."""
        self._state[:] = 0

    def step(self, inputs: list[np.float32]) -> list[np.float32]:
        """Evaluate one step.

        Args:
            inputs: terminals, (ninput,)

        Returns:
            outputs, (noutput,)
        """
        registers = inputs + self._constants
        dt = self._dt
        for reference, operands, state in self._steps:
            values = [registers[i] for i in operands]
            registers.append(reference(*values) if state is None else reference(state, dt, *values))
        return [registers[i] for i in self._outputs]


def run_program(program: Program, dt: float, inputs: Floats) -> Floats:
    """Evaluate successive steps from the start.

    Args:
        program: the program
        dt: period, rounded to float32 [s]
        inputs: terminals, float32, (nstep, ninput)

    Returns:
        the program's outputs, unclamped, float32, (nstep, noutput)

    Raises:
        InputError: the program is not valid or the shape of the inputs is wrong
    """
    rows = check_inputs(program, inputs)
    outputs = np.empty((len(rows), len(program.outputs)), np.float32)
    machine = ReferenceProgram(program, dt)
    with np.errstate(all="ignore"):
        for i, row in enumerate(rows):
            outputs[i] = machine.step(list(row))
    return outputs


def check_inputs(program: Program, inputs: Floats) -> Floats:
    """Return the inputs as contiguous float32 rows.

    Args:
        program: the program
        inputs: terminals, (nstep, ninput)

    Returns:
        the same, C-contiguous, (nstep, ninput)

    Raises:
        InputError: their shape is wrong
    """
    rows = np.ascontiguousarray(inputs, np.float32)
    if rows.ndim != 2 or rows.shape[1] != len(program.inputs):
        raise InputError(
            f"the inputs have shape {rows.shape}; give (steps, {len(program.inputs)}): {' '.join(program.inputs)}"
        )
    return rows
