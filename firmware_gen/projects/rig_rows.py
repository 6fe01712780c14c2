"""What the firmware reads, compares and writes of one servo before it gets torque: rows of registers and counts.

The same rules as the host loop's, which compares counts with the rig by name (`deploy.servo_findings`,
`deploy.torque`); here every rule is the range that a register must hold.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

from controller.register import Register
from controller.registers import registers
from controller.rig import Joint, Rig
from controller.terminals import joint_scale

LOWEST: Final = 0
HIGHEST: Final = 2**16 - 1
"""The ends of what a row can allow: of registers without a sign in two bytes, or of what its joint says."""

_LIMIT_SLACK_RAD: Final = 0.05
_OVERVOLTAGE: Final = 1.2
_SECONDARY_IDS: Final = (253, 255)
_MULTI_TURN_BIT: Final = 0x10
_TABLE_GAP: Final = 8


@dataclass(frozen=True)
class CheckRow:
    """Say what a register must hold: `sv_check` of `runtime/sv_rig.h`.

    Where a joint may be, and its servo's own limits, are the joint's to say: those rows allow everything here.

    Args:
        register: the register
        low: smallest count, from 0
        high: largest count, below 65536
        kind: what is found otherwise, as `sv_finding` of `runtime/sv_reason.h` names it after SV_FINDING_
        mask: bits of the count that matter, 0: all
    """

    register: Register
    low: int
    high: int
    kind: str = "SETTING"
    mask: int = 0

    @property
    def error(self) -> bool:
        """Whether that keeps the rig from running."""
        return self.kind != "TORQUE"


def check_rows(rig: Rig, joint: Joint) -> tuple[CheckRow, ...]:
    """List what a servo's registers must hold, in the order in which findings are told: errors first.

    Args:
        rig: the rig
        joint: the servo's joint
    """
    rows = [*_line_rows(rig, joint), *_setting_rows(joint), *_bound_rows(rig, joint), *_state_rows(rig, joint)]
    return tuple(sorted(rows, key=lambda row: not row.error))


def setting_counts(joint: Joint) -> Iterator[tuple[Register, int]]:
    """Yield what is written to a servo before it gets torque, in order, but for the torque ceiling, which is last.

    Args:
        joint: the servo's joint
    """
    family, table = joint.family, registers(joint.product)
    in_ram = [(table[name], count) for name, count in family.settings if not table[name].eeprom]
    first = [pair for pair in in_ram if pair[0].name in (family.status_level, family.watchdog)]
    if family.protocol == "feetech" and family.lock is not None:
        yield table[family.lock], 1
    yield from first
    yield from ((table[name], count) for name, count in joint.gains.items() if not table[name].eeprom)
    yield from (pair for pair in in_ram if pair not in first)


def table_blocks(joint: Joint) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return (address, size) of the registers in EEPROM, and of those in RAM up to the first wide gap.

    Args:
        joint: the servo's joint
    """
    table = sorted(registers(joint.product).values(), key=lambda register: register.address)
    start = next(number for number, register in enumerate(table) if not register.eeprom)
    end = start + 1
    for before, after in itertools.pairwise(table[start:]):
        if after.address - (before.address + before.size) >= _TABLE_GAP:
            break
        end += 1
    return _block(table[:start]), _block(table[start:end])


def count_limits(joint: Joint) -> tuple[int, int]:
    """Return the smallest and the largest encoder count within the limits of a joint that has limits [counts].

    Args:
        joint: the joint
    """
    ends = sorted(joint.zero_tick + round(angle / joint_scale(joint)) for angle in (joint.low_rad, joint.high_rad))
    return ends[0], ends[1]


def place_limits(joint: Joint) -> tuple[int, int]:
    """Return the smallest and the largest encoder count where a joint that has limits may stand before a run [counts].

    Args:
        joint: the joint
    """
    scale = joint_scale(joint)
    low, high = joint.low_rad - _LIMIT_SLACK_RAD, joint.high_rad + _LIMIT_SLACK_RAD

    def above(count: int, angle: float) -> bool:
        """Tell whether a count is at or beyond an angle, the way that counts grow."""
        return count * scale >= angle if scale > 0.0 else count * scale <= angle

    def beyond(count: int, angle: float) -> bool:
        return count * scale > angle if scale > 0.0 else count * scale < angle

    near, far = (low, high) if scale > 0.0 else (high, low)
    lowest = joint.zero_tick + _first(lambda count: above(count, near), near / scale)
    highest = joint.zero_tick + _first(lambda count: beyond(count, far), far / scale) - 1
    if joint.mode == "position":
        return max(lowest, 0), min(highest, joint.product.count_max)
    return lowest, highest


def lowest_voltage(rig: Rig, joint: Joint) -> int:
    """Return the least count of a servo's voltage that is not too low.

    Args:
        rig: the rig
        joint: the servo's joint
    """
    scale, low_v = registers(joint.product)[joint.family.voltage].scale, rig.safety.voltage_low_v
    return _first(lambda count: round(count * scale, 6) >= low_v, low_v / scale)


def _block(lines: list[Register]) -> tuple[int, int]:
    first, last = lines[0], lines[-1]
    return first.address, last.address + last.size - first.address


def _line_rows(rig: Rig, joint: Joint) -> Iterator[CheckRow]:
    """Yield how it must talk."""
    family, table = joint.family, registers(joint.product)
    bauds = {rate: count for count, rate in family.bauds.items()}
    if rig.bus.baud in bauds:
        yield _exactly(table[family.baud_rate], bauds[rig.bus.baud])
    delay = table[family.return_delay]
    yield _exactly(delay, rig.bus.return_delay_us // round(delay.scale * 1e6))


def _setting_rows(joint: Joint) -> Iterator[CheckRow]:
    """Yield what its EEPROM must hold."""
    family, table = joint.family, registers(joint.product)
    for name, count in family.settings:
        if table[name].eeprom:
            yield _exactly(table[name], count)
    if family.operating_mode is not None:
        yield _exactly(table[family.operating_mode], family.modes[joint.mode])
    if "secondary_id" in table:
        yield CheckRow(table["secondary_id"], *_SECONDARY_IDS)
    if "phase" in table:
        yield CheckRow(table["phase"], 0, 0, mask=_MULTI_TURN_BIT)
    for name, count in joint.gains.items():
        if table[name].eeprom:
            yield _exactly(table[name], count)


def _bound_rows(rig: Rig, joint: Joint) -> Iterator[CheckRow]:
    """Yield how wide its own limits must be."""
    family, table = joint.family, registers(joint.product)
    if joint.mode == "position":
        lowest, highest = family.position_limits
        yield CheckRow(table[lowest], LOWEST, HIGHEST, "LOW_LIMIT")
        yield CheckRow(table[highest], LOWEST, HIGHEST, "HIGH_LIMIT")
    if family.torque_ceiling is not None:
        yield CheckRow(table[family.ceiling_limit], joint.ceiling, HIGHEST)
    highest = family.voltage_limits[1]
    scale = table[highest].scale
    yield CheckRow(table[highest], _first(lambda count: count * scale >= rig.supply_v, rig.supply_v / scale), HIGHEST)


def _state_rows(rig: Rig, joint: Joint) -> Iterator[CheckRow]:
    """Yield how it must be."""
    family, table = joint.family, registers(joint.product)
    voltage, scale = table[family.voltage], table[family.voltage].scale
    high_v = _OVERVOLTAGE * rig.supply_v
    highest = _first(lambda count: count * scale > high_v, high_v / scale) - 1
    yield CheckRow(voltage, lowest_voltage(rig, joint), highest, "VOLTAGE")
    yield CheckRow(table[family.temperature], LOWEST, math.floor(rig.safety.temperature_c_max), "TEMPERATURE")
    if not joint.unlimited:
        yield CheckRow(table[family.position], LOWEST, HIGHEST, "POSITION")
    yield CheckRow(table[family.torque_enable], 0, 0, "TORQUE")
    if family.hardware_error is not None:
        yield CheckRow(table[family.hardware_error], 0, 0, "HARDWARE")


def _first(holds: Callable[[int], bool], near: float) -> int:
    """Return the smallest count for which something holds that holds from there on, which lies near a number."""
    count = math.floor(near) - 2
    while not holds(count):
        count += 1
    return count


def _exactly(register: Register, count: int) -> CheckRow:
    return CheckRow(register, count, count)
