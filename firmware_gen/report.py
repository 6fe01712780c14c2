"""The report beside the C: sizes and stack as compilers see them, and the worst case of a step."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from controller.errors import InputError
from firmware_gen.compiled import run_compiler
from firmware_gen.generate import Transpiled
from firmware_gen.unit import Unit


@dataclass(frozen=True)
class Target:
    """Describe how to compile for one kind of machine.

    Args:
        name: as the report calls it
        compiler: its command; the size tool's is beside it
        size: the command that prints section and symbol sizes
        flags: for the compiler
    """

    name: str
    compiler: str
    size: str
    flags: tuple[str, ...]


TARGETS: Final = (
    Target("this machine", "cc", "nm", ()),
    Target(
        "Cortex-M4F",
        "arm-none-eabi-gcc",
        "arm-none-eabi-nm",
        ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16", "-ffreestanding"),
    ),
)

_SYMBOL: Final = re.compile(r"^[0-9a-f]+ ([0-9a-f]+) ([A-Za-z]) (\w+)$", re.M)
_STACK: Final = re.compile(r":(\w+)\t(\d+)\t")


@dataclass(frozen=True)
class Sizes:
    """Hold what one compiler made of a controller.

    Args:
        target: the kind of machine
        compiler: the first line of the compiler's version
        text_bytes: code of each function that is left after inlining, with its name
        table_bytes: constants, which only the selftest reads
        data_bytes: writable memory outside the state structure: none
        stack_bytes: frame of each function, with its name; empty where the compiler can not tell
    """

    target: Target
    compiler: str
    text_bytes: dict[str, int]
    table_bytes: int
    data_bytes: int
    stack_bytes: dict[str, int]


def measure_sizes(transpiled: Transpiled, target: Target) -> Sizes | None:
    """Compile a controller with -O2 and look at the object file.

    Args:
        transpiled: the files
        target: the kind of machine

    Returns:
        the sizes, or None where this machine has no such compiler

    Raises:
        RunError: the files do not compile
    """
    if shutil.which(target.compiler) is None or shutil.which(target.size) is None:
        return None
    with tempfile.TemporaryDirectory(prefix="servolve-c-") as name:
        folder = Path(name)
        source = str(transpiled.source.resolve())
        command = [target.compiler, "-std=c99", "-O2", *target.flags, "-c", source, "-o", "controller.o"]
        run_compiler([*command, "-fstack-usage"], folder)
        symbols = _output([target.size, "-S", "controller.o"], folder)
        version = _output([target.compiler, "--version"], folder).splitlines()[0]
        stacks = "".join(path.read_text(encoding="utf-8", errors="replace") for path in folder.glob("*.su"))
    kinds: dict[str, dict[str, int]] = {"t": {}, "r": {}, "d": {}}
    for size, kind, symbol in _SYMBOL.findall(symbols):
        group = {"t": "t", "r": "r"}.get(kind.lower(), "d")
        kinds[group][symbol] = int(size, 16)
    return Sizes(
        target=target,
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
    sections = [_worst_case(unit)]
    for target in TARGETS:
        sizes = measure_sizes(transpiled, target)
        if sizes is None:
            sections.append(f"## {target.name}\n\nNot measured: there is no {target.compiler} here.\n")
        else:
            sections.append(_sizes(sizes))
    lines = [
        f"# {unit.name}\n",
        f"- controller: {unit.controller.name}",
        f"- program: {unit.program_hash}",
        f"- inputs: {len(unit.controller.inputs)}, outputs: {len(unit.controller.outputs)}",
        f"- state: {unit.state_bytes} bytes, owned by the caller; no heap, no globals",
        f"- period: {unit.controller.period_s:g} s\n",
    ]
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


def _output(command: list[str], folder: Path) -> str:
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, errors="replace", check=True).stdout


def _worst_case(unit: Unit) -> str:
    lines = [
        "## Worst case of a step\n",
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
        f"## {sizes.target.name}\n",
        f"{sizes.compiler}, `{' '.join(['-std=c99', '-O2', *sizes.target.flags])}`: "
        f"{sum(sizes.text_bytes.values())} bytes of code, {sizes.table_bytes} bytes of constants, "
        f"{sizes.data_bytes} bytes of writable data.\n",
        "| function | code [bytes] | stack frame [bytes] |",
        "|---|---|---|",
    ]
    for symbol, size in sizes.text_bytes.items():
        lines.append(f"| `{symbol}` | {size} | {sizes.stack_bytes.get(symbol, '–')} |")
    return "\n".join([*lines, ""])
