"""The firmware's bus master: the same questions at the same times as the host's, and the same sense of any answer."""

from dataclasses import dataclass

import pytest
import runtime_shim
from hypothesis import given, settings
from hypothesis import strategies as st
from runtime_shim import Bus, Said
from scripted_port import ScriptedPort

from deploy.dynamixel_bus import DynamixelBus
from deploy.feetech_bus import FeetechBus
from deploy.virtual import dynamixel2 as dxl
from deploy.virtual import protocol1 as p1

runtime = runtime_shim.runtime

HOSTS = {"dynamixel-2.0": DynamixelBus, "feetech-sts": FeetechBus}
IDS = (1, 2, 5)
PATIENCE_US = 2000
BROADCAST = 0xFE

both = pytest.mark.parametrize("protocol", HOSTS)


# two ends of a scripted line: the firmware's in whole microseconds, the host's in seconds


class Line:
    """The other end of the firmware's line, and time that only waiting moves."""

    def __init__(self, answer):
        self.now_us = 0
        self.answer = answer
        self.asked = []
        self._coming = []
        self._waiting = b""

    def send(self, frame):
        self.asked.append((self.now_us, frame))
        self._coming = sorted(self._coming + [(self.now_us + delay, data) for delay, data in self.answer(frame)])
        return len(frame)

    def wait(self, until_us):
        if self._waiting:
            return
        if not self._coming or self._coming[0][0] > until_us:
            self.now_us = max(self.now_us, until_us)
            return
        at, data = self._coming.pop(0)
        self.now_us = max(self.now_us, at)
        self._waiting += data

    def take(self, size):
        taken, self._waiting = self._waiting[:size], self._waiting[size:]
        return taken

    def rest(self, us):
        """Let time pass; what comes then waits."""
        self.now_us += us
        while self._coming and self._coming[0][0] <= self.now_us:
            self._waiting += self._coming.pop(0)[1]


class HostPort(ScriptedPort):
    """The host's port with the same script, its time held to whole microseconds."""

    def __init__(self, answer):
        super().__init__(answer)
        self.latency_s = 1e-6 * PATIENCE_US
        self.asked = []

    def wait(self, deadline):
        while not self.waiting():
            if not self.coming or self.coming[0][0] > _us(deadline):
                self.time = max(self.time, 1e-6 * _us(deadline), deadline)
                return False
            at, data = self.coming.pop(0)
            self.time = 1e-6 * max(_us(self.time), at)
            self.line.write_through(data)
        return True

    def writePort(self, packet):  # noqa: N802
        now_us, answer, coming = _us(self.time), self.answer, self.coming
        self.answer, self.coming = lambda _: [], []
        count = super().writePort(packet)
        self.answer, frame = answer, self.sent_frames[-1]
        self.asked.append((now_us, frame))
        self.coming = sorted(coming + [(now_us + delay, data) for delay, data in answer(frame)])
        return count

    def rest(self, us):
        """Let time pass; what comes then waits."""
        self.time = 1e-6 * (_us(self.time) + us)
        while self.coming and self.coming[0][0] <= _us(self.time):
            self.line.write_through(self.coming.pop(0)[1])


class HostBus:
    """The host's bus, to be driven like the firmware's."""

    def __init__(self, bus, ids):
        self.bus = bus
        self.ids = ids

    @property
    def strays(self):
        return self.bus.port.strays

    def ping(self, servo):
        reply, model = self.bus.ping(servo)
        return _said(reply)._replace(data=b""), model

    def read(self, *question):
        return _said(self.bus.read(*question))

    def write(self, *question):
        return _said(self.bus.write(*question))

    def sync_read(self, *question):
        return {servo: _said(reply) for servo, reply in self.bus.sync_read(self.ids, *question).items()}

    def sync_write(self, address, data):
        size = len(data) // len(self.ids)
        self.bus.sync_write(address, {servo: data[n * size :][:size] for n, servo in enumerate(self.ids)})


def _us(seconds):
    return round(1e6 * seconds)


def _said(reply):
    return Said(reply.status, reply.data, reply.error, reply.alert, reply.late, _us(reply.t))


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
        for kind, place, value in self.damage:
            if wire:
                at = place % len(wire)
                if kind == "flip":
                    wire[at] ^= 1 << value % 8
                elif kind == "drop":
                    del wire[at]
                else:
                    wire.insert(at, value)
        pieces, start, delay = [], 0, 0
        for cut, gap in self.cuts:
            delay += gap
            end = len(wire) if (cut, gap) == self.cuts[-1] else min(len(wire), start + cut)
            pieces.append((delay, bytes(wire[start:end])))
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
    damage=st.lists(
        st.tuples(st.sampled_from(["flip", "drop", "insert"]), st.integers(0, 70), st.integers(0, 255)), max_size=3
    ).map(tuple),
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
    port = HostPort(replier())
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
