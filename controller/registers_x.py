"""Control tables of Dynamixel's X series, protocol 2.0: one line a register."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Final

from controller.register import TURN_4096, Register, RegisterLine

_EM: Final = "[EM]"

SOURCES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "[EM]": "ROBOTIS e-Manual, docs/en/dxl (GitHub, ROBOTIS-GIT/emanual): x/xc330-m181.md@01ba971,"
        " x/xl330-m288.md@028a13d, x/xl430-w250.md@00a4b78, x/xm430-w350.md@07fe860 (no ranges: those of the others),"
        " ax/ax-12a.md@07fe860",
        "SDK": "the `.model` files of dynamixel-sdk 4.1.0",
    }
)
"""Tag => what it stands for."""

_RPM: Final = 0.0239691227
"""[rad/s] a velocity count: `Product.velocity_unit_rad_s`."""

_REV_MIN2: Final = 2.0 * math.pi / 3600.0
"""[rad/s2] a revolution per minute per minute."""

_line: Final = RegisterLine(_EM)

_I16: Final = 1 << 15
_I32: Final = 1 << 31
_TURNS: Final = 256 * 4096 - 1
_NO_MODEL: Final = "[EM]; not in the SDK's .model files"

_GOAL: Final = "[EM] extended position mode; position mode keeps to the position limits"

# fmt: off
# The lines hold the XL330-M288's values; _PRODUCT_LINES holds what differs.
_X: Final[tuple[Register, ...]] = (
    _line("E",   0, 2, "model_number",           "r",  1200, 0, 65535),
    _line("E",   2, 4, "model_information",      "r",     0, 0, 2**32 - 1),
    _line("E",   6, 1, "firmware_version",       "r",    52, 0, 255, source="[EM] gives no value; SDK: to 52"),
    _line("E",   7, 1, "id",                     "rw",    1, 0, 252),
    _line("E",   8, 1, "baud_rate",              "rw",    1, 0, 6),
    _line("E",   9, 1, "return_delay_time",      "rw",  250, 0, 254, "s", 2e-6),
    _line("E",  10, 1, "drive_mode",             "rw",    0, 0, 13, source="[EM] xc330 says 0..13, xl330@028a13d 0..5"),
    _line("E",  11, 1, "operating_mode",         "rw",    3, 0, 16),
    _line("E",  12, 1, "secondary_id",           "rw",  255, 0, 255, source="[EM] range 0..252, factory 255 (off)"),
    _line("E",  13, 1, "protocol_type",          "rw",    2, 2, 22),
    _line("E",  20, 4, "homing_offset",          "rw",    0, -1044479, 1044479, "rad", TURN_4096),
    _line("E",  24, 4, "moving_threshold",       "rw",   10, 0, 1023, "rad/s", _RPM),
    _line("E",  31, 1, "temperature_limit",      "rw",   70, 0, 100, "degC"),
    _line("E",  32, 2, "max_voltage_limit",      "rw",   70, 31, 70, "V", 0.1),
    _line("E",  34, 2, "min_voltage_limit",      "rw",   35, 31, 70, "V", 0.1),
    _line("E",  36, 2, "pwm_limit",              "rw",  885, 0, 885, "duty", 1.0 / 885.0),
    _line("E",  44, 4, "velocity_limit",         "rw",  445, 0, 2047, "rad/s", _RPM),
    _line("E",  48, 4, "max_position_limit",     "rw", 4095, 0, 4095, "rad", TURN_4096),
    _line("E",  52, 4, "min_position_limit",     "rw",    0, 0, 4095, "rad", TURN_4096),
    _line("E",  60, 1, "startup_configuration",  "rw",    0, 0, 3, source=_NO_MODEL),
    _line("E",  63, 1, "shutdown",               "rw",   53, 0, 63),
    _line("R",  64, 1, "torque_enable",          "rw",    0, 0, 1),
    _line("R",  65, 1, "led",                    "rw",    0, 0, 1),
    _line("R",  68, 1, "status_return_level",    "rw",    2, 0, 2),
    _line("R",  69, 1, "registered_instruction", "r",     0, 0, 255),
    _line("R",  70, 1, "hardware_error_status",  "r",     0, 0, 255),
    _line("R",  76, 2, "velocity_i_gain",        "rw", 1600, 0, 16383),
    _line("R",  78, 2, "velocity_p_gain",        "rw",  180, 0, 16383),
    _line("R",  80, 2, "position_d_gain",        "rw",    0, 0, 16383),
    _line("R",  82, 2, "position_i_gain",        "rw",    0, 0, 16383),
    _line("R",  84, 2, "position_p_gain",        "rw",  400, 0, 16383),
    _line("R",  88, 2, "feedforward_2nd_gain",   "rw",    0, 0, 16383),
    _line("R",  90, 2, "feedforward_1st_gain",   "rw",    0, 0, 16383),
    _line("R",  98, 1, "bus_watchdog",           "rw",    0, 0, 127, "s", 0.02, source="[EM]; reads 255 once tripped"),
    _line("R", 100, 2, "goal_pwm",               "rw",  885, -885, 885, "duty", 1.0 / 885.0),
    _line("R", 104, 4, "goal_velocity",          "rw",    0, -2047, 2047, "rad/s", _RPM),
    _line("R", 108, 4, "profile_acceleration",   "rw",    0, 0, 32767, "rad/s2", 214.577 * _REV_MIN2),
    _line("R", 112, 4, "profile_velocity",       "rw",    0, 0, 32767, "rad/s", _RPM),
    _line("R", 116, 4, "goal_position",          "rw",    0, -_TURNS, _TURNS, "rad", TURN_4096, _GOAL),
    _line("R", 120, 2, "realtime_tick",          "r",     0, 0, 32767, "s", 1e-3),
    _line("R", 122, 1, "moving",                 "r",     0, 0, 255),
    _line("R", 123, 1, "moving_status",          "r",     0, 0, 255),
    _line("R", 124, 2, "present_pwm",            "r",     0, -_I16, _I16 - 1, "duty", 1.0 / 885.0),
    _line("R", 128, 4, "present_velocity",       "r",     0, -_I32, _I32 - 1, "rad/s", _RPM),
    _line("R", 132, 4, "present_position",       "r",     0, -_I32, _I32 - 1, "rad", TURN_4096),
    _line("R", 136, 4, "velocity_trajectory",    "r",     0, -_I32, _I32 - 1, "rad/s", _RPM),
    _line("R", 140, 4, "position_trajectory",    "r",     0, -_I32, _I32 - 1, "rad", TURN_4096),
    _line("R", 144, 2, "present_input_voltage",  "r",     0, 0, 65535, "V", 0.1),
    _line("R", 146, 1, "present_temperature",    "r",     0, 0, 255, "degC"),
    _line("R", 147, 1, "backup_ready",           "r",     0, 0, 255, source=_NO_MODEL),
)

_X330: Final[tuple[Register, ...]] = (
    *_X,
    _line("E",  38, 2, "current_limit",          "rw", 1750, 0, 1750, "A", 1e-3),
    _line("E",  62, 1, "pwm_slope",              "rw",  140, 1, 255, "V/s", 1.977),
    _line("R", 102, 2, "goal_current",           "rw", 1750, -1750, 1750, "A", 1e-3),
    _line("R", 126, 2, "present_current",        "r",     0, -_I16, _I16 - 1, "A", 1e-3),
    *(_line("R", 168 + 2 * i, 2, f"indirect_address_{i + 1}", "rw", 208 + i, 64, 227) for i in range(20)),
    *(
        _line("R", 208 + i, 1, f"indirect_data_{i + 1}", "rw", 0, 0, 255, source="[EM], SDK's fw52 file; older: 224")
        for i in range(20)
    ),
)

_X430: Final[tuple[Register, ...]] = (
    *_X,
    *(_line("R", 168 + 2 * i, 2, f"indirect_address_{i + 1}", "rw", 224 + i, 64, 661) for i in range(28)),
    *(_line("R", 224 + i, 1, f"indirect_data_{i + 1}", "rw", 0, 0, 255) for i in range(28)),
    *(_line("R", 522 + 2 * i, 2, f"indirect_address_{i + 1}", "rw", 606 + i, 64, 661) for i in range(28, 56)),
    *(_line("R", 606 + i, 1, f"indirect_data_{i + 1}", "rw", 0, 0, 255) for i in range(28, 56)),
)

_XL430: Final[tuple[Register, ...]] = (
    *_X430,
    _line("R", 126, 2, "present_load",           "r",     0, -1000, 1000, "duty", 1e-3),
)

_XM430: Final[tuple[Register, ...]] = (
    *_X430,
    _line("E",  38, 2, "current_limit",          "rw", 1193, 0, 1193, "A", 2.69e-3),
    _line("R", 102, 2, "goal_current",           "rw", 1193, -1193, 1193, "A", 2.69e-3),
    _line("R", 126, 2, "present_current",        "r",     0, -_I16, _I16 - 1, "A", 2.69e-3),
)
# fmt: on

# name: (initial, low, high) where a product differs from the lines, [EM]
_PRODUCT_LINES: Final[Mapping[str, Mapping[str, tuple[int, int, int]]]] = MappingProxyType(
    {
        "xl330-m288": {},
        "xc330-m181": {
            "model_number": (1230, 0, 65535),
            "current_limit": (2352, 0, 2352),
            "velocity_limit": (545, 0, 2047),
            "shutdown": (52, 0, 63),
            "velocity_i_gain": (1400, 0, 16383),
            "velocity_p_gain": (100, 0, 16383),
            "position_d_gain": (500, 0, 16383),
            "position_p_gain": (1200, 0, 16383),
            "goal_current": (2352, -2352, 2352),
        },
        "xl430-w250": {
            "model_number": (1060, 0, 65535),
            "baud_rate": (1, 0, 7),
            "protocol_type": (2, 1, 2),
            "temperature_limit": (72, 0, 100),
            "max_voltage_limit": (140, 60, 140),
            "min_voltage_limit": (60, 60, 140),
            "velocity_limit": (265, 0, 1023),
            "shutdown": (52, 0, 63),
            "velocity_i_gain": (1000, 0, 16383),
            "velocity_p_gain": (100, 0, 16383),
            "position_d_gain": (4000, 0, 16383),
            "position_p_gain": (640, 0, 16383),
            "goal_velocity": (0, -1023, 1023),
        },
        "xm430-w350": {
            "model_number": (1020, 0, 65535),
            "baud_rate": (1, 0, 7),
            "protocol_type": (2, 1, 2),
            "temperature_limit": (80, 0, 100),
            "max_voltage_limit": (160, 95, 160),
            "min_voltage_limit": (95, 95, 160),
            "velocity_limit": (350, 0, 1023),
            "shutdown": (52, 0, 63),
            "velocity_i_gain": (1920, 0, 16383),
            "velocity_p_gain": (100, 0, 16383),
            "position_p_gain": (800, 0, 16383),
            "goal_velocity": (0, -1023, 1023),
        },
    }
)

_SOURCES: Final[Mapping[tuple[str, str], str]] = MappingProxyType(
    {
        ("xl430-w250", "firmware_version"): "[EM] gives no value; servos of today have 45 and more",
        ("xm430-w350", "firmware_version"): "[EM] gives no value; servos of today have 45 and more",
        ("xl430-w250", "position_p_gain"): "[EM] @00a4b78; 800 with older firmware",
        ("xm430-w350", "velocity_limit"): "[EM] @07fe860; later revisions are said to give 200",
        ("xm430-w350", "protocol_type"): "[EM]; range of xl430@00a4b78",
        (
            "xm430-w350",
            "startup_configuration",
        ): "[EM] xl430@00a4b78; not in xm430@07fe860, not in the SDK's .model files",
        ("xm430-w350", "backup_ready"): "[EM] xl430@00a4b78; not in xm430@07fe860, not in the SDK's .model files",
    }
)


def _product_line(product: str, line: Register) -> Register:
    initial, low, high = _PRODUCT_LINES[product].get(line.name, (line.initial, line.low, line.high))
    source = _SOURCES.get((product, line.name), line.source)
    return replace(line, initial=initial, low=low, high=high, source=source)


def _table(product: str, lines: tuple[Register, ...]) -> Mapping[str, Register]:
    ordered = sorted(lines, key=lambda line: line.address)
    return MappingProxyType({line.name: _product_line(product, line) for line in ordered})


TABLES: Final[Mapping[str, Mapping[str, Register]]] = MappingProxyType(
    {
        "xl330-m288": _table("xl330-m288", _X330),
        "xc330-m181": _table("xc330-m181", _X330),
        "xl430-w250": _table("xl430-w250", _XL430),
        "xm430-w350": _table("xm430-w350", _XM430),
    }
)
"""Product => its control table by register name, in order of address."""

X330_BAUD: Final[Mapping[int, int]] = MappingProxyType(
    {0: 9600, 1: 57600, 2: 115200, 3: 1_000_000, 4: 2_000_000, 5: 3_000_000, 6: 4_000_000}
)
"""Baud rate register value => bits per second. Source: e-Manual, _includes/en/dxl/control_table_baudrate_2.md."""

X430_BAUD: Final[Mapping[int, int]] = MappingProxyType({**X330_BAUD, 7: 4_500_000})
"""Baud rate register value => bits per second. Source: e-Manual, _includes/en/dxl/control_table_baudrate_2.md."""

X330_OPERATING_MODES: Final = frozenset({0, 1, 3, 4, 5, 16})
"""Current, velocity, position, extended position, current-based position, PWM."""

XL430_OPERATING_MODES: Final = frozenset({1, 3, 4, 16})
"""Velocity, position, extended position, PWM: it measures no current."""
