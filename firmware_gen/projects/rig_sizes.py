"""How large a rig and its controller are: what arrays of the firmware have room for."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from controller import Controller
from controller.cycle import resolve_cycle
from controller.registers import registers
from controller.rig import Rig
from controller.schedule import schedule_of
from firmware_gen.projects.joint_config import servo_kinds
from firmware_gen.projects.rig_rows import table_blocks

PROTOCOLS: Final = {"dynamixel-2.0": "SV_DYNAMIXEL2", "feetech-sts": "SV_FEETECH_STS"}
"""Protocols that the firmware speaks, by their names in rig files and in C."""

_SHARED: Final = {
    "input": "inputs of a program",
    "output": "outputs of a program",
    "instruction": "instructions of a program",
    "constant": "constants of a program",
    "state": "float32 state slots of a program",
    "raw": "raw channels of a rig",
}
_FIRMWARE: Final = {
    "joint": "joints of a rig",
    "sensor": "channels of the sensor node",
    "message": "letters that a rig's lines have",
    "block": "bytes of the longest block that is read at once",
    "frame": "bytes of the longest packet, stuffing included",
}

_EXTRA: Final = 7
"""`SV_LENGTHS` of `runtime/sv_bus.h` less one: bytes more than wanted that the bus may ask for."""


@dataclass(frozen=True)
class Sizes:
    """Hold the sizes of `sv_sizes.h` and `sv_rig_sizes.h`; none is 0, for C has no empty arrays.

    Args:
        input: inputs of the program
        output: its outputs
        instruction: its instructions; compiled, it has none
        constant: its constants; compiled, it has none
        state: its float32 state slots
        raw: raw channels
        joint: joints
        sensor: channels of the sensor node
        message: letters that its lines have
        block: bytes of the longest block that is read at once
        frame: bytes of the longest packet, stuffing included
        terminal_kinds: kinds of terminals that the controller reads, `1 << sv_terminal_kind` each
    """

    input: int
    output: int
    instruction: int
    constant: int
    state: int
    raw: int
    joint: int
    sensor: int
    message: int
    block: int
    frame: int
    terminal_kinds: int


def sizes_of(rig: Rig, controller: Controller) -> Sizes:
    """Return the sizes of a rig with a controller on it.

    Args:
        rig: the rig, of servos that the firmware speaks with
        controller: the controller
    """
    njoint = len(rig.joints)
    cycle = resolve_cycle(controller, rig)
    schedule = schedule_of(rig)
    blocks = [schedule.state, *schedule.health, *(block for joint in rig.joints for block in table_blocks(joint))]
    block = max(size for _, size in blocks)
    return Sizes(
        input=max(len(controller.inputs), 1),
        output=max(len(controller.outputs), 1),
        instruction=1,
        constant=1,
        state=max(controller.program.nstate, 1),
        raw=rig.nraw,
        joint=njoint,
        sensor=max(len(rig.sensors), 1),
        message=max(len(message_letters(rig)), 1),
        block=block,
        frame=_frame(rig, block),
        terminal_kinds=_bits(terminal.kind for terminal in cycle.terminals),
    )


def message_letters(rig: Rig) -> tuple[str, ...]:
    """Return the letters that the lines of a rig's sensor node begin with, in the order of its channels.

    Args:
        rig: the rig
    """
    return tuple(dict.fromkeys(sensor.message for sensor in rig.sensors))


def sizes_files(sizes: Sizes, rig: Rig, fast_sync_read: bool = False) -> dict[str, str]:
    """Write the headers that hold the sizes, and what kind of rig it is.

    Args:
        sizes: the sizes
        rig: the rig
        fast_sync_read: whether one status packet answers for all servos

    Returns:
        name => text of `sv_sizes.h`, which all code shares, and of `sv_rig_sizes.h`, which is the firmware's
    """
    cycle_kinds = [
        "// kinds that its cycle has, a bit each: those that are absent cost no code",
        f"#define SV_TERMINAL_KINDS 0x{sizes.terminal_kinds:X}U",
        "",
    ]
    one, several = "((void)(joint), (rig)->servos)", "((rig)->servos + (rig)->joints[joint].servo)"
    signs = "((reg)->encoding > SV_TWOS)"
    kinds = [
        "// what is known of the rig costs no code for the other cases",
        "#define SV_RIG(holder) ((void)(holder), &servolve_rig)",
        "#define SV_SET_RIG(holder, which) ((void)(holder), (void)(which))",
        f"#define SV_BAUD(rig) ((void)(rig), {rig.bus.baud})",
        f"#define SV_SERVO(rig, joint) {one if max(servo_kinds(rig)) == 0 else several}",
        f"#define SV_PROTOCOL(rig) ((void)(rig), {PROTOCOLS[rig.bus.protocol]})",
        f"#define SV_VELOCITY_MODE(rig) ((void)(rig), {int(rig.joints[0].mode == 'velocity')})",
        f"#define SV_FAST_SYNC_READ(rig) ((void)(rig), {int(fast_sync_read)})",
        f"#define SV_HAS_SIGN_BIT(reg) {signs if rig.bus.protocol == 'feetech-sts' else '((void)(reg), 0)'}",
        "",
    ]
    return {
        "sv_sizes.h": _header("SV_SIZES_H_", sizes, _SHARED, cycle_kinds),
        "sv_rig_sizes.h": _header("SV_RIG_SIZES_H_", sizes, _FIRMWARE, kinds),
    }


def _header(guard: str, sizes: Sizes, comments: Mapping[str, str], kinds: Sequence[str]) -> str:
    lines = [f"#define SV_{name.upper()}_MAX {getattr(sizes, name)}" for name in comments]
    width = max(map(len, lines)) + 2
    return "\n".join(
        [
            "// What this rig and its controller need: arrays are no larger.",
            "// Written by servolve firmware; do not edit.",
            "",
            f"#ifndef {guard}",
            f"#define {guard}",
            "",
            *(f"{line:<{width}}// {comment}" for line, comment in zip(lines, comments.values(), strict=True)),
            "",
            *kinds,
            f"#endif  // {guard}",
            "",
        ]
    )


def _bits(numbers: Iterable[int]) -> int:
    return sum(1 << number for number in set(numbers))


def _frame(rig: Rig, block: int) -> int:
    """Return the bytes of the longest packet: an answer with the longest block, or a question that holds all goals."""
    joint = rig.joints[0]
    goal = registers(joint.product)[joint.family.goal(joint.mode)].size
    stuffed = joint.family.protocol == "dynamixel-2.0"
    body = max(1 + block + _EXTRA, 4 + len(rig.joints) * (1 + goal))
    return 14 + body + body // 3 + 1 if stuffed else 8 + body
