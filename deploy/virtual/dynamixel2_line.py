"""Dynamixel 2.0 on the line: which servo carries out a packet, who answers, and in which order.

Source: ROBOTIS e-Manual, docs/en/dxl/protocol2.md; secondary id: _includes/en/dxl/control_table_shadowid.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from deploy.virtual import dynamixel2 as dxl
from deploy.virtual.bus import Answer, Framing
from deploy.virtual.servo import VirtualServo


def carry_out(packet: dxl.Packet, present: Sequence[VirtualServo], now_ns: int) -> Iterator[Answer]:
    """Let servos carry out a packet; yield what they send.

    Args:
        packet: what the master sent
        present: all servos that hear it
        now_ns: when it ended [ns]
    """
    if packet.id != dxl.BROADCAST:
        yield from _addressed(packet, present, now_ns)
    elif packet.instruction == dxl.SYNC_READ:
        yield from _sync_read(packet.parameters, present, now_ns)
    elif packet.instruction == dxl.SYNC_WRITE:
        _sync_write(packet.parameters, present, now_ns)
    else:
        for servo in sorted(present, key=lambda servo: servo.id):
            answer = servo.answer(packet, now_ns)
            if answer:
                yield Answer(servo.return_delay_ns, (answer,))


DYNAMIXEL2: Final = Framing(dxl.PacketParser, carry_out)


def _addressed(packet: dxl.Packet, present: Sequence[VirtualServo], now_ns: int) -> Iterator[Answer]:
    asked = [servo for servo in present if servo.id == packet.id]
    delay_ns = max((servo.return_delay_ns for servo in asked), default=0)
    frames = [frame for servo in asked if (frame := servo.answer(packet, now_ns))]
    if frames:
        yield Answer(delay_ns, frames)


def _sync_read(parameters: bytes, present: Sequence[VirtualServo], now_ns: int) -> Iterator[Answer]:
    """Let the servos answer in the order of the ids, each after the packet of the one before it.

    A servo that does not hear its predecessor waits for it in vain: all after a silent one stay silent.
    All measure when the question has ended, not when their turn comes.
    """
    if len(parameters) < 5:
        return
    address = parameters[0] | parameters[1] << 8
    length = parameters[2] | parameters[3] << 8
    for identity in parameters[4:]:
        asked = [servo for servo in present if servo.id == identity]
        frames = [frame for servo in asked if (frame := servo.answer_sync_read(address, length, now_ns))]
        if not frames:
            return
        yield Answer(max(servo.return_delay_ns for servo in asked), frames, follows=True)


def _sync_write(parameters: bytes, present: Sequence[VirtualServo], now_ns: int) -> None:
    """Let each servo write its part; nobody answers, not even who refuses."""
    if len(parameters) < 4:
        return
    address = parameters[0] | parameters[1] << 8
    length = parameters[2] | parameters[3] << 8
    rest = parameters[4:]
    if length == 0 or len(rest) % (length + 1):
        return
    for start in range(0, len(rest), length + 1):
        for servo in present:
            if servo.id == rest[start]:
                servo.write(address, rest[start + 1 : start + 1 + length], now_ns)
