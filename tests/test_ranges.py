"""Intervals of what programs can give, against what the reference gives."""

import math

import numpy as np
import pytest
from conftest import EDGES, TERMINALS, large_source
from hypothesis import given, settings
from hypothesis import strategies as st

from controller import Controller, Input, Output, load_controller, lower, parse
from controller.operations import BY_NAME, BY_OPCODE, OPERATIONS
from controller.reference import run_program
from firmware_gen.bounds.intervals import STATELESS, Interval
from firmware_gen.bounds.ranges import program_ranges

F = np.float32
STATELESS_NAMES = [operation.name for operation in OPERATIONS if operation.nstate == 0]


def make(text, ranges):
    source = parse(text, list(ranges))
    return from_source(source, ranges)


def from_source(source, ranges):
    return Controller(
        name="made",
        period_s=0.02,
        inputs=tuple(Input(name, "1", low, high) for name, (low, high) in ranges.items()),
        outputs=tuple(Output(f"j{i}", "position", "deg", -50.0, 50.0, 1.5) for i in range(len(source.outputs))),
        source=source,
        program=lower(source, list(ranges)),
    )


def outputs_of(text, **ranges):
    return program_ranges(make(text, ranges)).outputs


ANY = st.one_of(st.sampled_from(EDGES.tolist()), st.floats(width=32), st.floats(-40, 40, width=32))
PAIRS = st.tuples(ANY, ANY)


@st.composite
def members(draw):
    """An interval, and a value in it."""
    pair = draw(PAIRS.filter(lambda pair: not any(map(math.isnan, pair))))
    a, b = sorted(pair, key=lambda x: (x, math.copysign(1, x)))
    value = draw(st.one_of(st.sampled_from([a, b]), st.floats(a, b, width=32)))
    nan = draw(st.booleans())
    return Interval(a, b, nan), (math.nan if nan and draw(st.booleans()) else value)


@settings(max_examples=3000)
@given(st.sampled_from(STATELESS_NAMES), st.lists(members(), min_size=3, max_size=3))
def test_an_operation_stays_in_its_interval(name, drawn):
    operation = BY_NAME[name]
    drawn = drawn[: operation.arity]
    with np.errstate(all="ignore"):
        value = float(operation.reference(*[F(member) for _, member in drawn]))
        interval = STATELESS[name](*[interval for interval, _ in drawn])
    assert interval.holds(value), (name, drawn, value, interval)


@pytest.mark.parametrize("seed", range(12))
def test_programs_stay_in_their_intervals_over_many_steps(seed):
    rng = np.random.default_rng(seed)
    ranges = {name: tuple(sorted(rng.uniform(-4, 4, 2))) for name in TERMINALS}
    controller = from_source(large_source(rng), ranges)
    found = program_ranges(controller)
    low, high = (np.array([F(r[i]) for r in ranges.values()], F) for i in (0, 1))
    # all over the ranges, then mostly at their upper ends, where integrals grow
    for part in (rng.uniform(0, 1, (300, len(ranges))), (rng.uniform(0, 1, (300, len(ranges))) > 0.1).astype(float)):
        rows = np.clip((low + (high - low) * part).astype(F), low, high)
        outputs = run_program(controller.program, controller.period_s, rows)
        for interval, column in zip(found.outputs, outputs.T, strict=True):
            assert all(interval.holds(float(value)) for value in column), interval


def test_most_random_programs_have_bounds():
    ranges = dict.fromkeys(TERMINALS, (-2.0, 2.0))
    made = [from_source(large_source(np.random.default_rng(seed)), ranges) for seed in range(40)]
    intervals = [interval for controller in made for interval in program_ranges(controller).outputs]
    assert sum(not interval.infinite and not interval.nan for interval in intervals) > len(intervals) / 3


def test_intervals_by_hand():
    assert outputs_of("(list (+ (* 2 a) 1))", a=(-1, 3)) == (Interval(-1.0, 7.0),)
    assert outputs_of("(list (% 1 a))", a=(0.5, 4)) == (Interval(0.25, 2.0),)
    assert outputs_of("(list (min 3 (max -3 (* a a))))", a=(-9, 9)) == (Interval(-3.0, 3.0),)
    assert outputs_of("(list (ifltz a 1 2) (ifltz (- a 7) 1 2))", a=(-1, 3)) == (Interval(1.0, 2.0), Interval(1.0, 1.0))
    assert outputs_of("(list (sin (* 9 a)) (osc-tri a a))", a=(-1, 3)) == (Interval(-1.0, 1.0), Interval(-1.0, 1.0))


def test_memory_is_bounded_where_it_can_be():
    delayed, kept, turned, smoothed = outputs_of(
        "(list (delay a) (memory a b) (tanh (integrate a)) (smooth a 0.3))", a=(-2, 3), b=(-1, 1)
    )
    assert delayed == kept == Interval(-2.0, 3.0)
    assert turned == Interval(-1.0, 1.0)
    assert -2.0001 < smoothed.low <= -2 and 3 <= smoothed.high < 3.0001 and not smoothed.nan
    recurrent = "(let ((n (tanh (+ a (* 1.5 (last n)))))) (list (* 30 n)))"
    (network,) = outputs_of(recurrent, a=(-1, 1))
    assert -30 <= network.low < -29 and 29 < network.high <= 30 and not network.nan


def test_an_integral_grows_until_float32_can_add_no_more():
    (total,) = outputs_of("(list (integrate a))", a=(0, 1))
    assert total.low == 0 and 0.02 * 2**23 < total.high < math.inf and not total.nan
    (nothing,) = outputs_of("(list (integrate a))", a=(0, 0))
    assert nothing == Interval(0.0, 0.0)
    (doubled,) = outputs_of("(let ((n (+ a (* 2 (last n))))) (list n))", a=(0, 1))
    assert doubled.high == math.inf and doubled.low == 0 and not doubled.nan


def test_sources_of_infinity_and_nan():
    controller = make("(list (- (% 1 a) (% 1 b)) (sin a) (* a b))", {"a": (-1, 1), "b": (-1, 1)})
    found = program_ranges(controller)
    operations = [BY_OPCODE[op].name for op in controller.program.instructions["op"].tolist()]
    names = [(operations[source.instruction], source.infinite, source.nan) for source in found.sources]
    assert names == [("%", True, False), ("%", True, False), ("-", False, True)]
    assert found.outputs[0] == Interval(-math.inf, math.inf, True)
    assert not found.outputs[1].nan and not found.outputs[2].infinite
    safe = make("(list (% 1 a))", {"a": (0.1, 1)})
    assert program_ranges(safe).sources == ()


def test_a_lamp_on_its_ranges(request):
    controller = load_controller(request.config.rootpath / "tests" / "golden" / "lamp-hop.controller.toml")
    found = program_ranges(controller)
    assert found.sources == ()
    rows = np.random.default_rng(1).uniform(-1, 1, (400, 1)).astype(F)
    outputs = run_program(controller.program, controller.period_s, rows)
    for interval, column in zip(found.outputs, outputs.T, strict=True):
        assert interval.low <= column.min() and column.max() <= interval.high
        assert interval.high - interval.low < 4 * (column.max() - column.min())
