"""The half-duplex line between a master and virtual servos: who answers, when, and what the line does to it.

All times are whole nanoseconds, so that the same bytes in give the same bytes out. A byte takes ten bits. What several
servos send queues on the line; what is sent over another's bytes destroys both.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from typing import Final

from deploy.virtual import dynamixel2 as dxl
from deploy.virtual.servo import VirtualServo

BITS_PER_BYTE: Final = 10
GAP_NS: Final = 50_000_000
"""A packet whose next byte takes longer than this is abandoned. The manual gives no number: an estimate."""

_SLACK_NS: Final = 1000  # times come as float seconds
_GARBLE: Final = 0xAA  # two senders pull bits down


class VirtualBus:
    """Carry bytes between one master and the servos.

    Args:
        servos: all that hang on the line
        baud: bits per second of the master
        dead: tells whether a servo, by its place in `servos`, is without power or connection
        lose: what the line does to a status packet: returns it, changed or not, or None if it does not arrive
    """

    def __init__(
        self,
        servos: Sequence[VirtualServo],
        baud: int,
        dead: Callable[[int], bool],
        lose: Callable[[bytes], bytes | None],
    ) -> None:
        self.baud = baud
        self.servos = servos
        self._dead = dead
        self._lose = lose
        self._parser = dxl.PacketParser()
        self._heard_ns = 0
        self._free_ns = 0
        self._replies: deque[tuple[int, int, bytes]] = deque()  # (first byte starts, last byte has ended, bytes)

    def duration_ns(self, nbyte: int) -> int:
        """Return how long bytes are on the line [ns].

        Args:
            nbyte: how many
        """
        return nbyte * BITS_PER_BYTE * 1_000_000_000 // self.baud

    def feed(self, data: bytes, end_ns: int) -> None:
        """Take bytes from the master.

        Args:
            data: any bytes
            end_ns: when the last one has ended [ns]
        """
        start_ns = end_ns - self.duration_ns(len(data))
        if self._parser.waiting and start_ns - self._heard_ns > GAP_NS:
            self._parser.abandon()
        self._heard_ns = end_ns
        if self._collides(start_ns, end_ns):
            self._parser.abandon()
            return
        for packet in self._parser.feed(data):
            self._carry_out(packet, end_ns)

    def take_replies(self, until_ns: int) -> list[tuple[int, bytes]]:
        """Return what has ended on the line by a time: (end [ns], bytes), in order.

        Args:
            until_ns: time [ns]
        """
        taken: list[tuple[int, bytes]] = []
        while self._replies and self._replies[0][1] <= until_ns:
            _, end_ns, reply = self._replies.popleft()
            if reply:
                taken.append((end_ns, reply))
        return taken

    def next_ns(self) -> int | None:
        """Return when the next reply ends, or None if there is none [ns]."""
        return next((end_ns for _, end_ns, reply in self._replies if reply), None)

    def _collides(self, start_ns: int, end_ns: int) -> bool:
        """Destroy the replies that the master talks over; return whether there is one."""
        collided = False
        for index, (first_ns, last_ns, reply) in enumerate(self._replies):
            if start_ns < last_ns - _SLACK_NS and end_ns > first_ns + _SLACK_NS:
                self._replies[index] = (first_ns, last_ns, bytes(byte & _GARBLE for byte in reply))
                collided = True
        return collided

    def _carry_out(self, packet: dxl.Packet, now_ns: int) -> None:
        listening = [
            (index, servo)
            for index, servo in enumerate(self.servos)
            if servo.baud == self.baud and not self._dead(index) and not servo.silent(now_ns)
        ]
        for _, servo in listening:
            servo.hear(now_ns)
        present = [servo for _, servo in listening]
        if packet.id == dxl.BROADCAST and packet.instruction == dxl.SYNC_READ:
            self._sync_read(packet.parameters, present, now_ns)
        elif packet.id == dxl.BROADCAST and packet.instruction == dxl.SYNC_WRITE:
            _sync_write(packet.parameters, present, now_ns)
        elif packet.id == dxl.BROADCAST:
            for servo in sorted(present, key=lambda servo: servo.id):
                self._send([servo.answer(packet, now_ns)], now_ns + servo.return_delay_ns)
        else:
            addressed = [servo for servo in present if servo.id == packet.id]
            delays = [servo.return_delay_ns for servo in addressed]
            answers = [servo.answer(packet, now_ns) for servo in addressed]
            self._send(answers, now_ns + max(delays, default=0))

    def _sync_read(self, parameters: bytes, present: Sequence[VirtualServo], now_ns: int) -> None:
        """Let the servos answer in the order of the ids, each after the packet of the one before it.

        A servo that does not hear its predecessor waits for it in vain: all after a silent one stay silent.
        All measure when the question has ended, not when their turn comes.
        """
        if len(parameters) < 5:
            return
        address = parameters[0] | parameters[1] << 8
        length = parameters[2] | parameters[3] << 8
        turn_ns = now_ns
        for identity in parameters[4:]:
            asked = [servo for servo in present if servo.id == identity]
            answers = [servo.answer_sync_read(address, length, now_ns) for servo in asked]
            if not any(answers):
                return
            turn_ns = self._send(answers, turn_ns + max(servo.return_delay_ns for servo in asked))

    def _send(self, answers: Iterable[bytes | None], start_ns: int) -> int:
        """Put a status packet on the line, as soon as it is free; return when it ends [ns]."""
        sent = [answer for answer in answers if answer]
        if not sent:
            return start_ns
        reply = sent[0]
        for other in sent[1:]:
            # two servos with one id pull the line down together
            reply = bytes(a & b for a, b in zip(reply, other, strict=False))
        first_ns = max(start_ns, self._free_ns)
        self._free_ns = first_ns + self.duration_ns(len(reply))
        self._replies.append((first_ns, self._free_ns, self._lose(reply) or b""))
        return self._free_ns


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
