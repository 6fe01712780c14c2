"""The X series' profiles: the manual's times, bounds that hold, no steps where the one overrides the other."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deploy.virtual.trajectory import (
    RECTANGULAR,
    STEP,
    TRAPEZOIDAL,
    TRIANGULAR,
    Sample,
    in_time,
    rest,
    to_position,
    to_velocity,
)

REST = Sample(0.0, 0.0, 0.0)
WAYS = st.floats(-20_000, 20_000)
SPEEDS = st.floats(-3000, 3000)
BOUNDS = st.floats(1, 5000)
ACCELERATIONS = st.floats(10, 1e5)


@pytest.mark.parametrize("way", [1000.0, -1000.0])
def test_a_trapezoid_takes_the_manuals_times(way):
    # t1 = V / A, t2 = way / V, t3 = t1 + t2
    plan = to_position(REST, way, 500.0, 2000.0)
    t1, t2 = 500.0 / 2000.0, 1000.0 / 500.0
    assert plan.kind == TRAPEZOIDAL
    assert plan.end_s == pytest.approx(t1 + t2)
    assert plan.at(t1) == pytest.approx((math.copysign(0.5 * 500.0 * t1, way), math.copysign(500.0, way), 0.0))
    assert plan.at(0.5 * plan.end_s).position == pytest.approx(0.5 * way)
    assert plan.at(plan.end_s) == (way, 0.0, 0.0)
    assert plan.at(99.0) == (way, 0.0, 0.0)


def test_a_short_way_is_a_triangle():
    plan = to_position(REST, 100.0, 5000.0, 1000.0)
    assert plan.kind == TRIANGULAR
    assert plan.end_s == pytest.approx(2.0 * math.sqrt(100.0 / 1000.0))
    assert plan.at(0.5 * plan.end_s).velocity == pytest.approx(math.sqrt(100.0 * 1000.0))


def test_without_acceleration_it_is_a_rectangle_and_without_velocity_a_step():
    plan = to_position(REST, -300.0, 100.0, 0.0)
    assert (plan.kind, plan.end_s, plan.at(1.0)) == (RECTANGULAR, 3.0, (-100.0, -100.0, 0.0))
    for plan in (to_position(REST, 7.0, 0.0, 500.0), in_time(REST, 7.0, 0.0, 0.1), rest(7.0)):
        assert (plan.kind, plan.at(0.0)) == (STEP, (7.0, 0.0, 0.0))


@pytest.mark.parametrize(("rise_s", "peak"), [(0.0, 500.0), (0.5, 1000.0 / 1.5), (1.0, 1000.0), (9.0, 1000.0)])
def test_time_based_profiles_take_their_time(rise_s, peak):
    # an acceleration time beyond half of it counts as half of it
    plan = in_time(REST, 1000.0, 2.0, rise_s)
    assert plan.end_s == pytest.approx(2.0)
    assert plan.at(1.0).velocity == pytest.approx(peak)
    assert plan.at(1.0).position == pytest.approx(500.0)


def test_a_velocity_is_reached_in_its_time():
    plan = to_velocity(Sample(3.0, -50.0, 0.0), 100.0, 0.5)
    assert plan.at(0.25).velocity == pytest.approx(25.0)
    assert plan.at(0.5).velocity == plan.at(2.0).velocity == 100.0
    assert to_velocity(REST, 100.0, 0.0).at(0.0).velocity == 100.0


@given(WAYS, SPEEDS, WAYS, BOUNDS, ACCELERATIONS)
def test_any_start_comes_to_rest_at_the_goal_within_bounds(start, speed, goal, velocity_max, acceleration_max):
    plan = to_position(Sample(start, speed, 0.0), goal, velocity_max, acceleration_max)
    first = plan.at(0.0)
    assert first.position == pytest.approx(start) and first.velocity == pytest.approx(speed, abs=1e-6)
    for piece_s, position, velocity, acceleration in plan.pieces:
        assert abs(acceleration) <= acceleration_max * (1 + 1e-9)
        assert abs(velocity) <= max(velocity_max, abs(speed)) * (1 + 1e-9)
        assert 0.0 <= piece_s <= plan.end_s * (1 + 1e-9)
        # the pieces meet
        before = plan.at(piece_s * (1 - 1e-12))
        assert before.position == pytest.approx(position, abs=1e-3)
        assert before.velocity == pytest.approx(velocity, abs=1e-3)
    almost = plan.at(plan.end_s * (1 - 1e-12))
    assert almost.position == pytest.approx(goal, abs=1e-3)
    assert almost.velocity == pytest.approx(0.0, abs=1e-2)
