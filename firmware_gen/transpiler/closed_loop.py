"""The part of the selftest that closes the loop: every input follows a command, and all state is carried."""

from __future__ import annotations

import numpy as np

from firmware_gen.transpiler.header import input_dimension
from firmware_gen.transpiler.literals import literal
from firmware_gen.transpiler.unit import Unit
from firmware_gen.transpiler.vectors import LOOP_PART, Vectors


def closed_loop_lines(unit: Unit, vectors: Vectors) -> list[str]:
    """Write the function that runs the controller on its own commands.

    Args:
        unit: the controller and its names
        vectors: a recorded run of the reference

    Returns:
        lines of C
    """
    name = unit.name
    return [
        *(_feed_back(unit) if unit.controller.inputs else []),
        "// from the first recorded inputs on, every input goes towards a command, within its range",
        f"static int32_t {name}_closed_loop(void) {{",
        f"  {name}_state state;",
        f"  float inputs[{input_dimension(unit)}];",
        f"  float outputs[{name}_noutput];",
        f"  float command[{name}_noutput];",
        "  int32_t step;",
        "  int32_t i;",
        f"  {name}_init(&state);",
        *(
            [
                f"  for (i = 0; i < {name}_ninput; i++) {{",
                f"    inputs[i] = {name}_float({name}_recorded_inputs[0][i]);",
                "  }",
            ]
            if unit.controller.inputs
            else ["  inputs[0] = 0.0F;"]
        ),
        f"  for (step = 0; step < {len(vectors.loop)}; step++) {{",
        f"    {name}_step(&state, inputs, outputs);",
        f"    {name}_command(&state, outputs, command);",
        *([f"    {name}_feed_back(command, inputs);"] if unit.controller.inputs else []),
        f"    for (i = 0; i < {name}_noutput; i++) {{",
        f"      if (!{name}_same(outputs[i], {name}_recorded_loop[step][i])) {{",
        "        return 0;",
        "      }",
        "    }",
        "  }",
        "  return 1;",
        "}",
        "",
    ]


def _feed_back(unit: Unit) -> list[str]:
    name = unit.name
    tables = [
        f"  static const float {field}[{name}_ninput] = {{{', '.join(values)}}};"
        for field in ("low", "high")
        for values in [[literal(np.float32(getattr(terminal, field))) for terminal in unit.controller.inputs]]
    ]
    return [
        f"static void {name}_feed_back(const float command[{name}_noutput], float inputs[{name}_ninput]) {{",
        *tables,
        "  int32_t i;",
        f"  for (i = 0; i < {name}_ninput; i++) {{",
        f"    float y = command[{f'i % {name}_noutput' if len(unit.controller.outputs) > 1 else '0'}];",
        "    y = y - inputs[i];",
        f"    y = {literal(LOOP_PART)} * y;",
        "    y = inputs[i] + y;",
        f"    inputs[i] = {name}_limit(y, low[i], high[i], low[i]);",
        "  }",
        "}",
        "",
    ]
