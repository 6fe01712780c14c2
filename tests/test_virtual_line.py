"""Virtual servos on their line, asked over the wire: who answers, when, and in which order."""

import pytest
from dynamixel_master import block
from xc330_master import BYTE_S, Master

from deploy.virtual import dynamixel2 as dxl


@pytest.fixture
def master():
    return Master()


def test_a_broadcast_ping_is_answered_by_all_in_order_of_id(master):
    assert master.ask(dxl.BROADCAST, dxl.PING) == [
        (i, 0, (1230).to_bytes(2, "little") + bytes([52])) for i in (1, 2, 3)
    ]
    assert master.ask(9, dxl.PING) == []


def test_an_unknown_instruction_is_an_instruction_error_and_silence_as_a_broadcast(master):
    assert master.ask(1, 0x42, bytes.fromhex("01 44584C22")) == [(1, dxl.INSTRUCTION_ERROR, b"")]
    assert master.ask(1, dxl.SYNC_READ, block(132, 4) + b"\x01") == [(1, dxl.INSTRUCTION_ERROR, b"")]
    assert master.ask(dxl.BROADCAST, 0x42, b"") == []


def test_broadcast_writes_are_carried_out_in_silence(master):
    assert master.ask(dxl.BROADCAST, dxl.WRITE, block(65) + b"\x01") == []
    assert master.ask(dxl.BROADCAST, dxl.READ, block(65, 1)) == []
    assert master.sync_read("led", [3, 1, 2]) == {3: 1, 1: 1, 2: 1}


def test_status_return_level(master):
    assert master.write(1, "status_return_level", 1) == 0
    assert master.write(1, "led", 1) is None
    assert master.read(1, "led") == 1
    assert master.write(1, "status_return_level", 0) is None
    assert master.ask(1, dxl.READ, block(65, 1)) == []
    assert len(master.ask(1, dxl.PING)) == 1
    assert master.sync_read("led", [2]) == {2: 0}


def test_a_change_of_id_is_answered_from_the_old_one(master):
    assert master.ask(1, dxl.WRITE, block(7) + b"\x09") == [(1, 0, b"")]
    assert master.ask(1, dxl.PING) == []
    assert master.ask(9, dxl.PING)[0][0] == 9


def test_two_servos_with_one_id_talk_over_each_other(master):
    master.write(2, "id", 1)
    assert len(master.ask(1, dxl.PING)) == 1, "the same answer twice is one answer"
    frames = master.frames(dxl.encode(1, dxl.READ, block(132, 4)))
    assert len(frames) == 1
    assert dxl.PacketParser().feed(frames[0][1]) == []


def test_a_wrong_baud_rate_is_silence(master):
    assert master.write(1, "baud_rate", 1) == 0
    assert master.ask(1, dxl.PING) == []
    master.rig.set_baud(57600)
    assert len(master.ask(1, dxl.PING)) == 1
    assert master.ask(2, dxl.PING) == []
    # a byte of the answer now takes ten bits at the slower rate
    [(ended, frame)] = master.frames(dxl.encode(1, dxl.PING))
    assert ended - master.asked == pytest.approx(len(frame) * 10 / 57600, abs=1e-8)


def test_bytes_take_their_time_on_the_line(master):
    [(ended, frame)] = master.frames(dxl.encode(1, dxl.PING))
    assert ended - master.asked == pytest.approx(len(frame) * BYTE_S, abs=1e-9)
    assert master.write(1, "return_delay_time", 250) == 0
    [(ended, frame)] = master.frames(dxl.encode(1, dxl.PING))
    assert ended - master.asked == pytest.approx(500e-6 + len(frame) * BYTE_S, abs=1e-9)
    # each waits its own delay after the one before it
    frames = master.frames(dxl.encode(dxl.BROADCAST, dxl.SYNC_READ, block(126, 10) + bytes([2, 1, 3])))
    length = sum(len(frame) for _, frame in frames)
    assert frames[-1][0] - master.asked == pytest.approx(500e-6 + length * BYTE_S, abs=1e-9)
    assert frames[1][0] - frames[0][0] == pytest.approx(500e-6 + len(frames[1][1]) * BYTE_S, abs=1e-9)


def test_without_wire_time_answers_come_at_once():
    master = Master(wire_time=False)
    assert master.sync_read("present_position", [2, 1, 3]).keys() == {1, 2, 3}
    assert master.t == master.asked == 0.0
    assert master.write(1, "return_delay_time", 250) == 0
    assert len(master.ask(1, dxl.PING)) == 1
    assert master.t - master.asked == pytest.approx(500e-6), "the servos' own delay stays"


def test_an_echo_returns_the_masters_own_bytes_before_the_answer():
    master = Master(echo=True)
    question = dxl.encode(1, dxl.PING)
    [(echoed, own), (ended, answer)] = master.frames(question)
    assert own == question
    assert echoed == pytest.approx(len(question) * BYTE_S, abs=1e-9)
    assert ended - echoed == pytest.approx(len(answer) * BYTE_S, abs=1e-9)
    assert [packet.id for packet in dxl.PacketParser().feed(answer)] == [1]
    assert len(master.frames(dxl.encode(9, dxl.PING))) == 1, "who asks in vain hears himself"


def test_sync_read_answers_in_the_order_asked_and_stops_at_a_silent_servo(master):
    answers = master.ask(dxl.BROADCAST, dxl.SYNC_READ, block(132, 4) + bytes([3, 1, 2]))
    assert [servo for servo, _, _ in answers] == [3, 1, 2]
    answers = master.ask(dxl.BROADCAST, dxl.SYNC_READ, block(132, 4) + bytes([3, 9, 2]))
    assert [servo for servo, _, _ in answers] == [3]
    assert master.ask(dxl.BROADCAST, dxl.SYNC_READ, block(300, 4) + bytes([1, 2])) == [(1, 7, b""), (2, 7, b"")]


def test_sync_write_writes_each_its_own_and_nobody_answers(master):
    assert master.sync_write("goal_position", {1: 2000, 3: 2100, 9: 1}) == []
    assert master.sync_read("goal_position", [1, 3]) == {1: 2000, 3: 2100}
    assert master.sync_write("goal_position", {1: 5000, 3: 2200}) == []
    assert master.sync_read("goal_position", [1, 3]) == {1: 2000, 3: 2200}


def test_a_master_that_talks_over_an_answer_destroys_it(master):
    frame = dxl.encode(1, dxl.READ, block(0, 100))
    sent = master.rig.transmit(frame, 0.0)
    master.rig.transmit(dxl.encode(2, dxl.PING), sent + 20 * BYTE_S)
    answers = b"".join(answer for _, answer in master.rig.replies_until(1.0))
    assert answers
    assert dxl.PacketParser().feed(answers) == []
    assert len(master.ask(2, dxl.PING)) == 1


def test_a_packet_that_is_never_finished_is_forgotten(master):
    unfinished = dxl.encode(1, dxl.WRITE, block(168) + bytes(40))[:12]
    master.frames(unfinished)
    assert master.ask(1, dxl.PING) == [], "its bytes belong to the unfinished packet"
    master.wait(0.2)
    assert len(master.ask(1, dxl.PING)) == 1


def test_a_wrong_crc_is_silence(master):
    frame = bytearray(dxl.encode(1, dxl.PING))
    frame[-1] ^= 1
    assert master.frames(bytes(frame)) == []
