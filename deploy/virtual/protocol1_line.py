"""Protocol 1 framing on the line: which servo carries out a packet, who answers, and in which order.

Sources: ROBOTIS e-Manual, docs/en/dxl/protocol1.md; Feetech, Smart Bus Servo Communication Protocol Manual, §1.3.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final, Protocol

from deploy.virtual import protocol1 as p1
from deploy.virtual.bus import BITS_PER_BYTE, Answer, BusServo, Framing

_STATUS_BYTES: Final = 6


class Protocol1Servo(BusServo, Protocol):
    """Give the line what it needs to know of a servo with protocol 1 framing."""

    id: int
    return_delay_ns: int
    sync_read: bool
    """Whether it knows sync reads."""
    takes_turns: bool
    """Whether it answers a broadcast ping after those with smaller ids rather than at once."""

    def answer(self, packet: p1.Packet, now_ns: int) -> bytes | None:
        """Carry out a packet; return the status packet, or None for silence."""
        ...

    def answer_sync_read(self, address: int, length: int, now_ns: int) -> bytes:
        """Return the status packet of this servo's part of a sync read."""
        ...

    def write(self, address: int, data: bytes, now_ns: int) -> int:
        """Write registers; return error bits."""
        ...


def carry_out(packet: p1.Packet, present: Sequence[Protocol1Servo], now_ns: int) -> Iterator[Answer]:
    """Let servos carry out a packet; yield what they send.

    Args:
        packet: what the master sent
        present: all servos that hear it
        now_ns: when it ended [ns]
    """
    if packet.id != p1.BROADCAST:
        yield from _together([servo for servo in present if servo.id == packet.id], packet, now_ns)
    elif not packet.sound:
        return
    elif packet.instruction == p1.SYNC_READ:
        yield from _sync_read(packet.parameters, present, now_ns)
    elif packet.instruction == p1.SYNC_WRITE:
        _sync_write(packet.parameters, present, now_ns)
    elif packet.instruction == p1.PING:
        yield from _together([servo for servo in present if not servo.takes_turns], packet, now_ns)
        for servo in sorted((servo for servo in present if servo.takes_turns), key=lambda servo: servo.id):
            yield from _together([servo], packet, now_ns)
    else:
        for servo in present:
            servo.answer(packet, now_ns)


PROTOCOL1: Final = Framing(p1.PacketParser, carry_out)


def _together(asked: Sequence[Protocol1Servo], packet: p1.Packet, now_ns: int) -> Iterator[Answer]:
    """Let servos answer at one time, which only survives if they say the same."""
    delay_ns = max((servo.return_delay_ns for servo in asked), default=0)
    frames = [frame for servo in asked if (frame := servo.answer(packet, now_ns))]
    if frames:
        yield Answer(delay_ns, frames)


def _sync_read(parameters: bytes, present: Sequence[Protocol1Servo], now_ns: int) -> Iterator[Answer]:
    """Let the servos answer in the order of the ids.

    The manual does not say what a servo does whose predecessor stays silent: here it speaks when the packet that it
    waits for would have ended, as feetech-cli 0.1.8 and the parser of ftservo-python-sdk 2.0 expect.
    """
    if len(parameters) < 3 or not 0 < parameters[1] <= p1.DATA_MAX:
        return
    address, length = parameters[0], parameters[1]
    missing_ns = 0
    for identity in parameters[2:]:
        asked = [servo for servo in present if servo.id == identity and servo.sync_read]
        if asked:
            frames = [servo.answer_sync_read(address, length, now_ns) for servo in asked]
            delay_ns = max(servo.return_delay_ns for servo in asked)
            yield Answer(missing_ns + delay_ns, frames, follows=True)
            missing_ns = 0
        elif present:
            missing_ns += (_STATUS_BYTES + length) * BITS_PER_BYTE * 1_000_000_000 // present[0].baud


def _sync_write(parameters: bytes, present: Sequence[Protocol1Servo], now_ns: int) -> None:
    """Let each servo write its part; nobody answers, not even who refuses."""
    if len(parameters) < 3:
        return
    address, length, rest = parameters[0], parameters[1], parameters[2:]
    if length == 0 or len(rest) % (length + 1):
        return
    for start in range(0, len(rest), length + 1):
        for servo in present:
            if servo.id == rest[start]:
                servo.write(address, rest[start + 1 : start + 1 + length], now_ns)
