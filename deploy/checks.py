"""Check a rig before anything is written to it: each finding is one sentence that says what to change."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Final

from controller.controller import Controller
from controller.registers import Register, decode_register, registers
from controller.rig import Joint, Rig
from deploy.buses.line_time import period_line_s
from deploy.buses.port import usb_latency_s
from deploy.buses.reading import Reading
from deploy.buses.sensor_reader import SensorReader
from deploy.buses.servo_bus import Reply, ServoBus
from deploy.finding import Finding, Fix
from deploy.safety import judge_hardware_error
from deploy.servo_findings import setting_findings, state_findings

__all__ = [
    "Finding",
    "Fix",
    "check_controller",
    "check_derating",
    "check_sensors",
    "check_servos",
    "check_watchdogs",
]

_USB_LATENCY_S_MAX: Final = 0.0015
_LATE_S_MAX: Final = 0.003
_DELAY_S_MAX: Final = 508e-6
"""The longest that a servo can be set to wait before it answers [s]."""
_PATIENCE_S: Final = 0.1
_LINE_SHARE_MAX: Final = 0.8
_TABLE_GAP: Final = 8
"""Bytes without a register after which a table holds nothing that is checked: indirect data, or the maker's own."""


def check_servos(bus: ServoBus, rig: Rig) -> tuple[list[Reading], list[Finding]]:
    """Read every servo's registers, write none, and compare them with the rig.

    Args:
        bus: the bus
        rig: the rig

    Returns:
        what was read, and what was found
    """
    readings, findings, waits_s = [], _check_line(bus, rig), [math.inf]
    for joint in rig.joints:
        reading, found = _check_servo(bus, rig, joint, waits_s)
        readings.append(reading)
        findings += found
    late_s = min(waits_s)
    if _LATE_S_MAX < late_s < math.inf and usb_latency_s(bus.port.port_name) is None:
        text = (
            f"{bus.port.label}: every reply comes at least {1e3 * late_s:.0f} ms later than the line needs; set the "
            "adapter's latency timer to 1 ms"
        )
        findings.append(Finding("warning", text))
    return readings, findings + check_watchdogs(rig)


def check_sensors(rig: Rig, reader: SensorReader, needed: frozenset[int], now: float) -> list[Finding]:
    """Compare what the sensor node has sent with what the rig promises.

    Args:
        rig: the rig
        reader: after some time of listening
        needed: numbers of the sensors that the run can not do without
        now: time [s]
    """
    findings = []
    for number, sensor in enumerate(rig.sensors):
        age = reader.age(number, now)
        if age <= sensor.age_s_max:
            continue
        heard = "no line has come" if math.isinf(age) else f"the newest is {age:.2f} s old"
        findings.append(
            Finding(
                "error" if number in needed else "warning",
                f"sensor {sensor.name}: ${sensor.message} lines should come {sensor.rate_hz:g} times a second, but "
                f"{heard}; check the sensor node and its port",
            )
        )
    return findings


def check_controller(rig: Rig, controller: Controller) -> list[Finding]:
    """Warn of a controller whose goals may jump: only its own slew limit keeps them from it.

    Args:
        rig: the rig
        controller: the controller, which fits the rig
    """
    if controller.slew_rad_s > 0.0:
        return []
    joints = {joint.name: joint for joint in rig.joints}
    jump = 0.0
    for output in controller.outputs:
        unit = math.pi / 180.0 if output.unit.startswith("deg") else 1.0
        joint = joints[output.name]
        low, high = joint.low_rad, joint.high_rad
        if joint.mode == "velocity":
            low, high = -joint.speed_rad_s_max, joint.speed_rad_s_max
        span = min(output.high * unit, high) - max(output.low * unit, low)
        jump = max(jump, controller.filter * span)
    unit_name = "rad/s" if rig.joints[0].mode == "velocity" else "rad"
    text = (
        f"controller {controller.name}: has no slew limit (slew_rad_s); its goals may jump by {jump:.2g} {unit_name} a "
        "period"
    )
    return [Finding("warning", text)]


def check_derating(rig: Rig, derate: float) -> list[Finding]:
    """Object to a derated run of servos that have no torque ceiling to lower.

    Args:
        rig: the rig
        derate: part of the torque ceiling that is allowed
    """
    lacking = [joint for joint in rig.joints if joint.family.torque_ceiling is None]
    if derate >= 1.0 or not lacking:
        return []
    text = f"{lacking[0].product.name} servos have no torque ceiling outside their EEPROM; leave --derate out"
    return [Finding("error", text)]


def check_watchdogs(rig: Rig) -> list[Finding]:
    """Say what stops the servos if this program dies, where nothing on them does.

    Args:
        rig: the rig
    """
    lacking = [joint for joint in rig.joints if joint.family.watchdog is None]
    if not lacking:
        return []
    products = ", ".join(sorted({joint.product.name for joint in lacking}))
    goes_on = "turning" if lacking[0].mode == "velocity" else "holding the last goal"
    text = (
        f"{products} servos have no bus watchdog: if this program or its cable dies, they go on {goes_on} until their "
        "own overload protection or you cut them off; keep the power switch at hand"
    )
    return [Finding("warning", text)]


def _check_line(bus: ServoBus, rig: Rig) -> list[Finding]:
    findings = []
    latency_s = usb_latency_s(bus.port.port_name)
    if latency_s is not None and latency_s > _USB_LATENCY_S_MAX:
        text = (
            f"{bus.port.label}: the USB adapter holds replies back for {1e3 * latency_s:.0f} ms; write 1 to its "
            "latency_timer under /sys/bus/usb-serial/devices"
        )
        findings.append(Finding("warning", text))
    line_s = period_line_s(rig)
    if line_s > _LINE_SHARE_MAX * rig.period_s:
        text = (
            f"{bus.port.label}: a period's packets and return delays take {1e3 * line_s:.1f} ms of its "
            f"{1e3 * rig.period_s:g} ms; raise baud, or lower return_delay_us, in servos and rig"
        )
        findings.append(Finding("warning", text))
    return findings


def _check_servo(bus: ServoBus, rig: Rig, joint: Joint, waits_s: list[float]) -> tuple[Reading, list[Finding]]:
    named = f"joint {joint.name} (servo {joint.id})"
    reply, model = bus.ping(joint.id)
    for _ in range(2):
        if reply.status != "data":
            reply, model = bus.ping(joint.id)
    if reply.status == "missing":
        slow_s = _patient_ping_s(bus, joint)
        if slow_s is not None:
            text = (
                f"{named}: answers {1e3 * slow_s:.0f} ms late; set the adapter's latency timer to 1 ms, or look for "
                "what else holds bytes back"
            )
            return Reading(joint, {}), [Finding("error", text)]
    if reply.status != "data":
        said = "does not answer" if reply.status == "missing" else "answers with corrupt packets only"
        where = f"on {bus.port.label} at {rig.bus.baud} baud"
        text = f"{named}: {said} {where}; check its power, cable, id and baud rate; rig scan shows who answers"
        return Reading(joint, {}), [Finding("error", text)]
    if model != joint.product.model_number:
        text = (
            f"{named}: is a model {model}, the rig says {joint.product.name} (model {joint.product.model_number}); "
            "connect the right servo or correct the rig"
        )
        return Reading(joint, {}), [Finding("error", text)]
    values, error, missing = _read_table(bus, joint, waits_s)
    if missing:
        text = f"{named}: {missing}; check cables, ground and other masters on the bus"
        return Reading(joint, values, error), [Finding("error", text)]
    findings = [*setting_findings(rig, joint, values), *state_findings(rig, joint, values)]
    status = error if joint.family.hardware_error is None else values[joint.family.hardware_error]
    hardware = judge_hardware_error(joint, status, values[joint.family.shutdown])
    if hardware:
        findings.append(Finding("error", hardware))
    return Reading(joint, values, error), sorted(findings, key=lambda finding: finding.level)


def _patient_ping_s(bus: ServoBus, joint: Joint) -> float | None:
    """Ask once more and wait for long; return how long the answer took, or None if there is none [s]."""
    usual_s, bus.port.latency_s = bus.port.latency_s, _PATIENCE_S
    try:
        asked = bus.port.now()
        reply, _ = bus.ping(joint.id)
        return reply.t - asked if reply.status == "data" else None
    finally:
        bus.port.latency_s = usual_s


def _read_table(bus: ServoBus, joint: Joint, waits_s: list[float]) -> tuple[dict[str, int], int, str]:
    """Read the whole table in two blocks; return its counts, the servo's error byte and, if a block failed, why."""
    values: dict[str, int] = {}
    error = 0
    for block in _blocks(joint):
        first, size = block[0].address, block[-1].address + block[-1].size - block[0].address
        reply = _read_block(bus, joint, first, size, waits_s)
        if reply.status != "data":
            what = f"the registers {first} to {first + size - 1} could not be read"
            if reply.status == "corrupt":  # a ping's answers are equal and pass for one
                what += f", answers are corrupt: two servos may share id {joint.id}"
            return values, error, what
        error |= reply.error
        values |= _decode_block(block, first, reply.data)
    return values, error, ""


def _blocks(joint: Joint) -> Iterator[list[Register]]:
    """Yield the registers in EEPROM, and those in RAM up to the first wide gap."""
    table = sorted(registers(joint.product).values(), key=lambda register: register.address)
    start = next(number for number, register in enumerate(table) if not register.eeprom)
    yield table[:start]
    end = start + 1
    for before, after in itertools.pairwise(table[start:]):
        if after.address - (before.address + before.size) >= _TABLE_GAP:
            break
        end += 1
    yield table[start:end]


def _read_block(bus: ServoBus, joint: Joint, first: int, size: int, waits_s: list[float]) -> Reply:
    asked = bus.port.now()
    reply = bus.read(joint.id, first, size)
    if reply.status == "data":
        # beyond the delay that the servo may hold, and the question's and the answer's bytes
        waits_s.append(reply.t - asked - _DELAY_S_MAX - (2 * bus.status_bytes + size) * bus.port.byte_s)
    for _ in range(2):
        if reply.status != "data":
            reply = bus.read(joint.id, first, size)
    return reply


def _decode_block(block: Sequence[Register], first: int, data: bytes) -> dict[str, int]:
    return {
        register.name: decode_register(
            register, data[register.address - first : register.address - first + register.size]
        )
        for register in block
    }
