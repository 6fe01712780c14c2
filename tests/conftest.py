"""Shared by all tests: deterministic hypothesis, random programs, figure 7's controller."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from served_rig import serve

from controller import Controller, Input, Output, lower
from controller.operations import OPERATIONS
from controller.source import Apply, Constant, Last, Name, Source

settings.register_profile("servolve", derandomize=True, deadline=None)
settings.load_profile("servolve")

STEPS_SHORT, STEPS_LONG = 600, 10_000


def pytest_addoption(parser):
    group = parser.getgroup("servolve")
    group.addoption("--long", action="store_true", help="random tests at full length")
    group.addoption("--fuzz-seconds", type=float, default=0.0, help="mutate bytes for so long; left out: a short form")


@pytest.fixture(scope="session")
def machine_steps(request):
    """Return how many steps a random master takes."""
    return STEPS_LONG if request.config.getoption("--long") else STEPS_SHORT


@pytest.fixture
def serve_rig(tmp_path):
    """Return a function that serves a rig from another process: see `served_rig.serve`."""
    processes = []

    def start(rig, *arguments):
        processes.append(serve(tmp_path, rig, *arguments))
        return processes[-1]

    yield start
    for process in processes:
        process.kill()


TERMINALS = ("t", "a0", "a1", "px")
DEFINITIONS = ("n0", "n1", "n2")
NODES_MAX = 150

# where float32 arithmetic is at its edges: zeros, subnormals, ties, saturation, NaN
EDGES = np.array(
    [
        0,
        -0.0,
        1,
        -1,
        0.5,
        1e-45,
        -1e-45,
        1.17549435e-38,
        3.4028235e38,
        -3.4028235e38,
        np.inf,
        -np.inf,
        np.nan,
        16777216,
        8388608.5,
        8192,
        8193,
        -0.015,
        88.8,
        -104,
        1.5707964,
        1e-10,
        -1e-10,
        2147483648,
        1e30,
    ],
    np.float32,
)
WORDS = st.one_of(st.sampled_from(EDGES.view(np.uint32).tolist()), st.integers(0, 2**32 - 1))
FINITE = WORDS.filter(lambda word: word & 0x7F800000 != 0x7F800000)
MODERATE = st.floats(-40, 40, width=32).map(lambda x: int(np.float32(x).view(np.uint32)))


def to_float32(word):
    return np.uint32(word).view(np.float32)


def build_source(index, word, noperation):
    """Build a source over every operation of the program text, `let` and `last` included.

    Args:
        index: n => an integer below n, chosen
        word: () => bits of a finite float, chosen
        noperation: operations of each definition and output
    """
    defined = DEFINITIONS[: index(len(DEFINITIONS) + 1)]
    operations = [operation for operation in OPERATIONS if not operation.internal]

    def leaf(names):
        kind = index(8)
        if kind < 2:
            return Constant(to_float32(word()))
        if kind == 2 and defined:
            return Last(defined[index(len(defined))])
        return Name(names[index(len(names))])

    def grow(names):
        # from the leaves up; sizes bound what repeated use could double
        pool = [(leaf(names), 1)]
        for _ in range(noperation):
            operation = operations[index(len(operations))]
            operands = [
                pool[-1 - index(min(3, len(pool)))] if index(3) else (leaf(names), 1) for _ in range(operation.arity)
            ]
            size = 1 + sum(n for _, n in operands)
            if size <= NODES_MAX:
                pool.append((Apply(operation.name, tuple(expression for expression, _ in operands)), size))
        return pool[-1][0]

    definitions = tuple((name, grow((*TERMINALS, *defined[:i]))) for i, name in enumerate(defined))
    outputs = tuple(grow((*TERMINALS, *defined)) for _ in range(1 + index(3)))
    return Source(outputs, definitions)


@st.composite
def sources(draw):
    """Draw a source that hypothesis can shrink."""
    constant = st.one_of(MODERATE, FINITE)
    noperation = draw(st.sampled_from([1, 2, 3, 5, 8, 12]))
    return build_source(lambda n: draw(st.integers(0, n - 1)), lambda: draw(constant), noperation)


def large_source(rng):
    """Draw a source of some hundred nodes."""

    def word():
        value = np.float32(rng.uniform(-40, 40)) if rng.integers(2) else rng.choice(EDGES[np.isfinite(EDGES)])
        return int(value.view(np.uint32))

    return build_source(lambda n: int(rng.integers(n)), word, int(rng.integers(10, 60)))


def random_controller(seed, reach=4.0):
    """Return a controller of a large program.

    Args:
        seed: of the program
        reach: every terminal is between -reach and reach
    """
    source = large_source(np.random.default_rng(seed))
    return Controller(
        name=f"random{seed}",
        period_s=0.02,
        inputs=tuple(Input(terminal, "1", -reach, reach) for terminal in TERMINALS),
        outputs=tuple(Output(f"j{i}", "position", "deg", -50.0, 50.0, 1.5) for i in range(len(source.outputs))),
        source=source,
        program=lower(source, TERMINALS),
    )


def any_floats(rng, shape):
    """Draw floats of every kind: any bits, edges, moderate values, subnormals."""
    words = rng.integers(0, 2**32, shape, dtype=np.uint32)
    kind = rng.integers(0, 6, shape)
    values = np.where(kind == 1, rng.choice(EDGES, shape), words.view(np.float32))
    values = np.where(kind == 2, (words & np.uint32(0x807FFFFF)).view(np.float32), values)
    return np.where(kind >= 3, rng.uniform(-40, 40, shape).astype(np.float32), values)


def rows(ninput, steps_max=12):
    """Draw terminals at successive steps, of any bit pattern."""
    row = st.lists(st.one_of(MODERATE, WORDS), min_size=ninput, max_size=ninput)
    table = st.lists(row, min_size=1, max_size=steps_max)
    return table.map(lambda words: np.array(words, np.uint32).reshape(-1, ninput).view(np.float32))


def same(a, b):
    """Return whether two float32 arrays hold the same bits, all NaNs being equal."""
    a, b = np.asarray(a, np.float32), np.asarray(b, np.float32)
    return a.shape == b.shape and bool(np.all((a.view(np.uint32) == b.view(np.uint32)) | (np.isnan(a) & np.isnan(b))))


class Programs:
    """Give tests the strategies for random programs and how to compare what they compute."""

    terminals = TERMINALS
    edges = EDGES
    sources = staticmethod(sources)
    rows = staticmethod(rows)
    large_source = staticmethod(large_source)
    random_controller = staticmethod(random_controller)
    any_floats = staticmethod(any_floats)
    same = staticmethod(same)


@pytest.fixture(scope="session")
def programs():
    return Programs


FIGURE_7 = """(list
  (- (ifltz a0 pz a2) (% a1 t))
  (ifltz (- (- (ifltz a0 pz a2) (% a1 t)) (ifltz (+ a2 15.4963) (ifltz a0 pz a2) (% a1 a2)))
         (ifltz (% (- s0 vx) (+ a2 s0)) (% (- s0 vx) (+ a2 s0)) (+ (- a1 a1) (- a1 t)))
         (% (+ a1 vz) (ifltz (* pz a1) (% a0 pz) (% px a0))))
  (- (ifltz s0 (ifltz (- (% vx a0) (% vx vx)) (- (% vx a0) (- (+ -28.4382 t) (% a1 t))) (* 16.5266 s0)) vz) (+ a1 vz)))
"""
FIGURE_7_UNITS = {"t": "s", "a0": "rad", "a1": "rad", "a2": "rad", "s0": "N"} | {
    name: unit for unit, names in {"m": ("px", "py", "pz"), "m/s": ("vx", "vy", "vz")}.items() for name in names
}


@pytest.fixture(scope="session")
def figure_7_text():
    """Return the controller printed in figure 7 of Gritz & Hahn 1995, as a hand-written controller file."""
    inputs = "".join(
        f'\n[[input]]\nname = "{name}"\nunit = "{unit}"\nlow = -10\nhigh = 10\n'
        for name, unit in FIGURE_7_UNITS.items()
    )
    outputs = "".join(
        f'\n[[output]]\nname = "{name}"\nkind = "position"\nunit = "deg"\nlow = -60\nhigh = 60\nneutral = 0\n'
        for name in ("a0", "a1", "a2")
    )
    return f'program = """\n{FIGURE_7}"""\n\n[controller]\nname = "figure-7"\nperiod_s = 0.02\n{inputs}{outputs}'
