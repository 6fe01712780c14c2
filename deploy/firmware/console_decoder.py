"""Take a firmware's console stream apart: lines of text, and the records of its log, whatever else the line carries.

A record stands between zero bytes, as the COBS code of (type, body, CRC-16 of both); see sv_record.h. What stands there
is a record if its code and its CRC say so, and text otherwise: bytes that were lost or damaged cost the record or the
line that they were part of, and none after it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from deploy.firmware.records import Record, Shape, parse_record

RECORD_BYTES_MAX: Final = 250
"""`SV_RECORD_MAX`: type, body and CRC."""

_CODE_BYTES_MAX: Final = RECORD_BYTES_MAX + 1
_LINE_BYTES_MAX: Final = 512
_CRC_BYTES: Final = 2
_CRC_POLYNOMIAL: Final = 0x8005


@dataclass(frozen=True)
class Text:
    """Hold one line that the firmware has printed.

    Args:
        line: without its end
    """

    line: str


@dataclass(frozen=True)
class Damaged:
    """Hold bytes that are neither a record nor a line.

    Args:
        data: what came
    """

    data: bytes


class ConsoleDecoder:
    """Take bytes as they come, give back what is whole; never hold more than a line's or a record's length.

    Args:
        shape: of rig and controller
    """

    def __init__(self, shape: Shape) -> None:
        self._shape = shape
        self._piece = bytearray()

    def feed(self, data: bytes) -> Iterator[Record | Text | Damaged]:
        """Take bytes; yield what has ended in them.

        Args:
            data: any bytes
        """
        *ended, rest = data.split(b"\0")
        for piece in ended:
            self._piece += piece
            yield from self.end()
        self._piece += rest
        while len(self._piece) > _LINE_BYTES_MAX:
            # longer than any record's code, so text, or what is left of it
            cut = self._piece.find(b"\n", 0, _LINE_BYTES_MAX) + 1 or _LINE_BYTES_MAX
            yield from _lines(bytes(self._piece[:cut]))
            del self._piece[:cut]

    def end(self) -> Iterator[Record | Text | Damaged]:
        """Yield what is left, as if the stream ended here."""
        piece = bytes(self._piece)
        self._piece.clear()
        body = checked(piece)
        record = None if body is None else parse_record(body, self._shape)
        if record is not None:
            yield record
        else:
            yield from _lines(piece)


def crc16(data: bytes) -> int:
    """Return the CRC-16 of bytes: polynomial 0x8005, from 0, most significant bit first, as Dynamixel 2.0 has it.

    Args:
        data: any bytes
    """
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ (_CRC_POLYNOMIAL if crc & 0x8000 else 0)) & 0xFFFF
    return crc


def checked(code: bytes) -> bytes | None:
    """Return type and body of a coded record, or None if its code or its CRC is wrong.

    Args:
        code: what stood between two zeros
    """
    data = uncoded(code) if len(code) <= _CODE_BYTES_MAX else None
    if data is None or not 1 + _CRC_BYTES <= len(data) <= RECORD_BYTES_MAX:
        return None
    body, crc = data[:-_CRC_BYTES], int.from_bytes(data[-_CRC_BYTES:], "little")
    return body if crc == crc16(body) else None


def uncoded(code: bytes) -> bytes | None:
    """Return the bytes of a COBS code, or None if it is none.

    Args:
        code: without a zero
    """
    data = bytearray()
    at = 0
    while at < len(code):
        length = code[at]
        if at + length > len(code):
            return None
        data += code[at + 1 : at + length]
        at += length
        if length < 255 and at < len(code):
            data.append(0)
    return bytes(data)


def _lines(piece: bytes) -> Iterator[Text | Damaged]:
    """Yield text a line each, and whatever no terminal shows as what it is."""
    for line in piece.replace(b"\r\n", b"\n").split(b"\n"):
        if not line:
            continue
        if all(0x20 <= byte < 0x7F or byte == 0x09 for byte in line):
            yield Text(line.decode("ascii"))
        else:
            yield Damaged(line)
