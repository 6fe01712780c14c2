"""The piece of C between a transpiled controller and the control cycle, which calls programs by `sv_program.h`."""

from __future__ import annotations

from typing import Final

from firmware_gen.projects.plain import plain
from firmware_gen.transpiler.unit import Unit

_STEP: Final = (
    "void sv_step(const sv_program* program, float dt, const float* inputs, float* registers, float* state, "
    "float* outputs)"
)


def glue_source(unit: Unit) -> str:
    """Write `program.c`: the runtime's program functions, carried out by compiled code instead of the virtual machine.

    Args:
        unit: the controller and its names
    """
    name = unit.name
    return f"""// The control cycle's program: the compiled {plain(unit.controller.name)}.
// Written by servolve firmware; do not edit.

#include "{name}.h"
#include "rig.h"
#include "sv_program.h"

// the controller's state lies in an array of floats, which the board's main owns
typedef char sv_state_fits[sizeof({name}_state) == sizeof(float) * SERVOLVE_NSTATE ? 1 : -1];

int32_t sv_verify(const sv_program* program) {{
  return program->ninput == {name}_ninput && program->noutput == {name}_noutput ? SV_OK : SV_ERROR_SIZE;
}}

void sv_reset(const sv_program* program, float* registers, float* state) {{
  (void)program;
  (void)registers;
  {name}_init(({name}_state*)(void*)state);
}}

{_STEP} {{
  (void)program;
  (void)dt;
  (void)registers;
  {name}_step(({name}_state*)(void*)state, inputs, outputs);
}}

int32_t servolve_selftest(void) {{ return {name}_selftest(); }}
"""
