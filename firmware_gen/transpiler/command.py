"""The generated output stage: from a program's outputs to commands, operation for operation as the control cycle."""

from __future__ import annotations

import numpy as np

from controller.controller import Output
from controller.cycle import slew_step, unit_scale
from firmware_gen.transpiler.literals import literal
from firmware_gen.transpiler.names import mangle
from firmware_gen.transpiler.unit import Unit


def init_lines(unit: Unit) -> list[str]:
    """Write the function that goes back to the start.

    Args:
        unit: the controller and its names

    Returns:
        lines of C
    """
    held = [
        f"  state->held[{_place(unit, output)}] = {literal(np.float32(output.neutral) * _scale(output))};"
        for output in unit.controller.outputs
        if unit.follows
    ]
    return [
        f"void {unit.name}_init({unit.name}_state* state) {{",
        *[f"  state->s[{i}] = 0.0F;" for i in range(max(unit.controller.program.nstate, 1))],
        *held,
        "}",
        "",
    ]


def clamp_lines(unit: Unit) -> list[str]:
    """Write the function that clamps outputs, in their own units.

    Args:
        unit: the controller and its names

    Returns:
        lines of C
    """
    name = unit.name
    places = [f"outputs[{_place(unit, output)}]" for output in unit.controller.outputs]
    return [
        f"static float {name}_limit(float value, float low, float high, float neutral) {{",
        "  if (value != value) {",
        "    return neutral;",
        "  }",
        "  if (value < low) {",
        "    return low;",
        "  }",
        "  return value > high ? high : value;",
        "}",
        "",
        f"void {name}_clamp(float outputs[{name}_noutput]) {{",
        *[
            f"  {place} = {_limited(unit, output)};"
            for place, output in zip(places, unit.controller.outputs, strict=True)
        ],
        "}",
        "",
    ]


def command_lines(unit: Unit) -> list[str]:
    """Write the function that makes commands of outputs: clamp, SI, filter, slew limit.

    Args:
        unit: the controller and its names

    Returns:
        lines of C
    """
    name = unit.name
    lines = [
        *(_follow(unit) if unit.follows else []),
        f"void {name}_command({name}_state* state, const float outputs[{name}_noutput], "
        f"float command[{name}_noutput]) {{",
        *([] if unit.follows else ["  (void)state;"]),
        # one by one, so that no compiler makes a loop or a call of memcpy of it
        *[f"  command[{place}] = outputs[{place}];" for place in (_place(unit, o) for o in unit.controller.outputs)],
        f"  {name}_clamp(command);",
    ]
    for output in unit.controller.outputs:
        place = _place(unit, output)
        scale = _scale(output)
        if scale != 1:
            lines.append(f"  command[{place}] = command[{place}] * {literal(scale)};")
        if unit.follows:
            lines.append(f"  state->held[{place}] = {name}_follow(state->held[{place}], command[{place}]);")
            lines.append(f"  command[{place}] = state->held[{place}];")
    return [*lines, "}", ""]


def _follow(unit: Unit) -> list[str]:
    part, limit = np.float32(unit.controller.filter), np.float32(slew_step(unit.controller))
    lines = [
        "// target => filtered, then limited in rate [SI]",
        f"static float {unit.name}_follow(float held, float target) {{",
        "  float step;",
    ]
    if part != 1:
        lines += ["  step = target - held;", f"  step = {literal(part)} * step;", "  target = held + step;"]
    if limit > 0:
        lines += [
            "  step = target - held;",
            f"  if (step > {literal(limit)}) {{",
            f"    target = held + {literal(limit)};",
            "  }",
            f"  if (step < {literal(-limit)}) {{",
            f"    target = held - {literal(limit)};",
            "  }",
        ]
    return [*lines, "  return target;", "}", ""]


def _scale(output: Output) -> np.float32:
    return np.float32(unit_scale(output))


def _place(unit: Unit, output: Output) -> str:
    return f"{unit.name}_output_{mangle(output.name)}"


def _limited(unit: Unit, output: Output) -> str:
    limits = ", ".join(literal(np.float32(value)) for value in (output.low, output.high, output.neutral))
    return f"{unit.name}_limit(outputs[{_place(unit, output)}], {limits})"
