"""C symbols for the names that controller files allow."""

from __future__ import annotations

import re
from typing import Final

from controller.errors import InputError

LENGTH_MAX: Final = 64
IDENTIFIER: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,63}", re.ASCII)

_ESCAPED: Final = re.compile(r"[^A-Za-z0-9_]|_(?=x)", re.ASCII)
_SEPARATOR: Final = re.compile(r"(?<=_)([io])(?=(?:nput|utput)(?:_|$))", re.ASCII)
_NOT_IN_COMMENT: Final = re.compile(r"[^A-Za-z0-9_()+*/%^.,:;=<> -]", re.ASCII)
_COMMENT_MARK: Final = re.compile(r"/(?=[/*])|\*(?=/)")
_HEADERS: Final = frozenset(
    {
        "assert",
        "complex",
        "ctype",
        "errno",
        "fenv",
        "float",
        "inttypes",
        "iso646",
        "limits",
        "locale",
        "math",
        "setjmp",
        "signal",
        "stdalign",
        "stdarg",
        "stdatomic",
        "stdbit",
        "stdbool",
        "stdckdint",
        "stddef",
        "stdint",
        "stdio",
        "stdlib",
        "stdnoreturn",
        "string",
        "tgmath",
        "threads",
        "time",
        "uchar",
        "wchar",
        "wctype",
        # of the C libraries' own, which the standard ones include or which stand beside them
        "_ansi",
        "alloca",
        "dirent",
        "endian",
        "fcntl",
        "features",
        "io",
        "malloc",
        "memory",
        "newlib",
        "pthread",
        "regex",
        "sched",
        "semaphore",
        "strings",
        "unistd",
        "values",
        "wait",
    }
)
"""Headers of the C compiler and library: a NAME.h beside them would be included in their place."""


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


def unit_name(name: str) -> str:
    """Turn a controller's name into what its files and symbols begin with.

    It is mangled; besides, the first letters of words ``_input`` and ``_output`` become ``x69_`` and ``x6F_``: these
    words separate a unit's name from a terminal's (``lamp_input_a0``), so that symbols of two units differ whatever
    their terminals are called.

    Args:
        name: the controller's name

    Returns:
        letters, digits and underscores
    """
    return _SEPARATOR.sub(lambda match: f"x{ord(match.group()):02X}_", mangle(name))


def comment_text(text: str) -> str:
    """Return a text that can end no comment and begin none, and continues no line: other characters become ``_``.

    Args:
        text: whatever a controller calls something
    """
    return _COMMENT_MARK.sub("_", _NOT_IN_COMMENT.sub("_", text))


def local_prefix(unit: str) -> str:
    """Return what local variables for inputs begin with: nothing that a symbol of the unit can begin with.

    Args:
        unit: what the unit's symbols begin with
    """
    return "u_" if unit == "in" or unit.startswith("in_") else "in_"


def check_c_name(name: str, controller: str | None = None) -> str:
    """Return a name that generated files and symbols may begin with.

    Args:
        name: as the user gave it, or as `unit_name` made it
        controller: the name of the controller that `unit_name` made it of; None: the user gave it

    Returns:
        the same

    Raises:
        InputError: it is not a C identifier of at most 64 characters, hides a header of the C compiler or library, or
            could give another controller's symbols
    """
    if controller is not None and len(name) > LENGTH_MAX:
        raise InputError(
            f"the controller's name '{controller}' makes a C name of {len(name)} characters, above {LENGTH_MAX}; "
            "choose a shorter one with --name"
        )
    called = f"--name '{name[:70]}'" if controller is None else f"the controller's name '{controller}'"
    remedy = "choose another name" if controller is None else "choose another one with --name"
    if not IDENTIFIER.fullmatch(name):
        raise InputError(f"{called} is not a C identifier; use a letter or _, then up to 63 letters, digits or _")
    if name.lower() in _HEADERS:
        raise InputError(f"{called} would hide the C header <{name.lower()}.h>; {remedy}")
    if _SEPARATOR.search(name):
        raise InputError(f"{called} holds _input or _output, which separate a name from a terminal's; {remedy}")
    return name
