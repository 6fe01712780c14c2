"""Profiles of virtual X servos that turn a wheel: the manual's times, read off the bus."""

import itertools

import pytest
from x_wheel import ALL, EXTENDED, TICKS_S, TIME_BASED, Wheel


@pytest.fixture(params=ALL)
def wheel(request, tmp_path):
    return Wheel(request.param, tmp_path)


def test_feedforward_gains_act_on_the_profile(wheel):
    wheel(operating_mode=EXTENDED)
    wheel(position_p_gain=0, position_d_gain=0, feedforward_1st_gain=200, profile_velocity=60)
    wheel.jam()
    wheel(torque_enable=1, goal_position=100_000)
    wheel.wait(0.1)
    assert wheel["present_pwm"] == pytest.approx(200 / 4 * 60 * TICKS_S * 1e-3, abs=2)
    wheel(feedforward_1st_gain=0, feedforward_2nd_gain=16000, profile_acceleration=200, profile_velocity=30000)
    wheel(goal_position=-100_000)
    wheel.wait(0.1)
    acceleration = 200 * 214.577 / 3600 * 4096  # ticks/s2
    assert wheel["present_pwm"] == pytest.approx(-16000 / 4 * acceleration * 1e-6, rel=0.03)
    wheel(torque_enable=0)
    assert wheel["present_pwm"] == 0


def moving_time(wheel, step=2e-3, limit=5.0):
    start = wheel.t
    while wheel["moving_status"] & 2 and wheel.t - start < limit:
        wheel.wait(step)
    return wheel.t - start


PROFILES = {
    "rectangular": (0, 100, 0, 1),
    "trapezoidal": (0, 100, 20, 3),
    "triangular": (0, 400, 20, 2),
    "in time": (TIME_BASED, 900, 200, 3),
    "in time without acceleration": (TIME_BASED, 900, 0, 1),
}


@pytest.mark.parametrize("name", PROFILES)
def test_profiles_take_the_manuals_times(name, tmp_path):
    drive_mode, velocity, acceleration, kind = PROFILES[name]
    wheel = Wheel("xl430-w250", tmp_path)
    wheel(drive_mode=drive_mode)
    here, way = wheel["present_position"], 1000
    wheel(profile_velocity=velocity, profile_acceleration=acceleration, torque_enable=1, goal_position=here + way)
    start = wheel.asked
    assert wheel["moving_status"] >> 4 == kind
    # in ms: t1 = 64 V / A, t2 = 64 way / V, t3 = t1 + t2
    t3 = velocity if drive_mode else 64 * way / velocity + (64 * velocity / acceleration if acceleration else 0)
    if kind == 2:
        t3 = 2e3 * (way / (acceleration * 214.577 / 3600 * 4096)) ** 0.5
    wheel.wait(start + 0.5 * t3 * 1e-3 - wheel.t)
    assert wheel["position_trajectory"] - here == pytest.approx(way / 2, abs=0.02 * way)
    assert wheel["moving"] == 1 and wheel["velocity_trajectory"] > 0
    moving_time(wheel)
    assert (wheel.t - start) * 1e3 == pytest.approx(t3, rel=0.01, abs=6)
    assert (wheel["velocity_trajectory"], wheel["position_trajectory"]) == (0, here + way)
    wheel.wait(0.5)
    assert wheel["moving_status"] & 0x0B == 1, "in position, no profile, no following error"


def test_a_running_profile_keeps_its_own_bounds_and_overrides_smoothly(wheel):
    wheel(operating_mode=EXTENDED)
    here = wheel["present_position"]
    wheel(profile_velocity=100, profile_acceleration=50, torque_enable=1, goal_position=here + 8000)
    wheel.wait(0.5)
    assert wheel["velocity_trajectory"] == pytest.approx(100, abs=1)
    wheel(profile_velocity=40)
    wheel.wait(0.1)
    assert wheel["velocity_trajectory"] == pytest.approx(100, abs=1), "a profile is made when the goal is given"
    wheel(goal_position=here + 8000)
    seen = []
    for _ in range(40):
        seen.append(wheel["velocity_trajectory"])
        wheel.wait(3e-3)
    assert seen[0] == pytest.approx(100, abs=4) and seen[-1] == pytest.approx(40, abs=1)
    assert max(abs(a - b) for a, b in itertools.pairwise(seen)) <= 5, "velocity has no steps"


def test_a_blocked_profile_is_a_following_error(wheel):
    wheel.jam()
    here = wheel["present_position"]
    wheel(profile_velocity=100, torque_enable=1, goal_position=here + 1000)
    wheel.wait(0.5)
    assert wheel["moving_status"] & 0x0A == 0x0A
    wheel.wait(0.5)
    assert wheel["moving_status"] & 0x0B == 0x08
