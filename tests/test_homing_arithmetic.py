"""The arithmetic that decides goals beside the control cycle, against exact fractions and the shipped rigs' own."""

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller import load_rig
from controller.homing import derated, homing_goal, homing_near, homing_periods, homing_speed, speed_inside
from controller.terminals import joint_scale

LAMP = load_rig("lamp-xc330").joints[2]
WHEEL = next(joint for joint in load_rig("jumper-xc330").joints if joint.mode == "velocity")
COUNTS = st.integers(-4096, 8191)


def speed_of(joint, angle, rate):
    """Return the speed that double precision gives: 4 1/s times the distance, limited."""
    away = joint.neutral_rad - angle
    if joint.unlimited:
        away = math.remainder(away, 2.0 * math.pi)
    speed = min(max(4.0 * away, -rate), rate)
    speed = min(max(speed, -joint.speed_rad_s_max), joint.speed_rad_s_max)
    return round(speed / (joint.sign * joint.product.velocity_unit_rad_s))


@given(start=COUNTS, neutral=COUNTS, nmove=st.integers(1, 1 << 23), share=st.floats(0.0, 1.2))
def test_goals_lie_on_the_straight_line_rounded_half_to_even(start, neutral, nmove, share):
    k = int(share * nmove)
    part = min(Fraction(k + 1, nmove), Fraction(1))
    assert homing_goal(start, neutral, k, nmove) == round(start + (neutral - start) * part)


@pytest.mark.parametrize(
    ("start", "neutral", "goals"),
    [(0, 3, [0, 1, 2, 2, 2, 3]), (3, 6, [4, 4, 4, 5, 6, 6]), (1, -2, [0, 0, 0, -1, -2, -2])],
)
def test_a_tie_goes_to_the_even_goal_whatever_the_way(start, neutral, goals):
    assert [homing_goal(start, neutral, k, 6) for k in range(6)] == goals


@given(start=st.integers(0, 4095), neutral=st.integers(0, 4095), rate=st.floats(0.01, 20.0))
def test_a_move_is_no_faster_than_asked_and_no_longer_than_needed(start, neutral, rate):
    step = rate * 0.02
    nmove = homing_periods(LAMP, start, neutral, step)
    travel = abs(start - neutral) * abs(joint_scale(LAMP))
    assert travel / step * (1.0 - 1e-6) <= nmove <= travel / step * (1.0 + 1e-6) + 1


def test_a_move_of_no_distance_ends_at_once():
    assert homing_periods(LAMP, 2048, 2048, 0.01) == 0
    assert homing_goal(2048, 2048, 0, 0) == 2048


@pytest.mark.parametrize("name", ["jumper-xc330"])
@pytest.mark.parametrize("unlimited", [False, True])
def test_speeds_are_those_of_double_precision_at_every_angle_of_shipped_rigs(name, unlimited):
    rig = load_rig(name)
    for joint in rig.joints:
        turned = replace(joint, unlimited=unlimited)
        for count in range(0, 4096, 3):
            angle = (count - joint.zero_tick) * joint_scale(joint)
            wanted = speed_of(turned, angle, rig.safety.homing_rad_s)
            assert homing_speed(turned, count, rig.safety.homing_rad_s) == wanted, (joint.name, count)


@given(count=st.integers(-(1 << 24), 1 << 24))
def test_whole_turns_change_nothing_for_a_joint_that_may_turn_for_ever(count):
    wheel = replace(WHEEL, unlimited=True)
    ticks = wheel.product.ticks_per_turn
    away = math.remainder(wheel.neutral_rad - (count - wheel.zero_tick) % ticks * joint_scale(wheel), 2.0 * math.pi)
    assert homing_near(wheel, count) == (abs(away) <= 0.08)
    if abs(abs(away) - math.pi) > 1e-3:  # half a turn away either way is as short
        near = (count - wheel.zero_tick) % ticks + wheel.zero_tick
        assert homing_speed(wheel, count, 1.0) == homing_speed(wheel, near, 1.0)


@given(count=st.integers(0, 4095), speed=st.integers(-200, 200), age_s=st.floats(0.0, 5.0))
def test_a_speed_is_dropped_where_its_joint_may_have_reached_an_end(count, speed, age_s):
    rate = speed * WHEEL.sign * WHEEL.product.velocity_unit_rad_s
    limited = replace(WHEEL, unlimited=False, low_rad=-1.0, high_rad=1.5)
    end = (count - WHEEL.zero_tick) * joint_scale(WHEEL) + rate * (age_s + 0.02)
    beyond = (rate > 0.0 and end > 1.5) or (rate < 0.0 and end < -1.0)
    if min(abs(end - 1.5), abs(end + 1.0)) > 1e-4:
        assert speed_inside(limited, count, speed, age_s, 0.02) == (0 if beyond else speed)


def test_a_joint_that_was_never_read_is_not_driven_unless_it_may_turn_for_ever():
    limited = replace(WHEEL, unlimited=False, low_rad=-1.0, high_rad=1.5)
    assert speed_inside(limited, WHEEL.zero_tick, 10, math.inf, 0.02) == 0
    wheel = replace(WHEEL, unlimited=True, low_rad=-math.inf, high_rad=math.inf)
    assert speed_inside(wheel, WHEEL.zero_tick, 10, math.inf, 0.02) == 10


@given(ceiling=st.integers(0, 4095), part=st.integers(1, 1000))
def test_a_derated_ceiling_is_the_nearest_count_of_the_part_in_binary32(ceiling, part):
    exact = Fraction(float(np.float32(part / 1000))) * ceiling
    assert abs(derated(ceiling, part / 1000) - exact) <= Fraction(1, 2) + Fraction(1, 4096)
    assert derated(ceiling, 1.0) == ceiling
