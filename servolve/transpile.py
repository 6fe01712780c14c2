"""`servolve transpile`: a controller as C files."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.console import Console
from rich.table import Table

import firmware_gen
from controller import load_controller
from controller.errors import RunError
from firmware_gen.check import CheckRow, check_builds


def transpile(
    controller: Path,
    /,
    *,
    out: Path,
    name: str | None = None,
    check: Annotated[bool, Parameter(negative="")] = False,
    json_: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> int:
    """Write a controller as freestanding C99: NAME.h, NAME.c and a report of sizes, NAME.report.md.

    Args:
        controller: a controller file, or a run folder (its best)
        out: the folder to write to
        name: what files and symbols begin with; left out: the controller's name
        check: compile it with every compiler here, run its selftest, and compare 10,000 random steps bit by bit
        json_: print one JSON object

    Returns:
        exit status; 0: written, and no difference found; 1: a difference
    """
    loaded = load_controller(controller)
    transpiled = firmware_gen.transpile(loaded, out, name)
    report = firmware_gen.write_report(transpiled)
    files = [transpiled.header, transpiled.source, report]
    rows: list[CheckRow] = []
    if check:
        progress = Console(stderr=True)
        with progress.status("compiling and comparing"):
            rows = list(check_builds(loaded))
    if json_:
        summary = {"files": [str(path) for path in files], "program_hash": transpiled.unit.program_hash}
        print(json.dumps(summary | ({"check": [asdict(row) for row in rows]} if check else {})))
    else:
        for path in files:
            print(path)
        if check:
            Console(file=sys.stdout).print(_table(rows))
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
