"""Dynamixel 1.0 packets, which Feetech's servos share: checksum, and a parser that finds its way back from any bytes.

Source: ROBOTIS e-Manual, docs/en/dxl/protocol1.md; Feetech, Smart Bus Servo Communication Protocol Manual, §1.
"""

from __future__ import annotations

from typing import Final, NamedTuple

PING: Final = 0x01
READ: Final = 0x02
WRITE: Final = 0x03
REG_WRITE: Final = 0x04
ACTION: Final = 0x05
FACTORY_RESET: Final = 0x06
REBOOT: Final = 0x08
RESET_TURNS: Final = 0x0A
CALIBRATE: Final = 0x0B
SYNC_READ: Final = 0x82
SYNC_WRITE: Final = 0x83

BROADCAST: Final = 0xFE
ID_MAX: Final = 0xFD
DATA_MAX: Final = 253
"""Bytes that an answer can hold: its length field counts two more."""

_HEADER: Final = b"\xff\xff"
_PREFIX_BYTES: Final = 4  # header, id, length
_LENGTH_MIN: Final = 2  # instruction or error, checksum


class Packet(NamedTuple):
    """Hold one packet.

    Args:
        id: of the servo that is asked, or that answers
        instruction: what is asked; of a status packet its error byte
        parameters: what follows
        end: bytes of the stream up to and with this packet's last
        sound: whether its checksum is right
    """

    id: int
    instruction: int
    parameters: bytes
    end: int
    sound: bool = True


def checksum(body: bytes | bytearray) -> int:
    """Return the checksum of a packet: the complement of the sum of its bytes.

    Args:
        body: id, length, instruction and parameters
    """
    return ~sum(body) & 0xFF


def encode(servo: int, instruction: int, parameters: bytes = b"") -> bytes:
    """Return a packet's bytes.

    Args:
        servo: id
        instruction: instruction, or a status packet's error byte
        parameters: what follows it, at most `DATA_MAX` bytes

    Returns:
        header, id, length, instruction, parameters, checksum
    """
    body = bytes((servo, len(parameters) + 2, instruction)) + parameters
    return _HEADER + body + bytes((checksum(body),))


def encode_status(servo: int, error: int, parameters: bytes = b"") -> bytes:
    """Return a status packet's bytes.

    Args:
        servo: id of the servo that answers
        error: error bits
        parameters: the data
    """
    return encode(servo, error, parameters)


class PacketParser:
    """Cut a stream of bytes into packets; whatever is no packet is skipped, and nothing raises.

    A packet whose checksum is wrong is given too, marked as not sound, unless a sound one lies within its bytes: then
    its length was wrong rather than its content.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._taken = 0  # bytes of the stream before the buffer
        self._damaged: Packet | None = None  # not sound, as long as a sound one may lie within it

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
            if self._damaged and self._damaged.end <= self._taken:
                packets.append(self._damaged)
                self._damaged = None
            packet = self._first()
            if packet is None:
                return packets
            if packet.sound:
                self._damaged = None
                packets.append(packet)
                self._drop(packet.end - self._taken)
            else:
                self._damaged = self._damaged or packet
                self._drop(1)

    def abandon(self) -> None:
        """Forget a packet whose rest did not come."""
        self._drop(len(self._buffer))
        self._damaged = None

    def _first(self) -> Packet | None:
        """Return the packet that the buffer begins with, sound or not, or None while its rest is to come."""
        buffer = self._buffer
        if len(buffer) < _PREFIX_BYTES:
            return None
        end = _PREFIX_BYTES + buffer[3]
        if len(buffer) < end:
            return None
        sound = checksum(buffer[2 : end - 1]) == buffer[end - 1]
        return Packet(buffer[2], buffer[4], bytes(buffer[5 : end - 1]), self._taken + end, sound)

    def _drop(self, count: int) -> None:
        del self._buffer[:count]
        self._taken += count

    def _skip_to_header(self) -> None:
        """Drop what can not begin a packet: one begins with a header, an id that is no header, and a length."""
        buffer = self._buffer
        while True:
            start = buffer.find(_HEADER)
            if start < 0:
                start = len(buffer) - (1 if buffer.endswith(b"\xff") else 0)
            if start:
                self._drop(start)
            if (len(buffer) > 2 and buffer[2] == 0xFF) or (len(buffer) > 3 and buffer[3] < _LENGTH_MIN):
                self._drop(1)
                continue
            return
