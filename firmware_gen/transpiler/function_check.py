"""The part of the selftest that tries each operation's function directly: many inputs, one hash of all the answers."""

from __future__ import annotations

import functools
from typing import Final

import numpy as np

from controller.operations import BY_NAME, Operation
from firmware_gen.transpiler.literals import literal
from firmware_gen.transpiler.unit import Unit
from firmware_gen.transpiler.vectors import NAN_BITS

TRIALS: Final = 1024
"""Evaluations of each operation: a program may need hours to bring a function to all of its branches."""

SEED: Final = 0x2545F491
_STRIDE: Final = 0x9E3779B9
_FACTORS: Final = (0x21F0AAAD, 0x735A2D97)
HASH_START: Final = 0x811C9DC5
_MASK: Final = 0xFFFFFFFF
_SUBNORMAL: Final = 0x807FFFFF
_RANGES: Final = (1, 16, 16, 128, 16384)
"""Kinds 0 to 4 of random numbers: uniform within a range; 5: a zero, 6: a subnormal, 7: any bit pattern."""


def calls_functions(unit: Unit) -> bool:
    """Return whether the program uses an operation that is a function.

    Args:
        unit: the controller and its names
    """
    return bool(_checked(unit))


def function_check_lines(unit: Unit) -> list[str]:
    """Write the function that tries the functions of all operations that a program uses.

    Args:
        unit: the controller and its names

    Returns:
        lines of C, none where the program uses no function
    """
    operations = _checked(unit)
    if not operations:
        return []
    name = unit.name
    period = np.float32(unit.controller.period_s)
    nstate = max(operation.nstate for operation in operations)
    lines = [
        *number_lines(name),
        "// each function on random numbers of all kinds; one hash of all that it gives, as the reference does",
        f"static int32_t {name}_functions(void) {{",
        *[f"  float {operand};" for operand in "abc"[: max(operation.arity for operation in operations)]],
        *([f"  float s[{nstate}];"] if nstate else []),
        "  uint32_t random;",
        "  uint32_t hash;",
        "  int32_t i;",
    ]
    for operation in operations:
        lines += _trials(name, operation, period)
    return [*lines, "  return 1;", "}", ""]


def _checked(unit: Unit) -> list[Operation]:
    used = [BY_NAME[name] for name in unit.operation_counts]
    return [operation for operation in used if "sv_" in operation.c]


def number_lines(name: str) -> list[str]:
    """Write the functions that draw random numbers of all kinds and mix answers into a hash.

    Args:
        name: what the unit's symbols begin with

    Returns:
        lines of C
    """
    return [*_draw(name), *_mix(name)]


def _draw(name: str) -> list[str]:
    return [
        f"static uint32_t {name}_word(uint32_t* random) {{",
        "  uint32_t x;",
        f"  *random = *random + 0x{_STRIDE:08x}U;",
        "  x = *random;",
        f"  x = (x ^ (x >> 16)) * 0x{_FACTORS[0]:08x}U;",
        f"  x = (x ^ (x >> 15)) * 0x{_FACTORS[1]:08x}U;",
        "  return x ^ (x >> 15);",
        "}",
        "",
        f"static float {name}_draw(uint32_t* random) {{",
        f"  static const float ranges[{len(_RANGES)}] = {{{', '.join(literal(np.float32(r)) for r in _RANGES)}}};",
        f"  const uint32_t kind = {name}_word(random) >> 29;",
        f"  uint32_t word = {name}_word(random);",
        "  float x;",
        f"  if (kind == {len(_RANGES)}U) {{",
        "    return 0.0F;",
        "  }",
        f"  if (kind > {len(_RANGES)}U) {{",
        f"    return {name}_float(kind == {len(_RANGES) + 1}U ? word & 0x{_SUBNORMAL:08x}U : word);",
        "  }",
        "  // exact: 24 bits times a power of two",
        "  word = word >> 8;",
        "  x = (float)(int32_t)word;",
        "  x = x - 8388608.0F;",
        f"  x = x * {literal(np.float32(2.0**-23))};",
        "  return x * ranges[kind];",
        "}",
        "",
    ]


def _mix(name: str) -> list[str]:
    return [
        f"static uint32_t {name}_mix(uint32_t hash, float value) {{",
        "  union {",
        "    uint32_t u;",
        "    float f;",
        "  } word;",
        "  word.f = value;",
        f"  hash = (hash ^ (value != value ? 0x{NAN_BITS:08x}U : word.u)) * 0x{_FACTORS[0]:08x}U;",
        "  return hash ^ (hash >> 15);  // a sign must not stay in the top bit, where two of them cancel",
        "}",
        "",
    ]


def _trials(name: str, operation: Operation, period: np.float32) -> list[str]:
    operands = "abc"[: operation.arity]
    slots = range(operation.nstate)
    values = dict(zip(operands, operands, strict=True))
    expression = operation.c.format(**values, s="s", dt=literal(period))
    return [
        f"  random = 0x{SEED:08x}U;",
        f"  hash = 0x{HASH_START:08x}U;",
        f"  for (i = 0; i < {TRIALS}; i++) {{",
        *[f"    s[{slot}] = {name}_draw(&random);" for slot in slots],
        *[f"    {operand} = {name}_draw(&random);" for operand in operands],
        f"    hash = {name}_mix(hash, {expression});",
        *[f"    hash = {name}_mix(hash, s[{slot}]);" for slot in slots],
        "  }",
        f"  if (hash != 0x{answers_hash(operation.name, float(period)):08x}U) {{",
        "    return 0;",
        "  }",
    ]


@functools.cache
def answers_hash(name: str, dt: float) -> int:
    """Return the hash of what the reference gives for the random numbers.

    Args:
        name: the operation's name
        dt: period, a float32 [s]

    Returns:
        32 bits
    """
    operation = BY_NAME[name]
    random = SEED
    result = HASH_START
    with np.errstate(all="ignore"):
        for _ in range(TRIALS):
            drawn = []
            for _ in range(operation.nstate + operation.arity):
                random, value = draw_float(random)
                drawn.append(value)
            state = np.array(drawn[: operation.nstate], np.float32)
            operands = drawn[operation.nstate :]
            answer = (
                operation.reference(state, np.float32(dt), *operands)
                if operation.nstate
                else operation.reference(*operands)
            )
            for value in (np.float32(answer), *state):
                result = hash_float(result, value)
    return result


def hash_float(before: int, value: np.float32) -> int:
    """Return a hash with one more answer in it, as the generated C mixes it in; all NaNs are one.

    Args:
        before: the hash, 32 bits
        value: the answer

    Returns:
        32 bits
    """
    bits = NAN_BITS if np.isnan(value) else int(value.view(np.uint32))
    mixed = (before ^ bits) * _FACTORS[0] & _MASK
    return mixed ^ mixed >> 15


def draw_float(random: int) -> tuple[int, np.float32]:
    """Return the generator's next state and a random number, bit for bit as the generated C.

    Args:
        random: the generator's state, 32 bits
    """
    kind = _mixed(random + _STRIDE) >> 29
    random = (random + 2 * _STRIDE) & _MASK
    word = _mixed(random)
    if kind == len(_RANGES):
        return random, np.float32(0)
    if kind > len(_RANGES):
        bits = word & _SUBNORMAL if kind == len(_RANGES) + 1 else word
        return random, np.uint32(bits).view(np.float32)
    return random, np.float32(((word >> 8) - 8388608) * 2.0**-23 * _RANGES[kind])


def _mixed(x: int) -> int:
    x &= _MASK
    x = (x ^ (x >> 16)) * _FACTORS[0] & _MASK
    x = (x ^ (x >> 15)) * _FACTORS[1] & _MASK
    return x ^ (x >> 15)
