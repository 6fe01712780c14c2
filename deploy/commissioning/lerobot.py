"""Read and write LeRobot's calibration files: for each motor id, drive mode, homing offset and range, in counts.

Source: huggingface/lerobot, `MotorCalibration` of src/lerobot/motors/motors_bus.py; the range is in counts as the servo
reports them, homing offset applied.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Final

from controller.errors import InputError

BYTES_MAX: Final = 1 << 20
_COUNT_MAX: Final = 2**31


@dataclass(frozen=True)
class MotorCalibration:
    """Hold the calibration of one motor, in LeRobot's terms.

    Args:
        id: servo id
        drive_mode: 1 where positive is against the servo's counts, else 0; for Dynamixel servos their register
        homing_offset: of the servo's register [counts]
        range_min: smallest present position [counts]
        range_max: largest present position [counts]
    """

    id: int
    drive_mode: int
    homing_offset: int
    range_min: int
    range_max: int


def read_calibration(path: Path) -> dict[str, MotorCalibration]:
    """Read a calibration file.

    Args:
        path: the file

    Returns:
        motor name => calibration, in the file's order

    Raises:
        InputError: it can not be read or is no calibration file
    """
    try:
        data = path.read_bytes()[: BYTES_MAX + 1]
        if len(data) > BYTES_MAX:
            raise InputError(
                f"{path}: is larger than {BYTES_MAX} bytes; that can not be a calibration, name another file"
            )
        motors = json.loads(data, object_pairs_hook=lambda pairs: _once(path, pairs))
    except OSError as error:
        raise InputError(f"{path}: can not be read ({error.strerror}); name a LeRobot calibration file") from None
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        line = f", line {error.lineno}" if isinstance(error, json.JSONDecodeError) else ""
        raise InputError(f"{path}{line}: is not JSON; name a LeRobot calibration file") from None
    except RecursionError:
        raise InputError(f"{path}: is nested too deeply; name a LeRobot calibration file") from None
    if not isinstance(motors, dict) or not motors:
        raise InputError(f"{path}: holds no motors; write an object with one entry for each motor")
    calibrations = {name: _calibration(path, name, entry) for name, entry in motors.items()}
    ids = [calibration.id for calibration in calibrations.values()]
    for servo in ids:
        if ids.count(servo) > 1:
            raise InputError(f"{path}: id {servo} is used twice; give each motor its own id")
    return calibrations


def calibration_text(calibrations: Mapping[str, MotorCalibration]) -> str:
    """Return the text of a calibration file, as LeRobot writes it.

    Args:
        calibrations: motor name => calibration
    """
    return json.dumps({name: asdict(calibration) for name, calibration in calibrations.items()}, indent=4) + "\n"


def _once(path: Path, pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    names = [name for name, _ in pairs]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{path}: '{name}' stands there twice; remove one of the two")
    return dict(pairs)


def _calibration(path: Path, name: str, entry: object) -> MotorCalibration:
    keys = [field.name for field in fields(MotorCalibration)]
    if not isinstance(entry, dict):
        raise InputError(f"{path}: motor '{name}' is no object; write {', '.join(keys)} in it")
    for key in keys:
        value = entry.get(key)
        if isinstance(value, bool) or not isinstance(value, int) or abs(value) >= _COUNT_MAX:
            raise InputError(f"{path}: motor '{name}': {key} is missing or no whole number; write one")
    for key in entry:
        if key not in keys:
            raise InputError(f"{path}: motor '{name}': '{key}' is not known; remove it (known: {', '.join(keys)})")
    calibration = MotorCalibration(**entry)
    if calibration.range_min >= calibration.range_max:
        raise InputError(
            f"{path}: motor '{name}': range_min {calibration.range_min} is not below range_max "
            f"{calibration.range_max}; record the range again"
        )
    return calibration
