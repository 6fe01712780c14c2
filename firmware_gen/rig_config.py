"""One rig with one controller on it as constant data in C: `sv_rig` of `runtime/sv_rig.h`, and its cycle."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from controller import Controller
from controller.cycle import CycleSpec, OutputSpec, resolve_cycle
from controller.errors import InputError
from controller.register import Register
from controller.registers import registers
from controller.rig import Joint, Rig, Safety, Sensor
from controller.rig_file import require_bus
from controller.schedule import schedule_of
from controller.terminals import TerminalSpec, joint_scale
from firmware_gen.fingerprints import program_fingerprint, rig_fingerprint
from firmware_gen.literals import literal
from firmware_gen.plain import plain
from firmware_gen.rig_needs import needed_sensors
from firmware_gen.rig_rows import HIGHEST, LOWEST, CheckRow, check_rows, count_limits, setting_counts, table_blocks
from firmware_gen.rig_sizes import PROTOCOLS
from firmware_gen.unit import Unit

CONSOLE_BAUD: Final = 1_000_000
SENSOR_BAUD: Final = 115_200
"""What sensor nodes send at, on every rig [bits/s]."""

JOINT_MAX: Final = 16
SENSOR_MAX: Final = 16

_ENCODINGS: Final = {
    "unsigned": "SV_UNSIGNED",
    "twos": "SV_TWOS",
    "sign15": "SV_SIGN15",
    "sign11": "SV_SIGN11",
    "sign10": "SV_SIGN10",
}
_KINDS: Final = (
    "SV_TERMINAL_TIME",
    "SV_TERMINAL_RAW",
    "SV_TERMINAL_GOAL_DIST",
    "SV_TERMINAL_PX",
    "SV_TERMINAL_PY",
    "SV_TERMINAL_GOAL_MET",
    "SV_TERMINAL_HEADING_ERROR",
)
_PATIENCE_US: Final = 1000
_REST_SPEED_RAD_S: Final = 0.06
_REST_S_MAX: Final = 10.0
_WATCHDOG_UNIT_S: Final = 0.02
_FAR_RAD: Final = 3.4e38
"""What C has for an infinite angle."""


def require_speakable(rig: Rig) -> None:
    """Refuse a rig that the firmware can not drive.

    Args:
        rig: the rig

    Raises:
        InputError: it has no bus, its servos talk otherwise, or it has too many joints or sensors
    """
    require_bus(rig, "firmware")
    if rig.bus.protocol not in PROTOCOLS:
        raise InputError(
            f"rig {rig.name}: its {rig.joints[0].product.name} servos speak {rig.bus.protocol}, and firmware speaks "
            f"{' and '.join(PROTOCOLS)}; choose a rig with such servos, or run this one with `servolve deploy`"
        )
    for count, most, what in ((len(rig.joints), JOINT_MAX, "joints"), (len(rig.sensors), SENSOR_MAX, "sensors")):
        if count > most:
            raise InputError(
                f"rig {rig.name}: has {count} {what}, and firmware has room for {most}; leave some out, or run it with "
                "`servolve deploy`"
            )
    for joint in rig.joints:
        if joint.unlimited and joint.mode == "position":
            raise InputError(f'rig {rig.name}: joint {joint.name} is unlimited; give it limits, or mode = "velocity"')


def rig_header(rig: Rig, unit: Unit) -> str:
    """Write `rig.h`.

    Args:
        rig: the rig
        unit: the controller and its names
    """
    return f"""// Rig {plain(rig.name)} with controller {plain(unit.controller.name)}.
// Written by servolve firmware; do not edit.

#ifndef SERVOLVE_RIG_H_
#define SERVOLVE_RIG_H_

#include "sv_rig.h"

#define SERVOLVE_NJOINT {len(rig.joints)}
#define SERVOLVE_NSENSOR {len(rig.sensors)}
#define SERVOLVE_NINPUT {len(unit.controller.inputs)}
#define SERVOLVE_NREGISTER 1  // the compiled program needs none
#define SERVOLVE_NSTATE {unit.state_bytes // 4}
#define SERVOLVE_BUS_BAUD {rig.bus.baud}
#define SERVOLVE_SENSOR_BAUD {SENSOR_BAUD}
#define SERVOLVE_CONSOLE_BAUD {CONSOLE_BAUD}
#define SERVOLVE_PROGRAM 0x{program_fingerprint(unit.controller):08x}U  // its fingerprint

#ifdef __cplusplus
extern "C" {{
#endif

extern const sv_rig servolve_rig;

// Check the controller on this machine; return 0, or which step differs from the reference.
int32_t servolve_selftest(void);

#ifdef __cplusplus
}}
#endif

#endif  // SERVOLVE_RIG_H_
"""


def rig_source(rig: Rig, controller: Controller, fast_sync_read: bool = False) -> str:
    """Write `rig.c`: the same rig and controller, the same bytes.

    Args:
        rig: the rig
        controller: the controller
        fast_sync_read: whether one status packet answers for all servos; the host loop asks for one each

    Returns:
        the whole file

    Raises:
        InputError: the firmware can not drive the rig, or the controller does not fit it
    """
    require_speakable(rig)
    spec = resolve_cycle(controller, rig)
    needed = needed_sensors(rig, controller)
    lines = [
        f"// Rig {plain(rig.name)} with controller {plain(controller.name)}.",
        "// Written by servolve firmware; do not edit.",
        "",
        '#include "rig.h"',
        "",
        '#include "sv_reason.h"',
        "",
        *_cycle(spec),
    ]
    rows = [_joint_rows(rig, joint) for joint in rig.joints]
    for number, joint in enumerate(rig.joints):
        lines += _joint_tables(number, joint, rows)
    lines += ["static const sv_joint joints[] = {"]
    for number, joint in enumerate(rig.joints):
        lines += _joint(number, joint, rows)
    lines += ["};", ""]
    if rig.sensors:
        lines += ["static const sv_sensor sensors[] = {"]
        lines += _rows((_sensor(sensor, i in needed), plain(sensor.name)) for i, sensor in enumerate(rig.sensors))
        lines += ["};", ""]
    return "\n".join([*lines, *_rig(rig, controller, fast_sync_read)])


def _rig(rig: Rig, controller: Controller, fast_sync_read: bool) -> list[str]:
    places = {sensor.name: number for number, sensor in enumerate(rig.sensors)}
    tilt = {"roll", "pitch"} <= places.keys()
    return [
        "const sv_rig servolve_rig = {",
        *_fields(
            [
                ("protocol", PROTOCOLS[rig.bus.protocol]),
                ("baud", rig.bus.baud),
                ("return_delay_us", rig.bus.return_delay_us),
                ("patience_us", _PATIENCE_US),
                ("velocity_mode", int(rig.joints[0].mode == "velocity")),
                ("fast_sync_read", int(fast_sync_read and rig.bus.protocol == "dynamixel-2.0")),
                ("period_us", _us(rig.period_s)),
                ("homing_periods_max", math.ceil(_REST_S_MAX / rig.period_s)),
                ("slew_rad_s", _float(controller.slew_rad_s)),
                ("njoint", "SERVOLVE_NJOINT"),
                ("joints", "joints"),
                ("nsensor", "SERVOLVE_NSENSOR"),
                ("sensors", "sensors" if rig.sensors else "0"),
                ("roll", places["roll"] if tilt else -1),
                ("pitch", places["pitch"] if tilt else -1),
                ("schedule", _schedule(rig)),
                ("safety", _safety(rig.safety)),
                ("cycle", "&cycle"),
                ("fingerprint", f"0x{rig_fingerprint(rig, controller):08x}U"),
            ]
        ),
        "};",
        "",
    ]


def _schedule(rig: Rig) -> str:
    schedule = schedule_of(rig)
    health = ", ".join(_pair(block) for block in schedule.health)
    return (
        f"{{{schedule.nservo}, {_pair(schedule.state)}, {_pair(schedule.goal)}, {len(schedule.health)}, {{{health}}}, "
        f"{schedule.health_every}}}"
    )


def _safety(safety: Safety) -> str:
    values = [
        ("stop_holds", int(safety.stop == "hold")),
        ("homing_rad_s", _float(safety.homing_rad_s)),
        ("tracking_rad_max", _float(safety.tracking_rad_max)),
        ("tracking_us_max", _us(safety.tracking_s_max)),
        ("missed_max", safety.missed_cycles_max),
        ("temperature_max", _float(safety.temperature_c_max)),
        ("voltage_low", _float(safety.voltage_low_v)),
        ("tilt_rad_max", _float(safety.tilt_rad_max)),
        ("overrun_max", safety.overrun_cycles_max),
        ("watchdog_us", _us(safety.watchdog_s)),
        ("watchdog_count", round(safety.watchdog_s / _WATCHDOG_UNIT_S)),
    ]
    return "\n".join(["", "        {", *(f"        {line}" for line in _fields(values)), "        }"])


@dataclass(frozen=True)
class _Rows:
    """Hold the rows of one joint's checks and settings, as C; joints with equal rows share them."""

    checks: tuple[str, ...]
    settings: tuple[str, ...]


def _joint_rows(rig: Rig, joint: Joint) -> _Rows:
    return _Rows(
        tuple(_rows((_check(row), row.register.name) for row in check_rows(rig, joint))),
        tuple(_rows((f"{{{_register(line)}, {count}}}", line.name) for line, count in setting_counts(joint))),
    )


def _places(number: int, rows: Sequence[_Rows]) -> tuple[int, int]:
    """Return of which joints a joint has its checks and its settings: the first ones with the same rows."""
    checks = next(i for i, row in enumerate(rows) if row.checks == rows[number].checks)
    settings = next(i for i, row in enumerate(rows) if row.settings == rows[number].settings)
    return checks, settings


def _joint_tables(number: int, joint: Joint, rows: Sequence[_Rows]) -> list[str]:
    """Write the rows of one joint's checks and settings, where no joint before has the same."""
    checks, settings = _places(number, rows)
    lines = [f"// joint {plain(joint.name)}, servo {joint.id}: {joint.product.name}"]
    if checks == number:
        lines += [f"static const sv_check checks{number}[] = {{", *rows[number].checks, "};", ""]
    if settings == number:
        lines += [f"static const sv_setting settings{number}[] = {{", *rows[number].settings, "};", ""]
    return lines if len(lines) > 1 else []


def _check(row: CheckRow) -> str:
    level = "SV_ERROR" if row.error else "SV_WARNING"
    mask = "-1" if row.mask < 0 else f"0x{row.mask:02x}"
    return (
        f"{{{_register(row.register)}, {mask}, {_count(row.low)}, {_count(row.high)}, {level}, SV_FINDING_{row.kind}}}"
    )


def _joint(number: int, joint: Joint, rows: Sequence[_Rows]) -> list[str]:
    family, table = joint.family, registers(joint.product)
    checks, settings = _places(number, rows)
    velocity = joint.mode == "velocity"
    unit = joint.product.velocity_unit_rad_s
    seeds = (0, 0) if velocity else count_limits(joint)
    goals = (-_fastest(joint), _fastest(joint)) if velocity else seeds
    ends = (-_FAR_RAD, _FAR_RAD) if joint.unlimited else (joint.low_rad, joint.high_rad)

    def line(name: str | None) -> str:
        return _register(None if name is None else table[name])

    values = [
        ("id", joint.id),
        ("model", joint.product.model_number),
        ("zero", joint.zero_tick),
        ("angle_scale", _float(joint_scale(joint))),
        ("speed_scale", _float(joint.sign * unit)),
        ("goal_low", goals[0]),
        ("goal_high", goals[1]),
        ("seed_low", seeds[0]),
        ("seed_high", seeds[1]),
        ("neutral", _neutral(joint)),
        ("neutral_rad", _float(joint.neutral_rad)),
        ("low_rad", _float(ends[0])),
        ("high_rad", _float(ends[1])),
        ("speed_max", _float(joint.speed_rad_s_max)),
        ("no_load_speed", _float(joint.product.no_load_speed_rad_s)),
        ("unlimited", int(joint.unlimited)),
        ("rest_count", max(1, round(_REST_SPEED_RAD_S / unit))),
        ("position", line(family.position)),
        ("velocity", line(family.velocity)),
        ("load", line(family.load)),
        ("goal", line(family.goal(joint.mode))),
        ("torque", line(family.torque_enable)),
        ("ceiling", line(family.torque_ceiling)),
        ("ceiling_count", joint.ceiling),
        ("watchdog", line(family.watchdog)),
        ("hardware_error", line(family.hardware_error)),
        ("shutdown", line(family.shutdown)),
        ("voltage", line(family.voltage)),
        ("temperature", line(family.temperature)),
        ("voltage_scale", _float(table[family.voltage].scale)),
        ("error_bits", f"0x{sum(1 << bit for bit in family.error_bits):02x}"),
        ("tables", f"{{{', '.join(map(_pair, table_blocks(joint)))}}}"),
        ("checks", f"checks{checks}"),
        ("ncheck", len(rows[number].checks)),
        ("settings", f"settings{settings}"),
        ("nsetting", len(rows[number].settings)),
    ]
    return ["    {", *(f"    {text}" for text in _fields(values)), "    },"]


def _fastest(joint: Joint) -> int:
    return abs(round(joint.speed_rad_s_max / (joint.sign * joint.product.velocity_unit_rad_s)))


def _neutral(joint: Joint) -> int:
    count = joint.zero_tick + round(joint.neutral_rad / joint_scale(joint))
    if joint.unlimited:
        return count
    low, high = count_limits(joint)
    return min(max(count, low), high)


def _sensor(sensor: Sensor, needed: bool) -> str:
    values = [
        ("message", f"'{sensor.message}'"),
        ("field", sensor.field),
        ("needed", int(needed)),
        ("zero", sensor.zero),
        ("scale", _float(sensor.scale)),
        ("latency_us", _us(sensor.latency_s)),
        ("age_us_max", _us(sensor.age_s_max)),
    ]
    return f"{{{', '.join(str(value) for _, value in values)}}}"


def _cycle(spec: CycleSpec) -> list[str]:
    program = spec.program
    lines = [
        "static const sv_program program = {",
        *_fields(
            [
                ("ninput", len(program.inputs)),
                ("nstate", program.nstate),
                ("noutput", len(program.outputs)),
            ]
        ),
        "};",
        "",
    ]
    if spec.terminals:
        lines += ["static const sv_terminal terminals[] = {"]
        lines += _rows((_terminal(one), plain(one.name)) for one in spec.terminals)
        lines += ["};", ""]
    lines += ["static const sv_output outputs[] = {"]
    for output in spec.outputs:
        lines += ["    {", f"        // {plain(output.name)}", *(f"    {text}" for text in _output(output)), "    },"]
    return [
        *lines,
        "};",
        "",
        "static const sv_cycle cycle = {",
        *_fields(
            [
                ("program", "&program"),
                ("terminals", "terminals" if spec.terminals else "0"),
                ("outputs", "outputs"),
                ("period_s", _float(spec.period_s)),
                ("filter", _float(spec.filter)),
                ("slew_step", _float(spec.slew_step)),
                ("nraw", spec.nraw),
                ("x", _terminal(spec.x)),
                ("y", _terminal(spec.y)),
                ("heading", _terminal(spec.heading)),
                ("facing", _terminal(spec.facing)),
            ]
        ),
        "};",
        "",
    ]


def _output(output: OutputSpec) -> list[str]:
    return _fields(
        [
            ("kind", f"SV_OUTPUT_{output.kind.upper()}"),
            ("low", _float(output.low)),
            ("high", _float(output.high)),
            ("neutral", _float(output.neutral)),
            ("unit_scale", _float(output.unit_scale)),
            ("count_scale", _float(output.count_scale)),
            ("zero", output.zero),
            ("count_low", output.count_low),
            ("count_high", output.count_high),
            ("angle", _terminal(output.angle)),
            ("angle_low", _float(output.angle_low)),
            ("angle_high", _float(output.angle_high)),
        ]
    )


def _terminal(spec: TerminalSpec) -> str:
    return f"{{{_KINDS[spec.kind]}, {spec.channel}, {spec.zero}, {_float(spec.scale)}}}"


def _register(line: Register | None) -> str:
    if line is None:
        return "{0, 0, SV_UNSIGNED}"
    return f"{{{line.address}, {line.size}, {_ENCODINGS[line.encoding]}}}"


def _fields(values: Iterable[tuple[str, object]]) -> list[str]:
    return [f"    .{name} =" + f" {value},".replace(" \n", "\n") for name, value in values]


def _rows(values: Iterable[tuple[str, str]]) -> list[str]:
    """Write the rows of a table, each with what it is about."""
    rows = [(f"    {text},", name) for text, name in values]
    width = max(len(text) for text, _ in rows)
    return [f"{text:<{width}}  // {name}" for text, name in rows]


def _pair(block: Sequence[int]) -> str:
    return f"{{{block[0]}, {block[1]}}}"


def _count(value: int) -> str:
    return {LOWEST: "INT32_MIN", HIGHEST: "INT32_MAX"}.get(value, str(value))


def _float(value: float) -> str:
    return literal(np.float32(value))


def _us(seconds: float) -> int:
    return round(1e6 * seconds)
