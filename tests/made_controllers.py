"""Controllers made of a text, and what else the tests of generated C share."""

import subprocess
from pathlib import Path

from controller import Controller, Input, Output, lower, parse

ROOT = Path(__file__).parents[1]
GOLDEN = ROOT / "tests" / "golden"
FIGURE7 = GOLDEN / "figure7.controller.toml"

WARNINGS = ["-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Wmissing-prototypes", "-Werror", "-pedantic"]


def make_controller(text, inputs=("a0", "a1"), name="made", low=-50.0):
    return from_source(parse(text, inputs), inputs, name, low)


def from_source(source, inputs, name="made", low=-50.0):
    return Controller(
        name=name,
        period_s=0.02,
        inputs=tuple(Input(terminal, "1", -2.0, 2.0) for terminal in inputs),
        outputs=tuple(Output(f"j{i}", "position", "deg", low, 50.0, 1.5) for i in range(len(source.outputs))),
        source=source,
        program=lower(source, inputs),
    )


def run_command(*command, cwd):
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)


EVERYTHING = """(let ((n1 (tanh (+ (* 0.5 (last n1)) a0))) (n2 (sigmoid (* (last n3) n1))) (n3 (osc-wave a1 n2)))
  (list (integrate n3) (differentiate n2) (smooth n1 0.2) (osc-tri 1 n1) (osc-saw 2 a0) (memory a0 n3) (delay n1)
    (interpolate a0 n1 -2) (log (abs (sign (exp (min n1 (max a0 (cos (atan a1)))))))) (gt (if a0 a1 n1) 3) 7 -0 a1
    (% (sin a0) 1e-40) (ifltz a0 a1 n1)))"""
SHAPES = {
    "everything": make_controller(EVERYTHING),
    "no_terminal": make_controller("(list (osc-wave 1.5 0))", inputs=()),
    "unused": make_controller("(list 1 2)"),
    "no_operation": make_controller("(list a1)"),
    "in": make_controller("(list (+ a (* input_a state)))", inputs=("input_a", "a", "state")),
    "in_a": make_controller("(list (+ a_step (* a a_input_a)))", inputs=("a_step", "a", "a_input_a")),
    "made_": make_controller("(list (+ y (* v0 (integrate word))))", inputs=("y", "v0", "word")),
    "hard_names": make_controller("(list (+ int (* osc-like.name double)))", inputs=("int", "osc-like.name", "double")),
}

SLOW = "(list (* 30 (osc-tri 0.5 0)) (* 20 (osc-wave 0.7 0)) (smooth (tanh (integrate a0)) 0.001) (log (exp a1)))"

FLUSH = """
#if defined(__SSE2__)
#include <xmmintrin.h>
#define FLUSH() _mm_setcsr(_mm_getcsr() | 0x8040U)
#elif defined(__aarch64__)
#define FLUSH() __asm__ volatile("msr fpcr, %0" : : "r"(1UL << 24))
#else
#error "how are subnormals flushed to zero on this machine?"
#endif
"""
