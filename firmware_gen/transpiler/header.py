"""The generated header: the controller's manual, its names, and four functions."""

from __future__ import annotations

import numpy as np

from controller import format_source
from controller.controller import Input, Output
from controller.decimals import format_decimal
from firmware_gen.transpiler.names import comment_text, mangle
from firmware_gen.transpiler.unit import GENERATOR_VERSION, Unit
from firmware_gen.transpiler.vectors import STEPS_HARD, STEPS_LOOP, STEPS_USUAL


def header_text(unit: Unit, short: bool = False) -> str:
    """Write the header.

    Args:
        unit: the controller and its names
        short: whether the selftest compares a hash of the answers, not a recorded run

    Returns:
        the whole file
    """
    name = unit.name
    return "\n".join(
        [
            *opening_comment(unit),
            *_manual(unit, short),
            "",
            f"#ifndef {name}_H_",
            f"#define {name}_H_",
            "",
            "#include <stdint.h>",
            "",
            "// the source file compares these: a header and a source of different runs do not compile",
            f"#define {name}_GENERATOR {GENERATOR_VERSION}",
            f"#define {name}_FINGERPRINT 0x{unit.fingerprint:08x}",
            "",
            "#ifdef __cplusplus",
            'extern "C" {',
            "#endif",
            "",
            f"enum {{ {name}_ninput = {len(unit.controller.inputs)}, "
            f"{name}_noutput = {len(unit.controller.outputs)} }};",
            "",
            *_enumeration(unit, "input", [_input_comment(i) for i in unit.controller.inputs]),
            *_enumeration(unit, "output", [_output_comment(o) for o in unit.controller.outputs]),
            *_state(unit),
            *_functions(unit, short),
            "#ifdef __cplusplus",
            "}",
            "#endif",
            "",
            f"#endif  // {name}_H_",
            "",
        ]
    )


def opening_comment(unit: Unit) -> list[str]:
    """Return the lines that say where a generated file comes from.

    Args:
        unit: the controller and its names
    """
    return [
        f"// {unit.name}: a robot controller, written by servolve transpile; do not edit.",
        "//",
        f"//   controller  {comment_text(unit.controller.name)}",
        f"//   program     {unit.program_hash}",
        f"//   generator   {GENERATOR_VERSION}",
    ]


def input_dimension(unit: Unit) -> str:
    """Return the C text of the length of the input array, which C does not allow to be 0.

    Args:
        unit: the controller and its names
    """
    return f"{unit.name}_ninput" if unit.controller.inputs else "1"


def _manual(unit: Unit, short: bool) -> list[str]:
    name = unit.name
    step_words = len(unit.controller.inputs) + 3 * len(unit.controller.outputs)
    table_bytes = 4 * ((STEPS_USUAL + STEPS_HARD) * step_words + STEPS_LOOP * len(unit.controller.outputs))
    constants = "" if short else f"; {table_bytes} bytes of constants, for the selftest only"
    program = [f"//   {comment_text(line)}" for line in format_source(unit.controller.source).splitlines()]
    return [
        f"//   period      {_number(unit.controller.period_s)} s",
        f"//   filter      {_filter(unit)}",
        f"//   memory      {unit.state_bytes} bytes of state{constants}",
        f"//   worst case  {sum(unit.operation_counts.values())} program operations a step, at most "
        f"{unit.worst_case} float operations and comparisons",
        "//",
        *program,
        "//",
        "// C99 without libc, heap, globals, recursion and double. Once a period:",
        "//",
        f"//   {name}_step(&state, inputs, outputs);",
        f"//   {name}_command(&state, outputs, command);",
        "//   counts = zero + round(command * counts per rad), half to even, within the servo's limits",
        "//",
        f"// after {name}_selftest() has returned 0 and {name}_init(&state) has been called, at start-up.",
        "//",
        "// Symbols are <name>_<function>, <name>_input_<terminal> and <name>_output_<joint>. No <name> holds _input",
        "// or _output, so those of two controllers never meet.",
    ]


def _enumeration(unit: Unit, kind: str, comments: list[str]) -> list[str]:
    names = [o.name for o in (unit.controller.inputs if kind == "input" else unit.controller.outputs)]
    if not names:
        return []
    lines = [
        f"  {unit.name}_{kind}_{mangle(name)} = {i}{',' * (i < len(names) - 1)}  // {comment}"
        for i, (name, comment) in enumerate(zip(names, comments, strict=True))
    ]
    return [f"// places in the array of {kind}s", "typedef enum {", *lines, f"}} {unit.name}_{kind};", ""]


def _input_comment(terminal: Input) -> str:
    return f"{comment_text(terminal.unit)}, expected {_number(terminal.low)} to {_number(terminal.high)}"


def _output_comment(output: Output) -> str:
    what = f"{comment_text(output.kind)} in {comment_text(output.unit)}"
    limits = f"{_number(output.low)} to {_number(output.high)}"
    return f"{what}, clamped to {limits}, {_number(output.neutral)} for a NaN"


def _filter(unit: Unit) -> str:
    controller = unit.controller
    part = f"y += {_number(controller.filter)} * (u - y)" if np.float32(controller.filter) != 1 else "none"
    slew = f"{_number(controller.slew_rad_s)} rad/s" if controller.slew_rad_s else "none"
    return f"{part}; slew limit {slew}"


def _state(unit: Unit) -> list[str]:
    nstate = unit.controller.program.nstate
    comment = "the program's memory, all 0 at the start" if nstate else "unused: this program has no memory"
    held = [f"  float held[{unit.name}_noutput];  // the commands of the period before, neutral at the start"]
    return [
        "typedef struct {",
        f"  float s[{max(nstate, 1)}];  // {comment}",
        *(held if unit.follows else []),
        f"}} {unit.name}_state;",
        "",
    ]


def _functions(unit: Unit, short: bool) -> list[str]:
    name = unit.name
    recorded = [
        "// Check this build on this machine against the recorded answers of the reference. Returns 0: the same bits;",
        "// n > 0: step n of the recording differs; -1: subnormals are flushed to zero; -2: products are fused with",
        "// sums; -3: rounding is not to nearest even; -4: the clamp is wrong; -5: a copied function is wrong;",
        "// -6: the command is wrong; -7: a closed loop, whose inputs follow its commands, goes another way.",
    ]
    hashed = [
        "// Check the program of this build on this machine against a hash of the reference's answers. Returns 0: the",
        "// same bits; 1: the program's answers differ; -1: subnormals are flushed to zero; -2: products are fused",
        "// with sums; -3: rounding is not to nearest even; -5: a copied function is wrong.",
    ]
    return [
        "// Go back to the start.",
        f"void {name}_init({name}_state* state);",
        "",
        "// Evaluate one period: (inputs, state) => (outputs, state). The outputs are the program's own values.",
        f"void {name}_step({name}_state* state, const float inputs[{input_dimension(unit)}], "
        f"float outputs[{name}_noutput]);",
        "",
        "// Clamp outputs where they are, in their own units: a NaN becomes neutral, the rest keeps to its limits.",
        f"void {name}_clamp(float outputs[{name}_noutput]);",
        "",
        "// Turn the program's own outputs into commands [rad, rad/s], once a period: clamp, convert, filter, limit",
        "// the rate. Both arrays may be the same.",
        f"void {name}_command({name}_state* state, const float outputs[{name}_noutput], "
        f"float command[{name}_noutput]);",
        "",
        *(hashed if short else recorded),
        f"int32_t {name}_selftest(void);",
        "",
    ]


def _number(value: float) -> str:
    return format_decimal(np.float32(value))
