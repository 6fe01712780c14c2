"""Control table of Dynamixel's AX series, protocol 1.0: one line a register."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from controller import registers_x
from controller.register import REV_MIN, Register, RegisterLine

_EM: Final = "[EM]"

SOURCES: Final[Mapping[str, str]] = MappingProxyType({"[EM]": registers_x.SOURCES["[EM]"]})
"""Tag => what it stands for."""

_COUNT: Final = math.radians(300.0) / 1024.0
"""[rad] a count of position, which the manual rounds to 0.29 degrees."""

_RPM: Final = 0.111 * REV_MIN

_line: Final = RegisterLine(_EM)

_BAUD: Final = "[EM] 2000000 / (value + 1), to 1 Mbit/s; ranges from its includes"
_SPEED: Final = "[EM] joint mode, 0: as fast as it can; wheel mode: 0.1 % of the torque, bit 10 set turns clockwise"
_SLOPE: Final = "[EM] acts in powers of 2, from 2 to 128"
_PUNCH: Final = "[EM] range 32 to 1023; 0 is taken"
_MAX_TORQUE: Final = "[EM] about 0.1 % a count, 1023 is all"

# fmt: off
_AX12A: Final[tuple[Register, ...]] = (
    _line("E",  0, 2, "model_number",         "r",    12, 0, 65535),
    _line("E",  2, 1, "firmware_version",     "r",    24, 0, 255, source="[EM] gives no value; 24 seen"),
    _line("E",  3, 1, "id",                   "rw",    1, 0, 253),
    _line("E",  4, 1, "baud_rate",            "rw",    1, 0, 254, source=_BAUD),
    _line("E",  5, 1, "return_delay_time",    "rw",  250, 0, 254, "s", 2e-6),
    _line("E",  6, 2, "cw_angle_limit",       "rw",    0, 0, 1023, "rad", _COUNT),
    _line("E",  8, 2, "ccw_angle_limit",      "rw", 1023, 0, 1023, "rad", _COUNT, "[EM]; both limits 0: wheel mode"),
    _line("E", 11, 1, "temperature_limit",    "rw",   70, 0, 99, "degC", source="[EM], range of its includes"),
    _line("E", 12, 1, "min_voltage_limit",    "rw",   60, 50, 160, "V", 0.1),
    _line("E", 13, 1, "max_voltage_limit",    "rw",  140, 50, 160, "V", 0.1),
    _line("E", 14, 2, "max_torque",           "rw", 1023, 0, 1023, "duty", 1.0 / 1023.0, _MAX_TORQUE),
    _line("E", 16, 1, "status_return_level",  "rw",    2, 0, 2),
    _line("E", 17, 1, "alarm_led",            "rw",   36, 0, 127),
    _line("E", 18, 1, "shutdown",             "rw",   36, 0, 127),
    _line("R", 24, 1, "torque_enable",        "rw",    0, 0, 1),
    _line("R", 25, 1, "led",                  "rw",    0, 0, 1),
    _line("R", 26, 1, "cw_compliance_margin", "rw",    1, 0, 255, "rad", _COUNT),
    _line("R", 27, 1, "ccw_compliance_margin", "rw",   1, 0, 255, "rad", _COUNT),
    _line("R", 28, 1, "cw_compliance_slope",  "rw",   32, 0, 254, "rad", _COUNT, _SLOPE),
    _line("R", 29, 1, "ccw_compliance_slope", "rw",   32, 0, 254, "rad", _COUNT, _SLOPE),
    _line("R", 30, 2, "goal_position",        "rw",    0, 0, 1023, "rad", _COUNT),
    _line("R", 32, 2, "moving_speed",         "rw",    0, -1023, 1023, "rad/s", _RPM, _SPEED, "sign10"),
    _line("R", 34, 2, "torque_limit",         "rw", 1023, 0, 1023, "duty", 1.0 / 1023.0, "[EM] max_torque at power-up"),
    _line("R", 36, 2, "present_position",     "r",     0, 0, 65535, "rad", _COUNT),
    _line("R", 38, 2, "present_speed",        "r",     0, -1023, 1023, "rad/s", _RPM, encoding="sign10"),
    _line("R", 40, 2, "present_load",         "r",     0, -1023, 1023, "duty", 1.0 / 1023.0, encoding="sign10"),
    _line("R", 42, 1, "present_voltage",      "r",     0, 0, 255, "V", 0.1),
    _line("R", 43, 1, "present_temperature",  "r",     0, 0, 255, "degC"),
    _line("R", 44, 1, "registered",           "r",     0, 0, 1),
    _line("R", 46, 1, "moving",               "r",     0, 0, 1),
    _line("R", 47, 1, "lock",                 "rw",    0, 0, 1, source="[EM]; 1 stays until the power is cut"),
    _line("R", 48, 2, "punch",                "rw",   32, 0, 1023, "duty", 1.0 / 1023.0, _PUNCH),
)
# fmt: on

TABLES: Final[Mapping[str, Mapping[str, Register]]] = MappingProxyType(
    {"ax-12a": MappingProxyType({line.name: line for line in _AX12A})}
)
"""Product => its control table by register name, in order of address."""

AX_BAUD: Final[Mapping[int, int]] = MappingProxyType(
    {1: 1_000_000, 3: 500_000, 4: 400_000, 7: 250_000, 9: 200_000, 16: 115_200, 34: 57_600, 103: 19_200, 207: 9_600}
)
"""Baud rate register value => the usual rate that it is within 2.1 % of.

Source: e-Manual, _includes/en/dxl/control_table_baudrate.md.
"""
