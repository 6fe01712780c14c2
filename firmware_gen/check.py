"""Compile a controller with every compiler here and hold it to the virtual machine and the reference."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from controller import Controller
from controller.errors import InputError
from controller.native import NativeProgram
from controller.reference import run_program
from firmware_gen.transpiler.compiled import compile_controller
from firmware_gen.transpiler.vectors import bits_of, draw_inputs

COMPILERS: Final = ("gcc", "clang")
LEVELS: Final = ("-O0", "-O3")

SEQUENCES: Final = 100
STEPS: Final = 100
REFERENCE_SEQUENCES: Final = 5


@dataclass(frozen=True)
class CheckRow:
    """Hold what one build of a controller gave.

    Args:
        compiler: its command
        flags: its optimisation level
        selftest: what the generated selftest returned, 0 where all is well
        steps: random steps that were compared with the virtual machine
        vm_differences: outputs that differ from the virtual machine's
        reference_steps: how many of the steps were compared with the reference, too
        reference_differences: outputs that differ from the reference's
    """

    compiler: str
    flags: str
    selftest: int
    steps: int
    vm_differences: int
    reference_steps: int
    reference_differences: int

    @property
    def passed(self) -> bool:
        """Return whether nothing differs."""
        return self.selftest == 0 and self.vm_differences == 0 and self.reference_differences == 0


def check_builds(controller: Controller, compilers: Sequence[str] = COMPILERS) -> Iterator[CheckRow]:
    """Compile a controller with every compiler that is installed, and compare the bits of 10,000 random steps.

    Args:
        controller: a verified controller
        compilers: commands to look for

    Returns:
        one row for each compiler and optimisation level, as they are done

    Raises:
        InputError: there is no compiler at all
        RunError: the C does not compile
    """
    present = [compiler for compiler in compilers if shutil.which(compiler)]
    if not present:
        raise InputError(f"no compiler to check with ({', '.join(compilers)}); install one: apt-get install gcc")
    words = np.random.default_rng(0).integers(
        0, 1 << 32, (SEQUENCES, STEPS, len(controller.inputs), 2), dtype=np.uint32
    )
    inputs = draw_inputs(words, controller.inputs)
    vm = NativeProgram(controller.program)
    expected = np.stack([bits_of(vm.run(controller.period_s, rows)) for rows in inputs])
    reference = np.stack(
        [bits_of(run_program(controller.program, controller.period_s, rows)) for rows in inputs[:REFERENCE_SEQUENCES]]
    )
    for compiler in present:
        for level in LEVELS:
            with compile_controller(controller, compiler=compiler, flags=(level,)) as compiled:
                found: npt.NDArray[np.uint32] = np.stack([bits_of(compiled.run(rows)) for rows in inputs])
                yield CheckRow(
                    compiler=compiler,
                    flags=level,
                    selftest=compiled.selftest(),
                    steps=SEQUENCES * STEPS,
                    vm_differences=int(np.count_nonzero(found != expected)),
                    reference_steps=REFERENCE_SEQUENCES * STEPS,
                    reference_differences=int(np.count_nonzero(found[:REFERENCE_SEQUENCES] != reference)),
                )
