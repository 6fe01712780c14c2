"""Show what would be written to servos for good, ask whether that is wanted, and say how to undo it."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from rich.console import Console
from rich.table import Table

from controller.errors import InputError
from controller.rig import Rig
from controller.rig_file import load_rig
from deploy.finding import Fix


def agreed(console: Console, rig: Rig | None, fixes: Sequence[Fix], yes: bool) -> bool:
    """Show what would be written; return whether somebody agrees to it.

    Args:
        console: where to show and ask
        rig: the rig; None: the servos belong to none yet
        fixes: what would be written
        yes: whether they agreed beforehand
    """
    table = Table("joint", "servo", "register", "holds", "becomes", "why", title="to be changed", title_justify="left")
    names = {joint.id: joint.name for joint in rig.joints} if rig else {}
    for fix in fixes:
        table.add_row(names.get(fix.servo, "-"), str(fix.servo), fix.register, str(fix.held), str(fix.want), fix.why)
    console.print(table)
    if yes:
        return True
    servos = ", ".join(str(servo) for servo in sorted({fix.servo for fix in fixes}))
    count = f"{len(fixes)} register{'s' if len(fixes) > 1 else ''}"
    answer = console.input(f"Torque goes off on servo {servos}: hold the robot. Write {count} for good? \\[y/N] ")
    return answer.strip().lower() in ("y", "yes")


def backup_path(name: str) -> Path:
    """Return where to keep what servos hold now, in this folder.

    Args:
        name: of their rig, or of the one servo
    """
    return Path(f"{name}-servos-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.json")


def restore_command(rig: Rig, port: str, backup: Path) -> str:
    """Return the command that puts a backup back.

    Args:
        rig: the rig
        port: the servos' port
        backup: the file
    """
    try:
        shipped = load_rig(rig.name).path == rig.path
    except InputError:
        shipped = False
    name = rig.name if shipped else str(rig.path)
    return shlex.join(["servolve", "rig", "check", name, "--port", port, "--restore", str(backup)])
