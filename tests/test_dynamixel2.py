"""Dynamixel 2.0 packets: the manual's wire vectors, stuffing, and finding the way back from any bytes."""

import pytest
from dynamixel_sdk import PacketHandler
from hypothesis import given
from hypothesis import strategies as st

from deploy.virtual import dynamixel2 as dxl

IDS = st.integers(0, dxl.ID_MAX) | st.just(dxl.BROADCAST)
# bytes that look like headers and stuffing are rare among random ones
BYTES = st.lists(st.sampled_from([0xFF, 0xFD, 0x00, 0x55, 0x01]) | st.integers(0, 255), max_size=40).map(bytes)

# Source: e-Manual, docs/en/dxl/protocol2.md, the examples of each instruction
VECTORS = {
    "ping": (1, dxl.PING, "", "FFFFFD00 01 0300 01 194E"),
    "ping answer": (1, dxl.STATUS, "00 0604 26", "FFFFFD00 01 0700 55 00 0604 26 655D"),
    "ping answer of 2": (2, dxl.STATUS, "00 0604 26", "FFFFFD00 02 0700 55 00 0604 26 6F6D"),
    "broadcast ping": (254, dxl.PING, "", "FFFFFD00 FE 0300 01 3142"),
    "read": (1, dxl.READ, "8400 0400", "FFFFFD00 01 0700 02 8400 0400 1D15"),
    "read answer": (1, dxl.STATUS, "00 A6000000", "FFFFFD00 01 0800 55 00 A6000000 8CC0"),
    "read answer of 2": (2, dxl.STATUS, "00 1F080000", "FFFFFD00 02 0800 55 00 1F080000 BABE"),
    "write": (1, dxl.WRITE, "7400 00020000", "FFFFFD00 01 0900 03 7400 00020000 CA89"),
    "write answer": (1, dxl.STATUS, "00", "FFFFFD00 01 0400 55 00 A10C"),
    "reboot": (1, dxl.REBOOT, "", "FFFFFD00 01 0300 08 2F4E"),
    "sync read": (254, dxl.SYNC_READ, "8400 0400 01 02", "FFFFFD00 FE 0900 82 8400 0400 01 02 CEFA"),
    "sync write": (
        254,
        dxl.SYNC_WRITE,
        "7400 0400 01 96000000 02 AA000000",
        "FFFFFD00 FE 1100 83 7400 0400 01 96000000 02 AA000000 8287",
    ),
    # instructions that the servo does not carry out: the frame is the same
    "reg write": (1, 0x04, "6800 C8000000", "FFFFFD00 01 0900 04 6800 C8000000 AE8E"),
    "action": (1, 0x05, "", "FFFFFD00 01 0300 05 02CE"),
    "factory reset": (1, 0x06, "01", "FFFFFD00 01 0400 06 01 A1E6"),
    "clear": (1, 0x10, "01 44584C22", "FFFFFD00 01 0800 10 01 44584C22 B1DC"),
    "bulk read": (254, 0x92, "01 9000 0200 02 9200 0100", "FFFFFD00 FE 0D00 92 01 9000 0200 02 9200 0100 1A05"),
}


@pytest.mark.parametrize("name", VECTORS)
def test_wire_vectors_of_the_manual(name):
    servo, instruction, parameters, wire = VECTORS[name]
    frame, data = bytes.fromhex(wire), bytes.fromhex(parameters)
    assert dxl.encode(servo, instruction, data) == frame
    assert dxl.PacketParser().feed(frame) == [dxl.Packet(servo, instruction, data, len(frame))]


@given(st.binary(max_size=200))
def test_the_crc_is_the_sdks(data):
    assert dxl.crc16(data) == PacketHandler(2.0).updateCRC(0, data, len(data))


@given(IDS, st.integers(0, 255), BYTES)
def test_what_is_sent_is_what_arrives(servo, instruction, parameters):
    frame = dxl.encode(servo, instruction, parameters)
    assert dxl.PacketParser().feed(frame) == [dxl.Packet(servo, instruction, parameters, len(frame))]
    # inside a frame no header may stand
    assert frame.count(b"\xff\xff\xfd") == 1 + frame[7:-2].count(b"\xff\xff\xfd\xfd") + (
        frame[-4:-1] == b"\xff\xff\xfd"
    )


def test_stuffing_as_the_manual_states_it():
    frame = dxl.encode(1, dxl.WRITE, bytes.fromhex("7400 FFFFFD 02"))
    assert frame[5:7] == bytes.fromhex("0A00")
    assert frame[7:-2] == bytes.fromhex("03 7400 FFFFFDFD 02")
    already = bytes.fromhex("FFFFFDFD")
    assert dxl.encode(1, dxl.WRITE, already)[8:-2] == bytes.fromhex("FFFFFDFDFD")


@given(st.lists(st.tuples(IDS, st.integers(0, 255), BYTES), max_size=5), st.data())
def test_the_cuts_between_reads_do_not_matter(packets, data):
    stream = b"".join(dxl.encode(*packet) for packet in packets)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=8)))
    parser = dxl.PacketParser()
    found = []
    for start, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        found += parser.feed(stream[start:end])
    assert [(packet.id, packet.instruction, packet.parameters) for packet in found] == packets
    assert not found or found[-1].end == len(stream)
    assert parser.waiting == 0


@given(BYTES | st.binary(max_size=300))
def test_any_bytes_are_survived_and_the_next_packets_found(noise):
    parser = dxl.PacketParser()
    before = parser.feed(noise)
    # a false length makes the parser wait for at most LENGTH_MAX bytes: what follows them is understood
    good = dxl.encode(1, dxl.PING)
    found = parser.feed(good * (dxl.LENGTH_MAX // len(good) + 3))
    assert found[-1] == dxl.Packet(1, dxl.PING, b"", found[-1].end)
    assert len(found) >= 2
    assert all(packet.end <= len(noise) for packet in before)
    assert parser.waiting <= dxl.LENGTH_MAX + 7


@given(BYTES)
def test_noise_without_a_header_costs_no_packet(noise):
    parser = dxl.PacketParser()
    harmless = noise.replace(b"\xff", b"\x00")
    assert parser.feed(harmless + dxl.encode(7, dxl.PING))[-1].id == 7


@given(BYTES.filter(bool), st.data())
def test_one_wrong_bit_is_one_lost_packet(parameters, data):
    frame = bytearray(dxl.encode(3, dxl.WRITE, parameters))
    bit = data.draw(st.integers(0, 8 * len(frame) - 1))
    frame[bit // 8] ^= 1 << bit % 8
    assert dxl.Packet(3, dxl.WRITE, parameters, len(frame)) not in dxl.PacketParser().feed(bytes(frame))


def test_a_packet_inside_a_broken_one_is_found():
    broken = bytearray(dxl.encode(1, dxl.WRITE, bytes(10)))
    broken[5] = 40  # the length claims what follows too
    good = dxl.encode(2, dxl.PING)
    assert [packet.id for packet in dxl.PacketParser().feed(bytes(broken) + good * 4)] == [2] * 4
