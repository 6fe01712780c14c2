"""What a rig can tell a controller: the terminals, by name, and how the control cycle computes each."""

from __future__ import annotations

import difflib
import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from controller.controller import Controller
from controller.errors import InputError
from controller.registers import registers
from controller.rig import Joint, Rig, Sensor

IDEAL_LOAD_COUNTS: Final = 1_000_000
"""Load counts of an ideal joint at its motor's limit."""


class TerminalKind(IntEnum):
    """Name the kinds of `sv_terminal_kind` of `runtime/sv_cycle.h`."""

    TIME = 0
    RAW = 1
    GOAL_DIST = 2
    PX = 3
    PY = 4
    GOAL_MET = 5
    HEADING_ERROR = 6


@dataclass(frozen=True)
class TerminalSpec:
    """Describe how the cycle computes one terminal: for a raw channel, (raw[channel] - zero) * scale.

    Args:
        name: as programs name it
        kind: how it is computed
        unit: its SI unit, "1" for none
        channel: raw channel, -1: none
        zero: counts at 0 SI
        scale: SI per count
    """

    name: str
    kind: TerminalKind
    unit: str
    channel: int = -1
    zero: int = 0
    scale: float = 1.0


def terminals_of(rig: Rig) -> dict[str, TerminalSpec]:
    """List the terminals that a rig supplies.

    Args:
        rig: the rig

    Returns:
        name => specification: time, goal distance, joint angles, velocities and loads, sensors, derived from the pose
    """
    specs = [
        TerminalSpec("t", TerminalKind.TIME, "s"),
        TerminalSpec("goal_dist", TerminalKind.GOAL_DIST, "m"),
    ]
    for i in range(len(rig.joints)):
        specs += _joint_terminals(rig, i)
    sensors = {sensor.name: sensor for sensor in rig.sensors}
    for sensor in rig.sensors:
        if sensor.terminal is not None:
            specs.append(_sensor_terminal(rig, sensor, sensor.terminal))
    if "z" in sensors:
        specs.append(_sensor_terminal(rig, sensors["z"], "pz"))
    if all(name in sensors for name in ("x", "y", "heading")):
        specs += [
            TerminalSpec("px", TerminalKind.PX, "m"),
            TerminalSpec("py", TerminalKind.PY, "m"),
            TerminalSpec("goal_met", TerminalKind.GOAL_MET, "1"),
            TerminalSpec("heading_error", TerminalKind.HEADING_ERROR, "rad"),
        ]
    return {spec.name: spec for spec in specs}


def pose_channel(rig: Rig, name: str) -> TerminalSpec:
    """Return how the cycle reads one coordinate of the base pose.

    Args:
        rig: the rig
        name: "x", "y" or "heading"

    Returns:
        its specification; channel -1 where the rig has no such sensor
    """
    for sensor in rig.sensors:
        if sensor.name == name:
            return _sensor_terminal(rig, sensor, name)
    return TerminalSpec(name, TerminalKind.RAW, "rad" if name == "heading" else "m")


def angle_channel(rig: Rig, joint: str | None) -> TerminalSpec:
    """Return how the cycle reads a joint's encoder.

    Args:
        rig: the rig
        joint: name of the joint, or None

    Returns:
        its specification; channel -1 without a joint
    """
    for index, one in enumerate(rig.joints):
        if one.name == joint:
            return _joint_terminals(rig, index)[0]
    return TerminalSpec("none", TerminalKind.RAW, "rad")


def resolve_terminals(controller: Controller, rig: Rig) -> tuple[TerminalSpec, ...]:
    """Find a controller's terminals on a rig.

    Args:
        controller: the controller
        rig: the rig

    Returns:
        specifications in the controller's order, (ninput,)

    Raises:
        InputError: the rig can not supply one of them, or has it in another unit
    """
    supplied = terminals_of(rig)
    resolved = []
    for i, terminal in enumerate(controller.inputs, start=1):
        where = f"{controller.name}: input {i} ({terminal.name})"
        spec = supplied.get(terminal.name)
        if spec is None:
            close = difflib.get_close_matches(terminal.name, supplied, n=1, cutoff=0.5)
            hint = f"did you mean '{close[0]}'? " if close else ""
            raise InputError(
                f"{where}: rig '{rig.name}' can not supply '{terminal.name}'; {hint}use one of {' '.join(supplied)}"
            )
        if spec.unit != terminal.unit:
            raise InputError(
                f"{where}: unit '{terminal.unit}' is not the rig's; rig '{rig.name}' supplies it in '{spec.unit}'"
            )
        resolved.append(spec)
    return tuple(resolved)


def full_load_counts(joint: Joint) -> int:
    """Return the load counts that mean 1: a current at its limit, or full PWM duty, or an ideal motor's limit.

    Args:
        joint: the joint
    """
    if joint.ideal:
        return IDEAL_LOAD_COUNTS
    table = registers(joint.product)
    load = table[joint.family.load]
    return table["current_limit"].high if load.unit == "A" else round(1.0 / load.scale)


def joint_scale(joint: Joint) -> float:
    """Return the angle of one encoder count, sign included [rad].

    Args:
        joint: the joint
    """
    return joint.sign * 2.0 * math.pi / joint.product.ticks_per_turn


def _joint_terminals(rig: Rig, index: int) -> list[TerminalSpec]:
    joint = rig.joints[index]
    njoint = len(rig.joints)
    velocity = joint.sign * joint.product.velocity_unit_rad_s
    load = joint.sign / full_load_counts(joint)
    raw = TerminalKind.RAW
    return [
        TerminalSpec(joint.name, raw, "rad", index, joint.zero_tick, joint_scale(joint)),
        TerminalSpec(f"{joint.name}_vel", raw, "rad/s", njoint + index, 0, velocity),
        TerminalSpec(f"{joint.name}_load", raw, "1", 2 * njoint + index, 0, load),
    ]


def _sensor_terminal(rig: Rig, sensor: Sensor, name: str) -> TerminalSpec:
    channel = 3 * len(rig.joints) + rig.sensors.index(sensor)
    return TerminalSpec(name, TerminalKind.RAW, sensor.unit, channel, sensor.zero, sensor.scale)
