"""Modes, gains and limits of virtual X servos that turn a wheel: the manual's numbers, read off the bus."""

import pytest
from x_wheel import (
    ALL,
    CLEAR,
    CURRENT,
    CURRENT_POSITION,
    EXTENDED,
    MEASURES_CURRENT,
    POSITION,
    PWM,
    REVERSE,
    TIME_BASED,
    TORQUE_ON_BY_GOAL,
    VELOCITY,
    Wheel,
)

from deploy.virtual import dynamixel2 as dxl


@pytest.fixture(params=ALL)
def wheel(request, tmp_path):
    return Wheel(request.param, tmp_path)


@pytest.fixture
def xm430(tmp_path):
    return Wheel("xm430-w350", tmp_path)


def test_pwm_mode_sets_the_voltage(wheel):
    wheel(operating_mode=PWM)
    assert wheel["goal_pwm"] == 0, "torque must not run away with it"
    wheel(torque_enable=1, goal_pwm=-442)
    wheel.wait(2.0)
    product = wheel.product
    speed = -(442 / 885 * product.stall_torque_nm - product.friction_loss_nm) / wheel.brake
    assert wheel["present_velocity"] * product.velocity_unit_rad_s == pytest.approx(speed, rel=0.02)
    assert wheel["present_pwm"] == pytest.approx(-442, abs=4)
    assert wheel["moving"] == 1
    assert wheel.error("goal_pwm", 886) == dxl.DATA_LIMIT_ERROR
    wheel(goal_pwm=0)
    wheel.wait(1.0)
    assert (wheel["present_velocity"], wheel["moving"]) == (0, 0)


def test_velocity_mode_follows_its_p_and_i_gain(wheel):
    wheel(operating_mode=VELOCITY)
    wheel(velocity_i_gain=0, torque_enable=1, goal_velocity=100)
    wheel.wait(2.0)
    # duty = P / 128 / 885 a count of error; torque = stall * duty - what speed and friction take
    product = wheel.product
    torque_count = wheel["velocity_p_gain"] / 128 / 885 * product.stall_torque_nm
    per_count = wheel.brake * product.velocity_unit_rad_s
    expected = (torque_count * 100 - product.friction_loss_nm) / (torque_count + per_count)
    assert wheel["present_velocity"] == pytest.approx(expected, rel=0.02, abs=1)
    assert wheel["present_velocity"] < 97
    wheel(velocity_i_gain=2000)
    wheel.wait(3.0)
    assert wheel["present_velocity"] == pytest.approx(100, abs=1), "the integral takes what P leaves"
    assert wheel["velocity_trajectory"] == 100
    limit = wheel["velocity_limit"]
    assert wheel.error("goal_velocity", -limit - 1) == dxl.DATA_LIMIT_ERROR
    wheel(goal_velocity=-100)
    wheel.wait(3.0)
    assert wheel["present_velocity"] == pytest.approx(-100, abs=1)


@pytest.mark.parametrize(("drive_mode", "acceleration"), [(0, 16), (TIME_BASED, 400)])
def test_velocity_mode_ramps_with_the_profiles_acceleration(wheel, drive_mode, acceleration):
    wheel(drive_mode=drive_mode, operating_mode=VELOCITY)
    wheel(profile_acceleration=acceleration, torque_enable=1, goal_velocity=100)
    start = wheel.t
    # t1 = 64 * V / A, or A itself, in ms
    rise_s = 64e-3 * 100 / acceleration if drive_mode == 0 else acceleration * 1e-3
    for share in (0.25, 0.5, 0.75):
        wheel.wait(start + share * rise_s - wheel.t)
        assert wheel["velocity_trajectory"] == pytest.approx(100 * share, abs=2)
        assert wheel["moving"] == 1
    wheel.wait(start + rise_s + 5e-3 - wheel.t)
    assert wheel["velocity_trajectory"] == 100


@pytest.mark.parametrize("product", MEASURES_CURRENT)
def test_current_mode_holds_a_current(product, tmp_path):
    wheel = Wheel(product, tmp_path)
    wheel(operating_mode=CURRENT)
    assert wheel["goal_current"] == 0
    wheel.jam()
    unit_a = 2.69e-3 if product == "xm430-w350" else 1e-3
    for count in (300, -150):
        wheel(torque_enable=1, goal_current=count)
        wheel.wait(0.2)
        assert wheel["present_current"] == pytest.approx(count, rel=0.02)
        share = count * unit_a / wheel.product.stall_current_a
        assert wheel["present_pwm"] == pytest.approx(885 * share, rel=0.02, abs=1), "stalled, voltage makes current"
    limit = wheel["current_limit"]
    assert wheel.error("goal_current", limit + 1) == dxl.DATA_LIMIT_ERROR
    wheel(torque_enable=0)
    wheel(current_limit=200)
    assert wheel.error("goal_current", 201) == dxl.DATA_LIMIT_ERROR


def test_the_xl430_has_no_current_modes(tmp_path):
    wheel = Wheel("xl430-w250", tmp_path)
    for mode in (CURRENT, CURRENT_POSITION, 2, 7):
        assert wheel.error("operating_mode", mode) == dxl.DATA_RANGE_ERROR
    wheel.jam()
    wheel(operating_mode=PWM)
    wheel(torque_enable=1, goal_pwm=300)
    wheel.wait(0.1)
    assert wheel["present_load"] == pytest.approx(1000 * 300 / 885, abs=5)


def test_the_goal_current_bounds_current_based_position_mode(xm430):
    xm430(operating_mode=CURRENT_POSITION)
    assert xm430["goal_current"] == xm430["current_limit"]
    xm430.jam()
    xm430(goal_current=100, torque_enable=1, goal_position=200_000)
    xm430.wait(0.2)
    assert xm430["present_current"] == pytest.approx(100, rel=0.02)
    xm430(goal_current=400)
    xm430.wait(0.2)
    assert xm430["present_current"] == pytest.approx(400, rel=0.02)


def test_position_gains_are_the_manuals(wheel):
    wheel.jam()
    here = wheel["present_position"]
    wheel(position_p_gain=640, position_d_gain=0, torque_enable=1, goal_position=here + 50)
    wheel.wait(0.1)
    assert wheel["present_pwm"] == pytest.approx(640 / 128 * 50, abs=5)
    wheel(goal_pwm=100)
    wheel.wait(0.1)
    assert wheel["present_pwm"] == pytest.approx(100, abs=2), "goal PWM bounds the other modes"
    wheel(goal_pwm=885, position_p_gain=0, position_i_gain=3277)
    wheel.wait(0.01)
    start, before = wheel.t, wheel["present_pwm"]
    wheel.wait(0.2)
    # I / 65536 of the error, summed in steps of 1 ms
    grown = wheel["present_pwm"] - before
    assert grown == pytest.approx(3277 / 65536 * 50 * (wheel.t - start) * 1e3, rel=0.05)


def test_the_position_d_gain_brakes(wheel):
    ends = []
    for gain in (0, 16383):
        wheel(torque_enable=0)
        wheel(position_d_gain=gain, position_p_gain=400, torque_enable=1)
        here = wheel["present_position"]
        wheel(goal_position=here + 300)
        peak = 0
        for _ in range(40):
            wheel.wait(0.01)
            peak = max(peak, wheel["present_velocity"])
        ends.append(peak)
        wheel(goal_position=here)
        wheel.wait(1.0)
    assert ends[1] < 0.7 * ends[0]


def test_extended_position_mode_counts_turns(wheel):
    wheel(operating_mode=EXTENDED)
    wheel(torque_enable=1, goal_position=-10_000, position_i_gain=0)
    wheel.wait(6.0)
    assert wheel["present_position"] == pytest.approx(-10_000, abs=30)
    assert wheel.error("goal_position", 1_048_576) == dxl.DATA_RANGE_ERROR
    wheel(torque_enable=0)
    assert wheel["present_position"] == pytest.approx(-10_000, abs=30), "turns count on without torque"
    before = wheel["present_position"]
    wheel(operating_mode=POSITION)
    assert wheel["present_position"] == before % 4096, "position mode begins within one turn"


def test_clear_forgets_turns_and_nothing_moves(wheel):
    wheel(operating_mode=EXTENDED)
    wheel(torque_enable=1, goal_position=9_000)
    wheel.wait(0.1)
    assert wheel.ask(wheel.servo, dxl.CLEAR, CLEAR)[0][1] == dxl.RESULT_FAIL, "it turns"
    wheel.wait(6.0)
    before, angle = wheel["present_position"], wheel.rig.truth().joint_rad[0]
    assert wheel.ask(wheel.servo, dxl.CLEAR, CLEAR) == [(wheel.servo, 0, b"")]
    assert wheel["present_position"] == before % 4096 == before - 2 * 4096
    assert wheel["goal_position"] == 9_000 - 2 * 4096
    wheel.wait(0.5)
    assert wheel.rig.truth().joint_rad[0] == pytest.approx(angle, abs=1e-3)
    wheel(goal_position=9_000 - 4096)
    wheel.wait(4.0)
    assert abs(wheel.rig.truth().joint_rad[0] - angle) == pytest.approx(2 * 3.14159, rel=0.01)


def test_reverse_mode_turns_the_other_way(wheel):
    raw = wheel["present_position"]
    wheel(drive_mode=REVERSE)
    assert wheel["present_position"] == (-raw) % 4096
    wheel(homing_offset=100)
    assert wheel["present_position"] == (-raw) % 4096 + 100, "the offset's sign stays"
    wheel(homing_offset=0, profile_velocity=100, torque_enable=1)
    before = wheel.rig.truth().joint_rad[0]
    here = wheel["present_position"]
    wheel(goal_position=here + 500)
    wheel.wait(1.5)
    assert wheel["present_position"] == pytest.approx(here + 500, abs=20)
    turned = (wheel.rig.truth().joint_rad[0] - before) * wheel.rig.rig.joints[0].sign
    assert turned == pytest.approx(-500 / 4096 * 2 * 3.14159, rel=0.05)


def test_homing_offsets_beyond_a_quarter_turn_count_in_all_modes_but_position(wheel):
    raw = wheel["present_position"]
    wheel(homing_offset=1025)
    assert wheel["present_position"] == raw
    wheel(operating_mode=EXTENDED)
    assert wheel["present_position"] == raw + 1025
    wheel(homing_offset=-500_000)
    assert wheel["present_position"] == raw - 500_000


def test_another_mode_resets_gains_profile_and_goals(wheel):
    lines = wheel.lines[wheel.servo]
    wheel(position_p_gain=1, velocity_i_gain=2, feedforward_1st_gain=3, profile_velocity=4, profile_acceleration=5)
    wheel(goal_pwm=50, operating_mode=EXTENDED)
    for name in ("position_p_gain", "velocity_i_gain", "feedforward_1st_gain"):
        assert wheel[name] == lines[name].initial, name
    assert (wheel["profile_velocity"], wheel["profile_acceleration"], wheel["goal_pwm"]) == (0, 0, 885)
    assert wheel["goal_position"] == wheel["present_position"]
    wheel(position_p_gain=1)
    wheel(operating_mode=EXTENDED)
    assert wheel["position_p_gain"] == 1, "the same mode is no other"


def test_the_manuals_watchdog_example(wheel):
    wheel(operating_mode=VELOCITY)
    wheel(profile_acceleration=100, torque_enable=1, goal_velocity=50)
    wheel(bus_watchdog=100)
    wheel.wait(1.9)
    assert wheel["present_velocity"] == pytest.approx(50, abs=3)
    wheel.wait(4.0)
    assert (wheel["bus_watchdog"], wheel["goal_velocity"], wheel["profile_acceleration"]) == (255, 0, 0)
    assert abs(wheel["present_velocity"]) <= 1
    assert wheel.error("goal_velocity", 150) == dxl.DATA_RANGE_ERROR
    assert wheel.error("goal_velocity", 5000) == dxl.DATA_RANGE_ERROR, "beyond its limit or not"
    wheel(bus_watchdog=0)
    wheel(goal_velocity=150)
    wheel.wait(2.0)
    assert wheel["present_velocity"] == pytest.approx(150, abs=5)


@pytest.mark.parametrize(
    ("mode", "goal", "value", "other"),
    [
        (POSITION, "goal_position", 2100, "goal_velocity"),
        (VELOCITY, "goal_velocity", 20, "goal_position"),
        (PWM, "goal_pwm", 100, "goal_velocity"),
        (CURRENT, "goal_current", 100, "goal_position"),
        (CURRENT_POSITION, "goal_position", 2100, "goal_velocity"),
    ],
)
def test_the_goal_of_the_mode_switches_torque_on_where_the_drive_mode_says_so(xm430, mode, goal, value, other):
    xm430(drive_mode=TORQUE_ON_BY_GOAL, operating_mode=mode)
    xm430(**{other: 10})
    assert xm430["torque_enable"] == 0
    xm430(**{goal: value})
    assert xm430["torque_enable"] == 1


def test_limits_that_are_written_bring_goals_within(xm430):
    xm430(pwm_limit=300)
    assert (xm430["goal_pwm"], xm430.error("goal_pwm", 301)) == (300, dxl.DATA_LIMIT_ERROR)
    xm430(current_limit=500)
    assert (xm430["goal_current"], xm430.error("goal_current", -501)) == (500, dxl.DATA_LIMIT_ERROR)
    xm430(operating_mode=VELOCITY)
    xm430(goal_velocity=200)
    xm430(velocity_limit=100)
    assert (xm430["goal_velocity"], xm430.error("goal_velocity", 101)) == (100, dxl.DATA_LIMIT_ERROR)


def test_the_moving_threshold_is_a_velocity(wheel):
    wheel(moving_threshold=60, operating_mode=VELOCITY)
    wheel(torque_enable=1, goal_velocity=50)
    wheel.wait(1.5)
    assert wheel["moving"] == 0
    wheel(goal_velocity=80)
    wheel.wait(1.5)
    assert wheel["moving"] == 1
