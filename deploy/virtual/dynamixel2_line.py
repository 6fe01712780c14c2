"""Dynamixel 2.0 on the line: which servo carries out a packet, who answers, and in which order.

Source: ROBOTIS e-Manual, docs/en/dxl/protocol2.md; secondary id: _includes/en/dxl/control_table_shadowid.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Final, NamedTuple

from deploy.virtual import dynamixel2 as dxl
from deploy.virtual.bus import Answer, Framing
from deploy.virtual.x_servo import XServo


class Part(NamedTuple):
    """Say what one servo is asked or told by a sync or bulk packet.

    Args:
        id: which servo
        address: first byte
        length: bytes
        data: what is written there
    """

    id: int
    address: int
    length: int
    data: bytes = b""


def carry_out(packet: dxl.Packet, present: Sequence[XServo], now_ns: int) -> Iterator[Answer]:
    """Let servos carry out a packet; yield what they send.

    Args:
        packet: what the master sent
        present: all servos that hear it
        now_ns: when it ended [ns]
    """
    instruction, parameters = packet.instruction, packet.parameters
    if packet.id != dxl.BROADCAST:
        yield from _addressed(packet, present, now_ns)
    elif instruction in (dxl.SYNC_READ, dxl.BULK_READ):
        yield from _in_turn(read_parts(instruction, parameters), present, now_ns)
    elif instruction in (dxl.FAST_SYNC_READ, dxl.FAST_BULK_READ):
        yield from _in_one(read_parts(instruction, parameters), present, now_ns)
    elif instruction in (dxl.SYNC_WRITE, dxl.BULK_WRITE):
        # nobody answers, not even who refuses
        for part in write_parts(instruction, parameters):
            for servo in present:
                if servo.id == part.id:
                    servo.write(part.address, part.data, now_ns)
    else:
        for servo in sorted(present, key=lambda servo: servo.id):
            answer = servo.answer(packet, now_ns)
            if answer:
                yield Answer(servo.return_delay_ns, (answer,))


DYNAMIXEL2: Final = Framing(dxl.PacketParser, carry_out)


def read_parts(instruction: int, parameters: bytes) -> Sequence[Part]:
    """Return whom a sync or bulk read asks for what, nobody if it is malformed.

    Args:
        instruction: one of the four reads
        parameters: of the packet
    """
    if instruction in (dxl.SYNC_READ, dxl.FAST_SYNC_READ):
        if len(parameters) < 5:
            return ()
        address, length = _two(parameters, 0), _two(parameters, 2)
        return tuple(Part(servo, address, length) for servo in parameters[4:])
    if len(parameters) % 5:
        return ()
    return tuple(
        Part(parameters[at], _two(parameters, at + 1), _two(parameters, at + 3)) for at in range(0, len(parameters), 5)
    )


def write_parts(instruction: int, parameters: bytes) -> Sequence[Part]:
    """Return whom a sync or bulk write tells what, nobody if it is malformed.

    Args:
        instruction: one of the two writes
        parameters: of the packet
    """
    parts: list[Part] = []
    synchronous = instruction == dxl.SYNC_WRITE
    at = 4 if synchronous else 0
    while at < len(parameters):
        block = parameters if synchronous else parameters[at + 1 : at + 5]
        first = at + (1 if synchronous else 5)
        if len(block) < 4:
            return ()
        length = _two(block, 2)
        data = parameters[first : first + length]
        if not length or len(data) < length:
            return ()
        parts.append(Part(parameters[at], _two(block, 0), length, data))
        at = first + length
    return parts


def _two(data: bytes, at: int) -> int:
    return data[at] | data[at + 1] << 8


def _addressed(packet: dxl.Packet, present: Sequence[XServo], now_ns: int) -> Iterator[Answer]:
    asked = [servo for servo in present if servo.id == packet.id]
    group = [servo for servo in present if servo.secondary_id == packet.id and servo.id != packet.id]
    delay_ns = max((servo.return_delay_ns for servo in asked), default=0)
    frames = [frame for servo in asked if (frame := servo.answer(packet, now_ns))]
    for servo in group:
        servo.obey(packet, now_ns)
    if frames:
        yield Answer(delay_ns, frames)


def _in_turn(parts: Iterable[Part], present: Sequence[XServo], now_ns: int) -> Iterator[Answer]:
    """Let the servos answer in the order of the ids, each after the packet of the one before it.

    A servo that does not hear its predecessor waits for it in vain: all after a silent one stay silent.
    All measure when the question has ended, not when their turn comes.
    """
    for part in parts:
        asked = [servo for servo in present if servo.id == part.id and servo.answers_reads]
        if not asked:
            return
        frames = []
        for servo in asked:
            error, data = servo.tell(part.address, part.length, now_ns)
            frames.append(dxl.encode_status(servo.id, error, data))
        yield Answer(max(servo.return_delay_ns for servo in asked), frames, follows=True)


def _in_one(parts: Sequence[Part], present: Sequence[XServo], now_ns: int) -> Iterator[Answer]:
    """Let the servos answer in one packet, to which each adds its part; where one is missing there is none.

    Two servos with one id add their parts at once, each with its own CRC.
    """
    first: list[tuple[int, int, bytes]] = []
    last: list[tuple[int, int, bytes]] = []
    delay_ns = 0
    for part in parts:
        asked = [servo for servo in present if servo.id == part.id and servo.answers_reads]
        if not asked:
            return
        told = []
        for servo in asked:
            error, data = servo.tell(part.address, part.length, now_ns)
            told.append((error, servo.id, data.ljust(part.length, b"\0")))
        delay_ns = delay_ns if first else max(servo.return_delay_ns for servo in asked)
        first.append(told[0])
        last.append(told[-1])
    if first and 1 + sum(4 + part.length for part in parts) <= dxl.FAST_LENGTH_MAX:
        frame = dxl.encode_fast(first)
        yield Answer(delay_ns, (frame,) if first == last else (frame, dxl.encode_fast(last)))
