"""The float32 mathematics: C against Python bit for bit, both against double precision, and the written contract."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

from controller import float_math
from controller.measure_math import FUNCTIONS, apply, measure

ROOT = Path(__file__).parents[1]

REFERENCE = {
    "sin": float_math.sin,
    "cos": float_math.cos,
    "atan": float_math.atan,
    "exp": float_math.exp,
    "log": float_math.log,
    "tanh": float_math.tanh,
    "sigmoid": float_math.sigmoid,
}

INF = np.float32(np.inf)
FLOAT_MAX = np.finfo(np.float32).max
SMALLEST = np.float32(2.0**-149)


def f(value):
    return np.float32(value)


def around(*values):
    """Each value, its two neighbours, and their negatives."""
    found = []
    for value in values:
        x = f(value)
        with np.errstate(over="ignore"):
            found += [np.nextafter(x, -INF), x, np.nextafter(x, INF)]
    return np.array([*found, *[-x for x in found]], np.float32)


EDGES = np.concatenate(
    [
        np.array([0.0, -0.0, np.nan, np.inf, -np.inf], np.float32),
        np.array([0x7F800001, 0xFFC12345], np.uint32).view(np.float32),  # a signalling and a negative NaN
        around(2.0**-149, 2.0**-126, FLOAT_MAX, 2.0**-12, 0.625, 1.0, 8192.0, 88.7228317, 103.972084, 87.3365),
        around(9.0, 9.01, 10.0, math.sqrt(0.5), math.sqrt(2.0), math.log(2.0) / 2),
        around(*[k * math.pi / 4 for k in range(1, 30)], *[k * math.pi / 2 for k in (5214, 5215)]),
    ]
)


def assert_same_bits(found, expected, x):
    different = found.view(np.uint32) != expected.view(np.uint32)
    different &= ~(np.isnan(found) & np.isnan(expected))
    assert not different.any(), f"{different.sum()} differ, as at {x[different][:3]}"


def recorded():
    rows = {}
    for line in (ROOT / "docs" / "float_math.md").read_text().splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if cells[0] in FUNCTIONS:
            rows[cells[0]] = cells
    return rows


@pytest.mark.parametrize("name", FUNCTIONS)
def test_c_and_python_agree_bit_for_bit(name):
    rng = np.random.default_rng(1)
    bits = rng.integers(0, 2**32, 12_000, dtype=np.uint32).view(np.float32)
    usual = rng.uniform(-10.0, 10.0, 6_000).astype(np.float32)
    wide = rng.uniform(-9_000.0, 9_000.0, 6_000).astype(np.float32)
    x = np.concatenate([EDGES, bits, usual, wide])
    expected = np.array([REFERENCE[name](value) for value in x], np.float32)
    assert_same_bits(apply(name, x), expected, x)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_recorded_error_holds_on_a_sample(name):
    cells = recorded()[name]
    largest, worst = float(cells[1]), int(cells[3], 16)
    at_worst = measure(name, np.array([worst], np.uint32))
    assert at_worst.ulp == pytest.approx(largest, abs=2e-4)
    sample = measure(name, np.arange(0, 1 << 32, 4099, dtype=np.uint64).astype(np.uint32))
    assert sample.ulp <= largest + 1e-4
    assert sample.absolute <= float(cells[4]) * 1.001
    assert sample.wrong_nan == 0
    assert largest < 2.5


def test_the_recorded_page_names_every_function():
    assert list(recorded()) == list(FUNCTIONS)


CONTRACT = [
    ("sin", 8192.0, math.sin(8192.0)),
    ("sin", np.nextafter(f(8192.0), INF), 0.0),
    ("sin", -1e30, 0.0),
    ("sin", np.inf, 0.0),
    ("sin", 0.0, 0.0),
    ("cos", -8192.0, math.cos(8192.0)),
    ("cos", np.nextafter(f(8192.0), INF), 1.0),
    ("cos", -np.inf, 1.0),
    ("cos", 0.0, 1.0),
    ("atan", np.inf, math.pi / 2),
    ("atan", -np.inf, -math.pi / 2),
    ("exp", 0.0, 1.0),
    ("exp", 1.0, math.e),
    ("exp", 89.0, FLOAT_MAX),
    ("exp", np.inf, FLOAT_MAX),
    ("exp", -np.inf, 0.0),
    ("exp", -104.0, 0.0),
    ("exp", -103.0, 2.0**-149),
    ("log", 0.0, 0.0),
    ("log", -0.0, 0.0),
    ("log", -3.0, 0.0),
    ("log", -np.inf, 0.0),
    ("log", 1.0, 0.0),
    ("log", np.inf, np.inf),
    ("log", SMALLEST, -149 * math.log(2.0)),
    ("tanh", 20.0, 1.0),
    ("tanh", -np.inf, -1.0),
    ("tanh", SMALLEST, SMALLEST),
    ("sigmoid", 0.0, 0.5),
    ("sigmoid", np.inf, 1.0),
    ("sigmoid", -np.inf, 0.0),
    ("sigmoid", -104.0, 0.0),
]


@pytest.mark.parametrize(("name", "x", "expected"), CONTRACT)
def test_the_ends_are_as_written(name, x, expected):
    result = apply(name, np.array([x], np.float32))[0]
    assert result == f(expected)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_nan_gives_nan(name):
    assert np.isnan(apply(name, EDGES[np.isnan(EDGES)])).all()


@pytest.mark.parametrize("name", ["sin", "atan", "tanh"])
def test_odd_functions_are_odd_to_the_last_bit(name):
    x = np.concatenate([EDGES, np.linspace(0.0, 50.0, 20_000, dtype=np.float32)])
    x = x[np.isfinite(x) & ((np.abs(x) <= 8192.0) | (name != "sin"))]
    assert_same_bits(apply(name, -x), -apply(name, x), x)


@pytest.mark.parametrize("name", ["atan", "exp", "log", "tanh", "sigmoid"])
def test_monotone_over_coarse_steps(name):
    x = np.linspace(1e-3 if name == "log" else -95.0, 95.0, 50_000, dtype=np.float32)
    assert (np.diff(apply(name, x)) >= 0).all()


def test_the_c_text_does_one_operation_a_statement():
    text = (ROOT / "controller" / "runtime" / "sv_math.h").read_text()
    code = re.sub(r"//[^\n]*|#[^\n]*|sv_pow2\([^)]*\)", "", text)  # the argument of sv_pow2 is an integer
    statements = [s for s in re.split(r"[;{}]", code) if "=" in s and "uint32_t)" not in s]
    assert len(statements) > 100
    for statement in statements:
        assert len(re.findall(r" [-+*/] ", statement)) <= 1, statement
