"""Static checks of generated C with the tools that are installed, each in the configuration that suits this code."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final

import numpy as np

from firmware_gen.transpiler.generate import Transpiled
from firmware_gen.transpiler.literals import literal
from firmware_gen.transpiler.unit import Unit

SECONDS_MAX: Final = 300.0

WARNINGS: Final = (
    *("-std=c99", "-ffp-contract=off", "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion"),
    *("-Wmissing-prototypes", "-Wshadow"),
)

TIDY_CHECKS: Final = (
    "-*,clang-analyzer-*,bugprone-*,cert-*,misc-*,performance-*,portability-*,-bugprone-easily-swappable-parameters"
)

DEVIATIONS: Final = MappingProxyType(
    {
        "2.4": "enumerations of places and sizes have no variables of their types",
        "8.7": "the interface is for other files",
        "8.9": "the selftest's tables stand together, in front of its functions",
        "12.1": "a comparison before ?: needs no parentheses to be read",
        "15.5": "guards return early",
        "17.8": "a parameter is scaled or mixed where it is",
        "19.2": "unions read the bits of floats",
    }
)
"""MISRA C:2012 rules that generated code deviates from, with the reason; all of them are advisory."""

_SUPPRESSED: Final = (
    *(f"misra-c2012-{rule}" for rule in DEVIATIONS),
    *("missingIncludeSystem", "variableScope", "unusedFunction", "unmatchedSuppression"),
    # evolved programs say a - a and a / a, and mean it: infinities and NaNs
    *("duplicateExpression", "duplicateExpressionTernary", "duplicateConditionalAssign", "knownConditionTrueFalse"),
)


@dataclass(frozen=True)
class ToolRow:
    """Hold what one tool found.

    Args:
        tool: its name, and what it was asked
        version: of the tool, or how to install it where it is missing
        findings: how many; None where the tool is missing or failed
        first: the first of them, or why it failed
    """

    tool: str
    version: str
    findings: int | None
    first: str


@dataclass(frozen=True)
class Tool:
    """Describe one tool.

    Args:
        name: as the table calls it
        command: its command
        package: Debian's package of it
        arguments: (files, folder) => its arguments
        finding: matches a line for each finding
    """

    name: str
    command: str
    package: str
    arguments: Callable[[Transpiled, Path], list[str]]
    finding: re.Pattern[str]


def check_statically(transpiled: Transpiled, names: Sequence[str] = ()) -> Iterator[ToolRow]:
    """Run every tool that is installed on the generated files.

    Args:
        transpiled: the files
        names: of tools, to run only these

    Returns:
        one row for each tool, as they are done, those that are missing included
    """
    for tool in TOOLS:
        if names and tool.name not in names:
            continue
        if shutil.which(tool.command) is None:
            yield ToolRow(tool.name, f"not installed: apt-get install {tool.package}", None, "")
            continue
        with tempfile.TemporaryDirectory(prefix="servolve-check-") as folder:
            yield _run(tool, transpiled, Path(folder))


def _run(tool: Tool, transpiled: Transpiled, folder: Path) -> ToolRow:
    command = [tool.command, *tool.arguments(transpiled, folder)]
    version = _version(tool.command)
    try:
        done = subprocess.run(
            command, cwd=folder, capture_output=True, text=True, errors="replace", check=False, timeout=SECONDS_MAX
        )
    except subprocess.TimeoutExpired:
        return ToolRow(tool.name, version, None, f"took more than {SECONDS_MAX:g} s")
    text = (done.stdout + done.stderr).replace(f"{transpiled.source.resolve().parent}/", "")
    # Frama-C says what it means on the next line
    lines = [line.strip() for line in text.replace("Warning: \n", "Warning: ").splitlines()]
    found = [line for line in lines if tool.finding.search(line)]
    if done.returncode != 0 and not found:
        return ToolRow(tool.name, version, None, next((line for line in lines if "rror" in line), "it failed"))
    return ToolRow(tool.name, version, len(found), found[0] if found else "")


def _version(command: str) -> str:
    """Return the number of a version that a tool prints."""
    done = subprocess.run([command, "--version"], capture_output=True, text=True, errors="replace", check=False)
    match = re.search(r"\d+\.\d+(?:\.\d+)?", done.stdout)
    return match[0] if match else "unknown"


def _gcc(transpiled: Transpiled, _folder: Path) -> list[str]:
    return [*WARNINGS, "-O2", "-fanalyzer", "-c", str(transpiled.source.resolve()), "-o", "controller.o"]


def _clang_tidy(transpiled: Transpiled, _folder: Path) -> list[str]:
    return ["--quiet", f"--checks={TIDY_CHECKS}", str(transpiled.source.resolve()), "--", *WARNINGS]


def _cppcheck(transpiled: Transpiled, _folder: Path) -> list[str]:
    return [
        *("--quiet", "--std=c99", "--enable=warning,style,performance,portability", "--inconclusive", "--addon=misra"),
        *(f"--suppress={name}" for name in _SUPPRESSED),
        *("--template={id} {file}:{line} {message}", str(transpiled.source.resolve())),
    ]


def _eva(special_floats: str) -> Callable[[Transpiled, Path], list[str]]:
    def arguments(transpiled: Transpiled, folder: Path) -> list[str]:
        (folder / "driver.c").write_text(eva_driver(transpiled.unit), encoding="utf-8")
        source = transpiled.source.resolve()
        return [
            *("-machdep", "gcc_x86_64", f"-cpp-extra-args=-I'{source.parent}'", "-eva", "-eva-precision", "3"),
            *("-warn-special-float", special_floats, "-kernel-warn-key", "parser:decimal-float=inactive"),
            *(str(folder / "driver.c"), str(source)),
        ]

    return arguments


def eva_driver(unit: Unit) -> str:
    """Write a main for Frama-C: any number of periods, every input anywhere in its range.

    Args:
        unit: the controller and its names

    Returns:
        C, with Frama-C's built-in functions
    """
    name = unit.name
    draws = [
        f"    inputs[{i}] = Frama_C_float_interval({literal(np.float32(t.low))}, {literal(np.float32(t.high))});"
        for i, t in enumerate(unit.controller.inputs)
    ]
    return "\n".join(
        [
            '#include "__fc_builtin.h"',
            f'#include "{name}.h"',
            "int main(void) {",
            f"  {name}_state state;",
            f"  float inputs[{max(len(unit.controller.inputs), 1)}];",
            f"  float outputs[{name}_noutput];",
            f"  float command[{name}_noutput];",
            f"  {name}_init(&state);",
            "  inputs[0] = 0.0F;",
            "  while (Frama_C_interval(0, 1)) {",
            *draws,
            f"    {name}_step(&state, inputs, outputs);",
            f"    {name}_command(&state, outputs, command);",
            "  }",
            "  return 0;",
            "}",
            "",
        ]
    )


_DIAGNOSTIC: Final = re.compile(r"\b(?:warning|error): ")
_ALARM: Final = re.compile(r"\[eva:alarm\]")

TOOLS: Final = (
    Tool("gcc -fanalyzer and warnings", "gcc", "gcc", _gcc, _DIAGNOSTIC),
    Tool("clang-tidy", "clang-tidy", "clang-tidy", _clang_tidy, _DIAGNOSTIC),
    Tool("cppcheck, MISRA C:2012", "cppcheck", "cppcheck", _cppcheck, re.compile(r"^[\w.-]+ \S+:\d+ ")),
    Tool("Frama-C EVA, undefined behaviour", "frama-c", "frama-c-base", _eva("none"), _ALARM),
    Tool("Frama-C EVA, infinities and NaNs", "frama-c", "frama-c-base", _eva("non-finite"), _ALARM),
)
