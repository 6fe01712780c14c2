"""What a virtual STS3215 and SCS0009 do, asked over the line: framing, registers, lock, homing, byte order."""

import pytest
from feetech_bench import (
    ASYNC,
    BAUD,
    GOAL,
    ID,
    LEVEL,
    LIMIT,
    LOAD,
    LOCK,
    MIN,
    MODE,
    OFFSET,
    PHASE,
    PRESENT,
    SCS,
    TIME,
    TORQUE,
    P,
    place,
    power_cycle,
    scs,
    signed,
    sts,
)

from deploy.virtual import protocol1 as p1
from tests.motor_bench import low_high

# packets


def test_the_manuals_exchanges_byte_for_byte():
    bench = sts(1, 2)
    assert bench.frames(bytes.fromhex("FFFF 01 02 01 FB"))[0][1] == bytes.fromhex("FFFF 01 02 00 FC")
    bench.motors[0].angle = 1304 * bench.motors[0].rad_per_tick
    assert bench.frames(bytes.fromhex("FFFF 01 04 02 38 02 BE"))[0][1] == bytes.fromhex("FFFF 01 04 00 18 05 DD")
    assert bench.frames(bytes.fromhex("FFFF 01 09 03 2A 00 08 00 00 E8 03 D5"))[0][1] == bytes.fromhex(
        "FFFF 01 02 00 FC"
    )
    assert bench.frames(bytes.fromhex("FFFF FE 02 05 FA")) == []


def test_the_manuals_sync_read_is_answered_in_its_order():
    bench = sts(1, 2)
    bench.motors[1].angle = 2047 * bench.motors[1].rad_per_tick
    answers = [frame for _, frame in bench.frames(bytes.fromhex("FFFF FE 06 82 38 08 01 02 36"))]
    # the manual's own answers, but for voltage (12.0 V) and temperature (25 degC)
    assert [frame[:11].hex() for frame in answers] == ["ffff010a00" + "000800000000", "ffff020a00" + "ff0700000000"]
    assert [frame[11:13] for frame in answers] == [bytes([120, 25])] * 2


def test_who_is_missing_in_a_sync_read_leaves_a_gap_of_its_packet():
    bench = sts(1, 2, 3)
    whole = bench.frames(p1.encode(254, p1.SYNC_READ, bytes([PRESENT, 2, 1, 2, 3])))
    bench.dead.add(1)
    gapped = bench.frames(p1.encode(254, p1.SYNC_READ, bytes([PRESENT, 2, 1, 2, 3])))
    assert [frame[2] for _, frame in gapped] == [1, 3]
    assert [start for start, _ in gapped] == [whole[0][0], whole[2][0]]


def test_answers_wait_for_the_return_delay():
    bench = sts(1, return_delay=100)
    [(start, _)] = bench.frames(p1.encode(1, p1.PING))
    assert start == 200_000


def test_a_broadcast_ping_is_answered_by_each_in_turn():
    assert [servo for servo, _, _ in sts(7, 3, 5).ask(254, p1.PING)] == [3, 5, 7]


def test_damaged_unknown_and_foreign_packets_are_not_answered():
    bench = sts(1)
    assert bench.frames(p1.encode(1, p1.PING)[:-1] + b"\x00") == []
    assert bench.ask(1, 0x7F) == []
    assert bench.ask(1, p1.REBOOT) == []
    assert bench.ask(9, p1.PING) == []
    assert bench.ask(1, p1.READ, b"\x00\xff") == bench.ask(254, p1.SYNC_READ, b"\x00\xff\x01") == []  # fits no packet
    assert bench.ask(254, p1.READ, bytes([PRESENT, 2])) == []
    bench.line.baud = 500_000
    assert bench.ask(1, p1.PING) == []


def test_with_response_level_0_only_pings_and_reads_are_answered():
    bench = sts(1)
    assert bench.write(1, LEVEL, 0) == 0  # answered by the servo as it was
    assert bench.write(1, TORQUE, 1) is None
    assert bench.read(1, TORQUE) == 1
    assert bench.ask(1, p1.PING) == [(1, 0, b"")]


def test_a_registered_write_acts_with_the_action():
    bench = sts(1, 2)
    for servo in (1, 2):
        assert bench.ask(servo, p1.REG_WRITE, bytes([GOAL, *low_high(2100)])) == [(servo, 0, b"")]
        assert (bench.read(servo, ASYNC), bench.read(servo, GOAL, 2)) == (1, 2048)
    assert bench.ask(254, p1.ACTION) == []
    assert [(bench.read(i, ASYNC), bench.read(i, GOAL, 2), bench.read(i, TORQUE)) for i in (1, 2)] == [(0, 2100, 1)] * 2


def test_a_sync_write_reaches_each_servo_of_its_list():
    bench = sts(1, 2, 3)
    assert bench.ask(254, p1.SYNC_WRITE, bytes([GOAL, 2, 1, *low_high(2000), 3, *low_high(2100)])) == []
    assert [bench.read(i, GOAL, 2) for i in (1, 2, 3)] == [2000, 2048, 2100]


# registers


def test_identity_and_factory_values():
    bench = sts(1)
    assert bench.read(1, 3, 2) == 777
    assert bench.ask(1, p1.READ, bytes([3, 2]))[0][2] == bytes([9, 3])
    assert [bench.read(1, a) for a in (P, 22, 23, 36, 35, 34)] == [32, 32, 0, 80, 200, 20]
    assert bench.read(1, LIMIT, 2) == 1000
    assert scs().ask(1, p1.READ, bytes([3, 2]))[0][2] == bytes([5, 4])


def test_what_may_not_be_written_stays_as_it_was_and_is_answered_all_the_same():
    bench = sts(1)
    for address, data in ((PRESENT, low_high(5)), (3, (1, 1)), (MODE, (4,)), (TORQUE, (7,)), (ID, (254,))):
        before = bench.read(1, address, len(data))
        assert bench.write(1, address, *data) == 0
        assert bench.read(1, address, len(data)) == before
    # LeRobot writes the factory area's maximal acceleration, and reads it back
    assert bench.write(1, 85, 254) == 0
    assert bench.read(1, 85) == 254


def test_id_and_rate_change_after_the_answer():
    bench = sts(1)
    bench.write(1, LOCK, 0)
    assert bench.ask(1, p1.WRITE, bytes([ID, 7])) == [(1, 0, b"")]
    assert (bench.ask(1, p1.PING), bench.ask(7, p1.PING)) == ([], [(7, 0, b"")])
    assert bench.ask(7, p1.WRITE, bytes([BAUD, 4])) == [(7, 0, b"")]
    assert bench.ask(7, p1.PING) == []
    bench.line.baud = 115_200
    assert bench.ask(7, p1.PING) == [(7, 0, b"")]
    power_cycle(bench)
    assert bench.ask(7, p1.PING) == [(7, 0, b"")]


def test_what_is_written_while_locked_acts_and_is_lost_with_the_power():
    bench = sts(1)
    assert bench.read(1, LOCK) == 1
    bench.write(1, P, 16)
    bench.write(1, ID, 9)
    assert bench.read(9, P) == 16
    power_cycle(bench)
    assert bench.read(1, P) == 32
    bench.write(1, LOCK, 0)
    bench.write(1, P, 16)
    power_cycle(bench)
    assert (bench.read(1, P), bench.read(1, LOCK)) == (16, 1)
    assert bench.servos[0].table.eeprom()["p_coefficient"] == 16


def test_a_factory_reset_forgets_all():
    bench = sts(4, baud_rate=0, homing_offset=100)
    assert bench.ask(4, p1.FACTORY_RESET) == [(4, 0, b"")]
    assert (bench.read(1, OFFSET, 2), bench.read(1, TORQUE)) == (0, 0)


# homing


@pytest.mark.parametrize(("ticks", "offset", "shown"), [(628, 904, 3820), (311, -1652, 1963), (4000, -200, 104)])
def test_the_present_position_is_encoder_less_offset_in_a_turn(ticks, offset, shown):
    # the first pair was measured on an STS3215: feetech-cli 0.1.8
    assert place(sts(1, ticks=ticks, homing_offset=offset)) == shown


def test_128_makes_this_place_2048_and_moves_nothing():
    bench = sts(1, ticks=311.0)
    assert bench.write(1, TORQUE, 128) == 0
    assert (place(bench), bench.read(1, TORQUE)) == (2048, 0)
    assert signed(bench.read(1, OFFSET, 2), 11) == 311 - 2048
    power_cycle(bench)
    assert place(bench) == 2048
    bench.write(1, TORQUE, 1)
    bench.write(1, TORQUE, 128)
    bench.wait(0.5)
    assert bench.motors[0].ticks() == pytest.approx(311.0, abs=1.0)


def test_bit_4_of_phase_shows_turns():
    bench = sts(1, ticks=100.0, phase=0x1C)
    bench.motors[0].angle = -500 * bench.motors[0].rad_per_tick
    assert place(bench) == -500
    bench.motors[0].angle = 9000 * bench.motors[0].rad_per_tick
    assert place(bench) == 9000
    assert bench.ask(1, p1.RESET_TURNS) == [(1, 0, b"")]
    assert place(bench) == 9000 - 2 * 4096
    bench.write(1, PHASE, 0x0C)
    assert place(bench) == 9000 % 4096


# the SCS


def test_an_scs_has_the_high_byte_first_and_no_sync_read():
    bench = scs()
    assert bench.ask(1, p1.READ, bytes([PRESENT, 2])) == [(1, 0, bytes([2, 0]))]
    assert bench.ask(254, p1.SYNC_READ, bytes([PRESENT, 2, 1])) == []
    bench.write(1, GOAL, 2, 100)
    bench.wait(1.0)
    [(_, _, data)] = bench.ask(1, p1.READ, bytes([PRESENT, 2]))
    assert int.from_bytes(data, "big") == pytest.approx(612, abs=10)


def test_an_scs_is_locked_at_48():
    bench = scs()
    assert bench.read(1, 48) == 1
    bench.write(1, P, 20)
    power_cycle(bench)
    assert bench.read(1, P) == 15
    bench.write(1, 48, 0)
    bench.write(1, P, 20)
    power_cycle(bench)
    assert bench.read(1, P) == 20


def test_an_scs_without_limits_is_a_wheel_by_pwm():
    bench = scs()
    bench.write(1, MIN, 0, 0, 0, 0)
    bench.write(1, TORQUE, 1)
    bench.write(1, TIME, *divmod(700, 256))
    bench.wait(1.0)
    [(_, _, data)] = bench.ask(1, p1.READ, bytes([LOAD, 2]))
    assert int.from_bytes(data, "big") == 700
    assert bench.motors[0].omega > 0.5 * SCS.no_load_speed_rad_s
    bench.write(1, TIME, *divmod(700 | 1 << 10, 256))
    bench.wait(1.0)
    assert bench.motors[0].omega < -0.5 * SCS.no_load_speed_rad_s
