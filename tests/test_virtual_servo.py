"""The virtual servo's rules, asked over the wire: access, ranges, errors, protection, what it keeps."""

import json

import pytest
from dynamixel_master import block
from hypothesis import given, settings
from hypothesis import strategies as st
from xc330_master import LINES, Master

from controller.errors import InputError
from deploy.virtual import dynamixel2 as dxl
from deploy.virtual.faults import parse_fault


@pytest.fixture
def master():
    return Master()


def test_a_commissioned_servo_holds_the_factorys_values_but_for_the_rigs(master):
    changed = {"id": 2, "baud_rate": 3, "return_delay_time": 0}
    measured = range(LINES["realtime_tick"].address, LINES["backup_ready"].address)
    for name, line in LINES.items():
        if line.address in measured or name.startswith("goal_"):
            continue
        assert master.read(2, name) == changed.get(name, line.initial), name
    assert master.read(2, "goal_pwm") == LINES["pwm_limit"].initial
    assert master.read(2, "goal_position") == master.read(2, "present_position")


RULES = {
    "a goal": ("goal_position", 2100, 0),
    "a goal beyond its limit": ("goal_position", 4096, dxl.DATA_LIMIT_ERROR),
    "a negative goal": ("goal_position", -1, dxl.DATA_LIMIT_ERROR),
    "PWM beyond its limit": ("goal_pwm", 886, dxl.DATA_LIMIT_ERROR),
    "a gain": ("position_p_gain", 16383, 0),
    "a gain out of range": ("position_p_gain", 16384, dxl.DATA_RANGE_ERROR),
    "torque neither on nor off": ("torque_enable", 2, dxl.DATA_RANGE_ERROR),
    "an id out of range": ("id", 253, dxl.DATA_RANGE_ERROR),
    "a baud rate out of range": ("baud_rate", 7, dxl.DATA_RANGE_ERROR),
    "a read-only register": ("present_position", 0, dxl.ACCESS_ERROR),
    "the model number": ("model_number", 1, dxl.ACCESS_ERROR),
    "another mode": ("operating_mode", 1, 0),
    "a mode that there is not": ("operating_mode", 2, dxl.DATA_RANGE_ERROR),
    "a protocol that there is not": ("protocol_type", 3, dxl.DATA_RANGE_ERROR),
    "the reverse drive mode": ("drive_mode", 1, 0),
    "a drive mode out of range": ("drive_mode", 14, dxl.DATA_RANGE_ERROR),
    "an integral gain": ("position_i_gain", 10, 0),
    "another PWM slope": ("pwm_slope", 100, 0),
    "a secondary id": ("secondary_id", 100, 0),
    "an armed watchdog": ("bus_watchdog", 127, 0),
    "a watchdog out of range": ("bus_watchdog", 128, dxl.DATA_RANGE_ERROR),
}


@pytest.mark.parametrize("name", RULES)
def test_a_write_is_taken_or_refused_with_the_right_error(master, name):
    register, value, error = RULES[name]
    before = master.read(1, register)
    assert master.write(1, register, value) == error
    if register not in ("present_position",):
        assert master.read(1, register) == (value if error == 0 else before)


@pytest.mark.parametrize("name", ["profile_velocity", "profile_acceleration"])
def test_a_time_based_profile_takes_less_than_one_by_velocity(master, name):
    assert [master.write(1, name, value) for value in (32767, 32768)] == [0, dxl.DATA_RANGE_ERROR]
    assert master.write(1, "drive_mode", 4) == 0
    assert [master.write(1, name, value) for value in (32737, 32738)] == [0, dxl.DATA_RANGE_ERROR]
    assert master.read(1, name) == 32737


def test_goal_limits_are_those_in_the_table(master):
    assert master.write(1, "max_position_limit", 3000) == 0
    assert master.write(1, "min_position_limit", 1000) == 0
    assert [master.write(1, "goal_position", goal) for goal in (999, 1000, 3000, 3001)] == [6, 0, 0, 6]


def test_eeprom_is_locked_while_torque_is_on(master):
    assert master.write(1, "torque_enable", 1) == 0
    assert master.write(1, "return_delay_time", 10) == dxl.ACCESS_ERROR
    assert master.write(1, "torque_enable", 0) == 0
    assert master.write(1, "return_delay_time", 10) == 0


@pytest.mark.parametrize(
    ("parameters", "error"),
    [
        (block(116) + bytes(2), dxl.DATA_LENGTH_ERROR),
        (block(118) + bytes(4), dxl.DATA_LENGTH_ERROR),
        (block(116), dxl.DATA_LENGTH_ERROR),
        (b"\x74", dxl.DATA_LENGTH_ERROR),
        (block(66) + bytes(1), dxl.ACCESS_ERROR),
        (block(227) + bytes(2), dxl.ACCESS_ERROR),
        (block(65535) + bytes(1), dxl.ACCESS_ERROR),
    ],
    ids=["half a register", "from its middle", "no data", "no address", "a gap", "across the end", "far beyond"],
)
def test_a_write_of_the_wrong_shape_is_refused(master, parameters, error):
    assert master.ask(1, dxl.WRITE, parameters) == [(1, error, b"")]


@pytest.mark.parametrize(
    ("parameters", "error", "length"),
    [
        (block(0, 228), 0, 228),
        (block(227, 1), 0, 1),
        (block(66, 2), 0, 2),
        (block(228, 1), dxl.ACCESS_ERROR, 0),
        (block(0, 229), dxl.ACCESS_ERROR, 0),
        (block(0, 0), dxl.DATA_LENGTH_ERROR, 0),
        (block(132), dxl.DATA_LENGTH_ERROR, 0),
    ],
)
def test_a_read_ends_with_the_table(master, parameters, error, length):
    [(servo, got, data)] = master.ask(1, dxl.READ, parameters)
    assert (servo, got, len(data)) == (1, error, length)


def test_a_block_is_written_whole_or_not_at_all(master):
    profile = (100).to_bytes(4, "little") + (200).to_bytes(4, "little")
    assert master.ask(1, dxl.WRITE, block(108) + profile + (9999).to_bytes(4, "little"))[0][1] == dxl.DATA_LIMIT_ERROR
    assert (master.read(1, "profile_acceleration"), master.read(1, "profile_velocity")) == (0, 0)
    assert master.ask(1, dxl.WRITE, block(108) + profile + (2100).to_bytes(4, "little"))[0][1] == 0
    assert [master.read(1, name) for name in ("profile_acceleration", "profile_velocity", "goal_position")] == [
        100,
        200,
        2100,
    ]


def test_indirect_data_stand_for_other_registers(master):
    for number, address in enumerate((84, 85, 132, 133, 134, 135), start=1):
        assert master.write(1, f"indirect_address_{number}", address) == 0
    assert master.ask(1, dxl.WRITE, block(208) + (777).to_bytes(2, "little")) == [(1, 0, b"")]
    assert master.read(1, "position_p_gain") == 777
    [(_, _, data)] = master.ask(1, dxl.READ, block(208, 6))
    assert int.from_bytes(data[:2], "little") == 777
    assert int.from_bytes(data[2:], "little") == master.read(1, "present_position")


def test_the_bus_watchdog_stops_the_servo_and_locks_its_goals(master):
    assert master.write(1, "bus_watchdog", 5) == 0
    master.wait(1.0)
    assert master.read(1, "bus_watchdog") == 5, "torque is off"
    assert master.write(1, "torque_enable", 1) == 0
    master.wait(0.09)
    assert master.ask(3, dxl.PING), "any packet counts, for whomever it is"
    master.wait(0.09)
    assert master.read(1, "bus_watchdog") == 5
    master.wait(0.11)
    assert master.read(1, "bus_watchdog") == 255
    goal = master.read(1, "goal_position")
    assert master.write(1, "goal_position", 2100) == dxl.DATA_RANGE_ERROR
    assert master.write(1, "bus_watchdog", 10) == dxl.DATA_RANGE_ERROR
    assert master.read(1, "goal_position") == goal
    assert abs(goal - master.read(1, "present_position")) <= 20
    assert master.write(1, "bus_watchdog", 0) == 0
    assert master.write(1, "goal_position", 2100) == 0


def test_a_hardware_error_takes_the_torque_until_a_reboot():
    master = Master(faults=[parse_fault("overload=1@0.5-0.6")])
    assert master.write(1, "torque_enable", 1) == 0
    master.wait(0.6)
    assert master.ask(1, dxl.READ, block(64, 1)) == [(1, dxl.ALERT, b"\x00")]
    assert master.read(1, "hardware_error_status") == 0x20
    assert master.write(1, "torque_enable", 1) == dxl.ALERT | dxl.RESULT_FAIL
    assert master.ask(1, dxl.REBOOT) == [(1, dxl.ALERT, b"")]
    assert master.ask(1, dxl.PING) == [], "it boots"
    master.wait(0.5)
    assert master.ask(1, dxl.READ, block(70, 1)) == [(1, 0, b"\x00")]
    assert master.write(1, "torque_enable", 1) == 0


def test_shutdown_names_the_errors_that_take_the_torque():
    for mask, torque in ((0x34, 1), (0x35, 0)):
        master = Master(faults=[parse_fault("supply=3.0@0.5")])
        assert master.write(1, "shutdown", mask) == 0
        assert master.write(1, "torque_enable", 1) == 0
        master.wait(0.6)
        assert (master.read(1, "hardware_error_status"), master.read(1, "torque_enable")) == (0x01, torque)
        assert master.read(1, "present_input_voltage") == 30


def test_a_stalled_servo_warms_up_and_shuts_down():
    # 0.05 rad of error is a load of nothing; a joint at its stop is a stall at full PWM
    master = Master()
    assert master.write(3, "position_p_gain", 1450) == 0
    assert master.write(3, "goal_position", 500) == 0
    assert master.write(3, "torque_enable", 1) == 0
    cold = master.read(3, "present_temperature")
    master.wait(1.5)
    assert master.read(3, "hardware_error_status") == 0
    assert master.read(3, "present_pwm") == -885
    assert master.read(3, "present_current") == pytest.approx(-1800, abs=20)
    master.wait(2.0)
    assert master.read(3, "hardware_error_status") == 0x20
    assert master.read(3, "torque_enable") == 0
    assert master.read(3, "present_temperature") > cold
    assert master.read(3, "present_pwm") == 0


def test_a_reboot_keeps_the_eeprom_and_restores_the_rest(master):
    for name, value in (("position_p_gain", 900), ("led", 1), ("return_delay_time", 7)):
        assert master.write(1, name, value) == 0
    assert master.write(1, "torque_enable", 1) == 0
    master.ask(1, dxl.REBOOT)
    master.wait(0.5)
    assert [master.read(1, name) for name in ("position_p_gain", "led", "torque_enable", "return_delay_time")] == [
        LINES["position_p_gain"].initial,
        0,
        0,
        7,
    ]


def test_the_eeprom_file_keeps_what_was_written(tmp_path):
    path = tmp_path / "eeprom.json"
    master = Master(eeprom_path=path)
    assert not path.exists()
    assert master.write(2, "homing_offset", -500) == 0
    assert master.write(2, "led", 1) == 0
    again = Master(eeprom_path=path)
    assert (again.read(2, "homing_offset"), again.read(2, "led"), again.read(1, "homing_offset")) == (-500, 0, 0)
    content = json.loads(path.read_text())
    content["servos"]["a1"]["homing_offset"] = 1 << 30
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match="servo a1: 'homing_offset' = 1073741824 is no EEPROM register"):
        Master(eeprom_path=path)
    path.write_text("{")
    with pytest.raises(InputError, match="is no EEPROM file"):
        Master(eeprom_path=path)


def test_the_homing_offset_moves_position_and_goal_alike(master):
    before = master.read(1, "present_position")
    assert master.write(1, "homing_offset", 100) == 0
    assert master.read(1, "present_position") == before + 100
    assert master.write(1, "homing_offset", 1025) == 0
    assert master.read(1, "present_position") == before, "position mode ignores offsets beyond a quarter turn"
    master.write(1, "homing_offset", -100)
    assert master.write(1, "goal_position", before - 100) == 0
    assert master.write(1, "torque_enable", 1) == 0
    master.wait(1.0)
    assert abs(master.read(1, "present_position") - (before - 100)) <= 12


def test_goal_updates_switch_the_torque_on_where_the_drive_mode_says_so(master):
    assert master.write(1, "goal_position", 2050) == 0
    assert master.read(1, "torque_enable") == 0
    assert master.write(1, "drive_mode", 8) == 0
    assert master.write(1, "goal_position", 2060) == 0
    assert master.read(1, "torque_enable") == 1


def test_the_realtime_tick_counts_milliseconds_and_wraps(master):
    first = master.read(1, "realtime_tick")
    master.wait(1.0)
    assert (master.read(1, "realtime_tick") - first) == pytest.approx(1000, abs=2)
    master.wait(32.768 - 1.0)
    assert abs(master.read(1, "realtime_tick") - first) <= 2


WRITABLE = [name for name, line in LINES.items() if line.access == "rw"]
TRAFFIC = st.lists(
    st.tuples(
        st.sampled_from([1, 2, 3, 9, 254]), st.sampled_from([1, 2, 3, 8, 0x82, 0x83, 0x55]), st.binary(max_size=16)
    )
    | st.tuples(st.integers(1, 3), st.just("write"), st.sampled_from(WRITABLE), st.integers(-5, 5000))
    | st.binary(max_size=30),
    max_size=25,
)


@settings(max_examples=40)
@given(TRAFFIC)
def test_any_traffic_is_survived_and_leaves_legal_registers(traffic):
    master = Master()
    for item in traffic:
        if isinstance(item, bytes):
            master.frames(item)
            master.wait(0.1)
        elif item[1] == "write":
            master.write(item[0], item[2], item[3])
        else:
            master.frames(dxl.encode(*item))
    for servo in master.rig.servos:
        for name, line in LINES.items():
            tripped = name == "bus_watchdog" and servo.table[name] == 255
            if line.access == "rw" and not tripped:
                assert line.low <= servo.table[name] <= line.high, name
        assert servo.table["model_number"] == 1230
