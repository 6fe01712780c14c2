"""Dynamixel 2.0 packets: CRC, byte stuffing, and a parser that finds its way back from any bytes.

Source: ROBOTIS e-Manual, docs/en/dxl/protocol2.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

PING: Final = 0x01
READ: Final = 0x02
WRITE: Final = 0x03
REG_WRITE: Final = 0x04
ACTION: Final = 0x05
FACTORY_RESET: Final = 0x06
REBOOT: Final = 0x08
CLEAR: Final = 0x10
BACKUP: Final = 0x20
STATUS: Final = 0x55
SYNC_READ: Final = 0x82
SYNC_WRITE: Final = 0x83
FAST_SYNC_READ: Final = 0x8A
BULK_READ: Final = 0x92
BULK_WRITE: Final = 0x93
FAST_BULK_READ: Final = 0x9A

BROADCAST: Final = 0xFE
ID_MAX: Final = 0xFC

RESULT_FAIL: Final = 1
INSTRUCTION_ERROR: Final = 2
DATA_RANGE_ERROR: Final = 4
DATA_LENGTH_ERROR: Final = 5
DATA_LIMIT_ERROR: Final = 6
ACCESS_ERROR: Final = 7
ALERT: Final = 0x80

LENGTH_MAX: Final = 1024
"""Largest length field that is taken for one: more can only be noise, and waiting for it would deafen the bus."""

FAST_LENGTH_MAX: Final = 65535
"""Largest length field there is."""

_HEADER: Final = b"\xff\xff\xfd"
_STUFFED: Final = b"\xff\xff\xfd\xfd"
_PREFIX_BYTES: Final = 7  # header, reserved, id, length


class Packet(NamedTuple):
    """Hold one packet as it was meant: without stuffing.

    Args:
        id: of the servo that is asked, or that answers
        instruction: what is asked, or `STATUS`
        parameters: what follows the instruction; of a status packet first the error byte
        end: bytes of the stream up to and with this packet's last
    """

    id: int
    instruction: int
    parameters: bytes
    end: int


def _crc_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        crc = byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ 0x8005 if crc & 0x8000 else crc << 1
        table.append(crc & 0xFFFF)
    return tuple(table)


_CRC: Final = _crc_table()


def crc16(data: bytes | bytearray, crc: int = 0) -> int:
    """Return the CRC-16 of a packet (polynomial 0x8005, start 0, not reflected).

    Args:
        data: everything before the CRC, stuffing included
        crc: of the bytes before these
    """
    for byte in data:
        crc = ((crc & 0xFF) << 8) ^ _CRC[(crc >> 8) ^ byte]
    return crc


def encode(servo: int, instruction: int, parameters: bytes = b"") -> bytes:
    """Return a packet's bytes.

    Args:
        servo: id
        instruction: instruction, or `STATUS`
        parameters: what follows it, without stuffing

    Returns:
        header, id, length, stuffed body, CRC
    """
    body = (bytes((instruction,)) + parameters).replace(_HEADER, _STUFFED)
    length = len(body) + 2
    packet = _HEADER + bytes((0, servo, length & 0xFF, length >> 8)) + body
    crc = crc16(packet)
    return packet + bytes((crc & 0xFF, crc >> 8))


def encode_status(servo: int, error: int, parameters: bytes = b"") -> bytes:
    """Return a status packet's bytes.

    Args:
        servo: id of the servo that answers
        error: error number, with `ALERT` where there is a hardware error
        parameters: the data
    """
    return encode(servo, STATUS, bytes((error,)) + parameters)


def encode_fast(parts: Sequence[tuple[int, int, bytes]]) -> bytes:
    """Return the packet in which several servos answer a fast sync or bulk read: one header, then a part of each.

    Each part ends with the CRC of all that is before it, as who sends it has heard it. Nothing is stuffed.

    Args:
        parts: (error, id, data) of each servo
    """
    length = 1 + sum(4 + len(data) for _, _, data in parts)
    packet = _HEADER + bytes((0, BROADCAST, length & 0xFF, length >> 8, STATUS))
    crc = crc16(packet)
    for error, servo, data in parts:
        part = bytes((error, servo)) + data
        crc = crc16(part, crc)
        ending = bytes((crc & 0xFF, crc >> 8))
        packet += part + ending
        crc = crc16(ending, crc)
    return packet


class PacketParser:
    """Cut a stream of bytes into packets; whatever is no packet is skipped, and nothing raises."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._taken = 0  # bytes of the stream before the buffer

    @property
    def waiting(self) -> int:
        """Return how many bytes wait for the rest of their packet."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[Packet]:
        """Take what has arrived; return the packets that ended in it.

        Args:
            data: any bytes
        """
        self._buffer += data
        packets: list[Packet] = []
        while True:
            self._skip_to_header()
            if len(self._buffer) < _PREFIX_BYTES:
                return packets
            servo = self._buffer[4]
            length = self._buffer[5] | self._buffer[6] << 8
            if self._buffer[3] != 0 or servo in (0xFD, 0xFF) or not 3 <= length <= LENGTH_MAX:
                self._drop(1)
                continue
            end = _PREFIX_BYTES + length
            if len(self._buffer) < end:
                return packets
            crc = self._buffer[end - 2] | self._buffer[end - 1] << 8
            if crc16(self._buffer[: end - 2]) != crc:
                # the length may be what is wrong: a good packet can lie inside
                self._drop(1)
                continue
            body = bytes(self._buffer[_PREFIX_BYTES : end - 2]).replace(_STUFFED, _HEADER)
            self._drop(end)
            packets.append(Packet(servo, body[0], body[1:], self._taken))

    def abandon(self) -> None:
        """Forget a packet whose rest did not come."""
        self._drop(len(self._buffer))

    def _drop(self, count: int) -> None:
        del self._buffer[:count]
        self._taken += count

    def _skip_to_header(self) -> None:
        start = self._buffer.find(_HEADER)
        if start < 0:
            # keep what may be the beginning of a header
            keep = 2 if self._buffer.endswith(b"\xff\xff") else 1 if self._buffer.endswith(b"\xff") else 0
            start = len(self._buffer) - keep
        if start:
            self._drop(start)
