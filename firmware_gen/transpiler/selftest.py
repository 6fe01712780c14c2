"""The generated selftest, which tells whether this build on this machine gives the reference's bits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from firmware_gen.transpiler.closed_loop import closed_loop_lines
from firmware_gen.transpiler.function_check import calls_functions, function_check_lines
from firmware_gen.transpiler.header import input_dimension
from firmware_gen.transpiler.literals import literal
from firmware_gen.transpiler.unit import Unit
from firmware_gen.transpiler.vectors import NAN_BITS, Vectors


def selftest_lines(unit: Unit, vectors: Vectors) -> list[str]:
    """Write the recorded steps and the functions that check them.

    Args:
        unit: the controller and its names
        vectors: a recorded run of the reference

    Returns:
        lines of C
    """
    return [
        *_table(unit, "recorded_inputs", "the reference's inputs", vectors.inputs),
        *_table(unit, "recorded_outputs", "the reference's outputs", vectors.outputs),
        *_table(unit, "recorded_values", "outputs that try the output stage", vectors.values),
        *_table(unit, "recorded_commands", "the reference's commands for them", vectors.commands),
        *_table(unit, "recorded_loop", "the reference's outputs in a closed loop", vectors.loop),
        *arithmetic_lines(unit),
        *function_check_lines(unit),
        *_clamp_check(unit),
        *_command_check(unit, vectors),
        *closed_loop_lines(unit, vectors),
        *_selftest(unit, vectors),
    ]


def _table(unit: Unit, table: str, comment: str, bits: npt.NDArray[np.uint32]) -> list[str]:
    if bits.shape[1] == 0:
        return []
    size = f"{unit.name}_{'ninput' if table == 'recorded_inputs' else 'noutput'}"
    rows = []
    for row in bits.tolist():
        words = [f"0x{word:08x}U" for word in row]
        chunks = [", ".join(words[i : i + 8]) for i in range(0, len(words), 8)]
        rows.append("    {" + ",\n     ".join(chunks) + "},")
    return [
        f"// {comment}, as bits, step by step",
        f"static const uint32_t {unit.name}_{table}[{len(rows)}][{size}] = {{",
        *rows,
        "};",
        "",
    ]


def arithmetic_lines(unit: Unit) -> list[str]:
    """Write the functions that compare bits and try subnormals, rounding and contraction.

    Args:
        unit: the controller and its names

    Returns:
        lines of C
    """
    name = unit.name
    return [
        f"static float {name}_float(uint32_t bits) {{",
        "  union {",
        "    uint32_t u;",
        "    float f;",
        "  } word;",
        "  // volatile: the check must run on the machine, not in the compiler",
        "  volatile uint32_t unknown = bits;",
        "  word.u = unknown;",
        "  return word.f;",
        "}",
        "",
        "// same bits; all NaNs are equal",
        f"static int32_t {name}_same(float value, uint32_t bits) {{",
        "  union {",
        "    uint32_t u;",
        "    float f;",
        "  } word;",
        "  word.f = value;",
        "  if (value != value) {",
        f"    return bits == 0x{NAN_BITS:08x}U;",
        "  }",
        "  return word.u == bits;",
        "}",
        "",
        f"static int32_t {name}_arithmetic(void) {{",
        f"  const float smallest_normal = {name}_float(0x00800000U);",
        f"  const float half = {name}_float(0x3f000000U);",
        f"  const float one = {name}_float(0x3f800000U);",
        f"  const float factor = {name}_float(0x3f800800U);  // 1 + 2^-12",
        f"  const float square = {name}_float(0xbf801000U);  // -(1 + 2^-11), that squared and rounded, negated",
        f"  const float half_unit = {name}_float(0x33800000U);  // 2^-24, half a unit in the last place of 1",
        f"  const float three_halves = {name}_float(0x34400000U);  // 3 * 2^-24, one and a half units of 1",
        "  float y;",
        "  y = smallest_normal * half;",
        f"  if (!{name}_same(y, 0x00400000U)) {{",
        "    return -1;",
        "  }",
        f"  y = {name}_float(0x00400000U);",
        "  y = y / half;",
        f"  if (!{name}_same(y, 0x00800000U)) {{",
        "    return -1;",
        "  }",
        "  y = one + half_unit;",
        f"  if (!{name}_same(y, 0x3f800000U)) {{",
        "    return -3;",
        "  }",
        "  y = one + three_halves;",
        f"  if (!{name}_same(y, 0x3f800002U)) {{",
        "    return -3;",
        "  }",
        "  y = factor * factor;",
        "  y = y + square;",
        f"  return {name}_same(y, 0x00000000U) ? 0 : -2;",
        "}",
        "",
    ]


def _clamp_check(unit: Unit) -> list[str]:
    name = unit.name
    lines = [
        f"static int32_t {name}_clamps(uint32_t bits, const float expected[{name}_noutput]) {{",
        f"  float outputs[{name}_noutput];",
        "  int32_t i;",
        f"  for (i = 0; i < {name}_noutput; i++) {{",
        f"    outputs[i] = {name}_float(bits);",
        "  }",
        f"  {name}_clamp(outputs);",
        f"  for (i = 0; i < {name}_noutput; i++) {{",
        "    if (!(outputs[i] == expected[i])) {",
        "      return 0;",
        "    }",
        "  }",
        "  return 1;",
        "}",
        "",
        f"static int32_t {name}_clamp_check(void) {{",
    ]
    for field in ("low", "high", "neutral"):
        values = ", ".join(literal(np.float32(getattr(output, field))) for output in unit.controller.outputs)
        lines.append(f"  static const float {field}[{name}_noutput] = {{{values}}};")
    return [
        *lines,
        f"  return {name}_clamps(0xff800000U, low) && {name}_clamps(0x7f800000U, high) &&",
        f"         {name}_clamps(0x{NAN_BITS:08x}U, neutral);",
        "}",
        "",
    ]


def _command_check(unit: Unit, vectors: Vectors) -> list[str]:
    name = unit.name
    return [
        f"static int32_t {name}_command_check(void) {{",
        f"  {name}_state state;",
        f"  float values[{name}_noutput];",
        f"  float command[{name}_noutput];",
        "  int32_t step;",
        "  int32_t i;",
        f"  {name}_init(&state);",
        f"  for (step = 0; step < {len(vectors.values)}; step++) {{",
        f"    for (i = 0; i < {name}_noutput; i++) {{",
        f"      values[i] = {name}_float({name}_recorded_values[step][i]);",
        "    }",
        f"    {name}_command(&state, values, command);",
        f"    for (i = 0; i < {name}_noutput; i++) {{",
        f"      if (!{name}_same(command[i], {name}_recorded_commands[step][i])) {{",
        "        return 0;",
        "      }",
        "    }",
        "  }",
        "  return 1;",
        "}",
        "",
    ]


def opening_lines(unit: Unit, variables: Sequence[str] = ()) -> list[str]:
    """Write how a selftest begins: its variables, and the checks that need no program.

    Args:
        unit: the controller and its names
        variables: lines that declare those of one kind of selftest

    Returns:
        lines of C
    """
    name = unit.name
    return [
        f"int32_t {name}_selftest(void) {{",
        f"  {name}_state state;",
        f"  float inputs[{input_dimension(unit)}];",
        f"  float outputs[{name}_noutput];",
        *variables,
        "  int32_t step;",
        "  int32_t i;",
        f"  const int32_t status = {name}_arithmetic();",
        "  if (status != 0) {",
        "    return status;",
        "  }",
        *([f"  if (!{name}_functions()) {{", "    return -5;", "  }"] if calls_functions(unit) else []),
        *([] if unit.controller.inputs else ["  inputs[0] = 0.0F;"]),
    ]


def _selftest(unit: Unit, vectors: Vectors) -> list[str]:
    name = unit.name
    read = [
        f"    for (i = 0; i < {name}_ninput; i++) {{",
        f"      inputs[i] = {name}_float({name}_recorded_inputs[step][i]);",
        "    }",
    ]
    return [
        *opening_lines(unit),
        f"  {name}_init(&state);",
        f"  for (step = 0; step < {len(vectors.inputs)}; step++) {{",
        f"    if (step == {vectors.second}) {{",
        f"      {name}_init(&state);",
        "    }",
        *(read if unit.controller.inputs else []),
        f"    {name}_step(&state, inputs, outputs);",
        f"    for (i = 0; i < {name}_noutput; i++) {{",
        f"      if (!{name}_same(outputs[i], {name}_recorded_outputs[step][i])) {{",
        "        return step + 1;",
        "      }",
        "    }",
        "  }",
        f"  if (!{name}_clamp_check()) {{",
        "    return -4;",
        "  }",
        f"  if (!{name}_command_check()) {{",
        "    return -6;",
        "  }",
        f"  return {name}_closed_loop() ? 0 : -7;",
        "}",
    ]
