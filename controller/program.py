"""The compiled form of a controller: flat three-address code that every back end runs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

INSTRUCTION = np.dtype([("op", "<u2"), ("a", "<u2"), ("b", "<u2"), ("c", "<u2")])
"""One instruction, laid out as `sv_instruction` in `runtime/sv_program.h`."""


@dataclass(frozen=True, eq=False)
class Program:
    """Hold a program in static single assignment form.

    Registers are numbered inputs first, then constants, then one for each instruction: instruction ``i`` writes
    register ``len(inputs) + len(constants) + i``. A stateful operation names its first state slot in the operand
    after its last register operand.

    Args:
        inputs: terminal names, in the order of the input registers, (ninput,)
        constants: float32 constants, (nconst,)
        instructions: dtype `INSTRUCTION`, (ninstruction,)
        outputs: the register of each output, uint16, (noutput,)
        nstate: float32 state slots
    """

    inputs: tuple[str, ...]
    constants: npt.NDArray[np.float32]
    instructions: npt.NDArray[np.void]
    outputs: npt.NDArray[np.uint16]
    nstate: int

    @property
    def nregister(self) -> int:
        """Return how many registers one evaluation needs."""
        return len(self.inputs) + len(self.constants) + len(self.instructions)
