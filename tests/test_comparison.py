"""The parts of a comparison: errors, hops, the frame of the start, and the replay of goals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller import load_rig
from deploy.logs.comparison import HOP_CLEARANCE_M, count_hops, joint_errors
from deploy.logs.goal_replay import STEP_S, GoalWrites, SampleTimes, Start, replay_goals, tilt, to_start_frame


def test_joint_errors_are_root_mean_squares():
    real = np.radians([[1.0, 5.0], [math.nan, 5.0], [-3.0, 5.0]])
    sim = np.radians([[0.0, 5.0], [50.0, 5.0], [0.0, 5.0]])
    first, second = joint_errors(("p", "q"), np.array([0.1, 0.2, 0.3]), real, sim)
    assert (first.samples, first.max_time_s) == (2, 0.3)
    assert first.rmse_deg == pytest.approx(math.sqrt(5.0))
    assert first.max_deg == pytest.approx(3.0)
    assert (second.samples, second.rmse_deg) == (3, 0.0)


def test_a_joint_that_never_answered_has_no_error():
    (only,) = joint_errors(("p",), np.array([0.1]), np.array([[math.nan]]), np.array([[0.0]]))
    assert only.samples == 0 and math.isnan(only.rmse_deg)


@pytest.mark.parametrize(
    ("clearance_mm", "hops"),
    [
        ([], 0),
        ([0, 9.9, 0], 0),
        ([0, 10, 0], 1),
        ([0, 12, 5, 12, 0], 1),
        ([0, 12, 1, 12, 0], 2),
        ([12], 1),
        ([0, 12, math.nan, 12, 1.9, 30, -1], 2),
    ],
)
def test_hops_are_rises_of_all_feet_ended_by_a_landing(clearance_mm, hops):
    assert count_hops(np.array(clearance_mm) / 1000.0) == hops


@given(st.lists(st.floats(-0.01, 0.1), max_size=60))
def test_hops_do_not_depend_on_how_long_they_last(clearance):
    assert count_hops(np.repeat(clearance, 3)) == count_hops(np.array(clearance))
    assert count_hops(np.array(clearance)) <= sum(value >= HOP_CLEARANCE_M for value in clearance)


@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(-3, 3), st.floats(0, 2), st.floats(-3, 3))
def test_the_frame_of_the_start_undoes_the_start(x, y, heading, distance, bearing):
    there = (
        np.array([x + distance * math.cos(heading + bearing)]),
        np.array([y + distance * math.sin(heading + bearing)]),
    )
    forward, left = to_start_frame(*there, (x, y, heading))
    assert forward[0] == pytest.approx(distance * math.cos(bearing), abs=1e-9)
    assert left[0] == pytest.approx(distance * math.sin(bearing), abs=1e-9)


def test_tilt_is_the_angle_to_the_vertical():
    assert tilt(0.0, 0.3) == pytest.approx(0.3)
    assert tilt(-0.2, 0.0) == pytest.approx(0.2)
    assert tilt(math.pi, 0.0) == pytest.approx(math.pi)
    assert tilt(0.0, 0.0) == 0.0


# the replay


@pytest.fixture(scope="module")
def rig():
    return load_rig("lamp-xc330")


def stand(rig, goals, samples, joint_rad=(0.0, 0.0, 0.0)):
    start = Start(0.0, np.array(joint_rad), None, np.array(joint_rad), None)
    return replay_goals(rig, start, goals, samples)


def at(*times):
    return SampleTimes(np.array(times), np.array(times), np.array(times))


def test_a_body_without_goals_stays_where_it_stood(rig):
    track = stand(rig, GoalWrites(np.empty(0), np.empty((0, 3))), at(0.0, 0.5, 1.0))
    assert np.degrees(np.ptp(track.joint_rad, axis=0)).max() < 0.02
    assert np.ptp(track.position_m, axis=0).max() < 1e-5
    # it carries its own weight: 229 g
    np.testing.assert_allclose(track.force_n, 0.229 * 9.81, rtol=0.02)
    assert np.abs(track.clearance_m).max() < 5e-4


def test_a_goal_acts_from_its_step_on_and_not_before(rig):
    goals = GoalWrites(np.array([0.1005]), np.array([[0.4, 0.0, 0.0]]))
    times = np.arange(0.095, 0.2, STEP_S) + 0.5 * STEP_S
    none = np.empty(0)
    moved = stand(rig, goals, SampleTimes(times, none, none)).joint_rad[:, 0]
    still = stand(rig, GoalWrites(none, np.empty((0, 3))), SampleTimes(times, none, none)).joint_rad[:, 0]
    arrived = times >= 0.1 + STEP_S
    np.testing.assert_array_equal(moved[~arrived], still[~arrived])
    assert np.all(moved[arrived] > still[arrived])


def test_looking_more_often_changes_nothing(rig):
    times = np.arange(0.0, 1.0, 0.02) + 0.0007
    swing = np.stack([0.3 * np.sin(9 * times), 0.5 * np.sin(9 * times + 1), 0.4 * np.sin(9 * times + 2)], axis=1)
    few = stand(rig, GoalWrites(times, swing), at(0.5, 1.0))
    many = stand(rig, GoalWrites(times, swing), at(*np.linspace(0.0, 1.0, 201)))
    np.testing.assert_array_equal(few.joint_rad, many.joint_rad[[100, 200]])
    np.testing.assert_array_equal(few.position_m, many.position_m[[100, 200]])


def test_a_start_that_a_judge_saw_is_taken_as_it_is(rig):
    base = np.array([0.3, -0.2, 0.0135, 0.0, 0.0, 0.7])
    angles = np.array([0.1, -0.1, 0.2])
    start = Start(2.0, angles, np.zeros(3), angles, base)
    track = replay_goals(rig, start, GoalWrites(np.empty(0), np.empty((0, 3))), at(1.5, 2.0))
    np.testing.assert_allclose(track.joint_rad, [[0.1, -0.1, 0.2]] * 2)
    np.testing.assert_allclose(track.position_m, [[0.0, 0.0, 0.0135]] * 2, atol=1e-12)
    np.testing.assert_allclose(track.tilt_rad, 0.0, atol=1e-7)
