"""C symbols for the names that controller files allow."""

from __future__ import annotations

import re
from typing import Final

from controller.errors import InputError

IDENTIFIER: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,63}", re.ASCII)

_ESCAPED: Final = re.compile(r"[^A-Za-z0-9_]|_(?=x)", re.ASCII)
_FREESTANDING_HEADERS: Final = frozenset({"float", "iso646", "limits", "stdarg", "stdbool", "stddef", "stdint"})


def mangle(name: str) -> str:
    """Turn a name into the part of a C symbol after a prefix, different names into different parts.

    Letters, digits and underscores stay. Any other character becomes ``_x`` + its code in hex + ``_``, and so does an
    underscore before an x, so that no other name looks like an escape: ``osc-like.name`` gives
    ``osc_x2D_like_x2E_name``.

    Args:
        name: any text

    Returns:
        letters, digits and underscores
    """
    return _ESCAPED.sub(lambda match: f"_x{ord(match.group()):02X}_", name)


def check_c_name(name: str) -> str:
    """Return a name that generated files and symbols may begin with.

    Args:
        name: as the user gave it

    Returns:
        the same

    Raises:
        InputError: it is not a C identifier of at most 64 characters, or hides a header of the C compiler
    """
    if not IDENTIFIER.fullmatch(name):
        raise InputError(
            f"--name '{name[:70]}' is not a C identifier; use a letter or _, then up to 63 letters, digits or _"
        )
    if name.lower() in _FREESTANDING_HEADERS:
        raise InputError(f"--name '{name}' would hide the C header <{name.lower()}.h>; choose another name")
    return name
