"""The selftest of an image: the program on random numbers, one hash of all its answers instead of their tables.

The image's output stage is the control cycle's, so that the generated one is not in it and not tried.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from controller.reference import ReferenceProgram
from firmware_gen.transpiler.function_check import (
    HASH_START,
    SEED,
    calls_functions,
    draw_float,
    function_check_lines,
    hash_float,
    number_lines,
)
from firmware_gen.transpiler.selftest import arithmetic_lines, opening_lines
from firmware_gen.transpiler.unit import Unit

STEPS: Final = 512
"""Steps of the program."""

STEPS_RUN: Final = 16
"""Steps from one start to the next: a state that has become NaN tells nothing any more."""


def short_selftest_lines(unit: Unit) -> list[str]:
    """Write the functions that check arithmetic, copied functions and program.

    Args:
        unit: the controller and its names

    Returns:
        lines of C
    """
    return [
        *arithmetic_lines(unit),
        *(function_check_lines(unit) if calls_functions(unit) else number_lines(unit.name)),
        *_selftest(unit),
    ]


def _selftest(unit: Unit) -> list[str]:
    name = unit.name
    draw = [
        f"    for (i = 0; i < {name}_ninput; i++) {{",
        f"      inputs[i] = {name}_draw(&random);",
        "    }",
    ]
    random = [f"  uint32_t random = 0x{SEED:08x}U;"] if unit.controller.inputs else []
    return [
        *opening_lines(unit, [*random, f"  uint32_t hash = 0x{HASH_START:08x}U;"]),
        f"  for (step = 0; step < {STEPS}; step++) {{",
        f"    if (step % {STEPS_RUN} == 0) {{",
        f"      {name}_init(&state);",
        "    }",
        *(draw if unit.controller.inputs else []),
        f"    {name}_step(&state, inputs, outputs);",
        f"    for (i = 0; i < {name}_noutput; i++) {{",
        f"      hash = {name}_mix(hash, outputs[i]);",
        "    }",
        "  }",
        f"  return hash == 0x{steps_hash(unit):08x}U ? 0 : 1;",
        "}",
    ]


def steps_hash(unit: Unit) -> int:
    """Return the hash of what the reference gives for the random numbers.

    Args:
        unit: the controller and its names

    Returns:
        32 bits
    """
    program = ReferenceProgram(unit.controller.program, unit.controller.period_s)
    random, result = SEED, HASH_START
    with np.errstate(all="ignore"):
        for step in range(STEPS):
            if step % STEPS_RUN == 0:
                program.reset()
            inputs = []
            for _ in unit.controller.inputs:
                random, value = draw_float(random)
                inputs.append(value)
            for output in program.step(inputs):
                result = hash_float(result, output)
    return result
