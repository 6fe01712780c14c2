"""Load a `rig.toml`, checking all of it: a rig that loads can be simulated, served and deployed."""

from __future__ import annotations

import difflib
import math
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Final, Literal, cast

import numpy as np

from controller.cycle import COUNT_MAX
from controller.errors import InputError
from controller.operations import BY_NAME
from controller.products import PRODUCTS
from controller.registers import X330_BAUD, registers
from controller.rig import Bus, Joint, Rig, Safety, Sensor
from controller.toml_table import Table, parse_toml, read_toml

RAW_CHANNEL_MAX: Final = 128
"""`SV_RAW_MAX` of `runtime/sv_cycle.h`."""

DERIVED_TERMINALS: Final = ("t", "goal_dist", "px", "py", "pz", "goal_met", "heading_error")
"""Terminals that the control cycle computes: no joint or sensor may take their names."""

SENSOR_UNITS: Final = {"x": "m", "y": "m", "z": "m", "heading": "rad", "roll": "rad", "pitch": "rad", "force": "N"}
"""Channels with a meaning of their own, and the unit that each must have."""

# bytes of Dynamixel 2.0 packets with nothing in them, and of the blocks that are read and written in every period
_SYNC_BYTES, _STATUS_BYTES, _STATE_BYTES, _GOAL_BYTES = 14, 11, 10, 4

_PROTOCOL_FAMILIES: Final = {"dynamixel-2.0": ("dynamixel-x330",)}


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


def _shipped() -> dict[str, Path]:
    folder = Path(__file__).resolve().parent.parent / "sim_models"
    suffix = ".rig.toml"
    return {path.name.removesuffix(suffix): path for path in sorted(folder.glob(f"*/*{suffix}"))}


def _rig(top: Table, path: Path, body_needed: bool) -> Rig:
    top.refuse_unknown(("format", "rig", "bus", "safety", "joint", "sensor"))
    head = top.table("rig")
    head.refuse_unknown(("name", "body", "period_s", "supply_v"))
    name = head.name_value("name")
    body = path.parent / head.text_value("body")
    if body_needed and not body.is_file():
        head.fail("body", f"body '{head.values['body']}' is not a file beside the rig file; name the MJCF there")
    period_s = head.positive("period_s", 1.0)
    supply_v = head.positive("supply_v")
    bus = _bus(top.table("bus"))
    joints = _joints(top, bus)
    _check_supply(head, joints)
    _check_traffic(head, bus, len(joints), period_s)
    safety = _safety(top.table("safety"), period_s, supply_v, joints)
    sensors = _sensors(top, joints)
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
    )


def _bus(table: Table) -> Bus:
    table.refuse_unknown(field.name for field in fields(Bus))
    protocol = cast(Literal["dynamixel-2.0"], table.text_value("protocol", _PROTOCOL_FAMILIES))
    baud = table.integer("baud", 1, 2**31 - 1)
    if baud not in X330_BAUD.values():
        offered = ", ".join(str(rate) for rate in X330_BAUD.values())
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
    if abs(watchdog_s / 0.02 - round(watchdog_s / 0.02)) > 1e-6:
        table.fail("watchdog_s", f"watchdog_s {watchdog_s:g} is no multiple of 0.02 s, the register's unit; round it")
    if 0.0 < watchdog_s <= period_s:
        table.fail("watchdog_s", f"watchdog_s {watchdog_s:g} is not above the period; write at least {2 * period_s:g}")
    voltage_low_v = table.number("voltage_low_v", 0.0)
    if voltage_low_v >= supply_v:
        table.fail("voltage_low_v", f"voltage_low_v {voltage_low_v:g} is not below supply_v {supply_v:g}; lower it")
    temperature_c_max = table.positive("temperature_c_max")
    limit = min(registers(joint.product)["temperature_limit"].initial for joint in joints)
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


def _joints(top: Table, bus: Bus) -> tuple[Joint, ...]:
    tables = top.tables("joint")
    if not tables:
        top.fail(None, "there is no joint; add a table [[joint]] for each servo")
    joints = tuple(_joint(table, bus) for table in tables)
    _refuse_twice(tables, "name", [joint.name for joint in joints], "give each joint its own name")
    _refuse_twice(tables, "mjcf_joint", [joint.mjcf_joint for joint in joints], "name each hinge once")
    _refuse_twice(tables, "id", [joint.id for joint in joints], "give each servo its own id")
    taken = {f"{joint.name}{suffix}" for joint in joints for suffix in ("_vel", "_load")}.union(DERIVED_TERMINALS)
    for table, joint in zip(tables, joints, strict=True):
        if joint.name in taken:
            table.fail("name", f"name '{joint.name}' is the name of another terminal; choose another name")
        if joint.name in BY_NAME or joint.name in ("list", "let", "last"):
            table.fail("name", f"name '{joint.name}' is an operation of programs; choose another name")
    return joints


def _joint(table: Table, bus: Bus) -> Joint:
    table.refuse_unknown(field.name for field in fields(Joint))
    product = PRODUCTS[table.text_value("product", PRODUCTS)]
    if product.family not in _PROTOCOL_FAMILIES[bus.protocol]:
        table.fail("product", f"product '{product.name}' does not speak {bus.protocol}; choose another product")
    sign = table.integer("sign", -(2**31), 2**31 - 1)
    if sign not in (1, -1):
        table.fail("sign", f"sign {sign} is neither 1 nor -1; write 1, or -1 where the encoder counts the other way")
    zero_tick = table.integer("zero_tick", 0, product.ticks_per_turn - 1)
    low = table.number("low_rad")
    high = table.number("high_rad")
    if low >= high:
        table.fail("low_rad", f"low_rad {low:g} is not below high_rad {high:g}; exchange or correct them")
    neutral = table.number("neutral_rad")
    if not low <= neutral <= high:
        table.fail("neutral_rad", f"neutral_rad {neutral:g} is outside {low:g} to {high:g}; move it inside the limits")
    for key, angle in (("low_rad", low), ("high_rad", high)):
        tick = zero_tick + sign * angle * product.ticks_per_turn / (2.0 * math.pi)
        if not 0.0 <= tick <= product.ticks_per_turn - 1:
            table.fail(
                key,
                f"{key} {angle:g} is encoder tick {tick:.0f}, across the wrap at 0 and {product.ticks_per_turn}; "
                "narrow the limit, or mount the horn so that zero_tick is nearer to the middle",
            )
    lines = registers(product)

    def register(key: str, name: str, low_count: int = 0) -> int:
        return table.integer(key, low_count, lines[name].high)

    return Joint(
        name=table.name_value("name"),
        mjcf_joint=table.name_value("mjcf_joint"),
        id=table.integer("id", lines["id"].low, lines["id"].high),
        product=product,
        sign=sign,
        zero_tick=zero_tick,
        low_rad=low,
        high_rad=high,
        neutral_rad=neutral,
        p_gain=register("p_gain", "position_p_gain", 1),
        i_gain=register("i_gain", "position_i_gain"),
        d_gain=register("d_gain", "position_d_gain"),
        pwm_limit=register("pwm_limit", "pwm_limit", 1),
    )


def _check_supply(head: Table, joints: Sequence[Joint]) -> None:
    supply_v = head.values["supply_v"]
    for joint in joints:
        lines = registers(joint.product)
        low = lines["min_voltage_limit"].initial * lines["min_voltage_limit"].scale
        high = lines["max_voltage_limit"].initial * lines["max_voltage_limit"].scale
        if not low <= supply_v <= high:
            head.fail(
                "supply_v",
                f"supply_v {supply_v:g} is outside {low:g} to {high:g} V of {joint.product.name}; change the supply",
            )


def _check_traffic(head: Table, bus: Bus, njoint: int, period_s: float) -> None:
    """Refuse a bus that can not carry one period's questions and answers within the period."""
    asked = _SYNC_BYTES + njoint
    answered = njoint * (_STATUS_BYTES + _STATE_BYTES)
    written = _SYNC_BYTES + njoint * (1 + _GOAL_BYTES)
    needed_s = (asked + answered + written) * 10 / bus.baud + njoint * bus.return_delay_us * 1e-6
    if needed_s >= period_s:
        head.fail(
            "period_s",
            f"period_s {period_s:g} is too short for its traffic of {1e3 * needed_s:.1f} ms at {bus.baud} bit/s; "
            "lengthen it, raise baud or lower return_delay_us",
        )


def _sensors(top: Table, joints: Sequence[Joint]) -> tuple[Sensor, ...]:
    tables = top.tables("sensor")
    sensors = tuple(_sensor(table) for table in tables)
    _refuse_twice(tables, "name", [sensor.name for sensor in sensors], "give each sensor its own name")
    places = [f"{sensor.message} {sensor.field}" for sensor in sensors]
    _refuse_twice(tables, "field", places, "give each sensor its own field of a message", "message and field")
    terminals = [sensor.terminal for sensor in sensors]
    _refuse_twice(tables, "terminal", terminals, "give each sensor its own terminal")
    taken = {f"{joint.name}{suffix}" for joint in joints for suffix in ("", "_vel", "_load")}.union(DERIVED_TERMINALS)
    for table, sensor in zip(tables, sensors, strict=True):
        if sensor.terminal in taken:
            table.fail("terminal", f"terminal '{sensor.terminal}' is the name of another terminal; choose another name")
    for key in ("rate_hz", "latency_s"):
        first: dict[str, float] = {}
        for table, sensor in zip(tables, sensors, strict=True):
            value: float = getattr(sensor, key)
            if first.setdefault(sensor.message, value) != value:
                table.fail(key, f"{key} {value:g} differs within message {sensor.message}; a line has one {key}")
    return sensors


def _sensor(table: Table) -> Sensor:
    table.refuse_unknown(field.name for field in fields(Sensor))
    name = table.name_value("name")
    message = table.text_value("message")
    if not (len(message) == 1 and "A" <= message <= "Z"):
        table.fail("message", f'message {message!r} is not one capital letter; write the letter of the line, as "F"')
    unit = table.text_value("unit", ("N", "m", "rad"))
    if SENSOR_UNITS.get(name, unit) != unit:
        table.fail("unit", f"unit '{unit}' does not fit a sensor named {name}; write \"{SENSOR_UNITS[name]}\"")
    scale = table.number("scale")
    with np.errstate(over="ignore"):
        if not 0.0 < abs(np.float32(scale)) < math.inf:
            table.fail("scale", f"scale {scale:g} is 0 or infinite as a float32; write the SI value of one count")
    rate_hz = table.positive("rate_hz", 10000.0)
    age_s_max = table.positive("age_s_max")
    if age_s_max < 1.0 / rate_hz:
        table.fail(
            "age_s_max", f"age_s_max {age_s_max:g} is shorter than one line's interval; write at least {1 / rate_hz:g}"
        )
    return Sensor(
        name=name,
        message=message,
        field=table.integer("field", 0, 31),
        unit=unit,
        scale=scale,
        zero=table.integer("zero", 1 - COUNT_MAX, COUNT_MAX - 1),
        rate_hz=rate_hz,
        latency_s=table.number("latency_s", 0.0, 1.0),
        age_s_max=age_s_max,
        terminal=table.name_value("terminal") if "terminal" in table.values else None,
    )


def _refuse_twice(
    tables: Sequence[Table], key: str, values: Sequence[object], remedy: str, called: str | None = None
) -> None:
    seen: set[object] = set()
    for table, value in zip(tables, values, strict=True):
        if value is not None and value in seen:
            table.fail(key, f"{called or key} {value} is used twice; {remedy}")
        seen.add(value)
