"""How a virtual STS3215 and SCS0009 move and protect themselves, asked over the line."""

import math

import pytest
from feetech_bench import (
    ACCELERATION,
    CURRENT,
    GOAL,
    LIMIT,
    LOAD,
    MOVING,
    OVERLOAD,
    PRESENT_SPEED,
    SPEED,
    STATUS,
    STS,
    TEMPERATURE,
    TIME,
    TORQUE,
    UNLOAD,
    VOLTAGE,
    place,
    power_cycle,
    scs,
    signed,
    sts,
)

from deploy.virtual import protocol1 as p1
from deploy.virtual.heat import AMBIENT_C, warmed
from tests.motor_bench import low_high

# motion


def test_a_goal_switches_torque_on_and_is_reached():
    bench = sts(1)
    bench.write(1, ACCELERATION, 20)
    bench.write(1, TIME, 0, 0)
    assert bench.read(1, TORQUE) == 0
    bench.write(1, GOAL, *low_high(2500))
    assert bench.read(1, TORQUE) == 1
    bench.wait(2.0)
    assert place(bench) == pytest.approx(2500, abs=12)
    assert bench.read(1, MOVING) == 0


def test_a_goal_beyond_the_limits_stops_there():
    bench = sts(1, max_angle_limit=2300)
    bench.write(1, GOAL, *low_high(3000))
    bench.wait(2.0)
    assert place(bench) == pytest.approx(2300, abs=12)


def way_at(bench, times):
    start, ways = bench.motors[0].ticks(), []
    for before, at in zip((0.0, *times), times, strict=False):
        bench.wait(at - before)
        ways.append(bench.motors[0].ticks() - start)
    return ways


def test_goal_speed_and_acceleration_make_a_trapezoid():
    bench = sts(1, p_coefficient=254)  # a stiff servo is close behind its profile
    # 20 * 100 step/s2 up to 1000 step/s: 0.5 s and 250 steps either way, 0.5 s and 500 steps between
    bench.ask(1, p1.WRITE, bytes([ACCELERATION, 20, *low_high(3048), 0, 0, *low_high(1000)]))
    ways = way_at(bench, (0.5, 1.0, 1.5, 2.0))
    assert ways == pytest.approx([250, 750, 1000, 1000], abs=25)


def test_goal_time_is_what_the_way_takes():
    bench = sts(1)
    bench.ask(1, p1.WRITE, bytes([GOAL, *low_high(3048), *low_high(2000), 0, 0]))
    assert way_at(bench, (0.5, 1.0, 1.9, 2.2)) == pytest.approx([250, 500, 950, 1000], abs=25)
    moving = bench.read(1, MOVING)
    assert moving == 0


def test_a_wheel_turns_at_its_speed_either_way():
    bench = sts(1, operating_mode=1, velocity_p=50)
    bench.write(1, ACCELERATION, 10)
    bench.write(1, TORQUE, 1)
    bench.write(1, SPEED, *low_high(1500))
    bench.wait(0.5)
    ramp = signed(bench.read(1, PRESENT_SPEED, 2))
    assert ramp == pytest.approx(500, rel=0.1)
    bench.wait(1.5)
    assert signed(bench.read(1, PRESENT_SPEED, 2)) == pytest.approx(1500, rel=0.05)
    bench.write(1, SPEED, *low_high(1500 | 1 << 15))
    bench.wait(4.0)
    assert signed(bench.read(1, PRESENT_SPEED, 2)) == pytest.approx(-1500, rel=0.05)
    bench.write(1, TORQUE, 0)
    bench.wait(2.0)
    assert signed(bench.read(1, PRESENT_SPEED, 2)) == 0


@pytest.mark.parametrize("sign_bit", [10, 11])
def test_pwm_is_a_share_of_the_no_load_speed(sign_bit):
    bench = sts(1, operating_mode=2)
    bench.write(1, TORQUE, 1)
    bench.write(1, TIME, *low_high(500))
    bench.wait(2.0)
    full = STS.no_load_speed_rad_s * 4096 / (2 * math.pi)
    friction = STS.friction_loss_nm / STS.stall_torque_nm
    assert signed(bench.read(1, PRESENT_SPEED, 2)) == pytest.approx((0.5 - friction) * full, rel=0.02)
    assert signed(bench.read(1, LOAD, 2), 10) == 500
    bench.write(1, TIME, *low_high(500 | 1 << sign_bit))
    bench.wait(2.0)
    assert signed(bench.read(1, LOAD, 2), 10) == -500
    bench.write(1, LIMIT, *low_high(200))
    bench.wait(0.1)
    assert signed(bench.read(1, LOAD, 2), 10) == -200


def test_steps_add_up():
    bench = sts(1, operating_mode=3, min_angle_limit=0, max_angle_limit=0)
    for steps in (1000, 1000, 500 | 1 << 15):
        bench.write(1, GOAL, *low_high(steps))
        bench.wait(2.0)
    assert bench.motors[0].ticks() == pytest.approx(2048 + 1500, abs=12)


def test_damping_brakes_and_off_does_not():
    ways = []
    for torque in (0, 2):
        bench = sts(1)
        bench.write(1, TORQUE, torque)
        bench.motors[0].omega = 3.0
        bench.wait(0.5)
        ways.append(bench.motors[0].ticks() - 2048)
    assert ways[1] < 0.5 * ways[0]


# protection


def stall(bench, *goal):
    bench.motors[0].stuck = True
    bench.write(1, GOAL, *(goal or low_high(4000)))


def test_a_stall_is_an_overload_after_the_protection_time():
    bench = sts(1)
    stall(bench)
    bench.wait(1.9)
    assert bench.ask(1, p1.PING) == [(1, 0, b"")]
    assert signed(bench.read(1, LOAD, 2), 10) == 1000
    assert signed(bench.read(1, CURRENT, 2)) == round(STS.stall_current_a / 6.5e-3)
    bench.wait(0.2)
    assert bench.ask(1, p1.PING) == [(1, OVERLOAD, b"")]
    assert (bench.read(1, STATUS), bench.read(1, TORQUE)) == (OVERLOAD, 1)
    assert signed(bench.read(1, LOAD, 2), 10) == 200  # the protective torque
    # pushing on changes nothing, going back does
    assert bench.write(1, GOAL, *low_high(3900)) == OVERLOAD
    assert bench.write(1, GOAL, *low_high(1000)) == 0
    assert signed(bench.read(1, LOAD, 2), 10) == -1000


def test_protection_follows_its_registers():
    bench = sts(1, protection_time=50, protective_torque=50, overload_torque=30)
    bench.write(1, LIMIT, *low_high(400))
    stall(bench)
    bench.wait(0.6)
    assert signed(bench.read(1, LOAD, 2), 10) == 400
    assert bench.read(1, STATUS) == OVERLOAD
    bench.write(1, UNLOAD, 0)
    assert bench.write(1, TORQUE, 0) == 0


def test_an_scs_goes_on_with_the_next_goal():
    bench = scs(protection_time=10)
    stall(bench, 3, 0xE0)
    bench.wait(0.5)
    assert bench.read(1, STATUS) == OVERLOAD
    assert bench.write(1, GOAL, 3, 0xE1) == 0


@pytest.mark.parametrize(("volts", "error"), [(9.2, 1), (4.3, 1), (6.0, 0)])
def test_an_scs_lets_go_at_the_wrong_voltage(volts, error):
    bench = scs()
    bench.write(1, TORQUE, 1)
    bench.motors[0].volts = volts
    bench.wait(0.1)
    assert bench.ask(1, p1.PING) == [(1, error, b"")]
    assert bench.read(1, TORQUE) == 1 - error


def test_an_sts_reports_the_wrong_voltage_and_holds():
    bench = sts(1)
    bench.write(1, TORQUE, 1)
    bench.motors[0].volts = 3.5
    bench.wait(0.1)
    assert (bench.read(1, STATUS), bench.read(1, TORQUE), bench.read(1, VOLTAGE)) == (1, 1, 35)
    bench.motors[0].volts = 12.0
    assert bench.ask(1, p1.PING) == [(1, 0, b"")]


def test_heat_and_current_take_the_torque():
    bench = sts(1, overload_torque=100, protection_time=254, protection_current=100, overcurrent_time=10)
    stall(bench)
    bench.wait(0.2)
    assert (bench.read(1, STATUS), bench.read(1, TORQUE)) == (0x08, 0)
    bench = sts(1, max_temperature_limit=29, unloading_condition=0x04)
    stall(bench)
    while bench.read(1, TORQUE) and bench.now_ns < 20e9:
        bench.wait(0.01)
    assert (bench.read(1, TEMPERATURE), bench.read(1, STATUS), bench.read(1, TORQUE)) == (29, 0x04 | OVERLOAD, 0)


def test_a_load_warms_as_measured():
    # 1 kg at 15 cm for 10 minutes: 48 degC (SO-ARM100, issue 134)
    temperature = AMBIENT_C
    for _ in range(600):
        temperature = warmed(STS, temperature, 1.0 * 9.81 * 0.15, 1.0)
    assert temperature == pytest.approx(48, abs=1)


def test_the_torque_limit_is_the_max_torque_at_power_up():
    bench = sts(1, max_torque=500)
    assert bench.read(1, LIMIT, 2) == 500
    bench.write(1, LIMIT, *low_high(300))
    power_cycle(bench)
    assert bench.read(1, LIMIT, 2) == 500
