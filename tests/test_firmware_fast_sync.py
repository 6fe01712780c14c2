"""The firmware's fast sync read: one packet of all, every part of which stands for itself."""

import pytest
import runtime_shim
from hypothesis import given
from hypothesis import strategies as st
from runtime_shim import Bus
from two_masters import Line

from deploy.virtual import dynamixel2 as dxl

runtime = runtime_shim.runtime

IDS = (1, 2, 5)
PARTS = [(0, servo, bytes((servo,)) * 4) for servo in IDS]


def _fast(PARTS, spoil=()):
    wire = bytearray(dxl.encode_fast(PARTS))
    for place in spoil:
        wire[place] ^= 0x10
    return bytes(wire)


def _fast_bus(runtime, frames):
    """Return a bus whose first sync read, asked in turn, is answered, and then these frames to each question."""
    left = iter(frames)

    def answer(frame):
        if frame[7] == dxl.SYNC_READ and len(line.asked) == 1:
            return [(100, b"".join(dxl.encode_status(servo, error, data) for error, servo, data in PARTS))]
        return [(100, next(left, b""))]

    line = Line(answer)
    bus = Bus(runtime, line, "dynamixel-2.0", IDS, fast=True)
    assert {reply.status for reply in bus.sync_read(132, 4).values()} == {"data"}
    return bus, line


def test_a_fast_sync_read_is_one_packet_of_all(runtime):
    bus, line = _fast_bus(runtime, [_fast([(0, 1, b"\xff\xff\xfd\xfd"), (0x80, 2, b"abcd"), (4, 5, b"\0" * 4)])])
    told = bus.sync_read(132, 4)
    assert line.asked[1][1] == dxl.encode(dxl.BROADCAST, dxl.FAST_SYNC_READ, bytes((132, 0, 4, 0, *IDS)))
    assert [told[servo].status for servo in IDS] == ["data", "data", "refused"]
    assert [told[servo].data for servo in IDS] == [b"\xff\xff\xfd\xfd", b"abcd", b""]  # nothing is stuffed
    assert [told[servo].alert for servo in IDS] == [False, True, False]


@pytest.mark.parametrize("servo", range(3))
@pytest.mark.parametrize("place", range(6))
def test_a_corrupt_part_costs_no_other_servo_its_reply(runtime, servo, place):
    bus, _ = _fast_bus(runtime, [_fast(PARTS, [8 + servo * 8 + place])])
    told = bus.sync_read(132, 4)
    assert [told[number].status for number in IDS] == ["corrupt" if n == servo else "data" for n in range(3)]
    assert all(told[number].data in (b"", bytes((number,)) * 4) for number in IDS)


@given(places=st.lists(st.integers(0, 31), max_size=4), end=st.integers(0, 32), cut=st.integers(1, 31))
def test_damage_of_a_fast_reply_never_makes_a_wrong_value(runtime, places, end, cut):
    bus, line = _fast_bus(runtime, [])
    wire = _fast(PARTS, places)[:end]
    line.answer = lambda frame: [(90, wire[:cut]), (190, wire[cut:])] if frame[7] == dxl.FAST_SYNC_READ else []
    told = bus.sync_read(132, 4)
    assert all(told[number].data in (b"", bytes((number,)) * 4) for number in IDS)
    if end == 32 and not places:
        assert {reply.status for reply in told.values()} == {"data"}


def test_a_late_fast_reply_does_not_answer_the_next_question(runtime):
    bus, line = _fast_bus(runtime, [])
    late = _fast(PARTS)
    line.answer = lambda frame: [(9000, late)] if frame[7] == dxl.FAST_SYNC_READ else []
    assert {reply.status for reply in bus.sync_read(132, 4).values()} == {"missing"}
    line.answer = lambda frame: []
    told = bus.sync_read(132, 4)
    assert {(reply.status, reply.late) for reply in told.values()} <= {("missing", True), ("missing", False)}
