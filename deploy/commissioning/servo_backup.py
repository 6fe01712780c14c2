"""Keep what every register of a rig's servos holds in a file, before any is changed."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from controller.errors import InputError, RunError
from controller.products import PRODUCTS
from controller.registers import registers

FORMAT: Final = 1
KIND: Final = "servolve servo backup"
BYTES_MAX: Final = 1 << 22
_ID_MAX: Final = 253


@dataclass(frozen=True)
class ServoBackup:
    """Hold what one servo held.

    Args:
        id: its id
        product: its product's name
        baud: bit rate at which it answered [bits/s]
        values: register name => count
    """

    id: int
    product: str
    baud: int
    values: Mapping[str, int]


def save_backup(path: Path, rig: str, servos: Sequence[ServoBackup]) -> None:
    """Write a backup file, and return only when it is on the disk.

    Args:
        path: the file; must not be there
        rig: the rig's name
        servos: what they hold

    Raises:
        InputError: the file is there already, or its folder is not
        RunError: it can not be written
    """
    entries = [
        {"id": servo.id, "product": servo.product, "baud": servo.baud, "registers": dict(servo.values)}
        for servo in servos
    ]
    text = json.dumps({"format": FORMAT, "kind": KIND, "rig": rig, "servos": entries}, indent=1) + "\n"
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    except FileExistsError:
        raise InputError(f"{path}: is there already; name another file for the backup with --backup") from None
    except OSError as error:
        raise RunError(
            f"{path}: the backup can not be written ({error.strerror}), so nothing was changed; name another file with "
            "--backup"
        ) from None


def load_backup(path: Path) -> tuple[ServoBackup, ...]:
    """Read a backup file.

    Args:
        path: the file

    Returns:
        what its servos held

    Raises:
        InputError: it can not be read, is no backup, or is of a servo that has moved to another id or bit rate since
    """
    try:
        with path.open("rb") as file:
            data = file.read(BYTES_MAX + 1)
        top = json.loads(data)
    except OSError as error:
        raise InputError(f"{path}: can not be read ({error.strerror}); name a backup file") from None
    except (ValueError, RecursionError):
        raise InputError(f"{path}: is no backup of servos; name a file that --fix has written") from None
    if not isinstance(top, dict) or top.get("kind") != KIND or not isinstance(top.get("servos"), list):
        raise InputError(f"{path}: is no backup of servos; name a file that --fix has written")
    if top.get("format") != FORMAT:
        raise InputError(f"{path}: format {top.get('format')!r} is not known; this version reads format {FORMAT}")
    servos = tuple(_servo(path, entry) for entry in top["servos"])
    if len(servos) == 1 and top.get("rig") == servos[0].product:
        # `rig setup` names no rig
        raise InputError(
            f"{path}: was kept by `servolve rig setup`, which has moved the servo; `servolve rig setup PORT --product "
            f"{servos[0].product} --new-id {servos[0].id} --new-baud {servos[0].baud}` puts it back"
        )
    return servos


def _servo(path: Path, entry: Any) -> ServoBackup:  # noqa: ANN401 (JSON)
    def whole(value: object, low: int, high: int) -> bool:
        return isinstance(value, int) and not isinstance(value, bool) and low <= value <= high

    try:
        table = registers(PRODUCTS[entry["product"]])
        values = entry["registers"]
        sound = whole(entry["id"], 0, _ID_MAX) and whole(entry["baud"], 1, 2**31) and isinstance(values, dict)
        sound = sound and all(whole(value, -(2**31), 2**32) and name in table for name, value in values.items())
    except (KeyError, TypeError):
        sound = False
    if not sound:
        raise InputError(
            f"{path}: does not describe its servos as a backup does; it was edited or damaged, use another"
        )
    return ServoBackup(entry["id"], entry["product"], entry["baud"], values)
