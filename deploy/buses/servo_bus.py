"""Read and write the registers of servos on one port: what is the same in every protocol, and what each must bring.

A protocol's bus sends through an unmodified vendor SDK and fences that SDK's defects. What is here fences those that
the SDKs share:

- One silent servo in a sync read voids every servo's data: one `Reply` for each id; see `ServoBus.sync_read`.
- A corrupt length swallows the replies behind it: the bytes are scanned again from the next header.
- `getData` gives 0, a legal position, where there is no data: `Reply.data` is empty.
- Sync read discards the status error: `Reply.error` and `Reply.alert`.
- `is_using` stays set after an exception, or a send without a reply: it is released on every way out.
- A late reply answers the next question: see `ServoBus._unlike_late`.
- They wait busily and by the wall clock: see `deploy.buses.port`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import ClassVar, Final, Literal

from controller.errors import RunError
from controller.register import Register, decode_register, encode_register
from deploy.buses.port import SerialPort

LATE_S_MAX: Final = 0.25
"""A reply that has not come by then will not come: longer than any adapter holds bytes back. An estimate."""

_LENGTHS: Final = 8
"""Lengths that the same data may be asked for in."""


@dataclass(frozen=True)
class Reply:
    """Hold what one servo answered.

    Args:
        id: servo id
        status: "data": as asked; "refused": an error and no data; "missing": silence; "corrupt": bytes came, but no
            valid status packet
        data: the bytes read, empty unless status is "data"
        error: the status error byte, 0 if none came
        t: when the reply had been read, or was given up [s]
        alert: whether the servo reports that something is wrong with it, rather than with the question
        refusal: what the servo says of the question, "" if nothing
        late: whether it is missing, but since it was last asked something came that answers an earlier question
    """

    id: int
    status: Literal["data", "refused", "missing", "corrupt"]
    data: bytes
    error: int
    t: float
    alert: bool = False
    refusal: str = ""
    late: bool = False


class BusError(RunError):
    """Report that a servo did not do what it was asked to."""


class ServoBus(ABC):
    """Read and write the registers of servos on one port.

    Args:
        port: the open port; the bus closes it
        return_delay_s: how long a servo waits before it replies [s]
    """

    status_bytes: ClassVar[int]
    """Bytes of a status packet without data."""
    stuffing_bytes: ClassVar[int]
    """Bytes that stuffing may add to one; an estimate that only moves deadlines."""
    has_sync_read: bool
    """Whether one question can ask several servos; else they are asked one by one."""

    def __init__(self, port: SerialPort, return_delay_s: float = 0.0) -> None:
        self.port = port
        self.return_delay_s = return_delay_s
        self._lost = [-math.inf] * _LENGTHS  # when a reply was last lost, by its length modulo these
        self._silent: set[int] = set()
        self._strays: dict[int, int] = {}

    def close(self) -> None:
        """Close the port."""
        self.port.closePort()

    # what each protocol brings: it sends, and makes sense of what comes

    @abstractmethod
    def ping(self, servo: int) -> tuple[Reply, int]:
        """Ask a servo whether it is there.

        Args:
            servo: id

        Returns:
            its reply and its model number, 0 if there is no reply
        """

    @abstractmethod
    def reboot(self, servo: int) -> Reply | None:
        """Reboot a servo: the only way out of some hardware errors.

        Args:
            servo: id

        Returns:
            its reply, or None where the protocol knows no reboot
        """

    @abstractmethod
    def _send_read(self, servo: int, address: int, length: int) -> bool:
        """Send a read; return whether it went out, as all that send do."""

    @abstractmethod
    def _send_write(self, servo: int, address: int, data: bytes) -> bool: ...

    @abstractmethod
    def _send_sync_read(self, servos: Sequence[int], address: int, length: int) -> bool: ...

    @abstractmethod
    def _send_sync_write(self, address: int, values: Mapping[int, bytes]) -> bool: ...

    @abstractmethod
    def _next_packet(self) -> tuple[Literal["packet", "corrupt", "none"], list[int]]:
        """Return the next status packet, or the bytes that hold none, or that none comes by the deadline."""

    @abstractmethod
    def _parse(self, packet: list[int], length: int, t: float) -> Reply | None:
        """Return the reply in a status packet to a question for length bytes, None if it answers another one."""

    # transactions

    def read(self, servo: int, address: int, length: int) -> Reply:
        """Read a block of registers.

        Args:
            servo: id
            address: first byte
            length: bytes
        """
        asked = self._unlike_late(length)
        reply = self._ask(servo, asked, lambda: self._send_read(servo, address, asked))
        if reply.status == "refused" and asked != length:  # there is nothing behind the block
            reply = self._ask(servo, length, lambda: self._send_read(servo, address, length))
        return _shortened(reply, length)

    def write(self, servo: int, address: int, data: bytes) -> Reply:
        """Write a block of registers.

        Args:
            servo: id
            address: first byte
            data: what to write

        Returns:
            the reply; status "data" with no bytes if it was accepted
        """
        return self._ask(servo, 0, lambda: self._send_write(servo, address, data))

    def sync_read(self, servos: Sequence[int], address: int, length: int) -> dict[int, Reply]:
        """Read the same block of several servos, with one question where they know such; each reply stands for itself.

        Servos answer in the order of the question, each after the one before it, so a silent servo silences all behind
        it. Those are asked once more without it, and from then on it is asked last, where it keeps nobody waiting.

        Args:
            servos: ids
            address: first byte
            length: bytes

        Returns:
            id => reply, for every id
        """
        if not self.has_sync_read:
            return {servo: self.read(servo, address, length) for servo in servos}
        order = [servo for servo in servos if servo not in self._silent]
        order += [servo for servo in servos if servo in self._silent]
        replies = self._sync_read_once(order, address, length)
        answered = [index for index, servo in enumerate(order) if replies[servo].status != "missing"]
        first_silent = answered[-1] + 1 if answered else 0
        behind = order[first_silent + 1 :]
        if behind and order[first_silent] not in self._silent:
            self._silent.add(order[first_silent])
            replies |= self._sync_read_once(behind, address, length)
        return {servo: replies[servo] for servo in servos}

    def sync_write(self, address: int, values: Mapping[int, bytes]) -> bool:
        """Write the same registers of several servos with one packet; nobody replies.

        Args:
            address: first byte
            values: id => bytes, all of the same length

        Returns:
            whether it was sent
        """
        with self._transaction():
            return self._send_sync_write(address, values)

    def read_register(self, servo: int, register: Register, attempts: int = 3) -> int:
        """Read one register, again if the reply is lost.

        Args:
            servo: id
            register: what to read
            attempts: how often to try

        Returns:
            its count

        Raises:
            BusError: if the servo does not answer or refuses
        """
        reply = self._retry(attempts, lambda: self.read(servo, register.address, register.size))
        if reply.status != "data":
            raise self._error(reply, f"reading {register.name}")
        return decode_register(register, reply.data)

    def write_register(self, servo: int, register: Register, value: int, attempts: int = 3) -> None:
        """Write one register and read it back.

        Args:
            servo: id
            register: what to write
            value: count
            attempts: how often to try

        Raises:
            BusError: if the servo does not answer, refuses, or holds another value afterwards
        """
        reply = self._retry(attempts, lambda: self.write(servo, register.address, encode_register(register, value)))
        if reply.status == "refused":
            raise self._error(reply, f"writing {value} to {register.name}")
        held = self.read_register(servo, register, attempts)
        if held != value:
            raise BusError(
                f"servo {servo} on {self.port.label}: {register.name} reads {held} after {value} was written; "
                "switch the servo off and on and try again"
            )

    # inside

    def _ask(self, servo: int, length: int, send: Callable[[], bool]) -> Reply:
        with self._transaction():
            if not send():
                return Reply(servo, "missing", b"", 0, self.port.now())
            return self._receive([servo], length)[servo]

    def _sync_read_once(self, servos: Sequence[int], address: int, length: int) -> dict[int, Reply]:
        asked = self._unlike_late(length)
        with self._transaction():
            if not self._send_sync_read(servos, address, asked):
                return {servo: Reply(servo, "missing", b"", 0, self.port.now()) for servo in servos}
            replies = self._receive(servos, asked)
        return {servo: _shortened(reply, length) for servo, reply in replies.items()}

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        self.port.is_using = False
        try:
            yield
        finally:
            self.port.is_using = False
            if self.port.is_open:
                self.port.end_transaction()

    def _unlike_late(self, length: int) -> int:
        """Return how many bytes to ask for, so that no reply that is still missing could pass for the answer.

        The protocols number nothing, but a reply has the length that was asked for: after a lost reply the next
        questions ask for other lengths.
        """
        expired = self.port.now() - LATE_S_MAX
        lengths = range(length, length + _LENGTHS)
        return min(lengths, key=lambda asked: max(self._lost[asked % _LENGTHS], expired))

    def _receive(self, servos: Sequence[int], length: int) -> dict[int, Reply]:
        """Collect the replies of servos, of length data bytes each, until all, the last one, or the deadline."""
        port = self.port
        nbyte = self.status_bytes + length + self.stuffing_bytes
        port.expect(len(servos) * nbyte, len(servos), self.return_delay_s)
        replies: dict[int, Reply] = {}
        corrupt = False
        while len(replies) < len(servos):
            result, packet = self._next_packet()
            if result == "packet":
                reply = self._parse(packet, length, port.now())
                if reply is None:
                    port.strays += len(packet)
                elif reply.id in servos and reply.id not in replies:
                    replies[reply.id] = reply
                    self._silent.discard(reply.id)
                    if reply.id == servos[-1]:
                        break  # replies come in the order of the question: who has not answered by now will not
            elif result == "corrupt":
                corrupt = True
                port.put_back(bytes(packet[1:]))
            else:
                break
        port.drop_read()
        for servo in servos:
            if servo not in replies:
                status: Literal["corrupt", "missing"] = "corrupt" if corrupt else "missing"
                late = not corrupt and port.strays > self._strays.get(servo, 0)
                replies[servo] = Reply(servo, status, b"", 0, port.now(), late=late)
                self._lost[length % _LENGTHS] = port.now()
            self._strays[servo] = port.strays
        return replies

    def _retry(self, attempts: int, transaction: Callable[[], Reply]) -> Reply:
        for _ in range(attempts - 1):
            reply = transaction()
            if reply.status in ("data", "refused"):
                return reply
        return transaction()

    def _error(self, reply: Reply, doing: str) -> BusError:
        said = {
            "missing": "did not answer; check its power, cable and id",
            "corrupt": "answered with corrupt packets only; check cables, ground and other masters on the bus",
            "refused": f"refused: {reply.refusal}",
        }[reply.status]
        return BusError(f"servo {reply.id} on {self.port.label}: {doing}, it {said}")


def _shortened(reply: Reply, length: int) -> Reply:
    return replace(reply, data=reply.data[:length]) if len(reply.data) > length else reply
