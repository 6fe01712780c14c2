"""The half-duplex line between a master and virtual servos: who hears, when who speaks, and what the line does to it.

Which servo answers what, and in which order, is the protocol's: a `Framing`. All times are whole nanoseconds, so that
the same bytes in give the same bytes out. A byte takes ten bits. What several servos send queues on the line; what is
sent over another's bytes destroys both.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final, Generic, NamedTuple, Protocol, TypeVar

BITS_PER_BYTE: Final = 10
GAP_NS: Final = 50_000_000
"""A packet whose next byte takes longer than this is abandoned. The manuals give no number: an estimate."""

_SLACK_NS: Final = 1000  # times come as float seconds
_GARBLE: Final = 0xAA  # two senders pull bits down


class Answer(NamedTuple):
    """Say what goes onto the line next.

    Args:
        delay_ns: how long who answers waits first [ns]
        frames: what is sent at once: one frame, or those of several servos with one id
        follows: whether the delay starts when the answer before this one has ended; else, when the question has
    """

    delay_ns: int
    frames: Sequence[bytes]
    follows: bool = False


class BusServo(Protocol):
    """Give the line what it needs to know of a servo, whatever the servo speaks."""

    baud: int

    def silent(self, now_ns: int) -> bool:
        """Return whether the servo neither hears nor answers now."""
        ...

    def hear(self, now_ns: int) -> None:
        """Note that a packet was on the line, for whomever."""
        ...


PacketT = TypeVar("PacketT")
ServoT = TypeVar("ServoT", bound=BusServo)


class Parser(Protocol[PacketT]):
    """Cut a stream of bytes into packets."""

    @property
    def waiting(self) -> int:
        """Return how many bytes wait for the rest of their packet."""
        ...

    def feed(self, data: bytes) -> list[PacketT]:
        """Take what has arrived; return the packets that ended in it."""
        ...

    def abandon(self) -> None:
        """Forget a packet whose rest did not come."""
        ...


@dataclass(frozen=True)
class Framing(Generic[PacketT, ServoT]):
    """Hold a protocol: its packets, and its rules of who answers them.

    Args:
        parser: makes a parser of the master's bytes
        carry_out: lets servos that hear a packet carry it out, given the time when it ended [ns]; yields what they
            send, in the order in which they do. A frame is asked for when it is its turn, not when it goes out
    """

    parser: Callable[[], Parser[PacketT]]
    carry_out: Callable[[PacketT, Sequence[ServoT], int], Iterable[Answer]]


class VirtualBus(Generic[PacketT, ServoT]):
    """Carry bytes between one master and the servos.

    Args:
        servos: all that hang on the line
        baud: bits per second of the master
        dead: tells whether a servo, by its place in `servos`, is without power or connection
        lose: what the line does to a status packet: returns it, changed or not, or None if it does not arrive
        framing: the protocol of the line
        wire_time: whether bytes take time; without, whole packets pass at once, and nothing collides
        echo: whether the master hears its own bytes, as through an adapter that joins both directions
    """

    def __init__(
        self,
        servos: Sequence[ServoT],
        baud: int,
        dead: Callable[[int], bool],
        lose: Callable[[bytes], bytes | None],
        framing: Framing[PacketT, ServoT],
        *,
        wire_time: bool = True,
        echo: bool = False,
    ) -> None:
        self.baud = baud
        self.servos = servos
        self._dead = dead
        self._lose = lose
        self._carry_out = framing.carry_out
        self._parser = framing.parser()
        self._wire_time = wire_time
        self._echo = echo
        self._heard_ns = 0
        self._free_ns = 0
        self._replies: deque[tuple[int, int, bytes]] = deque()  # (first byte starts, last byte has ended, bytes)

    def duration_ns(self, nbyte: int) -> int:
        """Return how long bytes are on the line [ns].

        Args:
            nbyte: how many
        """
        return nbyte * BITS_PER_BYTE * 1_000_000_000 // self.baud if self._wire_time else 0

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
        collided = self._collides(start_ns, end_ns)
        if self._echo and data:
            self._replies.append((start_ns, end_ns, data))
        if collided:
            self._parser.abandon()
            return
        for packet in self._parser.feed(data):
            self._pass(packet, end_ns)

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

    def _pass(self, packet: PacketT, now_ns: int) -> None:
        """Let everybody who can hear a packet do so, and put on the line what they answer."""
        present = [
            servo
            for index, servo in enumerate(self.servos)
            if servo.baud == self.baud and not self._dead(index) and not servo.silent(now_ns)
        ]
        for servo in present:
            servo.hear(now_ns)
        turn_ns = now_ns
        for answer in self._carry_out(packet, present, now_ns):
            turn_ns = self._send(answer.frames, (turn_ns if answer.follows else now_ns) + answer.delay_ns)

    def _send(self, frames: Sequence[bytes], start_ns: int) -> int:
        """Put a status packet on the line, as soon as it is free; return when it ends [ns]."""
        reply = frames[0]
        for other in frames[1:]:
            # two servos with one id pull the line down together
            reply = bytes(a & b for a, b in zip(reply, other, strict=False))
        first_ns = max(start_ns, self._free_ns)
        self._free_ns = first_ns + self.duration_ns(len(reply))
        self._replies.append((first_ns, self._free_ns, self._lose(reply) or b""))
        return self._free_ns
