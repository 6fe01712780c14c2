"""The generated source: the program as three-address code, one operation a line."""

from __future__ import annotations

from typing import Final

from controller.decimals import format_decimal
from controller.operations import BY_OPCODE
from firmware_gen.transpiler.command import clamp_lines, command_lines, init_lines
from firmware_gen.transpiler.header import input_dimension, opening_comment
from firmware_gen.transpiler.names import comment_text, mangle
from firmware_gen.transpiler.selftest import selftest_lines
from firmware_gen.transpiler.short_selftest import short_selftest_lines
from firmware_gen.transpiler.unit import GENERATOR_VERSION, Unit, operands_of, register_texts
from firmware_gen.transpiler.vectors import selftest_vectors

COMMENT_MAX: Final = 72
"""Characters of a source expression in a comment; parts of longer ones are called by their variables."""

_ARITHMETIC: Final = """\
#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "this controller needs IEEE-754 arithmetic: compile without -ffast-math, -Ofast and -ffinite-math-only"
#endif
#if defined(__FLT_EVAL_METHOD__) && __FLT_EVAL_METHOD__ != 0 && __FLT_EVAL_METHOD__ != 16
#error "this controller needs floats rounded to float: compile with -msse2 -mfpmath=sse, or for an FPU with float"
#endif

// a * b + c must round twice, also where the compiler's default is to fuse it (gcc -std=gnu11)
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
#pragma GCC optimize("fp-contract=off")
#endif
"""


def source_text(unit: Unit, short: bool = False) -> str:
    """Write the source file.

    Args:
        unit: the controller and its names
        short: whether the selftest compares a hash of the answers, as an image's, not a recorded run

    Returns:
        the whole file
    """
    name = unit.name
    parts = [
        *opening_comment(unit),
        "",
        f'#include "{name}.h"',
        "",
        f"#if {name}_GENERATOR != {GENERATOR_VERSION} || {name}_FINGERPRINT != 0x{unit.fingerprint:08x}",
        f'#error "{name}.h and {name}.c are not of the same run: generate both again"',
        "#endif",
        "",
        _ARITHMETIC,
    ]
    parts += [function.text for function in unit.functions]
    parts += [*init_lines(unit), *_step(unit), *clamp_lines(unit), *command_lines(unit)]
    parts += short_selftest_lines(unit) if short else selftest_lines(unit, selftest_vectors(unit.controller))
    parts.append("")
    return "\n".join(parts)


def _step(unit: Unit) -> list[str]:
    name, program = unit.name, unit.controller.program
    registers = register_texts(unit.controller, name)
    first_result = program.nregister - len(program.instructions)
    rows = program.instructions.tolist()
    used = {i for row in rows for i in operands_of(BY_OPCODE[row[0]], row)} | set(program.outputs.tolist())
    lines = [
        f"void {name}_step({name}_state* state, const float inputs[{input_dimension(unit)}], "
        f"float outputs[{name}_noutput]) {{"
    ]
    lines += [
        f"  const float {registers[i]} = inputs[{name}_input_{mangle(terminal)}];"
        for i, terminal in enumerate(program.inputs)
        if i in used
    ]
    if program.nstate == 0:
        lines.append("  (void)state;")
    if not used & set(range(len(program.inputs))):
        lines.append("  (void)inputs;")
    for i, (expression, comment) in enumerate(zip(unit.expressions, source_expressions(unit), strict=True)):
        lines.append(f"  const float v{i} = {expression};  // {comment_text(comment)}")
        if first_result + i not in used:
            lines.append(f"  (void)v{i};")
    lines += [
        f"  outputs[{name}_output_{mangle(output.name)}] = {registers[register]};"
        for output, register in zip(unit.controller.outputs, program.outputs.tolist(), strict=True)
    ]
    return [*lines, "}", ""]


def source_expressions(unit: Unit) -> list[str]:
    """Return the source expression of each instruction, parts that are too long called by their variables.

    Args:
        unit: the controller and its names

    Returns:
        (ninstruction,)
    """
    program = unit.controller.program
    texts = [*program.inputs, *(format_decimal(value) for value in program.constants)]
    comments = []
    for i, row in enumerate(program.instructions.tolist()):
        operation = BY_OPCODE[row[0]]
        operands = [texts[k] for k in operands_of(operation, row)]
        if operation.internal:
            operands.append(f"s[{row[1 + operation.arity]}]")
        expression = f"({' '.join([operation.name, *operands])})"
        comments.append(expression)
        texts.append(expression if len(expression) <= COMMENT_MAX else f"v{i}")
    return comments
