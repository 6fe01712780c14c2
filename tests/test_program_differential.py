"""The compiled virtual machine against the slow reference: the same bits, all NaNs being equal."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controller.controller_file import parse_controller
from controller.lowering import lower
from controller.native import NativeProgram
from controller.operations import OPERATIONS
from controller.reference import run_program
from controller.source import Apply, Name, Source

CASES = 100_000


@settings(max_examples=300)
@given(st.data())
def test_random_programs_over_sequences(programs, data):
    program = lower(data.draw(programs.sources()), programs.terminals)
    rows = data.draw(programs.rows(len(programs.terminals)))
    period = data.draw(st.sampled_from([0.02, 0.005, 1.0, 0.01]))
    machine = NativeProgram(program)
    expected = run_program(program, period, rows)
    assert programs.same(machine.run(period, rows), expected)
    # a second run starts from the start
    assert programs.same(machine.run(period, rows), expected)


@pytest.mark.parametrize("block", range(8))
def test_large_random_programs_over_sequences(programs, block):
    seen = set()
    for seed in range(block * 40, block * 40 + 40):
        rng = np.random.default_rng(seed)
        program = lower(programs.large_source(rng), programs.terminals)
        seen |= set(program.instructions["op"].tolist())
        rows = programs.any_floats(rng, (30, len(programs.terminals)))
        assert programs.same(NativeProgram(program).run(0.02, rows), run_program(program, 0.02, rows)), f"seed {seed}"
    assert seen == {operation.opcode for operation in OPERATIONS}


def test_figure_7_on_100000_inputs(programs, figure_7_text):
    program = parse_controller(figure_7_text, "figure-7").program
    rows = programs.any_floats(np.random.default_rng(1995), (CASES, len(program.inputs)))
    assert np.isnan(rows).any() and np.isinf(rows).any() and (rows.view(np.uint32) == 0x80000000).any()
    expected = run_program(program, 0.02, rows)
    assert programs.same(NativeProgram(program).run(0.02, rows), expected)
    # the inputs do reach the outputs
    assert len(np.unique(expected[np.isfinite(expected)])) > CASES // 10


@pytest.mark.parametrize("operation", [o for o in OPERATIONS if not o.internal], ids=lambda o: o.name)
def test_each_operation_on_every_pair_of_edges(programs, operation):
    terminals = tuple("abc"[: operation.arity])
    program = lower(Source((Apply(operation.name, tuple(map(Name, terminals))),)), terminals)
    grids = np.meshgrid(*[programs.edges] * min(operation.arity, 2), indexing="ij")
    rows = np.stack([grid.ravel() for grid in grids], axis=1)
    rng = np.random.default_rng(7)
    if operation.arity == 3:
        rows = np.hstack([rows, rng.choice(programs.edges, (len(rows), 1))])
    # in random order, so that what state an operation has varies, and with other values in between
    rows = np.vstack([rows, programs.any_floats(rng, (3000, operation.arity))])
    rows = rng.permutation(rows).astype(np.float32)
    assert programs.same(NativeProgram(program).run(0.02, rows), run_program(program, 0.02, rows))
    for start in range(0, len(rows), 7):
        chunk = rows[start : start + 7]
        assert programs.same(NativeProgram(program).run(0.02, chunk), run_program(program, 0.02, chunk))
