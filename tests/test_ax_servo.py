"""What a virtual AX-12A does, asked over the line: errors as bits, joint and wheel, compliance, shutdown, lock."""

import math

import pytest

from controller.products import PRODUCTS
from deploy.virtual import protocol1 as p1
from tests.motor_bench import Bench, low_high

AX = PRODUCTS["ax-12a"]
# addresses: e-Manual, docs/en/dxl/ax/ax-12a.md
ID, BAUD, DELAY, CW, CCW, MAX_TORQUE, LEVEL, SHUTDOWN = 3, 4, 5, 6, 8, 14, 16, 18
TORQUE, LED, CW_MARGIN, CCW_MARGIN, CW_SLOPE, CCW_SLOPE, GOAL, SPEED, LIMIT = 24, 25, 26, 27, 28, 29, 30, 32, 34
PRESENT, PRESENT_SPEED, LOAD, VOLTAGE, TEMPERATURE, REGISTERED, MOVING, LOCK, PUNCH = 36, 38, 40, 42, 43, 44, 46, 47, 48
VOLTAGE_BIT, ANGLE, HEAT, RANGE, CHECKSUM, OVERLOAD, INSTRUCTION = (1 << bit for bit in range(7))


def ax(*ids, ticks=512.0, **eeprom):
    return Bench(*((AX, {"id": i, "return_delay_time": 0, **eeprom}, ticks) for i in ids or (1,)))


def signed(word):
    return -(word & 0x3FF) if word >> 10 & 1 else word & 0x3FF


def power_cycle(bench):
    for servo in bench.servos:
        servo.power_off()
        servo.reboot(bench.now_ns)
    bench.wait(0.5)


# packets


def test_the_manuals_exchanges_byte_for_byte():
    bench = ax(1)
    for asked, answer in (
        ("FFFF 01 02 01 FB", "FFFF 01 02 00 FC"),
        ("FFFF 01 05 04 1E F4 01 E2", "FFFF 01 02 00 FC"),
    ):
        assert bench.frames(bytes.fromhex(asked))[0][1] == bytes.fromhex(answer)
    assert bench.frames(bytes.fromhex("FFFF FE 02 05 FA")) == []
    assert bench.read(1, GOAL, 2) == 500
    bench.servos[0].fail(HEAT | OVERLOAD)
    assert bench.frames(bytes.fromhex("FFFF 01 02 01 FB"))[0][1] == bytes.fromhex("FFFF 01 02 24 D8")


def test_a_sync_write_of_the_manual_reaches_both():
    bench = ax(0, 1)
    assert bench.frames(bytes.fromhex("FFFF FE 0E 83 1E 04 00 10 00 50 01 01 20 02 60 03 67")) == []
    assert [(bench.read(i, GOAL, 2), bench.read(i, SPEED, 2)) for i in (0, 1)] == [(0x10, 0x150), (0x220, 0x360)]


ERRORS = {
    "an unknown instruction": (0x7F, b"", INSTRUCTION),
    "a reboot": (p1.REBOOT, b"", INSTRUCTION),
    "an action without a registered write": (p1.ACTION, b"", INSTRUCTION),
    "a goal out of range": (p1.WRITE, bytes([GOAL, 0, 4]), RANGE),
    "a torque that is neither on nor off": (p1.WRITE, bytes([TORQUE, 2]), RANGE),
    "an id out of range": (p1.WRITE, bytes([ID, 254]), RANGE),
    "a read-only register": (p1.WRITE, bytes([PRESENT, 0, 2]), RANGE),
    "a block beyond the table": (p1.READ, bytes([48, 3]), RANGE),
    "no length": (p1.READ, bytes([PRESENT, 0]), RANGE),
    "a registered goal out of range": (p1.REG_WRITE, bytes([GOAL, 0, 4]), RANGE),
}


@pytest.mark.parametrize("name", ERRORS)
def test_errors_are_bits_of_the_answer(name):
    instruction, parameters, error = ERRORS[name]
    assert ax().ask(1, instruction, parameters) == [(1, error, b"")]


def test_a_goal_beyond_the_angle_limits_is_told_and_not_taken():
    bench = ax(1, cw_angle_limit=200, ccw_angle_limit=800)
    assert [bench.write(1, GOAL, *low_high(goal)) for goal in (199, 200, 800, 801)] == [ANGLE, 0, 0, ANGLE]
    assert bench.read(1, GOAL, 2) == 800
    # a block with a refused part is not written at all
    assert bench.write(1, GOAL, *low_high(900), *low_high(100)) == ANGLE
    assert bench.read(1, SPEED, 2) == 0


def test_a_wrong_checksum_is_told():
    bench = ax()
    [(_, frame)] = bench.frames(bytes.fromhex("FFFF 01 02 01 FA"))
    assert frame == p1.encode_status(1, CHECKSUM)
    assert bench.ask(1, p1.PING) == [(1, 0, b"")]


def test_there_is_no_sync_read():
    assert ax().ask(254, p1.SYNC_READ, bytes([PRESENT, 2, 1])) == []


@pytest.mark.parametrize(("level", "answered"), [(0, (1, 0, 0)), (1, (1, 1, 0)), (2, (1, 1, 1))])
def test_the_status_return_level(level, answered):
    bench = ax(1, status_return_level=level)
    asked = ((p1.PING, b""), (p1.READ, bytes([LED, 1])), (p1.WRITE, bytes([LED, 1])))
    assert tuple(len(bench.ask(1, *question)) for question in asked) == answered


def test_broadcasts_are_carried_out_and_only_a_ping_is_answered():
    bench = ax(7)
    assert bench.ask(254, p1.WRITE, bytes([LED, 1])) == []
    assert bench.read(7, LED) == 1
    assert bench.ask(254, p1.PING) == [(7, 0, b"")]


def test_a_registered_write_waits_for_the_action():
    bench = ax()
    assert bench.ask(1, p1.REG_WRITE, bytes([GOAL, *low_high(600)])) == [(1, 0, b"")]
    assert (bench.read(1, REGISTERED), bench.read(1, GOAL, 2)) == (1, 512)
    assert bench.ask(1, p1.ACTION) == [(1, 0, b"")]
    assert (bench.read(1, REGISTERED), bench.read(1, GOAL, 2)) == (0, 600)


def test_id_and_rate_change_after_the_answer():
    bench = ax()
    assert bench.ask(1, p1.WRITE, bytes([ID, 5])) == [(1, 0, b"")]
    assert bench.ask(5, p1.WRITE, bytes([BAUD, 34])) == [(5, 0, b"")]
    assert bench.ask(5, p1.PING) == []
    bench.line.baud = 57_600  # the servo's 57,143 bit/s are near enough
    assert bench.ask(5, p1.PING) == [(5, 0, b"")]


def test_the_return_delay_is_in_2_us():
    [(start, _)] = ax(return_delay_time=250).frames(p1.encode(1, p1.PING))
    assert start == 500_000


def test_a_factory_reset_makes_the_id_1():
    bench = ax(0)
    assert bench.frames(bytes.fromhex("FFFF 00 02 06 F7"))[0][1] == bytes.fromhex("FFFF 00 02 00 FD")
    assert (bench.read(1, DELAY), bench.read(1, CCW, 2)) == (250, 1023)


# EEPROM


def test_eeprom_is_kept_and_refused_with_torque_on():
    bench = ax()
    assert bench.write(1, CCW, *low_high(900)) == 0
    assert bench.write(1, TORQUE, 1) == 0
    assert bench.write(1, CCW, *low_high(800)) == RANGE
    power_cycle(bench)
    assert (bench.read(1, CCW, 2), bench.read(1, TORQUE)) == (900, 0)


def test_the_lock_stays_until_the_power_is_cut():
    bench = ax()
    assert bench.write(1, LOCK, 1) == 0
    assert bench.write(1, ID, 4) == RANGE
    assert bench.write(1, LOCK, 0) == RANGE
    assert bench.write(1, LED, 1) == 0
    power_cycle(bench)
    assert bench.write(1, ID, 4) == 0


# motion


def test_a_goal_is_reached_once_torque_is_on():
    bench = ax()
    bench.write(1, GOAL, *low_high(700))
    bench.wait(0.5)
    assert (bench.read(1, PRESENT, 2), bench.read(1, TORQUE)) == (512, 0)
    bench.write(1, TORQUE, 1)
    assert bench.read(1, MOVING) == 0  # not yet
    bench.wait(0.1)
    assert bench.read(1, MOVING) == 1
    bench.wait(1.5)
    assert bench.read(1, PRESENT, 2) == pytest.approx(700, abs=3)
    assert bench.read(1, MOVING) == 0


def test_the_moving_speed_bounds_the_speed():
    bench = ax()
    bench.write(1, SPEED, *low_high(100))  # 11.1 rev/min: 227 counts a second
    bench.write(1, TORQUE, 1)
    bench.write(1, GOAL, *low_high(900))
    bench.wait(0.4)
    start = bench.motors[0].ticks()
    assert bench.read(1, MOVING) == 1
    bench.wait(1.0)
    speed = 100 * 0.111 / 60 * 360 * 1024 / 300
    assert bench.motors[0].ticks() - start == pytest.approx(speed, rel=0.02)
    assert signed(bench.read(1, PRESENT_SPEED, 2)) == pytest.approx(100, abs=3)


def hold(bench, goal):
    """Keep the horn where it is, ask for a goal, and return the load that the servo shows there."""
    bench.motors[0].stuck = True
    bench.write(1, TORQUE, 1)
    bench.write(1, GOAL, *low_high(goal))
    bench.wait(0.02)
    return signed(bench.read(1, LOAD, 2))


# load at an error: 0 within the margin, the punch at its edge, 1023 where the slope ends: the manual's picture
@pytest.mark.parametrize(
    ("margin", "slope", "punch", "error", "load"),
    [
        (1, 32, 32, 1, 0),
        (1, 32, 32, 17, 32 + (1023 - 32) // 2),
        (1, 32, 32, 33, 1023),
        (1, 32, 32, 200, 1023),
        (10, 32, 32, 10, 0),
        (10, 64, 0, 42, 511),
        (1, 100, 200, 65, 1023),  # 100 acts as 64
        (1, 100, 200, 33, 200 + (1023 - 200) // 2),
        (1, 128, 32, -65, -(32 + (1023 - 32) // 2)),
    ],
)
def test_compliance(margin, slope, punch, error, load):
    bench = ax()
    bench.write(1, CW_MARGIN, margin, margin, slope, slope)
    bench.write(1, PUNCH, *low_high(punch))
    assert hold(bench, 512 + error) == pytest.approx(load, abs=3)


def test_each_side_has_its_own_slope():
    bench = ax()
    bench.write(1, CW_MARGIN, 0, 0, 128, 16)
    bench.write(1, PUNCH, 0, 0)
    assert [hold(bench, 512 + error) for error in (8, -8)] == pytest.approx([512, -64], abs=3)


def test_the_torque_limit_bounds_the_load():
    bench = ax(1, max_torque=800)
    assert bench.read(1, LIMIT, 2) == 800
    bench.write(1, LIMIT, *low_high(300))
    assert hold(bench, 800) == 300


def test_without_limits_it_is_a_wheel_by_torque():
    bench = ax()
    bench.write(1, CW, 0, 0, 0, 0)
    bench.write(1, TORQUE, 1)
    bench.write(1, SPEED, *low_high(512))
    bench.wait(1.0)
    assert signed(bench.read(1, LOAD, 2)) == 512
    friction = AX.friction_loss_nm / AX.stall_torque_nm
    assert bench.motors[0].omega == pytest.approx((512 / 1023 - friction) * AX.no_load_speed_rad_s, rel=0.02)
    bench.write(1, SPEED, *low_high(512 | 1 << 10))
    bench.wait(1.0)
    assert bench.motors[0].omega < 0
    bench.write(1, SPEED, *low_high(1 << 10))
    bench.wait(1.0)
    assert abs(bench.motors[0].omega) < 0.1
    assert bench.write(1, SPEED, *low_high(2047)) == 0
    assert [bench.write(1, SPEED, *low_high(speed)) for speed in (2048, 3072)] == [RANGE] * 2
    assert bench.read(1, SPEED, 2) == 2047
    # a goal means nothing to a wheel, the sign of a speed nothing to a joint
    assert bench.write(1, GOAL, *low_high(1000)) == 0
    assert [ax().write(1, SPEED, *low_high(speed | 1 << 10)) for speed in (0, 512)] == [RANGE] * 2


@pytest.mark.parametrize(("degrees", "count"), [(0, 0), (150, 512), (299, 1021), (310, 1023), (350, 0), (365, 17)])
def test_the_potentiometer_lacks_60_degrees(degrees, count):
    bench = ax()
    bench.motors[0].angle = math.radians(degrees)
    assert bench.read(1, PRESENT, 2) == count


# protection


def test_an_overload_takes_the_torque_limit_until_it_is_given_back():
    bench = ax()
    hold(bench, 800)
    bench.wait(2.1)
    assert bench.ask(1, p1.PING) == [(1, OVERLOAD, b"")]
    assert (bench.read(1, LIMIT, 2), signed(bench.read(1, LOAD, 2)), bench.read(1, TORQUE)) == (0, 0, 1)
    assert bench.write(1, GOAL, *low_high(700)) == OVERLOAD
    assert bench.write(1, LIMIT, *low_high(500)) == 0
    bench.wait(0.01)
    assert signed(bench.read(1, LOAD, 2)) == 500


def test_what_shutdown_does_not_name_is_only_told():
    bench = ax(1, shutdown=0)
    bench.servos[0].fail(OVERLOAD)
    assert bench.ask(1, p1.PING) == [(1, OVERLOAD, b"")]
    assert bench.read(1, LIMIT, 2) == 1023


def test_the_wrong_voltage_is_told_while_it_lasts():
    bench = ax()
    bench.motors[0].volts = 5.5
    bench.wait(0.1)
    assert bench.ask(1, p1.PING) == [(1, VOLTAGE_BIT, b"")]
    bench.motors[0].volts = 12.0
    assert (bench.read(1, VOLTAGE), bench.read(1, TEMPERATURE)) == (120, 25)
    assert bench.ask(1, p1.PING) == [(1, 0, b"")]


def test_even_a_mistake_shuts_down_where_the_register_says_so():
    bench = ax(1, shutdown=ANGLE, cw_angle_limit=200)
    assert bench.write(1, GOAL, *low_high(100)) == ANGLE
    assert bench.read(1, LIMIT, 2) == 0
