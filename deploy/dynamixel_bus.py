"""Talk Dynamixel 2.0 through the unmodified vendor SDK, with a fence around each of its defects.

What SDK 4.1 does, and what stands here instead:

- It never stuffs what it sends: `_Protocol2.addStuffing` changes the packet that it was given.
- It drops a byte when it un-stuffs data with FF FF FD in it: `_Protocol2.removeStuffing` looks at what was received.
- It takes the CRC for data where an error reply has none: the length field decides, and `Reply.status` is "refused".
- One silent servo in a sync read voids every servo's data: one `Reply` for each id; see `DynamixelBus.sync_read`.
- A corrupt length swallows the replies behind it: the bytes are scanned again from the next header.
- `getData` gives 0, a legal position, where there is no data: `Reply.data` is empty.
- Sync read discards the status error: `Reply.error`, alert bit included.
- `is_using` stays set after an exception, or a send without a reply: it is released on every way out.
- A late reply answers the next question: see `_await_late_replies`.
- It waits busily and by the wall clock: see `deploy.port`.
"""

# The SDK chose some method names.
# ruff: noqa: N802

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final, Literal

from dynamixel_sdk.protocol2_packet_handler import Protocol2PacketHandler
from dynamixel_sdk.robotis_def import COMM_RX_CORRUPT, COMM_SUCCESS

from controller.errors import RunError
from controller.registers import Register
from deploy.port import SerialPort

ALERT: Final = 0x80
"""Bit of a status error that says: look at the hardware error status."""

ERROR_NUMBERS: Final = (
    "no error",
    "the servo could not carry it out",
    "unknown instruction",
    "CRC error",
    "value out of range",
    "wrong data length",
    "value beyond a limit",
    "register is read-only or locked",
)
"""What the number in a status error's low bits says. Source: e-Manual, protocol2.md, Error."""

HARDWARE_ERRORS: Final = {0: "input voltage", 2: "overheating", 3: "encoder", 4: "electrical shock", 5: "overload"}
"""Bits of the hardware error status. Source: e-Manual, X series, Hardware Error Status (70)."""

_STATUS_BYTES: Final = 11
_STUFFING_BYTES: Final = 2


@dataclass(frozen=True)
class Reply:
    """Hold what one servo answered.

    Args:
        id: servo id
        status: "data": as asked; "refused": an error number and no data; "missing": silence; "corrupt": bytes came,
            but no valid status packet
        data: the bytes read, empty unless status is "data"
        error: the status error byte, 0 if none came
        t: when the reply had been read, or was given up [s]
    """

    id: int
    status: Literal["data", "refused", "missing", "corrupt"]
    data: bytes
    error: int
    t: float

    @property
    def alert(self) -> bool:
        """Return whether the servo reports a hardware error."""
        return bool(self.error & ALERT)

    @property
    def refusal(self) -> str:
        """Return what the error number says."""
        number = self.error & ~ALERT
        return ERROR_NUMBERS[number] if number < len(ERROR_NUMBERS) else f"error {number}"


class BusError(RunError):
    """Report that a servo did not do what it was asked to."""


def decode(register: Register, data: bytes) -> int:
    """Return a register's count.

    Args:
        register: the register
        data: its bytes, little endian
    """
    return int.from_bytes(data, "little", signed=register.signed)


def encode(register: Register, value: int) -> bytes:
    """Return a register's bytes.

    Args:
        register: the register
        value: its count
    """
    return (value % (1 << (8 * register.size))).to_bytes(register.size, "little")


class _Protocol2(Protocol2PacketHandler):
    """The SDK's packets with their byte stuffing put right."""

    def addStuffing(self, packet: list[int]) -> list[int]:
        length = packet[5] | packet[6] << 8
        stuffed: list[int] = []
        for byte in packet[7 : 7 + length - 2]:
            stuffed.append(byte)
            if stuffed[-3:] == [0xFF, 0xFF, 0xFD]:
                stuffed.append(0xFD)
        packet[7:] = [*stuffed, 0, 0]
        packet[5], packet[6] = (len(stuffed) + 2) & 0xFF, (len(stuffed) + 2) >> 8
        return packet

    def removeStuffing(self, packet: list[int]) -> list[int]:
        length = packet[5] | packet[6] << 8
        body, crc = packet[7 : 7 + length - 2], packet[7 + length - 2 : 7 + length]
        plain: list[int] = []
        index = 0
        while index < len(body):
            plain.append(body[index])
            stuffed = body[index : index + 2] == [0xFD, 0xFD] and body[max(0, index - 2) : index] == [0xFF, 0xFF]
            index += 2 if stuffed else 1
        packet[7:] = [*plain, *crc]
        packet[5], packet[6] = (len(plain) + 2) & 0xFF, (len(plain) + 2) >> 8
        return packet


class DynamixelBus:
    """Read and write the registers of Dynamixel 2.0 servos on one port.

    Args:
        port: the open port; the bus closes it
        return_delay_s: how long a servo waits before it replies [s]
    """

    def __init__(self, port: SerialPort, return_delay_s: float = 0.0) -> None:
        self.port = port
        self.return_delay_s = return_delay_s
        self._sdk: Protocol2PacketHandler = _Protocol2()
        self._late: dict[tuple[int, int], float] = {}
        self._silent: set[int] = set()

    def close(self) -> None:
        """Close the port."""
        self.port.closePort()

    def ping(self, servo: int) -> tuple[Reply, int]:
        """Ask a servo whether it is there.

        Args:
            servo: id

        Returns:
            its reply and its model number, 0 if there is no reply
        """
        packet = [0] * 10
        packet[4:8] = [servo, 3, 0, 0x01]
        reply = self._ask(servo, packet, 3)
        return reply, int.from_bytes(reply.data[:2], "little")

    def read(self, servo: int, address: int, length: int) -> Reply:
        """Read a block of registers.

        Args:
            servo: id
            address: first byte
            length: bytes
        """
        with self._transaction():
            self._await_late_replies([servo], length)
            if self._sdk.readTx(self.port, servo, address, length) != COMM_SUCCESS:
                return Reply(servo, "missing", b"", 0, self.port.now())
            return self._receive([servo], length)[servo]

    def write(self, servo: int, address: int, data: bytes) -> Reply:
        """Write a block of registers.

        Args:
            servo: id
            address: first byte
            data: what to write

        Returns:
            the reply; status "data" with no bytes if it was accepted
        """
        with self._transaction():
            self._await_late_replies([servo], 0)
            if self._sdk.writeTxOnly(self.port, servo, address, len(data), list(data)) != COMM_SUCCESS:
                return Reply(servo, "missing", b"", 0, self.port.now())
            return self._receive([servo], 0)[servo]

    def reboot(self, servo: int) -> Reply:
        """Reboot a servo: the only way out of a hardware error.

        Args:
            servo: id
        """
        packet = [0] * 10
        packet[4:8] = [servo, 3, 0, 0x08]
        return self._ask(servo, packet, 0)

    def sync_read(self, servos: Sequence[int], address: int, length: int) -> dict[int, Reply]:
        """Read the same block of several servos with one question; each servo's reply stands for itself.

        Servos answer in the order of the question, each after the one before it, so a silent servo silences all behind
        it. Those are asked once more without it, and from then on it is asked last, where it keeps nobody waiting.

        Args:
            servos: ids
            address: first byte
            length: bytes

        Returns:
            id => reply, for every id
        """
        order = [servo for servo in servos if servo not in self._silent]
        order += [servo for servo in servos if servo in self._silent]
        with self._transaction():
            self._await_late_replies(servos, length)
        replies = self._sync_read_once(order, address, length)
        answered = [index for index, servo in enumerate(order) if replies[servo].status != "missing"]
        first_silent = answered[-1] + 1 if answered else 0
        behind = order[first_silent + 1 :]
        if any(servo not in self._silent for servo in behind):
            self._silent.add(order[first_silent])
            replies |= self._sync_read_once(behind, address, length)
        self._silent -= {servo for servo, reply in replies.items() if reply.status != "missing"}
        return {servo: replies[servo] for servo in servos}

    def sync_write(self, address: int, values: Mapping[int, bytes]) -> bool:
        """Write the same registers of several servos with one packet; nobody replies.

        Args:
            address: first byte
            values: id => bytes, all of the same length

        Returns:
            whether it was sent
        """
        length = len(next(iter(values.values())))
        parameters = [byte for servo, data in values.items() for byte in (servo, *data)]
        with self._transaction():
            sent = self._sdk.syncWriteTxOnly(self.port, address, length, parameters, len(parameters))
            return bool(sent == COMM_SUCCESS)

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
        return decode(register, reply.data)

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
        reply = self._retry(attempts, lambda: self.write(servo, register.address, encode(register, value)))
        if reply.status == "refused":
            raise self._error(reply, f"writing {value} to {register.name}")
        held = self.read_register(servo, register, attempts)
        if held != value:
            raise BusError(
                f"servo {servo} on {self.port.label}: {register.name} reads {held} after {value} was written; "
                "switch the servo off and on and try again"
            )

    def _sync_read_once(self, servos: Sequence[int], address: int, length: int) -> dict[int, Reply]:
        with self._transaction():
            sent = self._sdk.syncReadTx(self.port, address, length, list(servos), len(servos), False)
            if sent != COMM_SUCCESS:
                return {servo: Reply(servo, "missing", b"", 0, self.port.now()) for servo in servos}
            return self._receive(servos, length)

    def _ask(self, servo: int, packet: list[int], length: int) -> Reply:
        with self._transaction():
            self._await_late_replies([servo], length)
            if self._sdk.txPacket(self.port, packet) != COMM_SUCCESS:
                return Reply(servo, "missing", b"", 0, self.port.now())
            return self._receive([servo], length)[servo]

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        self.port.is_using = False
        try:
            yield
        finally:
            self.port.is_using = False
            if self.port.is_open:
                self.port.end_transaction()

    def _await_late_replies(self, servos: Sequence[int], length: int) -> None:
        # The protocol numbers nothing: a late reply of equal length would pass for the answer. Wait until none comes.
        late = [self._late.pop((servo, length), 0.0) for servo in servos]
        until = max(late)
        missing = sum(_STATUS_BYTES + length for t in late if t > 0.0)
        while missing > 0 and self.port.now() < until:
            if self.port.wait(until):
                missing -= self.port.drop_waiting()

    def _receive(self, servos: Sequence[int], length: int) -> dict[int, Reply]:
        """Collect the replies of servos, of length data bytes each, until all, the last one, or the deadline."""
        port = self.port
        port.expect(len(servos) * (_STATUS_BYTES + length + _STUFFING_BYTES), len(servos), self.return_delay_s)
        late = port.now() + 2.0 * port.latency_s
        replies: dict[int, Reply] = {}
        corrupt = False
        while len(replies) < len(servos):
            packet, result = self._sdk.rxPacket(port, False)
            if result == COMM_SUCCESS:
                reply = _parse(packet, length, port.now())
                if reply and reply.id in servos and reply.id not in replies:
                    replies[reply.id] = reply
                    if reply.id == servos[-1]:
                        break  # replies come in the order of the question: who has not answered by now will not
            elif result == COMM_RX_CORRUPT:
                corrupt = True
                port.put_back(bytes(packet[1:]))
            else:
                break
        port.drop_read()
        for servo in servos:
            if servo not in replies:
                replies[servo] = Reply(servo, "corrupt" if corrupt else "missing", b"", 0, port.now())
                self._late[servo, length] = late
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


def _parse(packet: list[int], length: int, t: float) -> Reply | None:
    """Return the reply in an un-stuffed status packet, or None if it answers another question."""
    ndata = (packet[5] | packet[6] << 8) - 4
    if ndata < 0:
        return None
    servo, error = packet[4], packet[8]
    if error & ~ALERT:
        return Reply(servo, "refused", b"", error, t)
    return Reply(servo, "data", bytes(packet[9 : 9 + ndata]), error, t) if ndata == length else None
