"""The report beside the C: what outputs can be, and what the machine code takes of memory, stack and time."""

from __future__ import annotations

import math
import re
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from controller.errors import InputError
from firmware_gen.bounds.footprint import Footprint, has_tools, measure_footprint
from firmware_gen.bounds.intervals import Interval
from firmware_gen.bounds.machine_code import run_tool
from firmware_gen.bounds.ranges import program_ranges
from firmware_gen.bounds.targets import FUNCTIONS, LEVELS, TARGETS, Target, Timing
from firmware_gen.bounds.worst_case import WorstCase
from firmware_gen.transpiler.compiled import run_compiler
from firmware_gen.transpiler.generate import Transpiled
from firmware_gen.transpiler.source import source_expressions
from firmware_gen.transpiler.unit import Unit

REPORT_MARK: Final = "Written by servolve transpile beside the C; do not edit."

_SYMBOL: Final = re.compile(r"^[0-9a-f]+ ([0-9a-f]+) ([A-Za-z]) (\w+)$", re.M)
_STACK: Final = re.compile(r":(\w+)\t(\d+)\t")


@dataclass(frozen=True)
class Sizes:
    """Hold what one compiler made of a controller.

    Args:
        compiler: the first line of the compiler's version
        text_bytes: code of each function that is left after inlining, with its name
        table_bytes: constants, which only the selftest reads
        data_bytes: writable memory outside the state structure: none
        stack_bytes: frame of each function, with its name; empty where the compiler can not tell
    """

    compiler: str
    text_bytes: dict[str, int]
    table_bytes: int
    data_bytes: int
    stack_bytes: dict[str, int]


def measure_sizes(transpiled: Transpiled) -> Sizes | None:
    """Compile a controller for this machine with -O2 and look at the object file.

    Args:
        transpiled: the files

    Returns:
        the sizes, or None where this machine has no compiler

    Raises:
        RunError: the files do not compile
    """
    if shutil.which("cc") is None or shutil.which("nm") is None:
        return None
    with tempfile.TemporaryDirectory(prefix="servolve-c-") as name:
        folder = Path(name)
        source = str(transpiled.source.resolve())
        run_compiler(["cc", "-std=c99", "-O2", "-c", source, "-o", "controller.o", "-fstack-usage"], folder)
        symbols = run_tool(["nm", "-S", "controller.o"], folder)
        version = run_tool(["cc", "--version"], folder).splitlines()[0]
        stacks = "".join(path.read_text(encoding="utf-8", errors="replace") for path in folder.glob("*.su"))
    kinds: dict[str, dict[str, int]] = {"t": {}, "r": {}, "d": {}}
    for size, kind, symbol in _SYMBOL.findall(symbols):
        group = {"t": "t", "r": "r"}.get(kind.lower(), "d")
        kinds[group][symbol] = int(size, 16)
    return Sizes(
        compiler=version,
        text_bytes=kinds["t"],
        table_bytes=sum(kinds["r"].values()),
        data_bytes=sum(kinds["d"].values()),
        stack_bytes={symbol: int(size) for symbol, size in _STACK.findall(stacks)},
    )


def report_text(transpiled: Transpiled) -> str:
    """Write the report as Markdown.

    Args:
        transpiled: the files

    Returns:
        the page

    Raises:
        RunError: the files do not compile
    """
    unit = transpiled.unit
    lines = [
        f"# {unit.name}\n",
        f"{REPORT_MARK}\n",
        f"- controller: {unit.controller.name}",
        f"- program: {unit.program_hash}",
        f"- inputs: {len(unit.controller.inputs)}, outputs: {len(unit.controller.outputs)}",
        f"- state: {unit.state_bytes} bytes, owned by the caller; no heap, no globals",
        f"- period: {unit.controller.period_s:g} s\n",
    ]
    sections = [_outputs(unit), _worst_case(unit)]
    sections += [target_section(transpiled, target) for target in TARGETS]
    sizes = measure_sizes(transpiled)
    sections.append("## This machine\n\nNot measured: there is no cc here.\n" if sizes is None else _sizes(sizes))
    return "\n".join([*lines, *sections])


def write_report(transpiled: Transpiled) -> Path:
    """Write ``<name>.report.md`` beside the C.

    Args:
        transpiled: the files

    Returns:
        its path

    Raises:
        InputError: it can not be written
        RunError: the files do not compile
    """
    path = transpiled.source.with_suffix(".report.md")
    text = report_text(transpiled)
    try:
        path.write_text(text, encoding="utf-8", newline="\n")
    except OSError as error:
        raise InputError(f"{error.filename}: {error.strerror}; choose a folder that can be written") from None
    return path


def _outputs(unit: Unit) -> str:
    """Write what the program can give, and where infinities and NaNs come from."""
    ranges = program_ranges(unit.controller)
    lines = [
        "## Outputs\n",
        "Bounds for any number of steps while every input keeps to its range, rounding included; then what is left of",
        "them behind the clamp, which holds for whatever inputs.\n",
        "| output | unit | the program's own value | clamped |",
        "|---|---|---|---|",
    ]
    for output, interval in zip(unit.controller.outputs, ranges.outputs, strict=True):
        low, high = (min(max(end, output.low), output.high) for end in (interval.low, interval.high))
        if interval.nan:
            low, high = min(low, output.neutral), max(high, output.neutral)
        lines.append(f"| `{output.name}` | {output.unit} | {interval_text(interval)} | {low:.6g} to {high:.6g} |")
    if not ranges.sources:
        return "\n".join([*lines, "", "No operation can give an infinity or a NaN.", ""])
    expressions = source_expressions(unit)
    lines += [
        "",
        "These operations may give an infinity or a NaN out of finite numbers, as far as intervals tell: they know no",
        "relation between operands, and that a divisor may be as near to 0 as floats are.\n",
        "| | expression | may give |",
        "|---|---|---|",
    ]
    for source in ranges.sources:
        kinds = " or ".join(["an infinity"] * source.infinite + ["a NaN"] * source.nan)
        lines.append(f"| v{source.instruction} | `{expressions[source.instruction]}` | {kinds} |")
    return "\n".join([*lines, ""])


def interval_text(interval: Interval) -> str:
    """Return an interval as a reader expects it, with "unbounded" for infinities.

    Args:
        interval: the interval
    """
    if interval.low > interval.high:
        return "only NaN"
    if interval.infinite:
        ends = [f"{end:.6g}" if math.isfinite(end) else "unbounded" for end in (interval.low, interval.high)]
        text = "unbounded" if ends[0] == ends[1] else " to ".join(ends)
    else:
        text = f"{interval.low:.6g} to {interval.high:.6g}"
    return f"{text}, or NaN" if interval.nan else text


def target_section(transpiled: Transpiled, target: Target) -> str:
    """Write what a controller costs on a target.

    Args:
        transpiled: the files
        target: the kind of machine

    Raises:
        RunError: the files do not compile
    """
    if not has_tools(target):
        return f"## {target.name}\n\nNot measured: there is no {target.tools}gcc here.\n"
    builds = [measure_footprint(transpiled, target, level) for level in LEVELS]
    lines = [
        f"## {target.name}\n",
        f"{builds[0].compiler}, `{' '.join(['-std=c99', *target.flags])}`. Worst cases are the longest paths through",
        f"the linked machine code, callees included; cycles after {target.table.source}.",
        *[f"{timing.name}: {timing.assumption}." for timing in target.timings],
        "Interrupts are not counted.\n",
    ]
    for build in builds:
        lines += _build(build)
    return "\n".join(lines)


def _build(build: Footprint) -> list[str]:
    timings = build.target.timings
    lines = [
        f"`{build.level}`: {build.text_bytes} bytes of code, {build.library_bytes} bytes of the compiler's library, "
        f"{build.selftest_bytes} more bytes with the selftest, which takes {_known(build.selftest_stack_bytes)} bytes "
        f"of stack; {build.data_bytes} bytes of writable data.\n",
        "| function | code [bytes] | stack [bytes] | instructions | "
        + " | ".join(f"cycles, {timing.name}" for timing in timings)
        + " |",
        f"|---|---|---|---|{'---|' * len(timings)}",
    ]
    for name in FUNCTIONS:
        lines.append(f"| `{name}` | {build.sizes.get(name, '–')} | {_bound(build.bounds.get(name), timings)} |")
    lines.append(f"| a period: `step`, `command` | | {_bound(build.period, timings)} |")
    if build.period is not None:
        times = [f"{c / t.clock_hz * 1e6:.1f} µs" for c, t in zip(build.period.cycles, timings, strict=True)]
        lines.append(f"| at {timings[0].clock_hz / 1e6:g} MHz | | | | {' | '.join(times)} |")
    return [*lines, "", *[f"No bound for `{name}`: {why}.\n" for name, why in build.refusals.items()]]


def _known(size: int | None) -> str:
    return "an unknown number of" if size is None else str(size)


def _bound(bound: WorstCase | None, timings: tuple[Timing, ...]) -> str:
    if bound is None:
        return " | ".join(["refused"] * (2 + len(timings)))
    return " | ".join(str(value) for value in (bound.stack_bytes, bound.instructions, *bound.cycles))


def _worst_case(unit: Unit) -> str:
    lines = [
        "## Operations of a step\n",
        "Every step evaluates every operation; there are no loops. The last columns bound the float operations and",
        "comparisons that an operation takes, all of its branches counted.\n",
        "| operation | times | each, at most | together |",
        "|---|---|---|---|",
    ]
    for name, count in unit.operation_counts.items():
        bound = unit.operation_bounds[name]
        lines.append(f"| `{name}` | {count} | {bound} | {count * bound} |")
    lines.append(f"| all | {sum(unit.operation_counts.values())} | | {unit.worst_case} |\n")
    return "\n".join(lines)


def _sizes(sizes: Sizes) -> str:
    lines = [
        "## This machine\n",
        f"{sizes.compiler}, `-std=c99 -O2`: {sum(sizes.text_bytes.values())} bytes of code, "
        f"{sizes.table_bytes} bytes of constants, {sizes.data_bytes} bytes of writable data.\n",
        "| function | code [bytes] | stack frame [bytes] |",
        "|---|---|---|",
    ]
    for symbol, size in sizes.text_bytes.items():
        lines.append(f"| `{symbol}` | {size} | {sizes.stack_bytes.get(symbol, '–')} |")
    return "\n".join([*lines, ""])
