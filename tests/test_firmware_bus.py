"""The firmware's bus master: the same questions at the same times as the host's, and the same sense of any answer."""

from dataclasses import dataclass, replace

import pytest
import runtime_shim
from damage import damaged, damages
from hypothesis import given, settings
from hypothesis import strategies as st
from runtime_shim import Bus
from two_masters import HostBus, HostPort, Line

from controller import load_rig, registers
from controller.register import decode_register, encode_register
from deploy.buses.dynamixel_bus import DynamixelBus
from deploy.buses.feetech_bus import FeetechBus
from deploy.virtual import dynamixel2 as dxl
from deploy.virtual import protocol1 as p1

runtime = runtime_shim.runtime

HOSTS = {"dynamixel-2.0": DynamixelBus, "feetech-sts": FeetechBus}
IDS = (1, 2, 5)
PATIENCE_US = 2000
BROADCAST = 0xFE
POSITION = registers(load_rig("lamp-sts3215").joints[0].product)["present_position"]

both = pytest.mark.parametrize("protocol", HOSTS)


# any answers


@dataclass(frozen=True)
class Answer:
    """Say how a question is answered: who, with what, damaged where, in which pieces, how late."""

    silent: frozenset[int] = frozenset()
    error: int = 0
    fill: bytes = b"\0"
    short: int = 0
    before: bytes = b""
    twice: bool = False
    echo: bool = False
    damage: tuple[tuple[str, int, int], ...] = ()
    cuts: tuple[tuple[int, int], ...] = ((0, 100),)

    def pieces(self, protocol, frame):
        """Return (delay_us, bytes), as a line gives them."""
        wire = bytearray(self.before + (frame if self.echo else b""))
        for servo, size in _asked(protocol, frame):
            if servo not in self.silent:
                data = (self.fill * size)[: max(0, size - self.short)]
                encode = dxl.encode_status if protocol == "dynamixel-2.0" else p1.encode
                wire += encode(servo, self.error, data) * (2 if self.twice else 1)
        wire = damaged(wire, self.damage)
        pieces, start, delay = [], 0, 0
        for cut, gap in self.cuts:
            delay += gap
            end = len(wire) if (cut, gap) == self.cuts[-1] else min(len(wire), start + cut)
            pieces.append((delay, wire[start:end]))
            start = end
        return [piece for piece in pieces if piece[1]]


def _asked(protocol, frame):
    """Return (servo, data bytes) of everybody who has to answer a question."""
    if protocol == "dynamixel-2.0":
        packet = dxl.PacketParser().feed(frame)[0]
        two = int.from_bytes(packet.parameters[2:4], "little")
        sync, sizes = packet.parameters[4:], {dxl.PING: 3, dxl.READ: two, dxl.WRITE: 0}
    else:
        packet = p1.PacketParser().feed(frame)[0]
        two = packet.parameters[1] if len(packet.parameters) > 1 else 0
        sync, sizes = packet.parameters[2:], {p1.PING: 0, p1.READ: two, p1.WRITE: 0}
    if packet.instruction == dxl.SYNC_READ:
        return [(servo, two) for servo in sync]
    return [(packet.id, sizes[packet.instruction])] if packet.id != BROADCAST else []


# bytes that packets are made of, so that garbage comes close to being one
SCRAPS = st.one_of(
    st.binary(max_size=12),
    st.lists(st.sampled_from(list(b"\xff\xff\xfd\x00\x01\x02\x55\xfe\x07")), max_size=14).map(bytes),
    st.builds(dxl.encode_status, st.sampled_from([1, 2, 5, 9]), st.just(0), st.binary(max_size=8)),
    st.builds(dxl.encode, st.sampled_from([1, 2, 254]), st.sampled_from([0x55, 2, 3]), st.binary(max_size=3)),
    st.builds(p1.encode, st.sampled_from([1, 2, 5, 9]), st.sampled_from([0, 0x20]), st.binary(max_size=8)),
)
SOUND = st.builds(
    Answer,
    silent=st.frozensets(st.sampled_from(IDS), max_size=2),
    fill=st.sampled_from([b"\0", b"\xff\xff\xfd", b"\xff\xff\xfd\xfd", b"\xff", b"\x01\x02\x03\x04"]),
    cuts=st.just(((0, 100),)) | st.lists(st.tuples(st.integers(1, 30), st.integers(1, 900)), min_size=1).map(tuple),
)
BROKEN = st.builds(
    Answer,
    silent=st.frozensets(st.sampled_from(IDS), max_size=3),
    error=st.sampled_from([0, 0, 0x80, 0x87, 4, 0x20, 0x01, 0x7F]),
    fill=st.sampled_from([b"\0", b"\xff\xff\xfd", b"\xff", b"\x01\x02\x03\x04"]),
    short=st.sampled_from([0, 0, 0, 1, 2, 9]),
    before=SCRAPS | st.just(b""),
    twice=st.booleans(),
    echo=st.booleans(),
    damage=damages(71, 3).map(tuple),
    cuts=st.lists(st.tuples(st.integers(1, 40), st.integers(1, 4000)), min_size=1, max_size=4).map(tuple),
)
QUESTIONS = st.one_of(
    st.tuples(st.just("ping"), st.sampled_from(IDS)),
    st.tuples(st.just("read"), st.sampled_from(IDS), st.just(56), st.integers(1, 20)),
    st.tuples(st.just("write"), st.sampled_from(IDS), st.just(40), st.binary(min_size=1, max_size=6)),
    st.tuples(st.just("sync_read"), st.just(56), st.integers(1, 12)),
    st.tuples(st.just("sync_read"), st.just(56), st.integers(1, 12)),
    st.tuples(st.just("sync_write"), st.just(42), st.sampled_from([b"\1\2" * 3, b"\xff\xff\xfd" * 3, b"\1\2\3\4" * 3])),
    st.tuples(st.just("rest"), st.sampled_from([7, 991, 4003, 90_001, 260_003])),
)


def _play(bus, line, questions):
    told = []
    for name, *arguments in questions:
        if name == "rest":
            line.rest(*arguments)
        else:
            told.append((name, getattr(bus, name)(*arguments), bus.strays))
    return told


def _assert_same(runtime, protocol, questions, answers):
    def replier():
        left = iter(answers)
        return lambda frame: next(left, Answer()).pieces(protocol, frame)

    line = Line(replier())
    port = HostPort(replier(), PATIENCE_US)
    try:
        host = _play(HostBus(HOSTS[protocol](port), IDS), port, questions)
        told = _play(Bus(runtime, line, protocol, IDS, patience_us=PATIENCE_US), line, questions)
        assert line.asked == port.asked
        assert told == host
    finally:
        port.closePort()
    return told


@both
@given(questions=st.lists(QUESTIONS, max_size=8), answers=st.lists(SOUND, max_size=14))
@settings(max_examples=120)
def test_sound_answers_are_heard_as_the_host_hears_them(runtime, protocol, questions, answers):
    _assert_same(runtime, protocol, questions, answers)


@both
@given(questions=st.lists(QUESTIONS, min_size=1, max_size=8), answers=st.lists(SOUND | BROKEN, max_size=14))
@settings(max_examples=250)
def test_any_bytes_are_heard_as_the_host_hears_them(runtime, protocol, questions, answers):
    _assert_same(runtime, protocol, questions, answers)


# the manuals' frames


def _frames(runtime, protocol, ids, ask):
    line = Line(lambda _: [])
    ask(Bus(runtime, line, protocol, ids))
    return [frame for _, frame in line.asked]


@pytest.mark.parametrize(
    ("protocol", "ids", "ask", "frame"),
    [
        ("dynamixel-2.0", [1], lambda bus: bus.ping(1), "FFFFFD00 01 0300 01 194E"),
        ("dynamixel-2.0", [1], lambda bus: bus.read(1, 132, 4), "FFFFFD00 01 0700 02 8400 0400 1D15"),
        (
            "dynamixel-2.0",
            [1],
            lambda bus: bus.write(1, 116, b"\0\2\0\0"),
            "FFFFFD00 01 0900 03 7400 00020000 CA89",
        ),
        ("dynamixel-2.0", [1, 2], lambda bus: bus.sync_read(132, 4), "FFFFFD00 FE 0900 82 8400 0400 01 02 CEFA"),
        (
            "dynamixel-2.0",
            [1, 2],
            lambda bus: bus.sync_write(116, bytes.fromhex("96000000AA000000")),
            "FFFFFD00 FE 1100 83 7400 0400 01 96000000 02 AA000000 8287",
        ),
        ("feetech-sts", [1], lambda bus: bus.ping(1), "FFFF 01 02 01 FB"),
        ("feetech-sts", [1], lambda bus: bus.read(1, 43, 1), "FFFF 01 04 02 2B 01 CC"),
        ("feetech-sts", [11, 12], lambda bus: bus.sync_read(30, 2), "FFFF FE 06 82 1E 02 0B 0C 42"),
        (
            "feetech-sts",
            [0, 1],
            lambda bus: bus.sync_write(30, bytes.fromhex("1000500120026003")),
            "FFFF FE 0E 83 1E 04 00 10 00 50 01 01 20 02 60 03 67",
        ),
    ],
)
def test_what_is_sent_is_the_manuals(runtime, protocol, ids, ask, frame):
    assert _frames(runtime, protocol, ids, ask)[0] == bytes.fromhex(frame)


@pytest.mark.parametrize(
    ("protocol", "ask", "frame", "said"),
    [
        ("dynamixel-2.0", lambda bus: bus.ping(1), "FFFFFD00 01 0700 55 00 0604 26 655D", ("data", b"", 1030)),
        (
            "dynamixel-2.0",
            lambda bus: (bus.read(1, 132, 4), None),
            "FFFFFD00 01 0800 55 00 A6000000 8CC0",
            ("data", b"\xa6\0\0\0", None),
        ),
        (
            "dynamixel-2.0",
            lambda bus: (bus.write(1, 116, b"\0\2\0\0"), None),
            "FFFFFD00 01 0400 55 00 A10C",
            ("data", b"", None),
        ),
        ("feetech-sts", lambda bus: (bus.read(1, 43, 1), None), "FFFF 01 03 00 20 DB", ("data", b"\x20", None)),
        ("feetech-sts", lambda bus: (bus.write(1, 40, b"\0"), None), "FFFF 01 02 00 FC", ("data", b"", None)),
    ],
)
def test_what_the_manuals_servos_answer_is_heard(runtime, protocol, ask, frame, said):
    reply, model = ask(Bus(runtime, Line(lambda _: [(50, bytes.fromhex(frame))]), protocol, [1]))
    assert (reply.status, reply.data, model) == said


def test_a_packet_that_would_not_fit_is_not_sent(runtime):
    for protocol in HOSTS:
        line = Line(lambda _: [])
        reply = Bus(runtime, line, protocol, [1]).write(1, 0, bytes(300))
        assert (reply.status, reply.t_us, line.asked) == ("missing", 0, [])


# registers


@pytest.mark.parametrize("rig", ["lamp-xc330", "lamp-sts3215"])
def test_registers_are_coded_as_the_hosts(runtime, rig):
    for register in registers(load_rig(rig).joints[0].product).values():
        size, encoding = register.size, runtime_shim.ENCODINGS[register.encoding]
        counts = (register.low, register.high, -1, 0, 1, 77, 255)
        for count in (count for count in counts if register.low <= count <= min(register.high, 2**31 - 1)):
            data = encode_register(register, count)
            room = runtime_shim.buffer(size)
            runtime.shim_encode(size, encoding, count, room)
            assert (room.raw, runtime.shim_decode(size, encoding, data)) == (data, count), register.name


@given(
    size=st.sampled_from([1, 2, 4]), encoding=st.sampled_from(list(runtime_shim.ENCODINGS)), data=st.binary(min_size=4)
)
def test_any_bytes_of_a_register_are_read_as_the_host_reads_them(runtime, size, encoding, data):
    register = replace(POSITION, size=size, encoding=encoding)
    want = decode_register(register, data[:size])
    assert runtime.shim_decode(size, runtime_shim.ENCODINGS[encoding], data) == min(want, 2**31 - 1)


@pytest.mark.parametrize(
    ("size", "encoding", "count", "held"),
    [
        (1, "unsigned", 256, 255),
        (2, "unsigned", -1, 0),
        (2, "twos", 40000, 32767),
        (2, "sign15", -32768, -32767),
        (2, "sign10", 1024, 1023),
    ],
)
def test_what_a_register_can_not_hold_becomes_the_nearest_that_it_can(runtime, size, encoding, count, held):
    room = runtime_shim.buffer(size)
    runtime.shim_encode(size, runtime_shim.ENCODINGS[encoding], count, room)
    assert runtime.shim_decode(size, runtime_shim.ENCODINGS[encoding], room) == held
