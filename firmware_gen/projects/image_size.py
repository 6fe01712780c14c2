"""How much memory a linked image takes, read from the image itself."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Final

from controller.errors import RunError

_ALLOC: Final = 2
_WRITE: Final = 1
_NOBITS: Final = 8


def image_size(image: Path) -> dict[str, int]:
    """Return the sizes of an ELF image as binutils' ``size`` counts them.

    Args:
        image: path of the image

    Returns:
        text_bytes: what is kept in flash: code, constants, initial values of variables; ram_bytes: variables

    Raises:
        RunError: it is no ELF file
    """
    text = ram = 0
    for kind, flags, size in _sections(image):
        if not flags & _ALLOC:
            continue
        if kind != _NOBITS:
            text += size
        if flags & _WRITE:
            ram += size
    return {"text_bytes": text, "ram_bytes": ram}


def _sections(image: Path) -> list[tuple[int, int, int]]:
    """Return (type, flags, size) of every section."""
    data = image.read_bytes()
    try:
        if data[:4] != b"\x7fELF":
            raise RunError(f"{image}: is no ELF image; build it again")
        wide = data[4] == 2
        header, section = ("<16sHHIQQQIHHHHHH", "<IIQQQQIIQQ") if wide else ("<16sHHIIIIIHHHHHH", "<IIIIIIIIII")
        fields = struct.unpack_from(header, data)
        first, entry, count = fields[6], fields[11], fields[12]
        rows = [struct.unpack_from(section, data, first + number * entry) for number in range(count)]
    except (struct.error, IndexError):
        raise RunError(f"{image}: is no complete ELF image; build it again") from None
    return [(row[1], row[2], row[5]) for row in rows]
