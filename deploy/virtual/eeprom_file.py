"""Keep the EEPROM of virtual servos between runs: a JSON file, joint name => register name => count."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from controller.errors import InputError
from controller.registers import Register, registers
from controller.rig import Rig
from deploy.virtual.control_table import ControlTable


def load_eeprom(path: Path, rig: Rig) -> dict[str, dict[str, int]]:
    """Load what the servos held last, nothing if there is no such file yet.

    Args:
        path: the file
        rig: the rig whose servos these are

    Returns:
        joint name => register name => count

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
    for joint in rig.joints:
        table = registers(joint.product)
        lines = {name: line for name, line in table.items() if line.eeprom and line.access == "rw"}
        takes = ControlTable(table).takes if joint.product.family.startswith("dynamixel-x") else _in_range
        for name, value in servos[joint.name].items() if isinstance(servos[joint.name], dict) else [("", None)]:
            if name not in lines or type(value) is not int or not takes(lines[name], value):
                raise InputError(
                    f"{path}: servo {joint.name}: {name!r} = {value!r} is no EEPROM register with its value; correct it"
                )
    return servos


def _in_range(line: Register, value: int) -> bool:
    return line.low <= value <= line.high


def save_eeprom(path: Path, rig: Rig, contents: Sequence[Mapping[str, int]]) -> None:
    """Save what the servos hold.

    Args:
        path: the file, replaced in one step
        rig: the rig whose servos these are
        contents: register name => count, of each joint in order
    """
    servos = {joint.name: dict(content) for joint, content in zip(rig.joints, contents, strict=True)}
    fresh = path.with_name(path.name + ".new")
    fresh.write_text(json.dumps({"format": 1, "servos": servos}, indent=1) + "\n", encoding="utf-8")
    fresh.replace(path)
