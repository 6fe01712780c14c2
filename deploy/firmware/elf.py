"""Read the symbols of a linked image: 32-bit ELF, little endian, as linkers for microcontrollers write it."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from controller.errors import InputError

_SYMBOLS: Final = 2
_SECTION: Final = struct.Struct("<10I")
_SYMBOL: Final = struct.Struct("<IIIBBH")
_FUNCTION: Final = 2


@dataclass(frozen=True)
class Symbol:
    """Hold where something lies.

    Args:
        address: of its first byte; of a function's first instruction
        size: [bytes]; 0 where the image does not say
    """

    address: int
    size: int


def read_symbols(image: Path) -> dict[str, Symbol]:
    """Return the symbols of an image by name; of a name with several, the last.

    Args:
        image: path of a linked image

    Raises:
        InputError: it can not be read, or is no such image
    """
    try:
        data = image.read_bytes()
    except OSError as error:
        raise InputError(f"{image}: can not be read ({error.strerror}); build the firmware first") from None
    try:
        return _symbols(data)
    except (struct.error, IndexError, UnicodeDecodeError):
        raise InputError(f"{image}: is not a 32-bit ELF image with symbols; build the firmware anew") from None


def _symbols(data: bytes) -> dict[str, Symbol]:
    if data[:6] != b"\x7fELF\x01\x01":
        raise IndexError
    begin = struct.unpack_from("<I", data, 32)[0]
    size, count = struct.unpack_from("<HH", data, 46)
    sections = [_SECTION.unpack_from(data, begin + size * i) for i in range(count)]
    table = next(section for section in sections if section[1] == _SYMBOLS) if sections else None
    if table is None:
        raise IndexError
    names = data[sections[table[6]][4] :]
    symbols = {}
    for offset in range(table[4], table[4] + table[5], _SYMBOL.size):
        name, value, length, kind, _, _ = _SYMBOL.unpack_from(data, offset)
        # the lowest bit of a function's address tells the instruction set
        address = value & ~1 if kind & 15 == _FUNCTION else value
        symbols[names[name : names.index(b"\0", name)].decode("ascii")] = Symbol(address, length)
    return symbols
