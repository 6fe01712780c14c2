"""`servolve transpile`: a controller as C files."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.console import Console
from rich.markup import escape
from rich.table import Table

import firmware_gen
from controller import load_controller
from controller.errors import RunError
from firmware_gen.check import CheckRow, check_builds
from firmware_gen.out_folder import check_out_folder
from firmware_gen.static_checks import DEVIATIONS, ToolRow, check_statically


def transpile(
    controller: Path,
    /,
    *,
    out: Path,
    name: str | None = None,
    check: Annotated[bool, Parameter(negative="")] = False,
    force: Annotated[bool, Parameter(negative="")] = False,
    json_: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> int:
    """Write a controller as freestanding C99: NAME.h, NAME.c and a report of sizes, NAME.report.md.

    Args:
        controller: a controller file, or a run folder (its best)
        out: the folder to write to
        name: what files and symbols begin with; left out: the controller's name
        check: compile it with every compiler here, run its selftest, compare 10,000 random steps bit by bit, and run
            the static checkers that are installed
        force: write into a folder that holds other files, and over files of the same names
        json_: print one JSON object

    Returns:
        exit status; 0: written, and no difference found; 1: a difference
    """
    loaded = load_controller(controller)
    generated = firmware_gen.generate(loaded, name)  # a bad name is refused before the folder is looked at
    check_out_folder(out, force)
    transpiled = firmware_gen.transpile(loaded, out, generated.unit.name)
    report = firmware_gen.write_report(transpiled)
    files = [transpiled.header, transpiled.source, report]
    rows: list[CheckRow] = []
    findings: list[ToolRow] = []
    if check:
        progress = Console(stderr=True)
        with progress.status("compiling and comparing"):
            rows = list(check_builds(loaded))
        with progress.status("looking for what the tools find"):
            findings = list(check_statically(transpiled))
    if json_:
        summary = {"files": [str(path) for path in files], "program_hash": transpiled.unit.program_hash}
        checked = {"check": [asdict(row) for row in rows], "static": [asdict(row) for row in findings]}
        print(json.dumps(summary | (checked if check else {})))
    else:
        for path in files:
            print(path)
        if check:
            console = Console(file=sys.stdout)
            console.print(_table(rows))
            console.print(_findings(findings))
    failed = [row for row in rows if not row.passed]
    if failed:
        builds = ", ".join(f"{row.compiler} {row.flags}" for row in failed)
        raise RunError(f"{transpiled.source}: compiled C differs from the virtual machine with {builds}; do not use it")
    return 0


def _table(rows: list[CheckRow]) -> Table:
    table = Table("build", "selftest", "steps", "not as the VM", "steps", "not as the reference")
    for row in rows:
        table.add_row(
            f"{row.compiler} {row.flags}",
            "passed" if row.selftest == 0 else f"failed: {row.selftest}",
            str(row.steps),
            str(row.vm_differences),
            str(row.reference_steps),
            str(row.reference_differences),
        )
    return table


def _findings(rows: list[ToolRow]) -> Table:
    table = Table(
        "static check",
        "version",
        "findings",
        "the first",
        caption=f"MISRA's advisory rules {', '.join(DEVIATIONS)} are deviated from, see docs/transpile.md",
    )
    for row in rows:
        table.add_row(row.tool, row.version, "–" if row.findings is None else str(row.findings), escape(row.first))
    return table
