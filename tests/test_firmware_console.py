"""The console stream of firmware: records and text apart, whatever comes, and numbers that mean what C means."""

import random
import re
import struct
from pathlib import Path

import pytest
from firmware_runs import STS3215, XC330

import firmware_gen
from deploy.firmware import findings, reasons, records
from deploy.firmware.console_decoder import RECORD_BYTES_MAX, ConsoleDecoder, Damaged, Text, crc16
from deploy.firmware.reasons import PLAIN, Reason, Why, sentence
from deploy.states import State

SHAPE = records.Shape(3, 7, 7, 3)
RUNTIME = Path(firmware_gen.__file__).parent / "runtime"


def cobs(data):
    """Return the code by its definition: each zero is replaced by the distance to the next one."""
    zeros = [i for i, byte in enumerate(data) if byte == 0]
    ends = [*zeros, len(data)]
    begin, code = 0, b""
    for end in ends:
        assert end - begin < 254
        code += bytes([end - begin + 1]) + data[begin:end]
        begin = end + 1
    return code


def coded(number, layout, *fields):
    body = bytes([number]) + struct.pack(f"<{layout}", *fields)
    return b"\0" + cobs(body + struct.pack("<H", crc16(body))) + b"\0"


def decoded(data, parts=1):
    decoder = ConsoleDecoder(SHAPE)
    size = max(1, -(-len(data) // parts))
    pieces = [piece for i in range(0, len(data), size) for piece in decoder.feed(data[i : i + size])]
    return [*pieces, *decoder.end()]


EVENT = coded(7, "qBBii", 123456789, 1, 255, 0, -5)
STATE = coded(2, "qBBBBii", 42, 3, 4, 4, 255, 0, 0)


def test_the_crc_is_that_of_dynamixels_manual():
    """e-Manual, protocol2, CRC: of a ping's bytes, whose CRC on the wire is 0x4e19."""
    assert crc16(bytes.fromhex("fffffd00010300 01")) == 0x4E19


def test_records_and_text_come_apart_in_any_cut():
    stream = b"servolve: try help\r\n" + EVENT + b"ok\r\nok\r\n" + STATE + EVENT + b"fault 33\r\n"
    expected = [
        Text("servolve: try help"),
        records.Event(123456789, 1, 255, 0, -5),
        Text("ok"),
        Text("ok"),
        records.Change(42, 3, 4, 4, 255, 0, 0),
        records.Event(123456789, 1, 255, 0, -5),
        Text("fault 33"),
    ]
    for parts in (1, 2, 7, len(stream)):
        assert decoded(stream, parts) == expected


def test_a_lost_zero_costs_no_other_record():
    stream = EVENT + STATE[1:] + b"ok\r\n" + EVENT
    found = [piece for piece in decoded(stream) if isinstance(piece, records.Event)]
    assert len(found) == 2
    assert [piece for piece in decoded(EVENT[1:] + STATE + EVENT[:-1]) if not isinstance(piece, Text)] == [
        records.Event(123456789, 1, 255, 0, -5),
        records.Change(42, 3, 4, 4, 255, 0, 0),
        records.Event(123456789, 1, 255, 0, -5),
    ]


def test_every_flipped_bit_is_noticed():
    for place in range(8, 8 * (len(EVENT) - 1)):
        damaged = bytearray(EVENT)
        damaged[place // 8] ^= 1 << place % 8
        pieces = decoded(bytes(damaged) + STATE)
        assert records.Event(123456789, 1, 255, 0, -5) not in pieces
        assert pieces[-1] == records.Change(42, 3, 4, 4, 255, 0, 0)


@pytest.mark.parametrize("seed", range(20))
def test_garbage_is_neither_a_record_nor_kept(seed):
    rng = random.Random(seed)
    decoder = ConsoleDecoder(SHAPE)
    for _ in range(200):
        for piece in decoder.feed(rng.randbytes(rng.randrange(400))):
            assert isinstance(piece, (Text, Damaged))
        assert len(decoder._piece) <= 512
    for piece in decoder.feed(bytes([rng.randrange(1, 256)]) * 5000):
        assert isinstance(piece, (Text, Damaged))
    assert len(decoder._piece) <= 512
    assert list(decoder.feed(b"\0" + EVENT))[-1] == records.Event(123456789, 1, 255, 0, -5)


@pytest.mark.parametrize("number", range(12))
def test_a_body_that_is_too_short_or_too_long_is_no_record(number):
    sizes = {1: 10, 2: 20, 3: 25, 4: 25, 6: 12 + 0x81, 7: 18, 8: 41, 9: 12 + 0x81}
    for size in range(0, RECORD_BYTES_MAX - 3):
        body = bytes([number]) + b"\x81" * size  # a varint that does not end, in a cycle's
        code = bytes([len(body) + 3]) + body + struct.pack("<H", crc16(body))
        if 0 in code or len(code) > 254:
            continue
        pieces = decoded(b"\0" + code + b"\0")
        right = [piece for piece in pieces if not isinstance(piece, (Text, Damaged))]
        assert len(right) == (size == sizes.get(number)), (size, pieces)


def enumeration(header, prefix):
    """Return the names and numbers of an enumeration of C."""
    text = (RUNTIME / header).read_text()
    return {name: int(number) for name, number in re.findall(rf"\b{prefix}(\w+) = (\d+)", text)}


def test_the_numbers_are_those_of_the_headers():
    assert enumeration("sv_reason.h", "SV_REASON_") == {one.name: one.value for one in Reason}
    assert enumeration("sv_reason.h", "SV_FINDING_") == {one.name: one.value for one in findings.Kind}
    states = enumeration("sv_reason.h", "SV_STATE_")
    assert states == {state.name: number for number, state in enumerate(State)}
    assert sorted(enumeration("sv_record.h", "SV_RECORD_").values()) == sorted(records._PARSERS)
    assert enumeration("sv_reason.h", "SV_EVENT_") == {"RELEASED": 1, "UNSURE": 2, "HELD": 3}
    limit = re.search(r"#define SV_RECORD_MAX (\d+)", (RUNTIME / "sv_record.h").read_text())
    assert int(limit[1]) == RECORD_BYTES_MAX


NUMBERS = {
    Reason.LATE: (0, 4, 0),
    Reason.SILENT: (255, 4, 0),
    Reason.CORRUPT: (1, 4, 1),
    Reason.REFUSED: (1, 4, 4 << 8),
    Reason.HARDWARE: (1, 0x20, 0x35),
    Reason.STALE: (0, 70000, 60000),
    Reason.JUMP: (0, 3100, 20000),
    Reason.TRACKING: (0, 950, 520000),
    Reason.OUTSIDE: (0, 1900, 0),
    Reason.TILT: (255, 1300, 0),
    Reason.HOT: (2, 71, 0),
    Reason.LOW: (2, 3900, 0),
    Reason.OVERRUN: (255, 6, 0),
    Reason.SETTING: (1, 84, 2 << 16),
    Reason.TORQUE_UNSURE: (255, 0b101, 0),
    Reason.RESET: (255, 1, 0),
}


@pytest.mark.parametrize("task", [XC330, STS3215], ids=lambda task: task.rig.name)
@pytest.mark.parametrize("reason", [one for one in Reason if one not in PLAIN and one is not Reason.BLOCKED])
def test_every_fault_has_its_sentence(task, reason):
    joint, a, b = NUMBERS.get(reason, (0, 1, 0))
    said = sentence(Why(reason, joint, a, b), task.rig, "virtual")
    assert "see sv_reason.h" not in said
    assert len(said) > 20


def test_a_number_that_nobody_knows_is_told_as_it_is():
    for why in (Why(99, 0, 1, 2), Why(Reason.HARDWARE, 9, 1, 0), Why(Reason.STALE, 200, 1, 2)):
        assert f"reason {why.reason}" in sentence(why, XC330.rig, "virtual")
    odd = records.Found(0, 1, 77, 0, 3, 1, 2, 3)
    assert "77" in findings.finding(odd, XC330.rig, "virtual", {}).text
    assert reasons.unsure_joints(XC330.rig, 0xFFFF) == list(XC330.rig.joints)
