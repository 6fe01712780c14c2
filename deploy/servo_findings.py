"""Compare what one servo holds and how it is with its rig: findings, each with what to change. Nothing is written."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final, Literal

from controller.registers import registers
from controller.rig import Joint, Rig
from deploy.finding import Finding, Fix
from deploy.joint_counts import count_limits, joint_angle

Values = Mapping[str, int]

_LIMIT_SLACK_RAD: Final = 0.05
_ID_MAX: Final = 252
_OVERVOLTAGE: Final = 1.2
_MULTI_TURN_BIT: Final = 0x10


def setting_findings(rig: Rig, joint: Joint, values: Values) -> Iterator[Finding]:
    """Yield what is wrong in a servo's EEPROM.

    Args:
        rig: the rig
        joint: the servo's joint
        values: register => count
    """
    yield from _line(rig, joint, values)
    family, table = joint.family, registers(joint.product)
    for name, want in family.settings:
        if table[name].eeprom and values[name] != want:
            yield _wrong(joint, values, name, want, f"{name} is {values[name]} and must be {want}")
    mode = family.operating_mode
    if mode is not None and values[mode] != family.modes[joint.mode]:
        want = family.modes[joint.mode]
        yield _wrong(joint, values, mode, want, f"{mode} is {values[mode]} and must be {want}")
    if values.get("secondary_id", _ID_MAX + 1) <= _ID_MAX:
        yield _wrong(joint, values, "secondary_id", 255, f"secondary_id {values['secondary_id']} is active")
    if values.get("phase", 0) & _MULTI_TURN_BIT:
        want = values["phase"] & ~_MULTI_TURN_BIT
        yield _wrong(joint, values, "phase", want, f"phase {values['phase']} counts angles over several turns")
    for name, want in joint.gains.items():
        if table[name].eeprom and values[name] != want:
            yield _wrong(joint, values, name, want, f"{name} is {values[name]}, the rig says {want}")
    yield from _bounds(rig, joint, values)


def state_findings(rig: Rig, joint: Joint, values: Values) -> Iterator[Finding]:
    """Yield what is wrong with a servo's present state.

    Args:
        rig: the rig
        joint: the servo's joint
        values: register => count
    """
    family, table = joint.family, registers(joint.product)
    voltage_v = values[family.voltage] * table[family.voltage].scale
    if voltage_v < rig.safety.voltage_low_v:
        text = (
            f"its supply is {voltage_v:.1f} V, at least {rig.safety.voltage_low_v:g} V are needed; charge or check it"
        )
        yield _found(joint, text)
    if voltage_v > _OVERVOLTAGE * rig.supply_v:
        text = f"its supply is {voltage_v:.1f} V, the rig says {rig.supply_v:g} V; connect the right supply"
        yield _found(joint, text)
    if values[family.temperature] > rig.safety.temperature_c_max:
        yield _found(joint, f"it is at {values[family.temperature]} degrees Celsius; let it cool")
    if not joint.unlimited:
        yield from _place(joint, values[family.position])
    if values[family.torque_enable]:
        yield _found(joint, "its torque was on already; nobody may hold the robot", "warning")


def _place(joint: Joint, position: int) -> Iterator[Finding]:
    angle = joint_angle(joint, position)
    if joint.mode == "position" and not 0 <= position <= joint.product.count_max:
        text = f"its position {position} is outside one turn, so it has wrapped around; reboot the servo"
        yield _found(joint, text)
    elif not joint.low_rad - _LIMIT_SLACK_RAD <= angle <= joint.high_rad + _LIMIT_SLACK_RAD:
        text = (
            f"it stands at {angle:.2f} rad, outside its limits {joint.low_rad:g} to {joint.high_rad:g} rad; move it "
            "inside by hand, or correct zero_tick"
        )
        yield _found(joint, text)


def _line(rig: Rig, joint: Joint, values: Values) -> Iterator[Finding]:
    """Yield what is wrong with how it talks."""
    family, table = joint.family, registers(joint.product)
    bauds = {rate: value for value, rate in family.bauds.items()}
    baud = values[family.baud_rate]
    if family.bauds.get(baud) != rig.bus.baud and rig.bus.baud in bauds:
        text = f"{family.baud_rate} holds {baud}, the rig says {rig.bus.baud} baud"
        yield _wrong(joint, values, family.baud_rate, bauds[rig.bus.baud], text)
    unit_us = round(table[family.return_delay].scale * 1e6)
    delay_us = unit_us * values[family.return_delay]
    if delay_us != rig.bus.return_delay_us:
        want = rig.bus.return_delay_us
        text = f"{family.return_delay} is {delay_us} us, the rig says {want} us"
        yield _wrong(joint, values, family.return_delay, want // unit_us, text)


def _bounds(rig: Rig, joint: Joint, values: Values) -> Iterator[Finding]:
    """Yield which of the servo's own limits are narrower than the rig's."""
    family, table = joint.family, registers(joint.product)
    if joint.mode == "position":
        low, high = count_limits(joint)
        lowest, highest = family.position_limits
        if values[lowest] > low:
            yield _wrong(joint, values, lowest, low, f"{lowest} {values[lowest]} cuts off travel", " or less")
        if values[highest] < high:
            yield _wrong(joint, values, highest, high, f"{highest} {values[highest]} cuts off travel", " or more")
    ceiling = family.ceiling_limit
    if family.torque_ceiling is not None and values[ceiling] < joint.ceiling:
        text = f"{ceiling} {values[ceiling]} is below the rig's {joint.ceiling}"
        yield _wrong(joint, values, ceiling, joint.ceiling, text, ", or the rig's", told=False)
    highest = family.voltage_limits[1]
    volts = values[highest] * table[highest].scale
    if volts < rig.supply_v:
        line = table[highest]
        want = line.initial
        if line.initial * line.scale < rig.supply_v:
            want = min(round(_OVERVOLTAGE * rig.supply_v / line.scale), line.high)
        yield _wrong(joint, values, highest, want, f"{highest} is {volts:g} V, the rig's supply {rig.supply_v:g} V")


def _wrong(joint: Joint, values: Values, name: str, want: int, text: str, more: str = "", told: bool = True) -> Finding:
    """Return the finding of a register that holds what it should not."""
    address = registers(joint.product)[name].address
    remedy = f"set register {address} to {want}{more}" if told else f"set register {address}{more}"
    return Finding("error", f"{_named(joint)}: {text}; {remedy}", Fix(joint.id, name, values[name], want, text))


def _found(joint: Joint, text: str, level: Literal["error", "warning"] = "error") -> Finding:
    return Finding(level, f"{_named(joint)}: {text}")


def _named(joint: Joint) -> str:
    return f"joint {joint.name} (servo {joint.id})"
