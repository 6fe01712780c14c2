"""Keep the EEPROM of virtual servos between runs: a JSON file, joint name => register name => count.

Beside it the file holds the backups of X servos, which are not registers of their own.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from controller.errors import InputError
from controller.registers import Register, registers
from controller.rig import Joint, Rig
from deploy.virtual.control_table import ControlTable
from deploy.virtual.x_effects import RESTORED


@dataclass(frozen=True)
class Kept:
    """Hold what one servo keeps without power.

    Args:
        eeprom: register name => count
        backup: the same, of its backup, or None if it has none
    """

    eeprom: Mapping[str, int]
    backup: Mapping[str, int] | None = None


def load_eeprom(path: Path, rig: Rig) -> dict[str, Kept]:
    """Load what the servos held last, nothing if there is no such file yet.

    Args:
        path: the file
        rig: the rig whose servos these are

    Returns:
        joint name => what its servo kept

    Raises:
        InputError: the file is none of this rig's
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, RecursionError) as error:
        reason = error.strerror if isinstance(error, OSError) else "no JSON"
        raise InputError(
            f"{path}: is no EEPROM file ({reason}); delete it to start with the rig's own values"
        ) from None
    servos = content.get("servos") if isinstance(content, dict) and content.get("format") == 1 else None
    if not isinstance(servos, dict) or set(servos) != {joint.name for joint in rig.joints}:
        raise InputError(f"{path}: is no EEPROM file of format 1 for {rig.name}; name another file")
    backups = content.get("backups", {})
    backed_up = {joint.name for joint in rig.joints if joint.product.family.startswith("dynamixel-x")}
    if not isinstance(backups, dict) or not set(backups) <= backed_up:
        raise InputError(f"{path}: its backups are of no servos of {rig.name} that keep one; take them out")
    kept = {}
    for joint in rig.joints:
        table = registers(joint.product)
        lines = {name: line for name, line in table.items() if line.eeprom and line.access == "rw"}
        eeprom = _checked(path, joint, servos[joint.name], lines)
        lines |= {name: table[name] for name in RESTORED if name in table}
        backup = _checked(path, joint, backups[joint.name], lines) if joint.name in backups else None
        kept[joint.name] = Kept(eeprom, backup)
    return kept


def _checked(path: Path, joint: Joint, counts: Any, lines: Mapping[str, Register]) -> dict[str, int]:  # noqa: ANN401 (JSON)
    takes = (
        ControlTable(registers(joint.product)).takes if joint.product.family.startswith("dynamixel-x") else _in_range
    )
    for name, value in counts.items() if isinstance(counts, dict) else [("", None)]:
        if name not in lines or type(value) is not int or not takes(lines[name], value):
            raise InputError(
                f"{path}: servo {joint.name}: {name!r} = {value!r} is no EEPROM register with its value; correct it"
            )
    return dict(counts)


def _in_range(line: Register, value: int) -> bool:
    return line.low <= value <= line.high


def save_eeprom(path: Path, rig: Rig, contents: Sequence[Kept]) -> None:
    """Save what the servos hold.

    Args:
        path: the file, replaced in one step
        rig: the rig whose servos these are
        contents: of each joint in order
    """
    named = [(joint.name, kept) for joint, kept in zip(rig.joints, contents, strict=True)]
    content: dict[str, object] = {"format": 1, "servos": {name: dict(kept.eeprom) for name, kept in named}}
    backups = {name: dict(kept.backup) for name, kept in named if kept.backup is not None}
    if backups:
        content["backups"] = backups
    fresh = path.with_name(path.name + ".new")
    fresh.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    fresh.replace(path)
