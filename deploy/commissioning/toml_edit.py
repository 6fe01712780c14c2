"""Change values in a TOML text and leave everything else as a person wrote it: comments, order, blanks."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from typing import Any, Final

from controller.errors import InputError

Value = int | float | str

_HEADER: Final = re.compile(r"\s*(\[\[?)\s*([A-Za-z0-9_-]+)\s*\]\]?\s*(?:#.*)?$")
_PLAIN: Final = r"""(?:"[^"\\]*"|'[^']*'|[^\s#"'\[{]+)"""


def set_values(text: str, origin: str, header: str, index: int, values: Mapping[str, Value]) -> str:
    """Return the text with the values of some keys of one table replaced.

    Args:
        text: a TOML file's text
        origin: what the file is called, for errors
        header: the table, as "rig" for ``[rig]`` or "joint" for ``[[joint]]``
        index: which ``[[header]]``, from 0; 0 for a plain table
        values: key => new value; each key must be there

    Returns:
        the new text, which parses to the old values but for these

    Raises:
        InputError: a key is written in a way that can not be edited
    """
    lines = text.splitlines(keepends=True)
    inside = False
    count = -1
    left = dict(values)
    for number, line in enumerate(lines):
        begins = _HEADER.match(line)
        if begins:
            count += begins[2] == header
            inside = begins[2] == header and count == index
        elif inside:
            for key in [key for key in left if _is_key(line, key)]:
                lines[number] = _replaced(line, left.pop(key))
    edited = "".join(lines)
    if left or _parsed(edited) != _expected(text, header, index, values):
        raise InputError(
            f"{origin}: {', '.join(left or values)} of [[{header}]] {index + 1} can not be edited in place; write each "
            "table under its own header and each number on a line of its own"
        )
    return edited


def format_value(value: Value) -> str:
    """Return a value as TOML.

    Args:
        value: whole number, number or text
    """
    if isinstance(value, str):
        return f'"{value}"'
    return repr(value)


def _is_key(line: str, key: str) -> bool:
    return re.match(rf"""\s*["']?{re.escape(key)}["']?\s*=""", line) is not None


def _replaced(line: str, value: Value) -> str:
    return re.sub(rf"(=\s*){_PLAIN}", lambda match: match[1] + format_value(value), line, count=1)


def _parsed(text: str) -> dict[str, Any] | None:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return None


def _expected(text: str, header: str, index: int, values: Mapping[str, Value]) -> dict[str, Any]:
    """Return what the new text must mean."""
    top = tomllib.loads(text)
    table = top.get(header)
    chosen = table[index] if isinstance(table, list) and index < len(table) else table
    if isinstance(chosen, dict):
        chosen |= {key: tomllib.loads(f"x = {format_value(value)}")["x"] for key, value in values.items()}
    return top
