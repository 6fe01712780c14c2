"""Servo control tables: one line a register, from which codecs, checks and the virtual servo's table are derived."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final, Literal

from controller.products import PRODUCTS, Product


@dataclass(frozen=True)
class Register:
    """Describe one item of a control table.

    Args:
        name: snake-case name, as "present_position"
        address: first byte
        size: bytes, little endian
        access: "r" or "rw"
        signed: two's complement
        unit: of one scaled count, "1" where there is none
        scale: unit per count
        low: smallest count that may be written (for "r": smallest that the size holds)
        high: largest count that may be written
        initial: factory or power-up count
        eeprom: kept without power, and locked while torque is on
        source: where the line comes from, with conflicts between sources
    """

    name: str
    address: int
    size: int
    access: Literal["r", "rw"]
    signed: bool
    unit: str
    scale: float
    low: int
    high: int
    initial: int
    eeprom: bool
    source: str


_EM: Final = "[EM]"
"""ROBOTIS e-Manual, docs/en/dxl/x/xc330-m181.md@01ba971 and xl330-m288.md@028a13d (GitHub, ROBOTIS-GIT/emanual)."""

_RPM: Final = 0.0239691227
"""[rad/s] a velocity count: `Product.velocity_unit_rad_s`."""


def _line(
    kind: Literal["E", "R"],
    address: int,
    size: int,
    name: str,
    access: Literal["r", "rw"],
    initial: int,
    low: int,
    high: int,
    unit: str = "1",
    scale: float = 1.0,
    source: str = _EM,
) -> Register:
    return Register(name, address, size, access, low < 0, unit, scale, low, high, initial, kind == "E", source)


_I16: Final = 1 << 15
_I32: Final = 1 << 31
_TURN: Final = 2.0 * math.pi / 4096.0

# fmt: off
# The family's lines hold the XL330-M288's values; _PRODUCT_LINES holds what differs.
_X330: Final[tuple[Register, ...]] = (
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
    _line("E",  20, 4, "homing_offset",          "rw",    0, -1044479, 1044479, "rad", _TURN),
    _line("E",  24, 4, "moving_threshold",       "rw",   10, 0, 1023, "rad/s", _RPM),
    _line("E",  31, 1, "temperature_limit",      "rw",   70, 0, 100, "degC"),
    _line("E",  32, 2, "max_voltage_limit",      "rw",   70, 31, 70, "V", 0.1),
    _line("E",  34, 2, "min_voltage_limit",      "rw",   35, 31, 70, "V", 0.1),
    _line("E",  36, 2, "pwm_limit",              "rw",  885, 0, 885, "duty", 1.0 / 885.0),
    _line("E",  38, 2, "current_limit",          "rw", 1750, 0, 1750, "A", 1e-3),
    _line("E",  44, 4, "velocity_limit",         "rw",  445, 0, 2047, "rad/s", _RPM),
    _line("E",  48, 4, "max_position_limit",     "rw", 4095, 0, 4095, "rad", _TURN),
    _line("E",  52, 4, "min_position_limit",     "rw",    0, 0, 4095, "rad", _TURN),
    _line("E",  60, 1, "startup_configuration",  "rw",    0, 0, 3, source="[EM]; not in the SDK's .model files"),
    _line("E",  62, 1, "pwm_slope",              "rw",  140, 1, 255, "V/s", 1.977),
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
    _line("R", 102, 2, "goal_current",           "rw", 1750, -1750, 1750, "A", 1e-3),
    _line("R", 104, 4, "goal_velocity",          "rw",    0, -2047, 2047, "rad/s", _RPM),
    _line("R", 108, 4, "profile_acceleration",   "rw",    0, 0, 32767, "rad/s2", 214.577 * 2.0 * math.pi / 3600.0),
    _line("R", 112, 4, "profile_velocity",       "rw",    0, 0, 32767, "rad/s", _RPM),
    _line("R", 116, 4, "goal_position",          "rw",    0, 0, 4095, "rad", _TURN),
    _line("R", 120, 2, "realtime_tick",          "r",     0, 0, 32767, "s", 1e-3),
    _line("R", 122, 1, "moving",                 "r",     0, 0, 255),
    _line("R", 123, 1, "moving_status",          "r",     0, 0, 255),
    _line("R", 124, 2, "present_pwm",            "r",     0, -_I16, _I16 - 1, "duty", 1.0 / 885.0),
    _line("R", 126, 2, "present_current",        "r",     0, -_I16, _I16 - 1, "A", 1e-3),
    _line("R", 128, 4, "present_velocity",       "r",     0, -_I32, _I32 - 1, "rad/s", _RPM),
    _line("R", 132, 4, "present_position",       "r",     0, -_I32, _I32 - 1, "rad", _TURN),
    _line("R", 136, 4, "velocity_trajectory",    "r",     0, -_I32, _I32 - 1, "rad/s", _RPM),
    _line("R", 140, 4, "position_trajectory",    "r",     0, -_I32, _I32 - 1, "rad", _TURN),
    _line("R", 144, 2, "present_input_voltage",  "r",     0, 0, 65535, "V", 0.1),
    _line("R", 146, 1, "present_temperature",    "r",     0, 0, 255, "degC"),
    _line("R", 147, 1, "backup_ready",           "r",     0, 0, 255, source="[EM]; not in the SDK's .model files"),
    *(_line("R", 168 + 2 * i, 2, f"indirect_address_{i + 1}", "rw", 208 + i, 64, 227) for i in range(20)),
    *(
        _line("R", 208 + i, 1, f"indirect_data_{i + 1}", "rw", 0, 0, 255, source="[EM], SDK's fw52 file; older: 224")
        for i in range(20)
    ),
)
# fmt: on

# name: (initial, low, high) where a product differs from the family's lines, [EM]
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
    }
)


def _table(product: str) -> Mapping[str, Register]:
    lines = _PRODUCT_LINES[product]
    return MappingProxyType(
        {
            line.name: replace(line, initial=lines[line.name][0], low=lines[line.name][1], high=lines[line.name][2])
            if line.name in lines
            else line
            for line in _X330
        }
    )


_TABLES: Final = MappingProxyType({name: _table(name) for name in PRODUCTS})

X330_BAUD: Final[Mapping[int, int]] = MappingProxyType(
    {0: 9600, 1: 57600, 2: 115200, 3: 1_000_000, 4: 2_000_000, 5: 3_000_000, 6: 4_000_000}
)
"""Baud rate register value => bits per second. Source: e-Manual, _includes/en/dxl/control_table_baudrate_2.md."""

X330_OPERATING_MODES: Final = frozenset({0, 1, 3, 4, 5, 16})
"""Current, velocity, position, extended position, current-based position, PWM."""


def registers(product: Product) -> Mapping[str, Register]:
    """Return a product's control table by register name, in order of address.

    Args:
        product: the servo

    Returns:
        name => register
    """
    return _TABLES[product.name]
