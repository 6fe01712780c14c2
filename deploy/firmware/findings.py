"""Say what a firmware's check has found as the host's check says it: from the registers that it has read."""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import IntEnum
from types import MappingProxyType
from typing import Final, Literal, cast

from controller.registers import decode_register, registers
from controller.rig import Joint, Rig
from deploy.buses.sensor_reader import SensorReader
from deploy.checks import check_derating, check_sensors, check_watchdogs
from deploy.finding import Finding
from deploy.firmware.records import Block, Found
from deploy.safety import judge_hardware_error
from deploy.servo_findings import setting_findings, state_findings


class Kind(IntEnum):
    """Name the numbers of `sv_finding`."""

    NONE = 0
    ABSENT = 1
    CORRUPT = 2
    MODEL = 3
    UNREADABLE = 4
    GARBLED = 5
    SETTING = 6
    LOW_LIMIT = 7
    HIGH_LIMIT = 8
    VOLTAGE = 9
    TEMPERATURE = 10
    POSITION = 11
    HARDWARE = 12
    SENSOR = 13
    DERATE = 14
    LATE = 15
    TORQUE = 32
    WATCHDOG = 33
    SLOW = 34
    OLD = 35


_WARNINGS: Final = Kind.TORQUE
"""Numbers of warnings begin here."""

_SETTINGS: Final = frozenset({Kind.SETTING, Kind.LOW_LIMIT, Kind.HIGH_LIMIT})
"""Findings of a register that holds the wrong count."""

_STATES: Final[Mapping[int, tuple[str, ...]]] = MappingProxyType(
    {
        Kind.VOLTAGE: ("its supply is ",),
        Kind.TEMPERATURE: ("it is at ",),
        Kind.POSITION: ("its position ", "it stands at "),
        Kind.TORQUE: ("its torque was on ",),
    }
)
"""How the host's sentence of a servo's state begins, after its name."""


def read_values(joint: Joint, block: Block) -> Mapping[str, int]:
    """Return the registers in a block that was read: name => count.

    Args:
        joint: whose
        block: what was read
    """
    end = block.address + len(block.data)
    return {
        name: decode_register(
            register, block.data[register.address - block.address : register.address - block.address + register.size]
        )
        for name, register in registers(joint.product).items()
        if block.address <= register.address and register.address + register.size <= end
    }


def finding(found: Found, rig: Rig, label: str, values: Mapping[str, int]) -> Finding:
    """Return a finding in the host's words.

    Args:
        found: what the firmware says
        rig: the rig
        label: what the bus is called
        values: what was read of the servo, register => count; may lack some

    Returns:
        the finding; of a number that this servolve does not know, the numbers
    """
    level: Literal["error", "warning"] = "error" if found.finding < _WARNINGS else "warning"
    try:
        said = _of_rig(found, rig, label)
        if said is None and found.joint < len(rig.joints):
            joint = rig.joints[found.joint]
            said = _of_line(found, rig, joint, label) or _of_servo(found, rig, joint, values)
    except (KeyError, IndexError, StopIteration):
        said = None  # not of this rig, or not all was read
    if isinstance(said, Finding):
        return said
    return Finding(level, said or _numbers(found, rig))


def _of_rig(found: Found, rig: Rig, label: str) -> Finding | str | None:
    """Return what is about no servo."""
    if found.finding in (Kind.SENSOR, Kind.OLD):
        age_s = math.inf if found.value < 0 else 1e-6 * found.value
        needed = frozenset({found.joint} if found.finding == Kind.SENSOR else ())
        return check_sensors(rig, cast(SensorReader, _Ages(found.joint, age_s)), needed, 0.0)[0]
    if found.finding == Kind.DERATE:
        return check_derating(rig, 0.5)[0]
    if found.finding == Kind.WATCHDOG:
        return check_watchdogs(rig)[0]
    if found.finding == Kind.SLOW:
        return (
            f"{label}: every reply comes at least {1e-3 * found.value:.0f} ms later than the line needs; set the "
            "adapter's latency timer to 1 ms"
        )
    return None


class _Ages:
    """Stand in for a sensor reader: one channel is old, the others are new."""

    def __init__(self, number: int, age_s: float) -> None:
        self._number = number
        self._age_s = age_s

    def age(self, number: int, _: float) -> float:
        return self._age_s if number == self._number else 0.0


def _of_line(found: Found, rig: Rig, joint: Joint, label: str) -> str | None:
    """Return what is about whether and how a servo answers."""
    named = _named(joint)
    if found.finding in (Kind.ABSENT, Kind.CORRUPT):
        said = "does not answer" if found.finding == Kind.ABSENT else "answers with corrupt packets only"
        where = f"on {label} at {rig.bus.baud} baud"
        return f"{named}: {said} {where}; check its power, cable, id and baud rate; rig scan shows who answers"
    if found.finding == Kind.LATE:
        return (
            f"{named}: answers {1e-3 * found.value:.0f} ms late; set the adapter's latency timer to 1 ms, or look for "
            "what else holds bytes back"
        )
    if found.finding == Kind.MODEL:
        return (
            f"{named}: is a model {found.value}, the rig says {joint.product.name} (model "
            f"{joint.product.model_number}); connect the right servo or correct the rig"
        )
    if found.finding in (Kind.UNREADABLE, Kind.GARBLED):
        corrupt = f", answers are corrupt: two servos may share id {joint.id}" if found.finding == Kind.GARBLED else ""
        last = found.address + found.value - 1
        return (
            f"{named}: the registers {found.address} to {last} could not be read{corrupt}; check cables, ground and "
            "other masters on the bus"
        )
    return None


def _of_servo(found: Found, rig: Rig, joint: Joint, values: Mapping[str, int]) -> Finding | None:
    """Return what is about a servo's registers, from all of them."""
    if found.finding == Kind.HARDWARE:
        said = judge_hardware_error(joint, found.value, values.get(joint.family.shutdown))
        return Finding("error", said) if said else None
    if found.finding in _SETTINGS:
        table = registers(joint.product)
        return next(
            one
            for one in setting_findings(rig, joint, values)
            if one.fix is not None and table[one.fix.register].address == found.address
        )
    starts = tuple(f"{_named(joint)}: {start}" for start in _STATES.get(found.finding, ()))
    return next(one for one in state_findings(rig, joint, values) if starts and one.text.startswith(starts))


def _numbers(found: Found, rig: Rig) -> str:
    """Say a finding by its numbers, where the registers that it is about were not recorded."""
    named = _named(rig.joints[found.joint]) if found.joint < len(rig.joints) else "the rig"
    if found.finding in _SETTINGS:
        return f"{named}: register {found.address} holds {found.value}; rig check says what it must hold"
    kind = Kind(found.finding).name.lower() if found.finding in set(Kind) else f"finding {found.finding}"
    return f"{named}: {kind}, {found.value}; see sv_reason.h of the firmware"


def _named(joint: Joint) -> str:
    return f"joint {joint.name} (servo {joint.id})"
