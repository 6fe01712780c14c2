"""Every instruction of Dynamixel 2.0 on virtual X servos, by the manual's rules, and as the vendor's SDK sees them."""

from dataclasses import replace

import pytest
from dynamixel_master import Master, SdkPort, block
from dynamixel_sdk import (
    COMM_RX_TIMEOUT,
    COMM_SUCCESS,
    GroupBulkRead,
    GroupBulkWrite,
    GroupSyncRead,
    PacketHandler,
)

from controller.errors import InputError
from controller.products import PRODUCTS
from controller.rig_file import load_rig
from deploy.virtual import dynamixel2 as dxl

RIG = load_rig("lamp-xc330")
CLEAR = bytes.fromhex("01 44584C22")
BACK_UP, RESTORE = bytes.fromhex("01 4354524C"), bytes.fromhex("02 4354524C")
LED, GOAL, POSITION, VOLTAGE = 65, 116, 132, 144


@pytest.fixture
def master():
    return Master(RIG)


def two(value):
    return value.to_bytes(2, "little")


# source: e-Manual, docs/en/dxl/protocol2.md and, for the backup, its newer revision
VECTORS = {
    "control table backup": (1, dxl.BACKUP, "01 4354524C", "FFFFFD00 01 0800 20 01 4354524C 16F5"),
    "bulk read answer": (1, dxl.STATUS, "00 7700", "FFFFFD00 01 0600 55 00 7700 C369"),
    "bulk read answer of 2": (2, dxl.STATUS, "00 24", "FFFFFD00 02 0500 55 00 24 8BA9"),
    "bulk write": (
        254,
        dxl.BULK_WRITE,
        "01 2000 0200 A000 02 1F00 0100 50",
        "FFFFFD00 FE 1000 93 01 2000 0200 A000 02 1F00 0100 50 B768",
    ),
}


@pytest.mark.parametrize("name", VECTORS)
def test_wire_vectors_of_the_manual(name):
    servo, instruction, parameters, wire = VECTORS[name]
    assert dxl.encode(servo, instruction, bytes.fromhex(parameters)) == bytes.fromhex(wire)


# (question, answer) of servo 1, by the manual; where a servo of ours says what the manual's does
ANSWERED = {
    "write": ("FFFFFD00 01 0900 03 7400 00020000 CA89", "FFFFFD00 01 0400 55 00 A10C"),
    "reg write": ("FFFFFD00 01 0900 04 6800 C8000000 AE8E", "FFFFFD00 01 0400 55 00 A10C"),
    "clear": ("FFFFFD00 01 0800 10 01 44584C22 B1DC", "FFFFFD00 01 0400 55 00 A10C"),
    "reboot": ("FFFFFD00 01 0300 08 2F4E", "FFFFFD00 01 0400 55 00 A10C"),
    "factory reset": ("FFFFFD00 01 0400 06 01 A1E6", "FFFFFD00 01 0400 55 00 A10C"),
    "sync write": ("FFFFFD00 FE 1100 83 7400 0400 01 96000000 02 AA000000 8287", ""),
}


@pytest.mark.parametrize("name", ANSWERED)
def test_the_manuals_questions_are_answered_byte_for_byte(master, name):
    question, answer = ANSWERED[name]
    assert b"".join(frame for _, frame in master.frames(bytes.fromhex(question))) == bytes.fromhex(answer)
    if name == "reg write":
        [(_, done)] = master.frames(bytes.fromhex("FFFFFD00 01 0300 05 02CE"))
        assert done == bytes.fromhex(answer)
        assert master.read(1, "goal_velocity") == 200
    elif name == "sync write":
        assert [master.read(servo, "goal_position") for servo in (1, 2)] == [150, 170]


def test_a_registered_write_waits_for_the_action(master):
    assert master.ask(1, dxl.ACTION) == [(1, dxl.INSTRUCTION_ERROR, b"")], "nothing is registered"
    assert master.ask(1, dxl.REG_WRITE, block(LED) + b"\x01") == [(1, 0, b"")]
    assert (master.read(1, "registered_instruction"), master.read(1, "led")) == (1, 0)
    assert master.ask(1, dxl.ACTION) == [(1, 0, b"")]
    assert (master.read(1, "registered_instruction"), master.read(1, "led")) == (0, 1)
    assert master.ask(1, dxl.ACTION) == [(1, dxl.INSTRUCTION_ERROR, b"")]


def test_what_may_not_be_written_is_not_registered(master):
    assert master.ask(1, dxl.REG_WRITE, block(POSITION) + bytes(4)) == [(1, dxl.ACCESS_ERROR, b"")]
    assert master.ask(1, dxl.REG_WRITE, block(GOAL) + bytes(2)) == [(1, dxl.DATA_LENGTH_ERROR, b"")]
    assert master.read(1, "registered_instruction") == 0


def test_a_registered_write_is_judged_again_when_it_acts(master):
    assert master.ask(1, dxl.REG_WRITE, block(9) + b"\x07") == [(1, 0, b"")]
    master.set(1, torque_enable=1)
    assert master.ask(1, dxl.ACTION) == [(1, dxl.ACCESS_ERROR, b"")]
    assert master.read(1, "return_delay_time") == 0


def test_an_action_for_all_is_carried_out_in_silence(master):
    for servo in (1, 3):
        assert master.ask(servo, dxl.REG_WRITE, block(LED) + b"\x01") == [(servo, 0, b"")]
    assert master.ask(dxl.BROADCAST, dxl.ACTION) == []
    assert [master.read(servo, "led") for servo in (1, 2, 3)] == [1, 0, 1]


@pytest.mark.parametrize(("option", "identity", "baud"), [(0xFF, 1, 57600), (1, 2, 57600), (2, 2, 1_000_000)])
def test_factory_reset_has_three_levels(option, identity, baud):
    master = Master(RIG)
    master.set(2, homing_offset=50, position_p_gain=77)
    assert master.ask(2, dxl.FACTORY_RESET, bytes([option])) == [(2, 0, b"")], "answered by the servo as it was"
    assert master.ask(2, dxl.PING) == [], "it boots"
    master.wait(0.5)
    master.rig.set_baud(baud)
    if baud == 1_000_000 and identity == 2:
        assert master.ask(2, dxl.PING)
    assert [servo.id for servo in master.rig.servos] == [1, identity, 3]
    master.write(identity, "led", 1)
    held = master.rig.servos[1].table
    assert (held["homing_offset"], held["position_p_gain"]) == (0, held.lines["position_p_gain"].initial)
    assert (held["led"], held["return_delay_time"]) == (1, 250)


def test_factory_reset_of_everything_is_not_for_everybody(master):
    master.set(1, homing_offset=50)
    assert master.ask(dxl.BROADCAST, dxl.FACTORY_RESET, b"\xff") == []
    assert master.read(1, "homing_offset") == 50
    assert master.ask(1, dxl.FACTORY_RESET, b"\x03") == [(1, dxl.DATA_RANGE_ERROR, b"")]
    assert master.ask(1, dxl.FACTORY_RESET, b"") == [(1, dxl.DATA_LENGTH_ERROR, b"")]
    assert master.ask(dxl.BROADCAST, dxl.FACTORY_RESET, b"\x02") == []
    master.wait(0.5)
    assert master.read(1, "homing_offset") == 0


def test_a_backup_outlives_the_rig(tmp_path):
    path = tmp_path / "eeprom.json"
    master = Master(RIG, eeprom_path=path)
    master.set(2, homing_offset=50, startup_configuration=2, position_p_gain=1234)
    assert master.ask(2, dxl.BACKUP, BACK_UP) == [(2, 0, b"")]
    master.set(2, homing_offset=-7)
    again = Master(RIG, eeprom_path=path)
    assert [again.read(servo, "backup_ready") for servo in (1, 2)] == [0, 1]
    assert (again.read(2, "homing_offset"), again.read(2, "position_p_gain")) == (-7, 1234)
    assert again.ask(2, dxl.BACKUP, RESTORE) == [(2, 0, b"")]
    again.wait(0.5)
    assert again.read(2, "homing_offset") == 50
    text = path.read_text()
    for old, new, told in (
        ('"position_p_gain": 1234', '"position_p_gain": 99999', "servo a1: 'position_p_gain' = 99999 is no"),
        ('"position_p_gain": 1234', '"led": 1', "servo a1: 'led' = 1 is no"),
        ('"backups": {\n  "a1"', '"backups": {\n  "a9"', "its backups are of no servos of lamp-xc330"),
    ):
        assert old in text
        path.write_text(text.replace(old, new))
        with pytest.raises(InputError, match=told):
            Master(RIG, eeprom_path=path)


def test_a_backup_brings_the_eeprom_back(master):
    assert master.read(1, "backup_ready") == 0
    assert master.ask(1, dxl.BACKUP, RESTORE) == [(1, dxl.RESULT_FAIL, b"")], "there is none yet"
    master.set(1, homing_offset=50, startup_configuration=2, position_p_gain=1234, profile_velocity=11)
    assert master.ask(1, dxl.BACKUP, BACK_UP) == [(1, 0, b"")]
    assert master.read(1, "backup_ready") == 1
    master.set(1, homing_offset=-7, position_p_gain=4321)
    assert master.ask(1, dxl.BACKUP, RESTORE) == [(1, 0, b"")]
    master.wait(0.5)
    assert (master.read(1, "homing_offset"), master.read(1, "backup_ready")) == (50, 1)
    # the startup configuration asks for the RAM, too
    assert (master.read(1, "position_p_gain"), master.read(1, "profile_velocity")) == (1234, 11)
    master.set(1, startup_configuration=0)
    master.ask(1, dxl.REBOOT)
    master.wait(0.5)
    assert master.read(1, "position_p_gain") == master.line(1, "position_p_gain").initial
    master.set(1, torque_enable=1)
    assert master.ask(1, dxl.BACKUP, BACK_UP) == [(1, dxl.RESULT_FAIL, b"")]
    assert master.ask(1, dxl.BACKUP, b"\x01CTRX") == [(1, dxl.DATA_RANGE_ERROR, b"")]


def test_the_startup_configuration_can_switch_torque_on(master):
    master.set(1, startup_configuration=1)
    master.ask(1, dxl.REBOOT)
    master.wait(0.5)
    assert master.read(1, "torque_enable") == 1
    assert master.write(1, "id", 9) == dxl.ACCESS_ERROR


def test_clear_takes_no_homing_offset_for_turns(master):
    master.set(1, operating_mode=4, homing_offset=40_000)
    turned = master.read(1, "present_position")
    assert turned > 40_000
    assert master.ask(1, dxl.CLEAR, CLEAR) == [(1, 0, b"")]
    assert master.read(1, "present_position") == turned, "the homing offset is no turn"
    assert master.ask(1, dxl.CLEAR, b"\x02DXL\x22") == [(1, dxl.DATA_RANGE_ERROR, b"")]
    assert master.ask(1, dxl.CLEAR, b"\x01") == [(1, dxl.DATA_LENGTH_ERROR, b"")]


def test_a_moving_servo_does_not_clear(master):
    master.set(3, operating_mode=4, profile_velocity=20)
    master.set(3, torque_enable=1, goal_position=2400)
    master.wait(0.1)
    assert master.ask(3, dxl.CLEAR, CLEAR) == [(3, dxl.RESULT_FAIL, b"")]


def test_a_secondary_id_is_obeyed_in_silence(master):
    # the manual's own example, with three servos
    for servo in (1, 2, 3):
        master.set(servo, secondary_id=3)
    assert master.write(1, "led", 1) == 0
    assert [master.read(servo, "led") for servo in (1, 2, 3)] == [1, 0, 0]
    assert master.ask(3, dxl.WRITE, block(LED) + b"\x01") == [(3, 0, b"")], "only the one with that id answers"
    assert [master.read(servo, "led") for servo in (1, 2, 3)] == [1, 1, 1]
    for servo in (1, 2, 3):
        master.set(servo, secondary_id=100)
    assert master.ask(100, dxl.WRITE, block(LED) + b"\x00") == []
    assert [master.read(servo, "led") for servo in (1, 2, 3)] == [0, 0, 0]
    assert master.ask(100, dxl.WRITE, block(9) + b"\x07") == []
    assert master.read(2, "return_delay_time") == 0, "a group's EEPROM is not written"
    assert master.ask(100, dxl.PING) == master.ask(100, dxl.READ, block(LED, 1)) == []
    master.set(2, secondary_id=253)
    assert master.ask(100, dxl.WRITE, block(LED) + b"\x01") == []
    assert [master.read(servo, "led") for servo in (1, 2, 3)] == [1, 0, 1]


def test_another_protocol_is_silence(master):
    assert master.write(1, "protocol_type", 20) == 0
    assert master.ask(1, dxl.PING) == []
    master.rig.servos[0].table["protocol_type"] = 2


def bulk(*parts):
    return b"".join(bytes([servo]) + two(address) + two(length) for servo, address, length in parts)


def test_bulk_read_answers_in_the_order_asked_and_stops_at_a_silent_servo(master):
    answers = master.ask(dxl.BROADCAST, dxl.BULK_READ, bulk((3, VOLTAGE, 2), (1, 0, 2), (2, 500, 1)))
    assert answers == [(3, 0, b"\x32\0"), (1, 0, two(1230)), (2, dxl.ACCESS_ERROR, b"")]
    answers = master.ask(dxl.BROADCAST, dxl.BULK_READ, bulk((3, VOLTAGE, 2), (9, 0, 2), (1, 0, 2)))
    assert [servo for servo, _, _ in answers] == [3]
    assert master.ask(dxl.BROADCAST, dxl.BULK_READ, bulk((3, VOLTAGE, 2))[:-1]) == []
    assert master.ask(1, dxl.BULK_READ, bulk((1, VOLTAGE, 2))) == [(1, dxl.INSTRUCTION_ERROR, b"")]


def test_bulk_write_writes_each_its_own_and_nobody_answers(master):
    told = b"\x01" + block(LED, 1) + b"\x01" + b"\x03" + block(84, 2) + two(777) + b"\x02" + block(84, 2) + two(65000)
    assert master.ask(dxl.BROADCAST, dxl.BULK_WRITE, told) == []
    assert (master.read(1, "led"), master.read(3, "position_p_gain")) == (1, 777)
    assert master.read(2, "position_p_gain") == master.line(2, "position_p_gain").initial
    assert master.ask(dxl.BROADCAST, dxl.BULK_WRITE, b"\x01" + block(LED, 1) + b"\x00" + b"\x02\x00") == []
    assert master.read(1, "led") == 1, "a malformed packet changes nothing"


def fast(master, instruction, parameters):
    frames = master.frames(dxl.encode(dxl.BROADCAST, instruction, parameters))
    return frames[0][1] if frames else b""


def test_a_fast_sync_read_is_one_packet_with_the_crc_after_each_part(master):
    ids = [3, 1, 2]
    frame = fast(master, dxl.FAST_SYNC_READ, block(POSITION, 4) + bytes(ids))
    assert frame[:8] == bytes.fromhex("FFFFFD00 FE") + two(1 + 3 * 8) + b"\x55"
    for place, servo in enumerate(ids):
        part = frame[8 + 8 * place : 16 + 8 * place]
        assert part[:2] == bytes([0, servo])
        assert int.from_bytes(part[2:6], "little", signed=True) == master.read(servo, "present_position")
        # an independent CRC over all that was on the line before
        before = frame[: 14 + 8 * place]
        assert int.from_bytes(part[6:], "little") == PacketHandler(2.0).updateCRC(0, before, len(before))
    assert len(frame) == 7 + 1 + 3 * 8


def test_a_fast_read_is_not_stuffed(master):
    looks_like_a_header = int.from_bytes(b"\xff\xff\xfd\xff", "little", signed=True)
    master.set(1, operating_mode=4, goal_position=looks_like_a_header)
    frame = fast(master, dxl.FAST_SYNC_READ, block(GOAL, 4) + bytes([1, 2]))
    assert frame[10:14] == b"\xff\xff\xfd\xff"
    assert len(frame) == 7 + 1 + 2 * 8


def test_a_fast_read_of_a_missing_servo_is_silence(master):
    assert fast(master, dxl.FAST_SYNC_READ, block(POSITION, 4) + bytes([1, 9, 2])) == b""
    assert fast(master, dxl.FAST_BULK_READ, bulk((1, POSITION, 4), (9, VOLTAGE, 2))) == b""
    assert master.write(2, "status_return_level", 0) == 0
    assert fast(master, dxl.FAST_SYNC_READ, block(POSITION, 4) + bytes([1, 2])) == b""


def test_a_fast_bulk_read_has_parts_of_different_lengths(master):
    frame = fast(master, dxl.FAST_BULK_READ, bulk((2, VOLTAGE, 2), (1, 0, 6), (3, 500, 1)))
    assert frame[5:7] == two(1 + (2 + 4) + (6 + 4) + (1 + 4))
    assert frame[8:12] == b"\0\x02\x32\0"
    assert frame[14:18] == b"\0\x01" + two(1230)
    assert frame[24:27] == bytes([dxl.ACCESS_ERROR, 3, 0]), "who refuses has zeros for data"


def test_the_alert_bit_is_in_every_part(master):
    master.rig.servos[1].fail(0x20)
    frame = fast(master, dxl.FAST_SYNC_READ, block(LED, 1) + bytes([1, 2]))
    assert (frame[8], frame[13]) == (0, dxl.ALERT)


@pytest.fixture
def sdk():
    master = Master(RIG)
    return SdkPort(master.rig), PacketHandler(2.0)


def test_the_sdk_reads_many_at_once(sdk):
    port, packets = sdk
    one_by_one = [packets.read4ByteTxRx(port, servo, POSITION)[0] for servo in (1, 2, 3)]
    group = GroupSyncRead(port, packets, POSITION, 4)
    for servo in (1, 2, 3):
        assert group.addParam(servo)
    for read in (group.txRxPacket, group.fastSyncRead):
        assert read() == COMM_SUCCESS
        assert [group.getData(servo, POSITION, 4) for servo in (1, 2, 3)] == one_by_one
    group.addParam(9)
    assert group.fastSyncRead() == COMM_RX_TIMEOUT


def test_the_sdk_reads_and_writes_in_bulk(sdk):
    port, packets = sdk
    writer = GroupBulkWrite(port, packets)
    writer.addParam(1, LED, 1, [1])
    writer.addParam(3, 84, 2, [0x09, 0x03])
    assert writer.txPacket() == COMM_SUCCESS
    reader = GroupBulkRead(port, packets)
    reader.addParam(1, LED, 1)
    reader.addParam(3, 84, 2)
    for read in (reader.txRxPacket, reader.fastBulkRead):
        assert read() == COMM_SUCCESS
        assert (reader.getData(1, LED, 1), reader.getData(3, 84, 2)) == (1, 777)


def test_the_sdk_registers_acts_reboots_clears_and_resets(sdk):
    port, packets = sdk
    assert packets.regWriteTxRx(port, 2, LED, 1, [1]) == (COMM_SUCCESS, 0)
    assert packets.read1ByteTxRx(port, 2, LED) == (0, COMM_SUCCESS, 0)
    assert packets.action(port, dxl.BROADCAST) == COMM_SUCCESS
    assert packets.read1ByteTxRx(port, 2, LED) == (1, COMM_SUCCESS, 0)
    assert packets.clearMultiTurn(port, 2) == (COMM_SUCCESS, 0)
    assert packets.reboot(port, 2) == (COMM_SUCCESS, 0)
    assert packets.ping(port, 2)[1] == COMM_RX_TIMEOUT
    port.rig.advance(port.rig.now + 0.5)
    assert packets.ping(port, 2) == (1230, COMM_SUCCESS, 0)
    assert packets.factoryReset(port, 2, 0x02) == (COMM_SUCCESS, 0)
    port.rig.advance(port.rig.now + 0.5)
    assert packets.ping(port, 2) == (1230, COMM_SUCCESS, 0)


def test_products_mix_on_one_line():
    names = ("xl330-m288", "xc330-m181", "xm430-w350")
    joints = tuple(
        replace(joint, product=PRODUCTS[name], gains={}, ceiling=885)
        for joint, name in zip(RIG.joints, names, strict=True)
    )
    master = Master(replace(RIG, joints=joints))
    assert [data[:2] for _, _, data in master.ask(dxl.BROADCAST, dxl.PING)] == [two(1200), two(1230), two(1020)]
    # of the X430, addresses go on where the X330's table ends
    parameters = bulk((1, 224, 4), (3, 634, 4), (2, 228, 1))
    assert [error for _, error, _ in master.ask(dxl.BROADCAST, dxl.BULK_READ, parameters)] == [0, 0, dxl.ACCESS_ERROR]
