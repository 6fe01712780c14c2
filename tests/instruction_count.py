"""Count instructions and stack of a controller's functions on an emulated Cortex-M, over random and hard inputs."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from toolchain import run_tool

from firmware_gen.bounds.targets import CORTEX_M4F_TARGET, FUNCTIONS
from firmware_gen.transpiler.vectors import SPECIAL_BITS

FOLDER = Path(__file__).parent / "counting"
SHIFT = 10  # an instruction takes 2^10 ns

# the machine and the frequency that its SysTick counts
MACHINES = {"Cortex-M4F": ("mps2-an386", 25e6), "Cortex-M0": ("microbit", 16e6)}


@dataclass(frozen=True)
class Counted:
    """Hold the most instructions, and bytes of stack, that a function took."""

    instructions: int
    stack_bytes: int


def count_instructions(transpiled, target, level, folder, trials=2000):
    """Run a controller's functions under QEMU.

    Args:
        transpiled: the files
        target: the kind of machine
        level: as "-Os"
        folder: for the image
        trials: how many random inputs

    Returns:
        the most that each function took, by its name; of the selftest the stack only
    """
    machine, frequency = MACHINES[target.name]
    (folder / "counted.h").write_text(definitions(transpiled.unit, trials), encoding="utf-8")
    compiler = [f"{target.tools}gcc", *target.flags, "-ffreestanding", "-ffunction-sections"]
    run_tool([*compiler, "-std=c99", level, "-c", transpiled.source.resolve(), "-o", "controller.o"], folder)
    own = [FOLDER / "count.c", FOLDER / "start.c"]
    warnings = ["-Wall", "-Wextra", "-Werror", "-Wno-cast-function-type"]
    include = ["-I.", f"-I{transpiled.header.parent.resolve()}"]
    link = ["-nostdlib", "-T", FOLDER / "layout.ld", "-lgcc", "-o", "count.elf"]
    run_tool([*compiler, "-std=gnu99", "-O1", "-fno-builtin", *warnings, *include, *own, "controller.o", *link], folder)
    emulator = ["qemu-system-arm", "-M", machine, "-icount", f"shift={SHIFT},sleep=off", "-display", "none"]
    emulator += ["-monitor", "none", "-serial", "none", "-semihosting-config", "enable=on,target=native"]
    words = run_tool([*emulator, "-kernel", "count.elf"], folder).split()
    ticks, stacks = [int(word) for word in words[:4]], [int(word) for word in words[4:8]]
    each = 2**SHIFT * 1e-9 * frequency
    # what an empty function took is taken off, and that is one instruction
    counted = {
        name: Counted(round(tick / each) + 1, stack) for name, tick, stack in zip(FUNCTIONS, ticks, stacks, strict=True)
    }
    return counted | {"selftest": Counted(0, int(words[8]))}


def definitions(unit, trials):
    """Return the header that tells tests/counting/count.c what to count."""
    name, inputs = unit.name, unit.controller.inputs
    symbols = (*FUNCTIONS, "selftest", "state", "noutput")
    lines = [f'#include "{name}.h"', *[f"#define COUNTED_{symbol} {name}_{symbol}" for symbol in symbols]]
    lines += [
        f"#define COUNTED_NINPUT {len(inputs)}",
        "#define COUNTED_RANGES " + "".join(f"{{{i.low:.9g}, {i.high:.9g}}}, " for i in inputs),
        "#define COUNTED_HARD " + ", ".join(f"0x{bits:08x}U" for bits in SPECIAL_BITS),
        f"#define COUNTED_TRIALS {trials}U",
    ]
    return "\n".join([*lines, ""])


def frame_sizes(transpiled, level, folder):
    """Return the compiler's own word on the stack frame of each function of a controller, for Cortex-M4F."""
    command = ["arm-none-eabi-gcc", *CORTEX_M4F_TARGET.flags, "-ffreestanding", "-ffunction-sections", "-std=c99"]
    run_tool([*command, level, "-fstack-usage", "-c", transpiled.source.resolve(), "-o", "frames.o"], folder)
    text = (folder / "frames.su").read_text()
    return {name: int(size) for name, size in re.findall(r":(\w+)[\w.]*\t(\d+)\t", text)}
