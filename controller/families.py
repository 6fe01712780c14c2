"""Servo families: what each calls the registers that play the same part, so that one host loop can drive them all."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final, Literal, TypeAlias

from controller.products import Product
from controller.registers import registers
from controller.registers_ax import AX_BAUD
from controller.registers_feetech import FEETECH_BAUD
from controller.registers_x import X330_BAUD, X430_BAUD

Mode: TypeAlias = Literal["position", "velocity"]


@dataclass(frozen=True)
class Family:
    """Name the registers of one servo family by the part they play; None where it has no such register.

    Args:
        name: as `Product.family` has it
        protocol: its packets
        bus_protocol: as rig files name it
        byte_order: of registers with more than one byte
        bauds: value of the baud rate register => bits per second
        id_max: largest id of a servo
        broadcast_id: the id that means all
        sync_read: whether one question can ask several servos
        model_number: register that names the product
        id: its id
        baud_rate: its bit rate
        return_delay: how long it waits before it answers
        status_level: which questions it answers
        status_level_all: value of `status_level` at which it answers all
        operating_mode: what is commanded
        modes: mode => value of `operating_mode`; those that a rig may use
        position: present position
        velocity: present velocity
        load: present load: current or PWM duty
        goal_position: goal in position mode
        goal_velocity: goal in velocity mode
        torque_enable: torque
        torque_ceiling: largest PWM duty, which the loop writes in RAM
        ceiling_key: key of the torque ceiling in a rig file
        ceiling_limit: register in EEPROM that bounds the torque ceiling
        position_limits: lowest and highest position
        homing_offset: what is added to the encoder's count, or taken from it
        voltage: supply voltage
        temperature: its temperature
        voltage_limits: lowest and highest supply voltage
        temperature_limit: shuts down above
        hardware_error: what is wrong with it; None: only its replies' error byte says so
        error_bits: bit of the hardware error, or of the error byte => what is wrong
        shutdown: which of these bits take its torque
        watchdog: stops the servo when the bus falls silent
        lock: keeps the EEPROM from being written, or from keeping what is written
        gains: mode => key in a rig file => the registers that hold it
        state: first and last register of the block that is read in every period
        health: first and last register of the blocks that are read one at a time
        settings: (register, count) that the loop needs as such, whatever the rig says
    """

    name: str
    protocol: Literal["dynamixel-2.0", "dynamixel-1.0", "feetech"]
    bus_protocol: Literal["dynamixel-2.0", "dynamixel-1.0", "feetech-sts", "feetech-scs"]
    byte_order: Literal["little", "big"]
    bauds: Mapping[int, int]
    id_max: int
    broadcast_id: int
    sync_read: bool
    model_number: str
    id: str
    baud_rate: str
    return_delay: str
    status_level: str
    status_level_all: int
    operating_mode: str | None
    modes: Mapping[Mode, int]
    position: str
    velocity: str
    load: str
    goal_position: str
    goal_velocity: str | None
    torque_enable: str
    torque_ceiling: str | None
    ceiling_key: str | None
    ceiling_limit: str
    position_limits: tuple[str, str]
    homing_offset: str | None
    voltage: str
    temperature: str
    voltage_limits: tuple[str, str]
    temperature_limit: str
    hardware_error: str | None
    error_bits: Mapping[int, str]
    shutdown: str
    watchdog: str | None
    lock: str | None
    gains: Mapping[Mode, Mapping[str, tuple[str, ...]]]
    state: tuple[str, str]
    health: tuple[tuple[str, str], ...]
    settings: tuple[tuple[str, int], ...]

    def goal(self, mode: Mode) -> str:
        """Return the register that a mode's goals are written to.

        Args:
            mode: what is commanded

        Raises:
            ValueError: the family has no such mode
        """
        name = self.goal_position if mode == "position" else self.goal_velocity
        if name is None or mode not in self.modes:
            raise ValueError(f"{self.name} servos have no {mode} mode")
        return name

    def errors(self, bits: int) -> tuple[str, ...]:
        """Return in words what a servo says is wrong with it.

        Args:
            bits: its hardware error, or the error byte of a servo that has none
        """
        return tuple(words for bit, words in self.error_bits.items() if bits >> bit & 1)


_X330: Final = Family(
    name="dynamixel-x330",
    protocol="dynamixel-2.0",
    bus_protocol="dynamixel-2.0",
    byte_order="little",
    bauds=X330_BAUD,
    id_max=252,
    broadcast_id=254,
    sync_read=True,
    model_number="model_number",
    id="id",
    baud_rate="baud_rate",
    return_delay="return_delay_time",
    status_level="status_return_level",
    status_level_all=2,
    operating_mode="operating_mode",
    modes=MappingProxyType({"position": 3, "velocity": 1}),
    position="present_position",
    velocity="present_velocity",
    load="present_current",
    goal_position="goal_position",
    goal_velocity="goal_velocity",
    torque_enable="torque_enable",
    torque_ceiling="goal_pwm",
    ceiling_key="pwm_limit",
    ceiling_limit="pwm_limit",
    position_limits=("min_position_limit", "max_position_limit"),
    homing_offset="homing_offset",
    voltage="present_input_voltage",
    temperature="present_temperature",
    voltage_limits=("min_voltage_limit", "max_voltage_limit"),
    temperature_limit="temperature_limit",
    hardware_error="hardware_error_status",
    error_bits=MappingProxyType(
        {
            0: "input voltage",
            2: "overheating",
            3: "motor encoder",
            4: "electrical shock or insufficient power",
            5: "overload",
        }
    ),
    shutdown="shutdown",
    watchdog="bus_watchdog",
    lock=None,
    gains=MappingProxyType(
        {
            "position": MappingProxyType(
                {
                    "p_gain": ("position_p_gain",),
                    "i_gain": ("position_i_gain",),
                    "d_gain": ("position_d_gain",),
                }
            ),
            "velocity": MappingProxyType(
                {
                    "velocity_p_gain": ("velocity_p_gain",),
                    "velocity_i_gain": ("velocity_i_gain",),
                }
            ),
        }
    ),
    state=("present_current", "present_position"),
    health=(("torque_enable", "hardware_error_status"), ("present_input_voltage", "present_temperature")),
    settings=(
        ("drive_mode", 0),
        ("homing_offset", 0),
        ("status_return_level", 2),
        ("bus_watchdog", 0),
        ("feedforward_1st_gain", 0),
        ("feedforward_2nd_gain", 0),
        ("profile_acceleration", 0),
        ("profile_velocity", 0),
    ),
)

_X430: Final = replace(
    _X330,
    name="dynamixel-x430",
    bauds=X430_BAUD,
    load="present_load",
    state=("present_load", "present_position"),
)

_AX: Final = Family(
    name="dynamixel-ax",
    protocol="dynamixel-1.0",
    bus_protocol="dynamixel-1.0",
    byte_order="little",
    bauds=AX_BAUD,
    id_max=253,
    broadcast_id=254,
    sync_read=False,
    model_number="model_number",
    id="id",
    baud_rate="baud_rate",
    return_delay="return_delay_time",
    status_level="status_return_level",
    status_level_all=2,
    operating_mode=None,
    modes=MappingProxyType({"position": 0}),
    position="present_position",
    velocity="present_speed",
    load="present_load",
    goal_position="goal_position",
    goal_velocity=None,
    torque_enable="torque_enable",
    torque_ceiling="torque_limit",
    ceiling_key="torque_limit",
    ceiling_limit="max_torque",
    position_limits=("cw_angle_limit", "ccw_angle_limit"),
    homing_offset=None,
    voltage="present_voltage",
    temperature="present_temperature",
    voltage_limits=("min_voltage_limit", "max_voltage_limit"),
    temperature_limit="temperature_limit",
    hardware_error=None,
    error_bits=MappingProxyType({0: "input voltage", 1: "angle limit", 2: "overheating", 5: "overload"}),
    shutdown="shutdown",
    watchdog=None,
    lock="lock",
    gains=MappingProxyType(
        {
            "position": MappingProxyType(
                {
                    "compliance_margin": ("cw_compliance_margin", "ccw_compliance_margin"),
                    "compliance_slope": ("cw_compliance_slope", "ccw_compliance_slope"),
                    "punch": ("punch",),
                }
            )
        }
    ),
    state=("present_position", "present_load"),
    health=(("torque_enable", "torque_enable"), ("present_voltage", "present_temperature")),
    settings=(("status_return_level", 2), ("moving_speed", 0)),
)

_FEETECH_BITS: Final = MappingProxyType(
    {0: "input voltage", 1: "sensor", 2: "overheating", 3: "overcurrent", 4: "angle", 5: "overload"}
)
_PID: Final = MappingProxyType(
    {"p_gain": ("p_coefficient",), "i_gain": ("i_coefficient",), "d_gain": ("d_coefficient",)}
)

_STS: Final = Family(
    name="feetech-sts",
    protocol="feetech",
    bus_protocol="feetech-sts",
    byte_order="little",
    bauds=FEETECH_BAUD,
    id_max=253,
    broadcast_id=254,
    sync_read=True,
    model_number="model_number",
    id="id",
    baud_rate="baud_rate",
    return_delay="return_delay",
    status_level="response_level",
    status_level_all=1,
    operating_mode="operating_mode",
    modes=MappingProxyType({"position": 0, "velocity": 1}),
    position="present_position",
    velocity="present_speed",
    load="present_load",
    goal_position="goal_position",
    goal_velocity="goal_speed",
    torque_enable="torque_enable",
    torque_ceiling="torque_limit",
    ceiling_key="torque_limit",
    ceiling_limit="max_torque",
    position_limits=("min_angle_limit", "max_angle_limit"),
    homing_offset="homing_offset",
    voltage="present_voltage",
    temperature="present_temperature",
    voltage_limits=("min_voltage_limit", "max_voltage_limit"),
    temperature_limit="max_temperature_limit",
    hardware_error="status",
    error_bits=_FEETECH_BITS,
    shutdown="unloading_condition",
    watchdog=None,
    lock="lock",
    gains=MappingProxyType(
        {
            "position": _PID,
            "velocity": MappingProxyType({"velocity_p_gain": ("velocity_p",), "velocity_i_gain": ("velocity_i",)}),
        }
    ),
    state=("present_position", "present_load"),
    health=(("torque_enable", "torque_enable"), ("present_voltage", "status")),
    settings=(("response_level", 1), ("acceleration", 0), ("goal_time", 0), ("goal_speed", 0)),
)

_SCS: Final = replace(
    _STS,
    name="feetech-scs",
    bus_protocol="feetech-scs",
    byte_order="big",
    sync_read=False,
    operating_mode=None,
    modes=MappingProxyType({"position": 0}),
    goal_velocity=None,
    torque_ceiling=None,
    ceiling_key=None,
    homing_offset=None,
    gains=MappingProxyType({"position": _PID}),
    settings=(("response_level", 1), ("goal_time", 0), ("goal_speed", 0)),
)

FAMILIES: Final[Mapping[str, Family]] = MappingProxyType(
    {family.name: family for family in (_X330, _X430, _AX, _STS, _SCS)}
)
"""The families, by name."""


def family_of(product: Product) -> Family:
    """Return the family of a servo.

    Args:
        product: the servo, not the ideal joint

    Returns:
        its family; of the X430, what measures current has its current for a load
    """
    family = FAMILIES[product.family]
    return family if family.load in registers(product) else _measuring_current(family.name)


@functools.cache  # this is asked for in every period
def _measuring_current(name: str) -> Family:
    family = FAMILIES[name]
    return replace(family, load="present_current", state=("present_current", family.state[1]))
