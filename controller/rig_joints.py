"""Read the `[[joint]]` tables of a rig file: servos on a bus, and the ideal joints of rigs that have none."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Final, cast

from controller.cycle import COUNT_MAX
from controller.families import FAMILIES, Family, Mode, family_of
from controller.operations import BY_NAME
from controller.products import IDEAL, PRODUCTS, Product
from controller.registers import Register, registers
from controller.rig import Bus, Joint
from controller.toml_table import Table

PROTOCOL_FAMILIES: Final[Mapping[str, tuple[str, ...]]] = {
    **{
        protocol: tuple(family.name for family in FAMILIES.values() if family.bus_protocol == protocol)
        for protocol in dict.fromkeys(family.bus_protocol for family in FAMILIES.values())
    },
    "none": (IDEAL.family,),
}
"""Families of servos that speak each protocol."""

DERIVED_TERMINALS: Final = ("t", "goal_dist", "px", "py", "pz", "goal_met", "heading_error")
"""Terminals that the control cycle computes: no joint or sensor may take their names."""

_VELOCITY_KEYS: Final = ("speed_rad_s_max", "unlimited")
_SERVO_KEYS: Final = tuple(
    dict.fromkeys(
        [key for family in FAMILIES.values() for gains in family.gains.values() for key in gains]
        + [family.ceiling_key for family in FAMILIES.values() if family.ceiling_key is not None]
    )
)
JOINT_KEYS: Final = (
    *("name", "mjcf_joint", "id", "product", "mode", "sign", "zero_tick", "low_rad", "high_rad", "neutral_rad"),
    *_SERVO_KEYS,
    *_VELOCITY_KEYS,
)
"""Keys of a `[[joint]]` table, of all families together."""

_IDEAL_KEYS: Final = (
    *("name", "mjcf_joint", "product", "mode", "low_rad", "high_rad", "neutral_rad"),
    *("unlimited", "speed_rad_s_max"),
)


def read_joints(top: Table, bus: Bus) -> tuple[Joint, ...]:
    """Read the joints of a rig.

    Args:
        top: the rig file
        bus: its bus

    Returns:
        the joints, in bus order, (njoint,)

    Raises:
        InputError: something in their tables is wrong
    """
    tables = top.tables("joint")
    if not tables:
        top.fail(None, "there is no joint; add a table [[joint]] for each servo")
    joints = tuple(_joint(table, bus) for table in tables)
    refuse_twice(tables, "name", [joint.name for joint in joints], "give each joint its own name")
    refuse_twice(tables, "mjcf_joint", [joint.mjcf_joint for joint in joints], "name each hinge once")
    refuse_twice(tables, "id", [joint.id for joint in joints], "give each servo its own id")
    taken = {f"{joint.name}{suffix}" for joint in joints for suffix in ("_vel", "_load")}.union(DERIVED_TERMINALS)
    for table, joint in zip(tables, joints, strict=True):
        if bus.protocol != "none" and joint.mode != joints[0].mode:
            table.fail(
                "mode", f"mode '{joint.mode}' is not joint {joints[0].name}'s; give all joints of a bus one mode"
            )
        if joint.name in taken:
            table.fail("name", f"name '{joint.name}' is the name of another terminal; choose another name")
        if joint.name in BY_NAME or joint.name in ("list", "let", "last"):
            table.fail("name", f"name '{joint.name}' is an operation of programs; choose another name")
    return joints


def refuse_twice(
    tables: Sequence[Table], key: str, values: Sequence[object], remedy: str, called: str | None = None
) -> None:
    """Refuse a value that two tables state.

    Args:
        tables: the tables
        key: where the value stands
        values: the value of each; None: it states none
        remedy: what to do about it
        called: what to call the value, its key if None

    Raises:
        InputError: there is such a value
    """
    seen: set[object] = set()
    for table, value in zip(tables, values, strict=True):
        if value is not None and value in seen:
            table.fail(key, f"{called or key} {value} is used twice; {remedy}")
        seen.add(value)


def _joint(table: Table, bus: Bus) -> Joint:
    table.refuse_unknown(JOINT_KEYS)
    product = _product(table, bus)
    family = None if product == IDEAL else family_of(product)
    mode = _mode(table, family)
    sign = 1 if product == IDEAL else table.integer("sign", -(2**31), 2**31 - 1)
    if sign not in (1, -1):
        table.fail("sign", f"sign {sign} is neither 1 nor -1; write 1, or -1 where the encoder counts the other way")
    zero_tick = 0 if product == IDEAL else table.integer("zero_tick", 0, product.count_max)
    unlimited = _unlimited(table)
    low = -math.inf if unlimited else table.number("low_rad")
    high = math.inf if unlimited else table.number("high_rad")
    if low >= high:
        table.fail("low_rad", f"low_rad {low:g} is not below high_rad {high:g}; exchange or correct them")
    neutral = table.number("neutral_rad")
    if not low <= neutral <= high:
        table.fail("neutral_rad", f"neutral_rad {neutral:g} is outside {low:g} to {high:g}; move it inside the limits")
    ticks_per_rad = product.ticks_per_turn / (2.0 * math.pi)
    if not unlimited:
        _check_travel(table, zero_tick, sign * ticks_per_rad, product.count_max, product == IDEAL)
    lines: Mapping[str, Register] = {} if product == IDEAL else registers(product)
    return Joint(
        name=table.name_value("name"),
        mjcf_joint=table.name_value("mjcf_joint"),
        id=table.integer("id", lines["id"].low, lines["id"].high) if lines else table.index,
        product=product,
        sign=sign,
        zero_tick=zero_tick,
        low_rad=low,
        high_rad=high,
        neutral_rad=neutral,
        gains=_gains(table, family, mode, lines) if family else {},
        ceiling=_ceiling(table, family, product, lines) if family else 0,
        mode=mode,
        unlimited=unlimited,
        speed_rad_s_max=_speed_max(table, lines) if mode == "velocity" else 0.0,
    )


def _gains(table: Table, family: Family, mode: Mode, lines: Mapping[str, Register]) -> dict[str, int]:
    """Return the counts of the mode's gain registers."""
    counts: dict[str, int] = {}
    for key, names in family.gains[mode].items():
        low = 1 if key.endswith("p_gain") else lines[names[0]].low
        counts |= dict.fromkeys(names, table.integer(key, low, lines[names[0]].high))
    return counts


def _ceiling(table: Table, family: Family, product: Product, lines: Mapping[str, Register]) -> int:
    """Return the torque ceiling in counts."""
    if family.ceiling_key is None:
        return product.duty_full
    return table.integer(family.ceiling_key, 1, lines[family.ceiling_limit].high)


def _product(table: Table, bus: Bus) -> Product:
    """Return the servo that speaks the bus's protocol, or the ideal joint of a rig without one."""
    product = {**PRODUCTS, IDEAL.name: IDEAL}[table.text_value("product", (*PRODUCTS, IDEAL.name))]
    if product.family not in PROTOCOL_FAMILIES[bus.protocol]:
        if bus.protocol == "none":
            table.fail("product", f"product '{product.name}' needs a bus; write \"{IDEAL.name}\", or name its protocol")
        table.fail("product", f"product '{product.name}' does not speak {bus.protocol}; choose another product")
    if product == IDEAL:
        for key in table.values:
            if key not in _IDEAL_KEYS:
                table.fail(key, f"{key} belongs to a servo, and an ideal joint has none; remove it")
    return product


def _mode(table: Table, family: Family | None) -> Mode:
    """Return what is commanded, refusing what belongs to the other mode or to other servos."""
    mode: Mode = "position"
    if "mode" in table.values:
        mode = cast(Mode, table.text_value("mode", ("position", "velocity")))
    if family is not None and mode not in family.modes:
        table.fail(
            "mode", f"mode '{mode}' is not for servos of {family.name}; remove it: they are commanded a position"
        )
    other: Mode = "position" if mode == "velocity" else "velocity"
    gains = family.gains if family is not None else {}
    for key in (*gains.get(other, ()), *(_VELOCITY_KEYS if mode == "position" else ())):
        if key in table.values:
            table.fail(key, f'{key} is for mode = "{other}"; remove it, or change the mode')
    if family is not None:
        _refuse_foreign(table, family, (*gains[mode], family.ceiling_key))
    return mode


def _refuse_foreign(table: Table, family: Family, own: Iterable[str | None]) -> None:
    """Refuse the gains of other families."""
    known = [key for key in own if key is not None]
    for key in _SERVO_KEYS:
        if key in table.values and key not in known:
            table.fail(key, f"{key} is no setting of servos of {family.name}; write {', '.join(known)} instead")


def _unlimited(table: Table) -> bool:
    """Return whether a joint may turn for ever."""
    unlimited = table.values.get("unlimited", False)
    if not isinstance(unlimited, bool):
        table.fail("unlimited", "unlimited is neither true nor false; write true for a joint that may turn for ever")
    if unlimited:
        for key in ("low_rad", "high_rad"):
            if key in table.values:
                table.fail(key, f"{key} limits a joint that is unlimited; remove one of the two")
    return unlimited


def _check_travel(table: Table, zero_tick: int, ticks_per_rad: float, count_max: int, ideal: bool) -> None:
    """Refuse limits that the encoder can not count to."""
    for key in ("low_rad", "high_rad"):
        angle = table.number(key)
        tick = zero_tick + angle * ticks_per_rad
        if ideal and abs(tick) >= COUNT_MAX:
            table.fail(key, f"{key} {angle:g} is too far to count; write unlimited = true instead of limits")
        if not ideal and not 0.0 <= tick <= count_max:
            table.fail(
                key,
                f"{key} {angle:g} is encoder tick {tick:.0f}, across the wrap at 0 and {count_max + 1}; "
                "narrow the limit, or mount the horn so that zero_tick is nearer to the middle",
            )


def _speed_max(table: Table, lines: Mapping[str, Register]) -> float:
    """Return the fastest velocity that may be commanded [rad/s]."""
    speed = table.positive("speed_rad_s_max", 1e4)
    if lines:
        # a servo without a velocity limit takes any goal that its register holds
        bound = lines.get("velocity_limit")
        limit = bound.initial * bound.scale if bound else lines["goal_speed"].high * lines["goal_speed"].scale
        if speed > limit:
            table.fail(
                "speed_rad_s_max",
                f"speed_rad_s_max {speed:g} is above the servo's velocity limit; write at most {limit:.4g}",
            )
    return speed
