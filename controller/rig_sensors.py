"""Read the `[[sensor]]` tables of a rig file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields
from typing import Any, Final

import numpy as np

from controller.cycle import COUNT_MAX
from controller.rig import Joint, Sensor
from controller.rig_joints import DERIVED_TERMINALS, refuse_twice
from controller.toml_table import Table

SENSOR_UNITS: Final = {
    **dict.fromkeys(("x", "y", "z"), "m"),
    **dict.fromkeys(("heading", "roll", "pitch"), "rad"),
    "force": "N",
    **dict.fromkeys(("vx", "vy", "vz"), "m/s"),
}
"""Channels with a meaning of their own, and the unit that each must have."""

_IDEAL_SCALE: Final = {"N": 1e-4}
_IDEAL_SCALE_OTHERS: Final = 1e-6


def read_sensors(top: Table, joints: Sequence[Joint], period_s: float | None) -> tuple[Sensor, ...]:
    """Read the sensors of a rig.

    Args:
        top: the rig file
        joints: its joints
        period_s: control period of a rig without a bus, whose sensors are ideal where they do not say otherwise [s]

    Returns:
        the sensors, in raw-channel order, (nsensor,)

    Raises:
        InputError: something in their tables is wrong
    """
    tables = top.tables("sensor")
    if period_s is not None:
        tables = [_idealised(table, period_s) for table in tables]
    sensors = tuple(_sensor(table) for table in tables)
    refuse_twice(tables, "name", [sensor.name for sensor in sensors], "give each sensor its own name")
    places = [f"{sensor.message} {sensor.field}" for sensor in sensors]
    refuse_twice(tables, "field", places, "give each sensor its own field of a message", "message and field")
    terminals = [sensor.terminal for sensor in sensors]
    refuse_twice(tables, "terminal", terminals, "give each sensor its own terminal")
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


def _idealised(table: Table, period_s: float) -> Table:
    """Return a sensor's table with the keys that it leaves out: a fresh sample at every control instant."""
    unit = SENSOR_UNITS.get(str(table.values.get("name")), "")
    ideal: dict[str, Any] = {
        "message": "P",
        "field": table.index - 1,
        "scale": _IDEAL_SCALE.get(unit, _IDEAL_SCALE_OTHERS),
        "zero": 0,
        "rate_hz": 1.0 / period_s,
        "latency_s": 0.0,
        "age_s_max": period_s,
    }
    if unit:
        ideal["unit"] = unit
    return Table(table.origin, table.text, {**ideal, **table.values}, table.header, table.index, table.label)


def _sensor(table: Table) -> Sensor:
    table.refuse_unknown(field.name for field in fields(Sensor))
    name = table.name_value("name")
    message = table.text_value("message")
    if not (len(message) == 1 and "A" <= message <= "Z"):
        table.fail("message", f'message {message!r} is not one capital letter; write the letter of the line, as "F"')
    unit = table.text_value("unit", ("N", "m", "m/s", "rad"))
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
