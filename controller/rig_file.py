"""Load a `rig.toml`, checking all of it: a rig that loads can be simulated, served and deployed."""

from __future__ import annotations

import difflib
import math
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Final, Literal, cast

from controller.errors import InputError
from controller.families import FAMILIES
from controller.registers import registers
from controller.rig import Bus, Joint, Rig, Safety
from controller.rig_joints import PROTOCOL_FAMILIES, read_joints
from controller.rig_sensors import read_sensors
from controller.toml_table import Table, parse_toml, read_toml

RAW_CHANNEL_MAX: Final = 128
"""`SV_RAW_MAX` of `runtime/sv_sizes.h`."""

# protocol: bytes of packets with nothing in them: a sync read or write, a status, a read of one servo
_PACKET_BYTES: Final = {"dynamixel-2.0": (14, 11, 14), "dynamixel-1.0": (8, 6, 8), "feetech": (8, 6, 8)}

_NO_BUS: Final = Bus(protocol="none", baud=0, return_delay_us=0)
_NO_SAFETY: Final = Safety("off", 0.0, 0.0, 0.0, 0, 0.0, 0.0, 0.0, 0, 0.0)


def rig_names() -> tuple[str, ...]:
    """Return the names of the rigs that come with servolve, sorted."""
    return tuple(sorted(_shipped()))


def load_rig(name_or_path: str | Path) -> Rig:
    """Load a rig and check all of it.

    Args:
        name_or_path: a name that `rig_names` lists, or the path of a rig file

    Returns:
        the rig

    Raises:
        InputError: there is no such rig, or something in its file is wrong
    """
    shipped = _shipped()
    text = str(name_or_path)
    if text in shipped:
        path = shipped[text]
    elif isinstance(name_or_path, Path) or text.endswith(".toml") or "/" in text or (text and Path(text).exists()):
        path = Path(name_or_path)
    else:
        close = difflib.get_close_matches(text, shipped, n=1)
        hint = f"did you mean '{close[0]}'?" if close else f"known: {', '.join(sorted(shipped))}, or give a file's path"
        raise InputError(f"there is no rig '{text}'; {hint}")
    return _rig(read_toml(path, "rig file"), path, body_needed=True)


def parse_rig(text: str, path: Path) -> Rig:
    """Build a rig from the text of its file, as a log embeds it.

    Args:
        text: the file's text
        path: where the file is or was; the body stands beside it, or is gone: nothing but a simulation needs it

    Returns:
        the rig

    Raises:
        InputError: something in the text is wrong
    """
    return _rig(parse_toml(text, str(path), "rig file"), path, body_needed=False)


def require_bus(rig: Rig, purpose: str) -> None:
    """Refuse a rig that exists in simulation only.

    Args:
        rig: the rig
        purpose: what needs a bus, as the error names it

    Raises:
        InputError: the rig has no bus
    """
    if rig.simulated_only:
        buildable = {name: path for name, path in _shipped().items() if not load_rig(name).simulated_only}
        beside = [name for name, path in buildable.items() if path.parent == rig.path.parent]
        # the lamps and jumpers that are told of most
        known = [name for name in beside or buildable if name.endswith("-xc330")]
        raise InputError(
            f"rig {rig.name}: exists in simulation only, and {purpose} needs a bus; "
            f"choose a rig that can be built, as {min(known or beside or buildable)}"
        )


def _shipped() -> dict[str, Path]:
    folder = Path(__file__).resolve().parent.parent / "sim_models"
    suffix = ".rig.toml"
    return {path.name.removesuffix(suffix): path for path in sorted(folder.glob(f"*/*{suffix}"))}


def _rig(top: Table, path: Path, body_needed: bool) -> Rig:
    top.refuse_unknown(("format", "rig", "bus", "safety", "joint", "sensor"))
    head = top.table("rig")
    head.refuse_unknown(("name", "body", "period_s", "supply_v", "facing"))
    name = head.name_value("name")
    body = path.parent / head.text_value("body")
    if body_needed and not body.is_file():
        head.fail("body", f"body '{head.values['body']}' is not a file beside the rig file; name the MJCF there")
    period_s = head.positive("period_s", 1.0)
    bus = _bus(top.table("bus"))
    joints = read_joints(top, bus)
    if bus.protocol == "none":
        supply_v, safety = 0.0, _NO_SAFETY
        for table, key in ((head, "supply_v"), (top, "safety")):
            if key in table.values:
                table.fail(key, f"{key} means nothing to a rig without a bus; remove it")
    else:
        supply_v = head.positive("supply_v")
        _check_supply(head, joints)
        _check_baud(top.table("bus"), bus, joints)
        _check_traffic(head, bus, joints, period_s)
        safety = _safety(top.table("safety"), period_s, supply_v, joints)
    sensors = read_sensors(top, joints, period_s if bus.protocol == "none" else None)
    if 3 * len(joints) + len(sensors) > RAW_CHANNEL_MAX:
        top.fail(None, f"joints and sensors make more than {RAW_CHANNEL_MAX} raw channels; remove some")
    return Rig(
        name=name,
        path=path,
        body=body,
        period_s=period_s,
        supply_v=supply_v,
        bus=bus,
        safety=safety,
        joints=joints,
        sensors=sensors,
        text=top.text,
        facing=_facing(head, joints),
    )


def _facing(head: Table, joints: Sequence[Joint]) -> str | None:
    return head.text_value("facing", [joint.name for joint in joints]) if "facing" in head.values else None


def _bus(table: Table) -> Bus:
    table.refuse_unknown(field.name for field in fields(Bus))
    protocol = cast(
        Literal["dynamixel-2.0", "dynamixel-1.0", "feetech-sts", "feetech-scs", "none"],
        table.text_value("protocol", PROTOCOL_FAMILIES),
    )
    if protocol == "none":
        for key in ("baud", "return_delay_us"):
            if key in table.values:
                table.fail(key, f'{key} means nothing with protocol = "none"; remove it')
        return _NO_BUS
    baud = table.integer("baud", 1, 2**31 - 1)
    rates = {rate for name in PROTOCOL_FAMILIES[protocol] for rate in FAMILIES[name].bauds.values()}
    if baud not in rates:
        offered = ", ".join(str(rate) for rate in sorted(rates))
        table.fail("baud", f"baud {baud} is not offered by {protocol} servos; choose one of {offered}")
    delay_us = table.integer("return_delay_us", 0, 508)
    if delay_us % 2:
        table.fail(
            "return_delay_us", f"return_delay_us {delay_us} is odd; the register counts 2 us, write an even number"
        )
    return Bus(protocol=protocol, baud=baud, return_delay_us=delay_us)


def _safety(table: Table, period_s: float, supply_v: float, joints: Sequence[Joint]) -> Safety:
    table.refuse_unknown(field.name for field in fields(Safety))
    watchdog_s = table.number("watchdog_s", 0.0, 2.54)
    without = [joint.product.name for joint in joints if joint.family.watchdog is None]
    if watchdog_s and without:
        table.fail("watchdog_s", f"watchdog_s {watchdog_s:g} asks for what {without[0]} servos do not have; write 0.0")
    if abs(watchdog_s / 0.02 - round(watchdog_s / 0.02)) > 1e-6:
        table.fail("watchdog_s", f"watchdog_s {watchdog_s:g} is no multiple of 0.02 s, the register's unit; round it")
    if 0.0 < watchdog_s <= period_s:
        table.fail("watchdog_s", f"watchdog_s {watchdog_s:g} is not above the period; write at least {2 * period_s:g}")
    voltage_low_v = table.number("voltage_low_v", 0.0)
    if voltage_low_v >= supply_v:
        table.fail("voltage_low_v", f"voltage_low_v {voltage_low_v:g} is not below supply_v {supply_v:g}; lower it")
    temperature_c_max = table.positive("temperature_c_max")
    limit = min(registers(joint.product)[joint.family.temperature_limit].initial for joint in joints)
    if temperature_c_max > limit:
        table.fail(
            "temperature_c_max",
            f"temperature_c_max {temperature_c_max:g} is above the servos' own shutdown; write at most {limit}",
        )
    return Safety(
        stop=cast(Literal["off", "hold"], table.text_value("stop", ("off", "hold"))),
        homing_rad_s=table.positive("homing_rad_s"),
        tracking_rad_max=table.positive("tracking_rad_max"),
        tracking_s_max=table.positive("tracking_s_max"),
        missed_cycles_max=table.integer("missed_cycles_max", 1, 1000),
        temperature_c_max=temperature_c_max,
        voltage_low_v=voltage_low_v,
        tilt_rad_max=table.number("tilt_rad_max", 0.0, math.pi),
        overrun_cycles_max=table.integer("overrun_cycles_max", 1, 1000),
        watchdog_s=watchdog_s,
    )


def _check_supply(head: Table, joints: Sequence[Joint]) -> None:
    supply_v = head.values["supply_v"]
    for joint in joints:
        lines = registers(joint.product)
        low, high = (lines[name].initial * lines[name].scale for name in joint.family.voltage_limits)
        if not low <= supply_v <= high:
            head.fail(
                "supply_v",
                f"supply_v {supply_v:g} is outside {low:g} to {high:g} V of {joint.product.name}; change the supply",
            )


def _check_baud(table: Table, bus: Bus, joints: Sequence[Joint]) -> None:
    """Refuse a bit rate that one of the servos does not offer."""
    for joint in joints:
        if bus.baud not in joint.family.bauds.values():
            offered = ", ".join(str(rate) for rate in sorted(joint.family.bauds.values()))
            table.fail("baud", f"baud {bus.baud} is not offered by {joint.product.name}; choose one of {offered}")


def _check_traffic(head: Table, bus: Bus, joints: Sequence[Joint], period_s: float) -> None:
    """Refuse a bus that can not carry one period's questions and answers within the period."""
    njoint, family = len(joints), joints[0].family
    sync, status, read = _PACKET_BYTES[family.protocol]
    asked = sync + njoint if family.sync_read else read * njoint
    answered = sum(status + _block_bytes(joint, joint.family.state) for joint in joints)
    written = sync + sum(1 + _block_bytes(joint, (joint.family.goal(joint.mode),) * 2) for joint in joints)
    needed_s = (asked + answered + written) * 10 / bus.baud + njoint * bus.return_delay_us * 1e-6
    if needed_s >= period_s:
        head.fail(
            "period_s",
            f"period_s {period_s:g} is too short for its traffic of {1e3 * needed_s:.1f} ms at {bus.baud} bit/s; "
            "lengthen it, raise baud or lower return_delay_us",
        )


def _block_bytes(joint: Joint, block: tuple[str, str]) -> int:
    """Return the size of a block of registers, from its first to its last."""
    first, last = (registers(joint.product)[name] for name in block)
    return last.address + last.size - first.address
