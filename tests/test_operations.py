"""Each operation against what design says of it: vectors by hand, never computed by our code."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from controller.generate_runtime import PATH, runtime_text
from controller.lowering import lower
from controller.native import NativeProgram
from controller.operations import BY_NAME, OPERATIONS
from controller.reference import run_program
from controller.text import parse

MANUAL = Path(__file__).parent.parent / "docs" / "controller.md"

INF, NAN = float("inf"), float("nan")
SUB = 2.0**-149  # the smallest subnormal
MAX = 2.0**128 - 2.0**104  # the largest finite float
BIG = 2.0**24  # from here on, odd integers are not floats

# (operation, operands, result)
STATELESS = [
    # nearest even, gradual underflow, overflow to infinity, IEEE zeros
    ("+", (BIG, 1), BIG),  # a tie, to even below
    ("+", (BIG + 2, 1), BIG + 4),  # a tie, to even above
    ("+", (SUB, SUB), 2 * SUB),
    ("+", (MAX, MAX), INF),
    ("+", (MAX, 2.0**102), MAX),  # less than half a unit
    ("+", (MAX, 2.0**103), INF),  # a tie, to even above
    ("+", (0.0, -0.0), 0.0),
    ("+", (-0.0, -0.0), -0.0),
    ("+", (INF, -INF), NAN),
    ("+", (NAN, 1), NAN),
    ("-", (0.0, 0.0), 0.0),
    ("-", (-0.0, 0.0), -0.0),
    ("-", (0.0, -0.0), 0.0),
    ("-", (INF, INF), NAN),
    ("-", (2.0**-126, SUB), 2.0**-126 - SUB),  # subnormals are kept
    ("*", (-1, 0.0), -0.0),
    ("*", (-0.0, -0.0), 0.0),
    ("*", (SUB, 0.5), 0.0),  # a tie, to even
    ("*", (3 * SUB, 0.5), 2 * SUB),  # a tie, to even
    ("*", (-SUB, 0.5), -0.0),
    ("*", (0.0, INF), NAN),
    ("*", (MAX, 2), INF),
    ("*", (MAX, -2), -INF),
    ("*", (1 + 2.0**-12, 1 + 2.0**-12), 1 + 2.0**-11),  # 1 + 2^-11 + 2^-24: a tie, to even
    # (% a b) = 1 if b == 0 else a / b
    ("%", (1, 3), 11184811 * 2.0**-25),  # 0.3333…: 24 bits 1010…1011, rounded up
    ("%", (5, 0.0), 1),
    ("%", (5, -0.0), 1),
    ("%", (0.0, 0.0), 1),
    ("%", (NAN, 0.0), 1),
    ("%", (INF, 0.0), 1),
    ("%", (-0.0, 5), -0.0),
    ("%", (1, SUB), INF),
    ("%", (SUB, 2), 0.0),
    ("%", (1, INF), 0.0),
    ("%", (-1, INF), -0.0),
    ("%", (INF, INF), NAN),
    ("%", (1, NAN), NAN),
    ("abs", (-0.0,), 0.0),
    ("abs", (0.0,), 0.0),
    ("abs", (-SUB,), SUB),
    ("abs", (-INF,), INF),
    ("abs", (MAX,), MAX),
    ("abs", (NAN,), NAN),
    # (sign a) = 1, -1 or 0; NaN gives 0
    ("sign", (SUB,), 1),
    ("sign", (-SUB,), -1),
    ("sign", (0.0,), 0.0),
    ("sign", (-0.0,), 0.0),
    ("sign", (-INF,), -1),
    ("sign", (NAN,), 0.0),
    # (min a b) = a if a < b else b
    ("min", (1, 2), 1),
    ("min", (2, 1), 1),
    ("min", (0.0, -0.0), -0.0),
    ("min", (-0.0, 0.0), 0.0),
    ("min", (NAN, 1), 1),
    ("min", (1, NAN), NAN),
    ("min", (-INF, NAN), NAN),
    # (max a b) = a if a > b else b
    ("max", (1, 2), 2),
    ("max", (2, 1), 2),
    ("max", (0.0, -0.0), -0.0),
    ("max", (-0.0, 0.0), 0.0),
    ("max", (NAN, 1), 1),
    ("max", (INF, NAN), NAN),
    # (gt a b) = 1 if a > b else 0
    ("gt", (SUB, 0.0), 1),
    ("gt", (0.0, -0.0), 0.0),
    ("gt", (1, 1), 0.0),
    ("gt", (INF, MAX), 1),
    ("gt", (NAN, 0), 0.0),
    ("gt", (0, NAN), 0.0),
    # (if a b c) = b if a > 0 else c
    ("if", (SUB, 2, 3), 2),
    ("if", (0.0, 2, 3), 3),
    ("if", (-0.0, 2, 3), 3),
    ("if", (NAN, 2, 3), 3),
    ("if", (1, -0.0, NAN), -0.0),
    ("if", (-1, NAN, -0.0), -0.0),
    # (ifltz a b c) = b if a < 0 else c
    ("ifltz", (-SUB, 2, 3), 2),
    ("ifltz", (-0.0, 2, 3), 3),
    ("ifltz", (0.0, 2, 3), 3),
    ("ifltz", (-INF, 2, 3), 2),
    ("ifltz", (NAN, 2, 3), 3),
    ("ifltz", (-1, NAN, 3), NAN),
    # (interpolate a b w) = a + (b - a) clamp01(w)
    ("interpolate", (1, 3, 0.5), 2),
    ("interpolate", (1, 3, -7), 1),
    ("interpolate", (1, 3, 7), 3),
    ("interpolate", (1, 3, INF), 3),
    ("interpolate", (1, 3, NAN), NAN),
    ("interpolate", (BIG, BIG + 2, 0.5), BIG),  # 2^24 + 1: a tie, to even
    ("interpolate", (0, INF, 0.0), NAN),  # infinity times 0
    ("interpolate", (0, INF, -1), NAN),
    ("interpolate", (-MAX, MAX, 0.5), INF),  # b - a overflows
    ("interpolate", (-0.0, -0.0, -0.0), -0.0),  # -0 + (-0 - -0) * -0 = -0 + 0 * -0
    # our own polynomials at the edges that are stated
    ("sin", (0.0,), 0.0),
    ("sin", (8193,), 0.0),
    ("sin", (-8193,), 0.0),
    ("sin", (INF,), 0.0),
    ("sin", (NAN,), NAN),
    ("sin", (SUB,), SUB),
    ("cos", (0.0,), 1),
    ("cos", (-8193,), 1),
    ("cos", (-INF,), 1),
    ("cos", (NAN,), NAN),
    ("atan", (0.0,), 0.0),
    ("atan", (INF,), 13176795 * 2.0**-23),  # pi / 2 = 0x1.921fb6p0
    ("atan", (-INF,), -13176795 * 2.0**-23),
    ("atan", (NAN,), NAN),
    ("exp", (0.0,), 1),
    ("exp", (-0.0,), 1),
    ("exp", (89,), MAX),
    ("exp", (INF,), MAX),
    ("exp", (-INF,), 0.0),
    ("exp", (-200,), 0.0),
    ("exp", (NAN,), NAN),
    ("log", (1,), 0.0),
    ("log", (0.0,), 0.0),
    ("log", (-0.0,), 0.0),
    ("log", (-1,), 0.0),
    ("log", (-INF,), 0.0),
    ("log", (NAN,), NAN),
    ("tanh", (0.0,), 0.0),
    ("tanh", (INF,), 1),
    ("tanh", (-100,), -1),
    ("tanh", (NAN,), NAN),
    ("sigmoid", (0.0,), 0.5),
    ("sigmoid", (INF,), 1),
    ("sigmoid", (-INF,), 0.0),
    ("sigmoid", (NAN,), NAN),
]

# (operation, one row of operands a step, results), dt = 1/2
STATEFUL = [
    ("delay", [(1,), (2,), (NAN,), (-0.0,), (5,)], [0, 1, 2, NAN, -0.0]),
    # s += dt a
    ("integrate", [(1,), (2,), (-4,)], [0.5, 1.5, -0.5]),
    ("integrate", [(2 * BIG,), (2,), (2,)], [BIG, BIG, BIG]),  # 2^24 + 1: ties to even, lost each time
    ("integrate", [(SUB,), (2 * SUB,), (3 * SUB,)], [0, SUB, 3 * SUB]),  # dt a rounds first: 1/2 to 0, 3/2 to 2
    ("integrate", [(INF,), (-INF,), (1,)], [INF, NAN, NAN]),
    ("integrate", [(-0.0,)], [0.0]),  # 0 + -0
    # (a - last) / dt, first step 0
    ("differentiate", [(3,), (4,), (4,), (3.5,)], [0, 2, 0, -1]),
    ("differentiate", [(INF,), (INF,), (0,), (0,)], [0, NAN, -INF, 0]),
    ("differentiate", [(NAN,), (1,), (2,)], [0, NAN, 2]),
    ("differentiate", [(0.0,), (MAX,)], [0, INF]),
    # s += clamp01(r) (a - s)
    ("smooth", [(1, 0.5), (1, 0.5), (0, 1), (7, 2), (9, -1), (9, -0.0)], [0.5, 0.75, 0, 7, 7, 7]),
    ("smooth", [(4, 1), (8, NAN), (1, 1)], [4, NAN, NAN]),
    ("smooth", [(INF, 0), (1, 1)], [NAN, NAN]),  # infinity times 0
    # s = a if w > 0
    ("memory", [(5, 0), (6, 1), (7, 0), (8, -1), (9, NAN), (-0.0, SUB)], [0, 6, 6, 6, 6, -0.0]),
    ("memory", [(NAN, 1), (1, 0), (1, 1)], [NAN, NAN, 1]),
    # phase s = frac(s + dt f), value of frac(s + p); saw: 2 x - 1
    ("osc-saw", [(0.5, 0)] * 5, [-0.5, 0, 0.5, -1, -0.5]),
    ("osc-saw", [(-0.5, 0)] * 4, [0.5, 0, -0.5, -1]),
    ("osc-saw", [(0.5, 0.5), (0.5, -0.25), (0, 7)], [0.5, -0.5, 0]),
    ("osc-saw", [(0.25, 0), (1e30, 0), (0.5, 0)], [-0.75, -1, -0.5]),  # whole turns from 2^23 on: phase 0
    ("osc-saw", [(-SUB * 4, 0), (0, 0)], [1 - 2.0**-23, 1 - 2.0**-23]),  # phase stays below 1: 2 (1 - 2^-24) - 1
    ("osc-saw", [(0.5, NAN), (0.5, 0), (INF, 0), (0.5, 0)], [NAN, 0, NAN, NAN]),
    ("osc-saw", [(0, 8388607.5), (0, -8388607.5), (0, -8388608)], [0, 0, -1]),
    # triangle: 4 x - 1 before half a turn, 3 - 4 x from there on
    ("osc-tri", [(0.5, 0)] * 5, [0, 1, 0, -1, 0]),
    ("osc-tri", [(0, 0.125), (0, 0.75), (0, 0.5 - 2.0**-25), (0, 1)], [-0.5, 0, 1 - 2.0**-23, -1]),
    # sine
    ("osc-wave", [(0, 0), (0, 0.25), (0, 0.75), (0, -0.25)], [0, 1, -1, -1]),
    ("osc-wave", [(0.5, 0), (1.0, 0), (0.5, NAN)], [1, -1, NAN]),
    ("osc-wave", [(NAN, 0), (0, 0)], [NAN, NAN]),
]


def test_the_table_has_everything_design_lists():
    stateless = "+ - * % abs sign min max gt if ifltz interpolate sin cos atan exp log tanh sigmoid"
    listed = f"{stateless} delay integrate differentiate smooth memory osc-wave osc-saw osc-tri".split(" ")
    assert [operation.name for operation in OPERATIONS if not operation.internal] == listed
    tested = {name for name, *_ in STATELESS} | {name for name, *_ in STATEFUL}
    assert tested == set(listed)
    assert all((BY_NAME[name].nstate > 0) == (name in {row[0] for row in STATEFUL}) for name in listed)


def test_opcodes_are_never_renumbered():
    # they are part of every program's hash
    assert [operation.opcode for operation in OPERATIONS] == list(range(1, 30))
    assert [o.name for o in OPERATIONS][:4] + [o.name for o in OPERATIONS][-2:] == ["+", "-", "*", "%", "load", "store"]


def test_the_generated_switch_is_in_step_with_the_table():
    assert PATH.read_text() == runtime_text()


def test_the_manual_lists_the_table():
    rows = [f"| `({' '.join([o.name, *'abc'[: o.arity]])})` | {o.summary} |" for o in OPERATIONS if not o.internal]
    assert "\n".join(["|---|---|", *rows, ""]) in MANUAL.read_text()


def apply(name, rows, run):
    """Run one operation over successive rows of operands, as inputs."""
    operands = ["a", "b", "c"][: len(rows[0])]
    program = lower(parse(f"(list ({name} {' '.join(operands)}))", operands), operands)
    return run(program, 0.5, np.array(rows, np.float32))[:, 0]


def native(program, dt, inputs):
    return NativeProgram(program).run(dt, inputs)


@pytest.mark.parametrize("run", [run_program, native])
@pytest.mark.parametrize(("name", "operands", "expected"), STATELESS)
def test_stateless(programs, run, name, operands, expected):
    result = apply(name, [operands], run)
    assert programs.same(result, [expected]), f"({name} {operands}) = {result}, not {expected}"


@pytest.mark.parametrize("run", [run_program, native])
@pytest.mark.parametrize(("name", "rows", "expected"), STATEFUL)
def test_stateful(programs, run, name, rows, expected):
    result = apply(name, rows, run)
    assert programs.same(result, expected), f"({name} {rows}) = {result}, not {expected}"


@pytest.mark.parametrize(("name", "operands", "expected"), [row for row in STATELESS if np.isfinite(row[1]).all()])
def test_folding_is_the_same(programs, name, operands, expected):
    constants = " ".join(np.format_float_scientific(np.float32(x), unique=True) for x in operands)
    program = lower(parse(f"(list ({name} {constants}))", ()), ())
    assert len(program.instructions) == (0 if np.isfinite(expected) else 1)
    assert programs.same(native(program, 0.5, np.empty((1, 0), np.float32)), [[expected]])


@pytest.mark.parametrize("run", [run_program, native])
def test_every_node_is_evaluated_every_step(run):
    text = "(list (ifltz w (integrate 2) (delay a)) (ifltz w (memory a 1) 0))"
    program = lower(parse(text, ("w", "a")), ("w", "a"))
    rows = np.array([(1, 10), (-1, 20), (-1, 30), (1, 40)], np.float32)
    # the integral grows at the first step too, and the delay sees the steps at which it was not selected
    assert run(program, 0.5, rows).tolist() == [[0, 0], [2, 20], [3, 30], [30, 0]]


@pytest.mark.parametrize("run", [run_program, native])
def test_last_is_the_value_of_the_step_before(run):
    text = "(let ((n (+ (last n) 1)) (m (* n (last k))) (k (+ m a))) (list n (last n) m (last k) (last m)))"
    program = lower(parse(text, ("a",)), ("a",))
    rows = np.array([[2], [3], [4]], np.float32)
    # n = 1 2 3; m = n last(k); k = m + a: 2, 4 + 3 = 7, 21 + 4
    assert run(program, 0.5, rows).tolist() == [[1, 0, 0, 0, 0], [2, 1, 4, 2, 0], [3, 2, 21, 7, 4]]
