"""One rig with one controller on it as constant data in C: `sv_rig` of `runtime/sv_rig.h`, and its cycle."""

from __future__ import annotations

import math
from typing import Final

from controller import Controller
from controller.cycle import CycleSpec, OutputSpec, resolve_cycle
from controller.errors import InputError
from controller.needed_sensors import needed_sensors
from controller.rig import Rig, Safety, Sensor
from controller.rig_file import require_bus
from controller.schedule import schedule_of
from controller.terminals import TerminalSpec
from firmware_gen.projects.fingerprints import program_fingerprint, rig_fingerprint
from firmware_gen.projects.joint_config import joint_lines
from firmware_gen.projects.plain import plain
from firmware_gen.projects.rig_sizes import PROTOCOLS, message_letters
from firmware_gen.projects.rig_text import field_lines, float_c, microseconds, pair_c, row_lines
from firmware_gen.transpiler.unit import Unit

CONSOLE_BAUD: Final = 1_000_000
SENSOR_BAUD: Final = 115_200
"""What sensor nodes send at, on every rig [bits/s]."""

JOINT_MAX: Final = 16
SENSOR_MAX: Final = 16

_PATIENCE_US: Final = 1000
_REST_S_MAX: Final = 10.0
_WATCHDOG_UNIT_S: Final = 0.02


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
        InputError: the firmware can not drive the rig, the controller does not fit it, or the servos answer one by one
    """
    require_speakable(rig)
    if fast_sync_read and rig.bus.protocol != "dynamixel-2.0":
        product = rig.joints[0].product.name
        raise InputError(f"rig {rig.name}: its {product} servos have no fast sync read; leave --fast-sync-read out")
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
    lines += joint_lines(rig, controller.slew_rad_s)
    if rig.sensors:
        lines += ["static const sv_message messages[] = {"]
        lines += row_lines(_message(rig, letter) for letter in message_letters(rig))
        lines += ["};", "", "static const sv_sensor sensors[] = {"]
        lines += row_lines(
            (_sensor(rig, sensor, i in needed), plain(sensor.name)) for i, sensor in enumerate(rig.sensors)
        )
        lines += ["};", ""]
    return "\n".join([*lines, *_schedule(rig), *_rig(rig, controller, fast_sync_read)])


def _rig(rig: Rig, controller: Controller, fast_sync_read: bool) -> list[str]:
    places = {sensor.name: number for number, sensor in enumerate(rig.sensors)}
    tilt = {"roll", "pitch"} <= places.keys() and rig.safety.tilt_rad_max > 0.0
    return [
        "const sv_rig servolve_rig = {",
        *field_lines(
            [
                ("protocol", PROTOCOLS[rig.bus.protocol]),
                ("baud", rig.bus.baud),
                ("return_delay_us", rig.bus.return_delay_us),
                ("patience_us", _PATIENCE_US),
                ("velocity_mode", int(rig.joints[0].mode == "velocity")),
                ("fast_sync_read", int(fast_sync_read)),
                ("period_us", microseconds(rig.period_s)),
                ("homing_periods_max", math.ceil(_REST_S_MAX / rig.period_s)),
                ("njoint", "SERVOLVE_NJOINT"),
                ("joints", "joints"),
                ("servos", "servos"),
                ("axes", "axes" if rig.joints[0].mode == "velocity" else "0"),
                ("nsensor", "SERVOLVE_NSENSOR"),
                ("sensors", "sensors" if rig.sensors else "0"),
                ("nmessage", len(message_letters(rig))),
                ("messages", "messages" if rig.sensors else "0"),
                ("roll", places["roll"] if tilt else -1),
                ("pitch", places["pitch"] if tilt else -1),
                ("safety", _safety(rig.safety)),
                ("fingerprint", f"0x{rig_fingerprint(rig, controller):08x}U"),
            ]
        ),
        "};",
        "",
    ]


def _schedule(rig: Rig) -> list[str]:
    schedule = schedule_of(rig)
    return [
        "const sv_schedule servolve_schedule = {",
        *field_lines(
            [
                ("nservo", schedule.nservo),
                ("state", pair_c(schedule.state)),
                ("goal", pair_c(schedule.goal)),
                ("nhealth", len(schedule.health)),
                ("health", f"{{{', '.join(pair_c(block) for block in schedule.health)}}}"),
                ("health_every", schedule.health_every),
            ]
        ),
        "};",
        "",
    ]


def _safety(safety: Safety) -> str:
    values = [
        ("stop_holds", int(safety.stop == "hold")),
        ("homing_rad_s", float_c(safety.homing_rad_s)),
        ("tracking_rad_max", float_c(safety.tracking_rad_max)),
        ("tracking_us_max", microseconds(safety.tracking_s_max)),
        ("missed_max", safety.missed_cycles_max),
        ("temperature_max", math.floor(safety.temperature_c_max)),
        ("tilt_cosine_min", float_c(math.cos(safety.tilt_rad_max))),
        ("overrun_max", safety.overrun_cycles_max),
        ("watchdog_us", microseconds(safety.watchdog_s)),
        ("watchdog_count", round(safety.watchdog_s / _WATCHDOG_UNIT_S)),
    ]
    return "\n".join(["", "        {", *(f"        {line}" for line in field_lines(values)), "        }"])


def _message(rig: Rig, letter: str) -> tuple[str, str]:
    sensors = [sensor for sensor in rig.sensors if sensor.message == letter]
    width = max(sensor.field for sensor in sensors) + 1
    names = plain(" ".join(sensor.name for sensor in sensors))
    return f"{{'{letter}', {width}, {microseconds(sensors[-1].latency_s)}}}", names


def _sensor(rig: Rig, sensor: Sensor, needed: bool) -> str:
    values = [
        ("message", message_letters(rig).index(sensor.message)),
        ("field", sensor.field),
        ("needed", int(needed)),
        ("zero", sensor.zero),
        ("scale", float_c(sensor.scale)),
        ("age_us_max", microseconds(sensor.age_s_max)),
    ]
    return f"{{{', '.join(str(value) for _, value in values)}}}"


def _cycle(spec: CycleSpec) -> list[str]:
    program = spec.program
    lines = [
        "static const sv_program program = {",
        *field_lines(
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
        lines += row_lines((_terminal(one), plain(one.name)) for one in spec.terminals)
        lines += ["};", ""]
    lines += ["static const sv_output outputs[] = {"]
    for output in spec.outputs:
        lines += ["    {", f"        // {plain(output.name)}", *(f"    {text}" for text in _output(output)), "    },"]
    lines += ["};", ""]
    guarded = any(output.angle.channel >= 0 for output in spec.outputs)
    if guarded:
        lines += ["static const sv_guard guards[] = {"]
        lines += row_lines((_guard(output), plain(output.name)) for output in spec.outputs)
        lines += ["};", ""]
    return [
        *lines,
        "const sv_cycle servolve_cycle = {",
        *field_lines(
            [
                ("program", "&program"),
                ("terminals", "terminals" if spec.terminals else "0"),
                ("outputs", "outputs"),
                ("guards", "guards" if guarded else "0"),
                ("period_s", float_c(spec.period_s)),
                ("filter", float_c(spec.filter)),
                ("slew_step", float_c(spec.slew_step)),
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
    return field_lines(
        [
            ("low", float_c(output.low)),
            ("high", float_c(output.high)),
            ("neutral", float_c(output.neutral)),
            ("unit_scale", float_c(output.unit_scale)),
            ("count_scale", float_c(output.count_scale)),
            ("zero", output.zero),
            ("count_low", output.count_low),
            ("count_high", output.count_high),
        ]
    )


def _guard(output: OutputSpec) -> str:
    return f"{{{_terminal(output.angle)}, {float_c(output.angle_low)}, {float_c(output.angle_high)}}}"


def _terminal(spec: TerminalSpec) -> str:
    return f"{{SV_TERMINAL_{spec.kind.name}, {spec.channel}, {spec.zero}, {float_c(spec.scale)}}}"
