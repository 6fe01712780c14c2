"""Controller files, `NAME.controller.toml`: load with every check, print, save."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal, cast

from controller.controller import Controller, Input, Output
from controller.errors import InputError
from controller.lowering import lower
from controller.operations import RESERVED
from controller.text import Place, format_source, parse
from controller.toml_table import Table, parse_toml, read_toml
from controller.verifier import INPUT_MAX, OUTPUT_MAX, verify

KIND: Final = "controller file"
BEST: Final = "best.controller.toml"
"""The controller of a run folder."""
RUN: Final = "run.toml"
"""What makes a folder a run, finished or not; `evolve.runs.run_folder` names both too."""

_FLOAT_MAX: Final = 3.4028234663852886e38
_LIMIT_MAX: Final = 1e6
"""Of outputs: what the filter and the slew limit subtract stays far below infinity."""
_OUTPUT_UNITS: Final = {"position": ("deg", "rad"), "velocity": ("deg/s", "rad/s")}
_PROGRAM: Final = re.compile(r"""^[ \t]*["']?program["']?[ \t]*=[ \t]*(\"\"\"\n?|'''\n?|"|')""", re.MULTILINE)
_HEX: Final = re.compile(r"0x[0-9a-f]{8}")


def load_controller(path: str | Path) -> Controller:
    """Load a controller file, or the best controller of a run folder, and check all of it.

    Args:
        path: a ``*.controller.toml``, or a folder that holds ``best.controller.toml``

    Returns:
        the controller, its program lowered and verified

    Raises:
        InputError: it can not be read, or something in it is wrong
    """
    path = Path(path)
    try:
        if path.is_dir():
            if not (path / BEST).exists():
                if (path / RUN).exists():
                    raise InputError(
                        f"{path}: this run is unfinished and has not chosen its best; go on with it: servolve evolve"
                        f" --resume {path}"
                    )
                raise InputError(f"{path}: is a folder without {BEST}; give a run folder or a *.controller.toml")
            path = path / BEST
        elif not path.exists():
            raise InputError(f"{path}: there is no such file; name a run folder or a *.controller.toml")
    except InputError:
        raise
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise InputError(f"{path}: can not be read ({reason}); name a readable {KIND}") from None
    return _controller(read_toml(path, KIND, format_required=False))


def parse_controller(text: str, origin: str) -> Controller:
    """Build a controller from the text of its file, as a log embeds it.

    Args:
        text: the file's text
        origin: where it came from, as errors name it

    Returns:
        the controller, its program lowered and verified

    Raises:
        InputError: something in the text is wrong
    """
    return _controller(parse_toml(text, origin, KIND, format_required=False))


def _controller(top: Table) -> Controller:
    top.refuse_unknown(("format", "program", "controller", "input", "output", "provenance", "golden"))
    program_text = top.text_value("program")
    head = top.table("controller")
    head.refuse_unknown(("name", "period_s", "filter", "slew_rad_s", "task"))
    inputs = tuple(_input(table) for table in _named(top, "input", INPUT_MAX))
    output_tables = _named(top, "output", OUTPUT_MAX)
    if not output_tables:
        top.fail(None, "there is no [[output]]; write one for each expression of the list")
    outputs = tuple(_output(table) for table in output_tables)
    names = [terminal.name for terminal in inputs]
    source = parse(program_text, names, _program_place(top, program_text))
    if len(source.outputs) != len(outputs):
        top.fail(
            "program",
            f"the program's list has {len(source.outputs)} expression{'s' * (len(source.outputs) != 1)}, but there "
            f"{'is' if len(outputs) == 1 else 'are'} {len(outputs)} [[output]]; "
            "write one [[output]] for each expression",
        )
    try:
        program = lower(source, names)
        verify(program)
    except InputError as error:
        top.fail("program", str(error))
    return Controller(
        name=head.name_value("name"),
        period_s=head.number("period_s", 1e-4, 10.0),
        inputs=inputs,
        outputs=outputs,
        source=source,
        program=program,
        filter=head.number("filter", 1e-6, 1.0) if "filter" in head.values else 1.0,
        slew_rad_s=head.number("slew_rad_s", 0.0, 1e6) if "slew_rad_s" in head.values else 0.0,
        task=head.text_value("task") if "task" in head.values else None,
        provenance=_provenance(top),
        golden=_golden(top, len(inputs), len(outputs)),
    )


def _named(top: Table, key: str, count_max: int) -> list[Table]:
    """Return the [[key]] tables, their names checked."""
    tables = top.tables(key)
    if len(tables) > count_max:
        top.fail(key, f"there are {len(tables)} [[{key}]]; write at most {count_max}")
    seen: set[str] = set()
    for table in tables:
        name = table.name_value("name")
        if name in RESERVED:
            table.fail("name", f"'{name}' is a word of the program text; give the {key} another name")
        if name in seen:
            table.fail("name", f"name '{name}' is used twice; give each {key} its own name")
        seen.add(name)
    return tables


def _input(table: Table) -> Input:
    table.refuse_unknown(("name", "unit", "low", "high"))
    unit = table.text_value("unit")
    if not unit.isprintable() or len(unit) > 32:
        table.fail("unit", f"unit {unit[:40]!r} is not one short word; write rad, rad/s, N, m, m/s, s or 1")
    low, high = table.number("low", -_FLOAT_MAX, _FLOAT_MAX), table.number("high", -_FLOAT_MAX, _FLOAT_MAX)
    if low > high:
        table.fail("low", f"low {low:g} is above high {high:g}; exchange or correct them")
    return Input(table.name_value("name"), unit, low, high)


def _output(table: Table) -> Output:
    table.refuse_unknown(("name", "kind", "unit", "low", "high", "neutral"))
    kind = cast(Literal["position", "velocity"], table.text_value("kind", _OUTPUT_UNITS))
    unit = cast(Literal["deg", "rad", "deg/s", "rad/s"], table.text_value("unit", _OUTPUT_UNITS[kind]))
    low, high = table.number("low", -_LIMIT_MAX, _LIMIT_MAX), table.number("high", -_LIMIT_MAX, _LIMIT_MAX)
    if low > high:
        table.fail("low", f"low {low:g} is above high {high:g}; exchange or correct them")
    neutral = table.number("neutral")
    if not low <= neutral <= high:
        table.fail("neutral", f"neutral {neutral:g} is outside {low:g} to {high:g}; move it inside the limits")
    return Output(table.name_value("name"), kind, unit, low, high, neutral)


def _provenance(top: Table) -> Mapping[str, Any]:
    if "provenance" not in top.values:
        return {}
    table = top.table("provenance")
    for key, value in table.values.items():
        items = value if isinstance(value, list) else [value]
        if not all(isinstance(item, str | int | float) for item in items):
            table.fail(key, f"{key} is not plain; write a text, a number, true or false, or a list of them")
    return table.values


def _golden(top: Table, ninput: int, noutput: int) -> Mapping[str, Any]:
    if "golden" not in top.values:
        return {}
    table = top.table("golden")
    table.refuse_unknown(("inputs", "outputs"))
    for key, width in (("inputs", ninput), ("outputs", noutput)):
        rows = table.values.get(key)
        if not isinstance(rows, list) or not all(
            isinstance(row, list)
            and len(row) == width
            and all(isinstance(cell, str) and _HEX.fullmatch(cell) for cell in row)
            for row in rows
        ):
            table.fail(key, f'{key} is no trace; write rows of {width} float32 bit patterns, as "0x3f800000"')
    if len(table.values["inputs"]) != len(table.values["outputs"]):
        table.fail("outputs", "inputs and outputs differ in length; record both at each step")
    return table.values


def _program_place(top: Table, program: str) -> Place:
    """Return where the program's first character stands in the file, if its text stands there as it is."""
    text = top.text.replace("\r\n", "\n")
    for match in _PROGRAM.finditer(text):
        start = match.end()
        if text.startswith(program, start):
            column = start - (text.rfind("\n", 0, start) + 1) + 1
            return Place(top.origin, text.count("\n", 0, start) + 1, column)
    # escapes in the string: lines and columns are the program's own
    return Place(f"{top.origin}, program")


def save_controller(controller: Controller, path: str | Path) -> None:
    """Write a controller file, all of it or nothing.

    Args:
        controller: the controller
        path: the file

    Raises:
        InputError: it can not be written
    """
    path = Path(path)
    part = path.with_name(f".{path.name}.part")
    try:
        part.write_text(controller_text(controller), encoding="utf-8")
        os.replace(part, path)  # noqa: PTH105  replaces atomically
    except OSError as error:
        raise InputError(f"{path}: can not be written ({error.strerror}); choose another place") from None


def controller_text(controller: Controller) -> str:
    """Print a controller file: the same controller gives the same bytes.

    Args:
        controller: the controller

    Returns:
        the text, which `parse_controller` reads back
    """
    lines = ["format = 1", 'program = """', *format_source(controller.source).split("\n"), '"""', ""]
    head: dict[str, Any] = {"name": controller.name, "period_s": controller.period_s}
    if controller.filter != 1.0:
        head["filter"] = controller.filter
    if controller.slew_rad_s != 0.0:
        head["slew_rad_s"] = controller.slew_rad_s
    if controller.task is not None:
        head["task"] = controller.task
    lines += _table_lines("[controller]", head)
    for terminal in controller.inputs:
        lines += _table_lines("[[input]]", _fields(terminal, ("name", "unit", "low", "high")))
    for output in controller.outputs:
        lines += _table_lines("[[output]]", _fields(output, ("name", "kind", "unit", "low", "high", "neutral")))
    if controller.provenance:
        lines += _table_lines("[provenance]", controller.provenance)
    if controller.golden:
        lines += _table_lines("[golden]", controller.golden)
    return "\n".join(lines[:-1]) + "\n"


def _fields(item: Input | Output, names: Sequence[str]) -> dict[str, Any]:
    return {name: getattr(item, name) for name in names}


def _table_lines(header: str, values: Mapping[str, Any]) -> list[str]:
    lines = [header]
    for key, value in values.items():
        bare = re.fullmatch(r"[A-Za-z0-9_-]+", key)
        lines.append(f"{key if bare else _toml_string(key)} = {_toml_value(value)}")
    return [*lines, ""]


def _toml_value(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _toml_string(value)
    if isinstance(value, int):
        return str(int(value))
    if isinstance(value, float):
        return repr(float(value))
    if isinstance(value, list | tuple):
        if value and isinstance(value[0], list | tuple):
            return "[\n" + "".join(f"  {_toml_value(row)},\n" for row in value) + "]"
        return f"[{', '.join(_toml_value(item) for item in value)}]"
    raise InputError(f"{value!r} can not stand in a {KIND}; use a text, a number, true or false, or a list of them")


def _toml_string(text: str) -> str:
    # a JSON string is a TOML basic string, but for DEL, which TOML wants escaped
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
