"""The joints of a rig as constant data in C: `sv_joint` of `runtime/sv_rig.h`, with their checks and settings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from controller.registers import registers
from controller.rig import Joint, Rig
from controller.terminals import joint_scale
from firmware_gen.projects.plain import plain
from firmware_gen.projects.rig_rows import CheckRow, check_rows, count_limits, setting_counts, table_blocks
from firmware_gen.projects.rig_text import count_c, field_lines, float_c, pair_c, register_c, row_lines

_REST_SPEED_RAD_S: Final = 0.06
_FAR_RAD: Final = 3.4e38
"""What C has for an infinite angle."""


@dataclass(frozen=True)
class _Rows:
    """Hold the rows of one joint's checks and settings, as C; joints with equal rows share them."""

    checks: tuple[str, ...]
    settings: tuple[str, ...]


def joint_lines(rig: Rig) -> list[str]:
    """Write the joints of a rig, with what each servo's registers must hold and what is written to them.

    Args:
        rig: the rig
    """
    rows = [_joint_rows(rig, joint) for joint in rig.joints]
    lines = [line for number, joint in enumerate(rig.joints) for line in _joint_tables(number, joint, rows)]
    lines += ["static const sv_joint joints[] = {"]
    lines += [line for number, joint in enumerate(rig.joints) for line in _joint(number, joint, rows)]
    return [*lines, "};", ""]


def _joint_rows(rig: Rig, joint: Joint) -> _Rows:
    return _Rows(
        tuple(row_lines((_check(row), row.register.name) for row in check_rows(rig, joint))),
        tuple(row_lines((f"{{{register_c(line)}, {count}}}", line.name) for line, count in setting_counts(joint))),
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
    values = [register_c(row.register), mask, count_c(row.low), count_c(row.high), level, f"SV_FINDING_{row.kind}"]
    return f"{{{', '.join(values)}}}"


def _joint(number: int, joint: Joint, rows: Sequence[_Rows]) -> list[str]:
    family, table = joint.family, registers(joint.product)
    checks, settings = _places(number, rows)
    velocity = joint.mode == "velocity"
    unit = joint.product.velocity_unit_rad_s
    seeds = (0, 0) if velocity else count_limits(joint)
    goals = (-_fastest(joint), _fastest(joint)) if velocity else seeds
    ends = (-_FAR_RAD, _FAR_RAD) if joint.unlimited else (joint.low_rad, joint.high_rad)

    def line(name: str | None) -> str:
        return register_c(None if name is None else table[name])

    values = [
        ("id", joint.id),
        ("model", joint.product.model_number),
        ("zero", joint.zero_tick),
        ("angle_scale", float_c(joint_scale(joint))),
        ("speed_scale", float_c(joint.sign * unit)),
        ("goal_low", goals[0]),
        ("goal_high", goals[1]),
        ("seed_low", seeds[0]),
        ("seed_high", seeds[1]),
        ("neutral", _neutral(joint)),
        ("neutral_rad", float_c(joint.neutral_rad)),
        ("low_rad", float_c(ends[0])),
        ("high_rad", float_c(ends[1])),
        ("speed_max", float_c(joint.speed_rad_s_max)),
        ("no_load_speed", float_c(joint.product.no_load_speed_rad_s)),
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
        ("voltage_scale", float_c(table[family.voltage].scale)),
        ("error_bits", f"0x{sum(1 << bit for bit in family.error_bits):02x}"),
        ("tables", f"{{{', '.join(map(pair_c, table_blocks(joint)))}}}"),
        ("checks", f"checks{checks}"),
        ("ncheck", len(rows[number].checks)),
        ("settings", f"settings{settings}"),
        ("nsetting", len(rows[number].settings)),
    ]
    return ["    {", *(f"    {text}" for text in field_lines(values)), "    },"]


def _fastest(joint: Joint) -> int:
    return abs(round(joint.speed_rad_s_max / (joint.sign * joint.product.velocity_unit_rad_s)))


def _neutral(joint: Joint) -> int:
    count = joint.zero_tick + round(joint.neutral_rad / joint_scale(joint))
    if joint.unlimited:
        return count
    low, high = count_limits(joint)
    return min(max(count, low), high)
