"""Dynamixel 1.0 and Feetech packets: the manuals' wire vectors, and finding the way back from any bytes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deploy.virtual import protocol1 as p1

IDS = st.integers(0, p1.BROADCAST)
# bytes that look like headers are rare among random ones
BYTES = st.lists(st.sampled_from([0xFF, 0xFE, 0x02, 0x01]) | st.integers(0, 255), max_size=40).map(bytes)

# Source: e-Manual, docs/en/dxl/protocol1.md, the examples of each instruction
ROBOTIS = {
    "ping": (1, p1.PING, "", "FFFF 01 02 01 FB"),
    "ping answer": (1, 0, "", "FFFF 01 02 00 FC"),
    "overloaded and hot": (1, 0x24, "", "FFFF 01 02 24 D8"),
    "read": (1, p1.READ, "2B 01", "FFFF 01 04 02 2B 01 CC"),
    "read answer": (1, 0, "20", "FFFF 01 03 00 20 DB"),
    "checksum example": (1, p1.WRITE, "0C 64 AA", "FFFF 01 05 03 0C 64 AA DC"),
    "broadcast write": (254, p1.WRITE, "03 01", "FFFF FE 04 03 03 01 F6"),
    "reg write": (1, p1.REG_WRITE, "1E F4 01", "FFFF 01 05 04 1E F4 01 E2"),
    "action": (254, p1.ACTION, "", "FFFF FE 02 05 FA"),
    "factory reset": (0, p1.FACTORY_RESET, "", "FFFF 00 02 06 F7"),
    "factory reset answer": (0, 0, "", "FFFF 00 02 00 FD"),
    "sync write": (
        254,
        p1.SYNC_WRITE,
        "1E 04 00 1000 5001 01 2002 6003",
        "FFFF FE 0E 83 1E 04 00 10 00 50 01 01 20 02 60 03 67",
    ),
}

# Source: Feetech, Smart Bus Servo Communication Protocol Manual, §1.3, examples 2 to 8; the last: rustypot's own test
FEETECH = {
    "read": (1, p1.READ, "38 02", "FFFF 01 04 02 38 02 BE"),
    "read answer": (1, 0, "18 05", "FFFF 01 04 00 18 05 DD"),
    "broadcast write": (254, p1.WRITE, "05 01", "FFFF FE 04 03 05 01 F4"),
    "write": (1, p1.WRITE, "2A 0008 0000 E803", "FFFF 01 09 03 2A 00 08 00 00 E8 03 D5"),
    "reg write": (10, p1.REG_WRITE, "2A 0008 0000 E803", "FFFF 0A 09 04 2A 00 08 00 00 E8 03 CB"),
    "sync write": (
        254,
        p1.SYNC_WRITE,
        "2A 06" + "".join(f" {i:02X} 0008 0000 E803" for i in (1, 2, 3, 4)),
        "FFFF FE 20 83 2A 06 01 0008 0000 E803 02 0008 0000 E803 03 0008 0000 E803 04 0008 0000 E803 58",
    ),
    "sync read": (254, p1.SYNC_READ, "38 08 01 02", "FFFF FE 06 82 38 08 01 02 36"),
    "sync read answer": (2, 0, "FF07 0000 0000 77 23", "FFFF 02 0A 00 FF 07 00 00 00 00 77 23 53"),
    "sync read of rustypot": (254, p1.SYNC_READ, "1E 02 0B 0C", "FFFF FE 06 82 1E 02 0B 0C 42"),
}

VECTORS = {f"robotis {name}": v for name, v in ROBOTIS.items()} | {f"feetech {name}": v for name, v in FEETECH.items()}


@pytest.mark.parametrize("name", VECTORS)
def test_wire_vectors_of_the_manuals(name):
    servo, instruction, parameters, wire = VECTORS[name]
    frame, data = bytes.fromhex(wire), bytes.fromhex(parameters)
    assert p1.encode(servo, instruction, data) == frame
    assert p1.PacketParser().feed(frame) == [p1.Packet(servo, instruction, data, len(frame))]


@given(IDS, st.integers(0, 255), BYTES)
def test_what_is_sent_is_what_arrives(servo, instruction, parameters):
    frame = p1.encode(servo, instruction, parameters)
    assert p1.PacketParser().feed(frame) == [p1.Packet(servo, instruction, parameters, len(frame))]


@given(BYTES | st.binary(max_size=300), st.integers(1, 7))
def test_no_bytes_raise_and_cutting_them_changes_nothing(noise, size):
    whole, pieces = p1.PacketParser(), p1.PacketParser()
    packets = whole.feed(noise)
    cut = [packet for start in range(0, len(noise), size) for packet in pieces.feed(noise[start : start + size])]
    assert cut == packets
    assert whole.waiting == pieces.waiting


@given(BYTES | st.binary(max_size=300))
def test_a_good_packet_is_found_once_its_time_has_come(noise):
    parser = p1.PacketParser()
    parser.feed(noise)
    parser.abandon()
    frame = p1.encode(3, p1.READ, b"\x38\x02")
    [packet] = parser.feed(frame)
    assert (packet.id, packet.instruction, packet.parameters, packet.sound) == (3, p1.READ, b"\x38\x02", True)
    assert packet.end == len(noise) + len(frame)


@given(IDS, st.integers(0, 255), BYTES, st.integers(1, 255))
def test_a_damaged_checksum_is_told(servo, instruction, parameters, flip):
    frame = bytearray(p1.encode(servo, instruction, parameters))
    frame[-1] ^= flip
    packets = p1.PacketParser().feed(bytes(frame) + bytes(300))
    assert packets[0].sound is False or packets[0].end < len(frame)
    if not any(packet.sound for packet in packets):
        assert packets[0] == p1.Packet(servo, instruction, parameters, len(frame), sound=False)


def test_a_sound_packet_within_a_damaged_length_is_found():
    ping = p1.encode(1, p1.PING)
    torn = b"\xff\xff\x02\x0a\x03" + ping
    assert p1.PacketParser().feed(torn + bytes(20)) == [p1.Packet(1, p1.PING, b"", len(torn))]
