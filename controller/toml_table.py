"""Read TOML so that every mistake is one sentence: file, line, table and key, what is wrong, remedy."""

from __future__ import annotations

import difflib
import math
import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NoReturn

import numpy as np

from controller.decimals import parse_decimal
from controller.errors import InputError

BYTES_MAX: Final = 1 << 20
_KEY_PARTS_MAX: Final = 256
# reading takes time in proportion to the square of the parts
_DOTTED_KEY: Final = re.compile(
    rf"""(?<![\w-])(?:(?:[A-Za-z0-9_-]+|"[^"\n]*"|'[^'\n]*')[ \t]*\.[ \t]*){{{_KEY_PARTS_MAX}}}"""
)
NAME: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_.-]{0,63}")


@dataclass(frozen=True)
class Table:
    """Hold one table of a TOML file with what an error needs to point at it.

    Args:
        origin: the file, as errors name it
        text: the file's text
        values: key => value
        header: "" for the top level, "bus" for ``[bus]``, "joint" for ``[[joint]]``
        index: which ``[[header]]`` it is, from 1; 0: not an array of tables
        label: how errors call it, as "joint 2 (a1)"
    """

    origin: str
    text: str
    values: Mapping[str, Any]
    header: str = ""
    index: int = 0
    label: str = field(default="")

    def fail(self, key: str | None, message: str) -> NoReturn:
        """Raise the error for this table.

        Args:
            key: the key at fault, or None for the table as a whole
            message: what is wrong, semicolon, remedy

        Raises:
            InputError: always
        """
        line = _line_of(self.text, self.header, self.index, key)
        where = self.label or (f"[{self.header}]" if self.header else "top level")
        raise InputError(f"{self.origin}{f', line {line}' if line else ''}: {where}: {message}")

    def refuse_unknown(self, known: Iterable[str]) -> None:
        """Refuse keys that mean nothing here.

        Args:
            known: the keys that mean something

        Raises:
            InputError: a key is not known
        """
        known = list(known)
        for key in self.values:
            if key not in known:
                self.fail(key, f"'{key}' is not known; {_suggest(key, known)}")

    def text_value(self, key: str, choices: Iterable[str] | None = None) -> str:
        """Return a required string.

        Args:
            key: its key
            choices: what it may be, or None for any

        Returns:
            the string

        Raises:
            InputError: it is missing, no string, or not one of the choices
        """
        value = self._required(key, "a text in quotes")
        if not isinstance(value, str):
            self.fail(key, f"{key} is {_kind(value)}; write a text in quotes")
        if choices is not None:
            listed = list(choices)
            if value not in listed:
                self.fail(key, f"{key} '{value}' is not known; {_suggest(value, listed)}")
        return value

    def name_value(self, key: str) -> str:
        """Return a required name.

        Args:
            key: its key

        Returns:
            the name

        Raises:
            InputError: it is missing or can not be a name
        """
        value = self.text_value(key)
        if not NAME.fullmatch(value):
            self.fail(
                key,
                f"{key} {value!r} can not be a name; use a letter or _, then up to 63 letters, digits or any of _ . -",
            )
        return value

    def integer(self, key: str, low: int, high: int) -> int:
        """Return a required integer.

        Args:
            key: its key
            low: smallest allowed
            high: largest allowed

        Returns:
            the integer

        Raises:
            InputError: it is missing, no integer, or out of range
        """
        value = self._required(key, f"a whole number from {low} to {high}")
        if isinstance(value, bool) or not isinstance(value, int):
            self.fail(key, f"{key} is {_kind(value)}; write a whole number from {low} to {high}")
        if not low <= value <= high:
            self.fail(key, f"{key} {value} is out of range; write a whole number from {low} to {high}")
        return value

    def number(self, key: str, low: float = -math.inf, high: float = math.inf) -> float:
        """Return a required finite number.

        Args:
            key: its key
            low: smallest allowed
            high: largest allowed

        Returns:
            the number

        Raises:
            InputError: it is missing, no finite number, or out of range
        """
        value = self._required(key, "a number")
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            self.fail(key, f"{key} is {_kind(value)}; write a number")
        number = _round_once(str(value)) if isinstance(value, int) else value
        if not math.isfinite(number):
            self.fail(key, f"{key} is not finite; write a finite number")
        if not low <= number <= high:
            bounds = f"from {low:g}" + (f" to {high:g}" if math.isfinite(high) else "")
            bounds = f"up to {high:g}" if not math.isfinite(low) else bounds
            self.fail(key, f"{key} {number:g} is out of range; write a number {bounds}")
        return number

    def positive(self, key: str, high: float = math.inf) -> float:
        """Return a required finite number above zero.

        Args:
            key: its key
            high: largest allowed

        Returns:
            the number

        Raises:
            InputError: it is missing, no finite number, not positive, or above `high`
        """
        number = self.number(key)
        if not 0.0 < number <= high:
            bounds = f" up to {high:g}" if math.isfinite(high) else ""
            self.fail(key, f"{key} {number:g} is not allowed; write a number above 0{bounds}")
        return number

    def table(self, key: str) -> Table:
        """Return a required ``[key]`` table.

        Args:
            key: its header

        Returns:
            the table

        Raises:
            InputError: it is missing or no table
        """
        if key not in self.values:
            self.fail(None, f"table [{key}] is missing; add it (is the file truncated?)")
        value = self.values[key]
        if not isinstance(value, dict):
            self.fail(key, f"'{key}' is {_kind(value)}; write a table [{key}]")
        return Table(self.origin, self.text, value, header=key)

    def tables(self, key: str) -> list[Table]:
        """Return the ``[[key]]`` tables, none if there is none.

        Args:
            key: their header

        Returns:
            the tables, in file order

        Raises:
            InputError: it is not an array of tables
        """
        value = self.values.get(key, [])
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            self.fail(key, f"'{key}' is not a list of tables; write [[{key}]] above each")
        tables = []
        for i, item in enumerate(value, start=1):
            name = item.get("name")
            label = f"{key} {i} ({name})" if isinstance(name, str) and NAME.fullmatch(name) else f"{key} {i}"
            tables.append(Table(self.origin, self.text, item, header=key, index=i, label=label))
        return tables

    def _required(self, key: str, kind: str) -> Any:  # noqa: ANN401  a TOML value is of any type until checked
        if key not in self.values:
            self.fail(None, f"{key} is missing; add `{key} = …` ({kind})")
        return self.values[key]


def read_toml(path: Path, kind: str, *, format_required: bool = True) -> Table:
    """Read a TOML file of format 1.

    Args:
        path: the file
        kind: what it is meant to be, as "rig file", for the errors
        format_required: whether `format` must be there

    Returns:
        its top-level table

    Raises:
        InputError: it can not be read, is no TOML, or is of another format
    """
    try:
        if path.is_dir():
            data = None
        else:
            with path.open("rb") as file:
                data = file.read(BYTES_MAX + 1)
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file; name an existing {kind}") from None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise InputError(f"{path}: can not be read ({reason}); name a readable {kind}") from None
    if data is None:
        raise InputError(f"{path}: is a folder; name the {kind} itself")
    if len(data) > BYTES_MAX:
        raise InputError(f"{path}: is larger than {BYTES_MAX} bytes; that can not be a {kind}, name another file")
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(f"{path}, line {line}: is not UTF-8 text; save the {kind} as UTF-8") from None
    return parse_toml(text, str(path), kind, format_required=format_required)


def parse_toml(text: str, origin: str, kind: str, *, format_required: bool = True) -> Table:
    """Parse the text of a TOML file of format 1.

    Args:
        text: the file's text
        origin: where it came from, as errors name it
        kind: what it is meant to be, as "rig file", for the errors
        format_required: whether `format` must be there

    Returns:
        its top-level table

    Raises:
        InputError: it is no TOML, or is of another format
    """
    if text.startswith("\ufeff"):
        raise InputError(f"{origin}, line 1: begins with a byte-order mark; save the {kind} as UTF-8 without one")
    dotted = _DOTTED_KEY.search(text)
    if dotted:
        line = text.count("\n", 0, dotted.start()) + 1
        raise InputError(f"{origin}, line {line}: a key has more than {_KEY_PARTS_MAX} parts; write a flat {kind}")
    try:
        values = tomllib.loads(text, parse_float=_round_once)
    except tomllib.TOMLDecodeError as error:
        reason, _, place = str(error).rpartition(" (at ")
        place = place.rstrip(")")
        if place == "end of document":
            raise InputError(
                f"{origin}, line {text.count(chr(10)) + 1}: the file ends in the middle of an entry ({reason}); "
                "it may be truncated: complete its last line"
            ) from None
        raise InputError(f"{origin}, {place}: is not valid TOML ({reason}); correct that line") from None
    except ValueError as error:
        raise InputError(f"{origin}: holds a value out of range ({error}); correct it") from None
    except RecursionError:
        raise InputError(f"{origin}: is nested too deeply; write a flat {kind}") from None
    top = Table(origin, text, values)
    version = values.get("format", None if format_required else 1)
    if version is None:
        top.fail(None, "format is missing; add `format = 1` as the first line")
    if isinstance(version, bool) or version != 1:
        top.fail("format", f"format {version!r} is not known; this version reads `format = 1`")
    return top


def _round_once(text: str) -> float:
    """Read a number so that rounding it to binary32 gives the float32 nearest to the text, as in program texts."""
    value = float(text)
    try:
        nearest = float(parse_decimal(text.replace("_", "")))
        # rounded to double first, a number close to half-way between two floats may fall to the wrong side
        return value if float(np.float32(value)) == nearest else nearest
    except (ValueError, OverflowError):
        # nan, inf, or beyond binary32, which those who use it refuse where it matters
        return value


def _suggest(word: str, known: Iterable[str]) -> str:
    known = list(known)
    close = difflib.get_close_matches(word, known, n=1)
    if close:
        return f"did you mean '{close[0]}'?"
    return f"known: {', '.join(known)}" if known else "remove it"


def _kind(value: object) -> str:
    if isinstance(value, bool):
        return "true or false"
    if isinstance(value, (int, float)):
        return f"the number {value}"
    if isinstance(value, str):
        return f"the text {value[:40]!r}"
    if isinstance(value, list):
        return "a list"
    return "a table" if isinstance(value, dict) else "a date or time"


def _line_of(text: str, header: str, index: int, key: str | None) -> int:
    """Return the line of a key, or of its table's header, or 0 where the file's own style hides it."""
    at_table = header == "" or 0
    line_of_table = 0
    count = 0
    for number, line in enumerate(text.splitlines(), start=1):
        stripped = line.strip()
        if stripped.startswith("["):
            name = stripped.split("#")[0].strip()
            if name in (f"[[{header}]]", f"[{header}]"):
                count += 1
                at_table = index in (0, count)
            else:
                at_table = False
            if at_table:
                line_of_table = number
            elif header == "" and key is not None and name in (f"[{key}]", f"[[{key}]]"):
                return number
        elif at_table and key is not None and re.match(rf"\"?{re.escape(key)}\"?\s*=", stripped):
            return number
    return line_of_table
