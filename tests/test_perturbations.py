"""Perturbations: seeded, within their ranges, and refused where no rig could have them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.errors import InputError
from sim_models.perturbations import (
    PerturbationRanges,
    check_ranges,
    draw_perturbations,
    nominal_perturbations,
    take,
)

NAMES = [field.name for field in dataclasses.fields(nominal_perturbations(1, 1))]


def draw(seed, n=200, njoint=3, ranges=None):
    return draw_perturbations(np.random.default_rng(seed), n, njoint, ranges)


def test_the_same_seed_draws_the_same_rigs():
    a, b, c = draw(1), draw(1), draw(2)
    for name in NAMES:
        assert np.array_equal(getattr(a, name), getattr(b, name))
    assert not np.array_equal(a.friction, c.friction)
    assert len(np.unique(a.seed)) == len(a)


@given(st.integers(0, 2**32), st.integers(1, 20), st.integers(1, 6), st.floats(0, 0.99), st.floats(0, 0.1))
def test_draws_stay_within_their_ranges(seed, n, njoint, width, latency):
    ranges = PerturbationRanges(friction=width, mass=width, torque=width, voltage=width, latency_s=latency)
    rows = draw(seed, n, njoint, ranges)
    assert len(rows) == n
    for name in ("friction", "mass", "torque"):
        value = getattr(rows, name)
        assert (value >= 1 - width).all() and (value <= 1 + width).all() and (value > 0).all()
    assert (rows.voltage <= 1).all() and (rows.voltage >= 1 - width).all()
    assert (rows.latency_s >= 0).all() and (rows.latency_s <= latency).all()
    assert rows.torque.shape == rows.encoder_bias_rad.shape == rows.initial_rad.shape == (n, njoint)


def test_spreads_are_used():
    rows, ranges = draw(3, 4000), PerturbationRanges()
    for name in ("friction", "mass", "torque"):
        assert getattr(rows, name).std() == pytest.approx(getattr(ranges, name) / 3**0.5, rel=0.05)
    for name in ("encoder_bias_rad", "initial_rad"):
        assert getattr(rows, name).std() == pytest.approx(getattr(ranges, name), rel=0.05)
    for name in ("pose_noise_m", "angle_noise_rad", "force_noise_n"):
        assert (getattr(rows, name) == getattr(ranges, name)).all()


def test_no_spread_is_the_nominal_rig():
    none = PerturbationRanges(**{field.name: 0.0 for field in dataclasses.fields(PerturbationRanges)})
    rows, nominal = draw(4, 5, 2, none), nominal_perturbations(5, 2)
    for name in set(NAMES) - {"seed"}:
        assert np.array_equal(getattr(rows, name), getattr(nominal, name)), name


def test_rows_are_taken_in_order():
    rows = draw(5)
    some = take(rows, [7, 0, 7])
    for name in NAMES:
        assert np.array_equal(getattr(some, name), getattr(rows, name)[[7, 0, 7]])


@pytest.mark.parametrize(
    ("name", "value"),
    [("friction", 1.0), ("mass", -0.1), ("torque", float("nan")), ("latency_s", float("inf")), ("pose_noise_m", -1.0)],
)
def test_impossible_ranges_are_refused(name, value):
    with pytest.raises(InputError, match=f"perturbation range {name}: .* choose a smaller spread"):
        check_ranges(PerturbationRanges(**{name: value}))
