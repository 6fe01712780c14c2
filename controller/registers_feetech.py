"""Control tables of Feetech's STS and SCS series: one line a register."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Final

from controller.register import TURN_4096, Register, RegisterLine

_MT: Final = "[MT]"

SOURCES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "[MT]": "Feetech's memory table of the ST3215, as crate st3215's build.rs quotes it",
        "[SDK]": "ftservo-python-sdk 2.0.1, scservo_sdk/sms_sts.py and scscl.py",
        "[LR]": "huggingface/lerobot@0558acc, src/lerobot/motors/feetech/tables.py",
        "[FC]": "feetech-cli 0.1.8, measured on an STS3215",
        "[SC]": "Feetech's SCS memory table, SCS0009 specification and SCS15 manual 1.02",
    }
)
"""Tag => what it stands for."""

_COUNT: Final = math.radians(300.0) / 1024.0
"""[rad] a count of an SCS's position."""

_line: Final = RegisterLine(_MT)

_BAUD: Final = "[MT], [SDK] 5: 76800, 6: 57600, 7: 38400; [LR] has 57600, 38400, 19200 there"
_PHASE: Final = "[MT] 12; bit 4: counts several turns, which [LR] clears"
_STATUS: Final = "[MT]; [FC] the error byte of every reply"
_LOCK: Final = "[FC] 1 at power-up, [MT] 0; 1: EPROM does not keep what is written"
_OFFSET: Final = "[FC] present = encoder - offset, modulo 4096; sign in bit 11 [LR]"
_GOAL: Final = "[MT]; a write switches torque on [FC]"
_TORQUE: Final = "[MT] 0 off, 1 on, 2 damping, 128 makes this place 2048"
_TIME: Final = "[MT] ms; mode 2: PWM in 0.1 %, sign in bit 10"
_M15: Final = (1 << 15) - 1

# fmt: off
_STS: Final[tuple[Register, ...]] = (
    _line("E",  0, 1, "firmware_major_version", "r",     3, 0, 255, source="[FC] 3.10 seen"),
    _line("E",  1, 1, "firmware_minor_version", "r",    10, 0, 255, source="[FC] 3.10 seen"),
    _line("E",  3, 2, "model_number",           "r",   777, 0, 65535),
    _line("E",  5, 1, "id",                     "rw",    1, 0, 253),
    _line("E",  6, 1, "baud_rate",              "rw",    0, 0, 7, source=_BAUD),
    _line("E",  7, 1, "return_delay",           "rw",    0, 0, 254, "s", 2e-6),
    _line("E",  8, 1, "response_level",         "rw",    1, 0, 1),
    _line("E",  9, 2, "min_angle_limit",        "rw",    0, 0, 4095, "rad", TURN_4096),
    _line("E", 11, 2, "max_angle_limit",        "rw", 4095, 0, 4095, "rad", TURN_4096, "[MT]; both 0: several turns"),
    _line("E", 13, 1, "max_temperature_limit",  "rw",   70, 0, 100, "degC"),
    _line("E", 14, 1, "max_voltage_limit",      "rw",  140, 0, 254, "V", 0.1),
    _line("E", 15, 1, "min_voltage_limit",      "rw",   40, 0, 254, "V", 0.1),
    _line("E", 16, 2, "max_torque",             "rw", 1000, 0, 1000, "duty", 1e-3),
    _line("E", 18, 1, "phase",                  "rw",   12, 0, 254, source=_PHASE),
    _line("E", 19, 1, "unloading_condition",    "rw",   44, 0, 254),
    _line("E", 20, 1, "led_alarm",              "rw",   47, 0, 254),
    _line("E", 21, 1, "p_coefficient",          "rw",   32, 0, 254),
    _line("E", 22, 1, "d_coefficient",          "rw",   32, 0, 254),
    _line("E", 23, 1, "i_coefficient",          "rw",    0, 0, 254),
    _line("E", 24, 2, "minimum_startup_force",  "rw",   16, 0, 1000, "duty", 1e-3),
    _line("E", 26, 1, "cw_dead_zone",           "rw",    1, 0, 32, "rad", TURN_4096),
    _line("E", 27, 1, "ccw_dead_zone",          "rw",    1, 0, 32, "rad", TURN_4096),
    _line("E", 28, 2, "protection_current",     "rw",  500, 0, 511, "A", 6.5e-3),
    _line("E", 30, 1, "angular_resolution",     "rw",    1, 1, 100),
    _line("E", 31, 2, "homing_offset",          "rw",    0, -2047, 2047, "rad", TURN_4096, _OFFSET, "sign11"),
    _line("E", 33, 1, "operating_mode",         "rw",    0, 0, 3),
    _line("E", 34, 1, "protective_torque",      "rw",   20, 0, 100, "duty", 1e-2),
    _line("E", 35, 1, "protection_time",        "rw",  200, 0, 254, "s", 1e-2),
    _line("E", 36, 1, "overload_torque",        "rw",   80, 0, 100, "duty", 1e-2),
    _line("E", 37, 1, "velocity_p",             "rw",   10, 0, 254),
    _line("E", 38, 1, "overcurrent_time",       "rw",  200, 0, 254, "s", 1e-2),
    _line("E", 39, 1, "velocity_i",             "rw",   10, 0, 254),
    _line("R", 40, 1, "torque_enable",          "rw",    0, 0, 128, source=_TORQUE),
    _line("R", 41, 1, "acceleration",           "rw",    0, 0, 254, "rad/s2", 100.0 * TURN_4096),
    _line("R", 42, 2, "goal_position",          "rw",    0, -32766, 32766, "rad", TURN_4096, _GOAL, "sign15"),
    _line("R", 44, 2, "goal_time",              "rw",    0, -1000, 1000, "1", 1.0, _TIME, "sign10"),
    _line("R", 46, 2, "goal_speed",             "rw",    0, -_M15, _M15, "rad/s", TURN_4096, encoding="sign15"),
    _line("R", 48, 2, "torque_limit",           "rw", 1000, 0, 1000, "duty", 1e-3, "[MT] max_torque at power-up"),
    _line("R", 55, 1, "lock",                   "rw",    1, 0, 1, source=_LOCK),
    _line("R", 56, 2, "present_position",       "r",     0, -_M15, _M15, "rad", TURN_4096, encoding="sign15"),
    _line("R", 58, 2, "present_speed",          "r",     0, -_M15, _M15, "rad/s", TURN_4096, encoding="sign15"),
    _line("R", 60, 2, "present_load",           "r",     0, -1023, 1023, "duty", 1e-3, encoding="sign10"),
    _line("R", 62, 1, "present_voltage",        "r",     0, 0, 255, "V", 0.1),
    _line("R", 63, 1, "present_temperature",    "r",     0, 0, 255, "degC"),
    _line("R", 64, 1, "async_flag",             "r",     0, 0, 1),
    _line("R", 65, 1, "status",                 "r",     0, 0, 255, source=_STATUS),
    _line("R", 66, 1, "moving",                 "r",     0, 0, 255),
    _line("R", 69, 2, "present_current",        "r",     0, -_M15, _M15, "A", 6.5e-3, encoding="sign15"),
)

_SC: Final = "[SC]"
_MOVING: Final = "[SC]; [SDK] has a current at 69, as the STS, [SC] and [LR] have none"
_SC15: Final = "[SC] SCS15"
_SCS: Final[tuple[Register, ...]] = (
    _line("E",  0, 1, "firmware_major_version", "r",     3, 0, 255, source="[SC] no value; taken as the STS3215's"),
    _line("E",  1, 1, "firmware_minor_version", "r",    10, 0, 255, source="[SC] no value; taken as the STS3215's"),
    _line("E",  3, 2, "model_number",           "r",  1284, 0, 65535, source="[SC]; bytes 05 04"),
    _line("E",  5, 1, "id",                     "rw",    1, 0, 253, source=_SC),
    _line("E",  6, 1, "baud_rate",              "rw",    0, 0, 7, source=_BAUD),
    _line("E",  7, 1, "return_delay",           "rw",    0, 0, 254, "s", 2e-6, _SC),
    _line("E",  8, 1, "response_level",         "rw",    1, 0, 1, source=_SC),
    _line("E",  9, 2, "min_angle_limit",        "rw",   20, 0, 1023, "rad", _COUNT, "[SC] 20; SCS15: 0"),
    _line("E", 11, 2, "max_angle_limit",        "rw", 1003, 0, 1023, "rad", _COUNT, "[SC] 1003; SCS15: 1023"),
    _line("E", 13, 1, "max_temperature_limit",  "rw",   80, 0, 100, "degC", source=_SC),
    _line("E", 14, 1, "max_voltage_limit",      "rw",   90, 0, 254, "V", 0.1, _SC15),
    _line("E", 15, 1, "min_voltage_limit",      "rw",   45, 0, 254, "V", 0.1, "[SC] SCS15; SCS0009: trips below 4 V"),
    _line("E", 16, 2, "max_torque",             "rw", 1000, 0, 1000, "duty", 1e-3, _SC15),
    _line("E", 18, 1, "phase",                  "rw",    0, 0, 254, source="[LR] address; value unknown"),
    _line("E", 19, 1, "unloading_condition",    "rw",   37, 0, 254, source="[SC] 36 or 37"),
    _line("E", 20, 1, "led_alarm",              "rw",   37, 0, 254, source=_SC),
    _line("E", 21, 1, "p_coefficient",          "rw",   15, 0, 254, source=_SC),
    _line("E", 22, 1, "d_coefficient",          "rw",    0, 0, 254, source=_SC),
    _line("E", 23, 1, "i_coefficient",          "rw",    0, 0, 254, source=_SC),
    _line("E", 24, 2, "minimum_startup_force",  "rw",   16, 0, 1000, "duty", 1e-3, "[SC]; value of the STS3215"),
    _line("E", 26, 1, "cw_dead_zone",           "rw",    2, 0, 32, "rad", _COUNT, _SC),
    _line("E", 27, 1, "ccw_dead_zone",          "rw",    2, 0, 32, "rad", _COUNT, _SC),
    _line("E", 37, 1, "protective_torque",      "rw",   20, 0, 100, "duty", 1e-2, "[SC] 20 to 40"),
    _line("E", 38, 1, "protection_time",        "rw",   80, 0, 254, "s", 4e-2, "[SC] 80 to 100"),
    _line("E", 39, 1, "overload_torque",        "rw",   80, 0, 100, "duty", 1e-2, _SC),
    _line("R", 40, 1, "torque_enable",          "rw",    0, 0, 2, source="[SC]; [LR] has an acceleration at 41"),
    _line("R", 42, 2, "goal_position",          "rw",    0, 0, 1023, "rad", _COUNT, _SC),
    _line("R", 44, 2, "goal_time",              "rw",    0, -1023, 1023, "1", 1.0, "[SC] ms; wheel: PWM", "sign10"),
    _line("R", 46, 2, "goal_speed",             "rw",    0, 0, _M15, "rad/s", _COUNT, "[SC] 0: as fast as it can"),
    _line("R", 48, 1, "lock",                   "rw",    1, 0, 1, source="[SC], [SDK]; the STS has torque_limit there"),
    _line("R", 56, 2, "present_position",       "r",     0, 0, 65535, "rad", _COUNT, _SC),
    _line("R", 58, 2, "present_speed",          "r",     0, -_M15, _M15, "rad/s", _COUNT, _SC, "sign15"),
    _line("R", 60, 2, "present_load",           "r",     0, -1023, 1023, "duty", 1e-3, _SC, "sign10"),
    _line("R", 62, 1, "present_voltage",        "r",     0, 0, 255, "V", 0.1, _SC),
    _line("R", 63, 1, "present_temperature",    "r",     0, 0, 255, "degC", source=_SC),
    _line("R", 64, 1, "async_flag",             "r",     0, 0, 1, source=_SC),
    _line("R", 65, 1, "status",                 "r",     0, 0, 255, source=_SC),
    _line("R", 66, 1, "moving",                 "r",     0, 0, 255, source=_MOVING),
)
# fmt: on


def _sts(max_voltage: int, source: str) -> Mapping[str, Register]:
    lines = {line.name: line for line in _STS}
    lines["max_voltage_limit"] = replace(lines["max_voltage_limit"], initial=max_voltage, source=source)
    return MappingProxyType(lines)


TABLES: Final[Mapping[str, Mapping[str, Register]]] = MappingProxyType(
    {
        "sts3215": _sts(140, "[MT]; 140 in the 12 V servo"),
        "sts3215-7v4": _sts(80, "[MT]; 80 in the 7.4 V servo"),
        "scs0009": MappingProxyType({line.name: replace(line, byte_order="big") for line in _SCS}),
    }
)
"""Product => its control table by register name, in order of address."""

FEETECH_BAUD: Final[Mapping[int, int]] = MappingProxyType(
    {0: 1_000_000, 1: 500_000, 2: 250_000, 3: 128_000, 4: 115_200, 5: 76_800, 6: 57_600, 7: 38_400}
)
"""Baud rate register value => bits per second. Source: [MT], [SDK]; [LR] has 57600, 38400, 19200 as 5 to 7."""
