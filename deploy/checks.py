"""Check a rig before anything is written to it: each finding is one sentence that says what to change."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from controller.controller import Controller
from controller.registers import X330_BAUD, Register, registers
from controller.rig import Joint, Rig
from deploy.joint_counts import count_limits, joint_angle
from deploy.port import usb_latency_s
from deploy.safety import judge_hardware_error
from deploy.sensor_reader import SensorReader
from deploy.servo_bus import ServoBus, decode

_USB_LATENCY_S_MAX = 0.0015
_LIMIT_SLACK_RAD = 0.05
_ID_MAX = 252


@dataclass(frozen=True)
class Finding:
    """Hold one thing that a check found.

    Args:
        level: "error" forbids to arm, "warning" does not
        text: one sentence
    """

    level: Literal["error", "warning"]
    text: str


@dataclass(frozen=True)
class Reading:
    """Hold what a check read from one servo, for people to look at.

    Args:
        joint: the joint
        values: register => count; empty if the servo is not there
    """

    joint: Joint
    values: Mapping[str, int]

    @property
    def angle_rad(self) -> float:
        """Return the joint's angle [rad], NaN if the servo is not there."""
        position = self.values.get("present_position")
        return math.nan if position is None else joint_angle(self.joint, position)


def check_servos(bus: ServoBus, rig: Rig) -> tuple[list[Reading], list[Finding]]:
    """Read every servo's registers, write none, and compare them with the rig.

    Args:
        bus: the bus
        rig: the rig

    Returns:
        what was read, and what was found
    """
    readings = []
    findings = []
    latency_s = usb_latency_s(bus.port.port_name)
    if latency_s is not None and latency_s > _USB_LATENCY_S_MAX:
        findings.append(
            Finding(
                "warning",
                f"{bus.port.label}: the USB adapter holds replies back for {1e3 * latency_s:.0f} ms; write 1 to "
                "its latency_timer under /sys/bus/usb-serial/devices",
            )
        )
    for joint in rig.joints:
        reading, found = _check_servo(bus, rig, joint)
        readings.append(reading)
        findings += found
    return readings, findings


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
        unit = math.pi / 180.0 if output.unit == "deg" else 1.0
        joint = joints[output.name]
        span = min(output.high * unit, joint.high_rad) - max(output.low * unit, joint.low_rad)
        jump = max(jump, controller.filter * span)
    text = (
        f"controller {controller.name}: has no slew limit (slew_rad_s); its goals may jump by {jump:.2g} rad a period"
    )
    return [Finding("warning", text)]


def _check_servo(bus: ServoBus, rig: Rig, joint: Joint) -> tuple[Reading, list[Finding]]:
    named = f"joint {joint.name} (servo {joint.id})"
    reply, model = bus.ping(joint.id)
    for _ in range(2):
        if reply.status != "data":
            reply, model = bus.ping(joint.id)
    if reply.status != "data":
        said = "does not answer" if reply.status == "missing" else "answers with corrupt packets only"
        where = f"on {bus.port.label} at {rig.bus.baud} baud"
        text = f"{named}: {said} {where}; check its power, cable, id and baud rate"
        return Reading(joint, {}), [Finding("error", text)]
    if model != joint.product.model_number:
        text = (
            f"{named}: is a model {model}, the rig says {joint.product.name} (model {joint.product.model_number}); "
            "connect the right servo or correct the rig"
        )
        return Reading(joint, {}), [Finding("error", text)]
    values, missing = _read_table(bus, joint)
    if missing:
        text = f"{named}: {missing}; check cables, ground and other masters on the bus"
        return Reading(joint, values), [Finding("error", text)]
    findings = [Finding("error", f"{named}: {text}") for text in _settings(rig, joint, values)]
    findings += [Finding("error", f"{named}: {text}") for text in _state(rig, joint, values)]
    hardware = judge_hardware_error(joint, values["hardware_error_status"], values["shutdown"])
    if hardware:
        findings.append(Finding("error", hardware))
    if values["torque_enable"]:
        findings.append(Finding("warning", f"{named}: its torque was on already; nobody may hold the robot"))
    return Reading(joint, values), findings


def _read_table(bus: ServoBus, joint: Joint) -> tuple[dict[str, int], str]:
    """Read the whole table in two blocks; return its counts and, if a block failed, what is wrong."""
    table = [register for register in registers(joint.product).values() if register.address < 148]
    values: dict[str, int] = {}
    for block in (
        [register for register in table if register.address < 64],
        [register for register in table if register.address >= 64],
    ):
        first, last = block[0].address, block[-1].address + block[-1].size
        reply = bus.read(joint.id, first, last - first)
        for _ in range(2):
            if reply.status != "data":
                reply = bus.read(joint.id, first, last - first)
        if reply.status != "data":
            what = f"the registers {first} to {last - 1} could not be read"
            if reply.status == "corrupt":  # a ping's answers are equal and pass for one
                what += f", answers are corrupt: two servos may share id {joint.id}"
            return values, what
        values |= _decode_block(block, first, reply.data)
    return values, ""


def _decode_block(block: Sequence[Register], first: int, data: bytes) -> dict[str, int]:
    return {
        register.name: decode(register, data[register.address - first : register.address - first + register.size])
        for register in block
    }


def _settings(rig: Rig, joint: Joint, values: Mapping[str, int]) -> Iterator[str]:
    """Yield what is wrong in the EEPROM, which is never written here."""
    delay_us = 2 * values["return_delay_time"]
    if X330_BAUD.get(values["baud_rate"]) != rig.bus.baud:
        yield f"baud_rate holds {values['baud_rate']}, the rig says {rig.bus.baud} baud; set register 8"
    if delay_us != rig.bus.return_delay_us:
        want = rig.bus.return_delay_us
        yield f"return_delay_time is {delay_us} us, the rig says {want} us; set register 9 to {want // 2}"
    for name, want in (("drive_mode", 0), ("operating_mode", 3), ("homing_offset", 0)):
        if values[name] != want:
            address = registers(joint.product)[name].address
            yield f"{name} is {values[name]} and must be {want}; set register {address} to {want}"
    if values["secondary_id"] <= _ID_MAX:
        yield f"secondary_id {values['secondary_id']} is active; set register 12 to 255"
    low, high = count_limits(joint)
    if values["min_position_limit"] > low:
        yield f"min_position_limit {values['min_position_limit']} cuts off travel; set register 52 to {low} or less"
    if values["max_position_limit"] < high:
        yield f"max_position_limit {values['max_position_limit']} cuts off travel; set register 48 to {high} or more"
    if values["pwm_limit"] < joint.pwm_limit:
        yield f"pwm_limit {values['pwm_limit']} is below the rig's {joint.pwm_limit}; set register 36, or the rig's"


def _state(rig: Rig, joint: Joint, values: Mapping[str, int]) -> Iterator[str]:
    """Yield what is wrong with the servo's present state."""
    voltage_v = 0.1 * values["present_input_voltage"]
    if voltage_v < rig.safety.voltage_low_v:
        yield f"its supply is {voltage_v:.1f} V, at least {rig.safety.voltage_low_v:g} V are needed; charge or check it"
    if voltage_v > 1.2 * rig.supply_v:
        yield f"its supply is {voltage_v:.1f} V, the rig says {rig.supply_v:g} V; connect the right supply"
    if values["present_temperature"] > rig.safety.temperature_c_max:
        yield f"it is at {values['present_temperature']} degrees Celsius; let it cool"
    position = values["present_position"]
    angle = joint_angle(joint, position)
    if not 0 <= position < joint.product.ticks_per_turn:
        yield f"its position {position} is outside one turn, so it has wrapped around; reboot the servo"
    elif not joint.low_rad - _LIMIT_SLACK_RAD <= angle <= joint.high_rad + _LIMIT_SLACK_RAD:
        yield (
            f"it stands at {angle:.2f} rad, outside its limits {joint.low_rad:g} to {joint.high_rad:g} rad; move it "
            "inside by hand, or correct zero_tick"
        )
