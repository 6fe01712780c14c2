"""The joints of a rig as constant data in C: `sv_joint` of `runtime/sv_rig.h`, and its servos, `sv_servo`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from controller.registers import registers
from controller.rig import Joint, Rig
from controller.terminals import joint_scale
from firmware_gen.projects.joint_limits import jump_counts, step_counts, tracking_counts
from firmware_gen.projects.plain import plain
from firmware_gen.projects.rig_rows import (
    CheckRow,
    check_rows,
    count_limits,
    lowest_voltage,
    place_limits,
    setting_counts,
    table_blocks,
)
from firmware_gen.projects.rig_text import field_lines, float_c, pair_c, register_c, row_lines

_REST_SPEED_RAD_S: Final = 0.06
_FAR_RAD: Final = 3.4e38
"""What C has for an infinite angle."""


def joint_lines(rig: Rig, slew_rad_s: float) -> list[str]:
    """Write the joints of a rig and its servos, with what their registers must hold and what is written to them.

    Args:
        rig: the rig
        slew_rad_s: of the controller, 0: none [rad/s]
    """
    kinds = servo_kinds(rig)
    servos = [rig.joints[kinds.index(kind)] for kind in range(max(kinds) + 1)]
    lines = [line for kind, joint in enumerate(servos) for line in _servo_tables(kind, rig, joint)]
    lines += ["static const sv_servo servos[] = {"]
    lines += [line for kind, joint in enumerate(servos) for line in _servo(kind, rig, slew_rad_s, joint)]
    lines += ["};", "", "static const sv_joint joints[] = {"]
    lines += [line for joint, kind in zip(rig.joints, kinds, strict=True) for line in _joint(joint, kind)]
    lines += ["};", ""]
    if rig.joints[0].mode == "velocity":
        lines += ["static const sv_axis axes[] = {", *(line for joint in rig.joints for line in _axis(joint)), "};", ""]
    return lines


def servo_kinds(rig: Rig) -> tuple[int, ...]:
    """Return the number of each joint's servo: those of one product with the same settings have the same, from 0.

    Args:
        rig: the rig
    """
    texts = [(*_servo_tables(0, rig, joint), *_servo(0, rig, 0.0, joint)) for joint in rig.joints]
    different = list(dict.fromkeys(texts))
    return tuple(different.index(text) for text in texts)


def _servo_tables(kind: int, rig: Rig, joint: Joint) -> list[str]:
    """Write the rows of one servo's checks and settings."""
    settings = [(f"{{{register_c(line)}, {count}}}", line.name) for line, count in setting_counts(joint)]
    return [
        f"// {joint.product.name}: register, low, high, mask, finding; limits and position are the joint's",
        f"static const sv_check checks{kind}[] = {{",
        *row_lines((_check(row), row.register.name) for row in check_rows(rig, joint)),
        "};",
        "",
        "// written before torque",
        f"static const sv_setting settings{kind}[] = {{",
        *row_lines(settings),
        "};",
        "",
    ]


def _check(row: CheckRow) -> str:
    mask = "0" if row.mask == 0 else f"0x{row.mask:02x}"
    return f"{{{register_c(row.register)}, {row.low}, {row.high}, {mask}, SV_FINDING_{row.kind}}}"


def _servo(kind: int, rig: Rig, slew_rad_s: float, joint: Joint) -> list[str]:
    family, table = joint.family, registers(joint.product)
    jump, turn = jump_counts(joint)
    homing_rad_s = 0.0 if joint.mode == "velocity" else rig.safety.homing_rad_s

    def line(name: str | None) -> str:
        return register_c(None if name is None else table[name])

    return _braced(
        joint.product.name,
        [
            ("model", joint.product.model_number),
            ("error_bits", f"0x{sum(1 << bit for bit in family.error_bits):02x}"),
            ("jump_counts", float_c(jump)),
            ("counts_per_us", float_c(turn)),
            ("tracking_counts", tracking_counts(rig, joint)),
            ("slew_counts", f"{step_counts(rig, joint, slew_rad_s)}U"),
            ("homing_counts", f"{step_counts(rig, joint, homing_rad_s)}U"),
            ("voltage_low", lowest_voltage(rig, joint)),
            ("rest_count", max(1, round(_REST_SPEED_RAD_S / joint.product.velocity_unit_rad_s))),
            ("ceiling_count", joint.ceiling),
            ("position", line(family.position)),
            ("velocity", line(family.velocity)),
            ("load", line(family.load)),
            ("goal", line(family.goal(joint.mode))),
            ("torque", line(family.torque_enable)),
            ("ceiling", line(family.torque_ceiling)),
            ("watchdog", line(family.watchdog)),
            ("hardware_error", line(family.hardware_error)),
            ("shutdown", line(family.shutdown)),
            ("voltage", line(family.voltage)),
            ("temperature", line(family.temperature)),
            ("tables", f"{{{', '.join(map(pair_c, table_blocks(joint)))}}}"),
            ("checks", f"checks{kind}"),
            ("ncheck", len(check_rows(rig, joint))),
            ("settings", f"settings{kind}"),
            ("nsetting", len(list(setting_counts(joint)))),
        ],
    )


def _joint(joint: Joint, kind: int) -> list[str]:
    goals = (-_fastest(joint), _fastest(joint)) if joint.mode == "velocity" else count_limits(joint)
    places = (0, 0) if joint.unlimited else place_limits(joint)
    return _braced(
        joint.name,
        [
            ("id", joint.id),
            ("servo", kind),
            ("zero", joint.zero_tick),
            ("angle_scale", float_c(joint_scale(joint))),
            ("goal_low", goals[0]),
            ("goal_high", goals[1]),
            ("place_low", places[0]),
            ("place_high", places[1]),
            ("neutral", _neutral(joint)),
        ],
    )


def _axis(joint: Joint) -> list[str]:
    """Write what a joint needs that is driven by its speed."""
    ends = (-_FAR_RAD, _FAR_RAD) if joint.unlimited else (joint.low_rad, joint.high_rad)
    return _braced(
        joint.name,
        [
            ("zero", joint.zero_tick),
            ("angle_scale", float_c(joint_scale(joint))),
            ("speed_scale", float_c(joint.sign * joint.product.velocity_unit_rad_s)),
            ("speed_max", float_c(joint.speed_rad_s_max)),
            ("neutral_rad", float_c(joint.neutral_rad)),
            ("low_rad", float_c(ends[0])),
            ("high_rad", float_c(ends[1])),
            ("unlimited", int(joint.unlimited)),
        ],
    )


def _braced(name: str, values: Sequence[tuple[str, object]]) -> list[str]:
    """Write a structure in a table, under what it is about."""
    return ["    {", f"        // {plain(name)}", *(f"    {text}" for text in field_lines(values)), "    },"]


def _fastest(joint: Joint) -> int:
    return abs(round(joint.speed_rad_s_max / (joint.sign * joint.product.velocity_unit_rad_s)))


def _neutral(joint: Joint) -> int:
    count = joint.zero_tick + round(joint.neutral_rad / joint_scale(joint))
    if joint.unlimited:
        return count
    low, high = count_limits(joint)
    return min(max(count, low), high)
