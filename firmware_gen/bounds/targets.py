"""The machines that the report knows: how to compile for them, and how long their instructions take."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from firmware_gen.bounds.instruction_costs import CORTEX_M0, CORTEX_M4F, CycleTable
from firmware_gen.bounds.machine_code import MachineCode, read_machine_code, run_tool
from firmware_gen.transpiler.compiled import run_compiler
from firmware_gen.transpiler.generate import Transpiled

FUNCTIONS: Final = ("init", "step", "clamp", "command")
"""What a firmware calls each period or at its start; the selftest is not counted."""


@dataclass(frozen=True)
class Timing:
    """Say when instructions come from where: a chip's clock and flash.

    Args:
        name: as the report calls it
        clock_hz: of the core
        flash_wait: cycles that each access to the flash waits
        line_bytes: how much one access gives
        slow_multiply: the core has the multiplier that takes 32 cycles
        assumption: what this holds for
    """

    name: str
    clock_hz: float
    flash_wait: int
    line_bytes: int
    slow_multiply: bool
    assumption: str


@dataclass(frozen=True)
class Target:
    """Describe how to compile for one kind of machine.

    Args:
        name: as the report calls it
        tools: what the names of its compiler and tools begin with
        flags: for the compiler
        table: how long its instructions take
        timings: the chips that the report gives times for
    """

    name: str
    tools: str
    flags: tuple[str, ...]
    table: CycleTable
    timings: tuple[Timing, ...]


CORTEX_M4F_TARGET: Final = Target(
    "Cortex-M4F",
    "arm-none-eabi-",
    ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"),
    CORTEX_M4F,
    (
        Timing("STM32F405, all hits", 168e6, 0, 16, False, "the flash accelerator's caches hold all code and literals"),
        Timing(
            "STM32F405, all misses",
            168e6,
            5,
            16,
            False,
            "caches and prefetch never help: each 16-byte line that a path enters, each literal, and a line fetched "
            "in vain before each taken branch wait 5 cycles",
        ),
    ),
)

CORTEX_M0_TARGET: Final = Target(
    "Cortex-M0",
    "arm-none-eabi-",
    ("-mcpu=cortex-m0", "-mthumb", "-mfloat-abi=soft"),
    CORTEX_M0,
    (
        Timing("16 MHz, fast multiplier", 16e6, 0, 4, False, "memory without wait states, as an nRF51822's"),
        Timing("16 MHz, small multiplier", 16e6, 0, 4, True, "memory without wait states, 32 cycles a multiplication"),
    ),
)

TARGETS: Final = (CORTEX_M4F_TARGET, CORTEX_M0_TARGET)
LEVELS: Final = ("-Os", "-O2")


def link_controller(transpiled: Transpiled, target: Target, level: str) -> tuple[MachineCode, MachineCode]:
    """Compile a controller for a target, link what a firmware calls of it, and read the machine code back.

    Args:
        transpiled: the files
        target: the kind of machine
        level: as "-Os"

    Returns:
        without and with the selftest

    Raises:
        InputError: there is no such compiler
        RunError: the files do not compile
    """
    name = transpiled.unit.name
    compiler = f"{target.tools}gcc"
    command = [compiler, "-std=c99", level, *target.flags, "-ffreestanding", "-ffunction-sections"]
    with tempfile.TemporaryDirectory(prefix="servolve-c-") as folder:
        version = run_tool([compiler, "--version"], Path(folder)).splitlines()[0]
        run_compiler([*command, "-c", str(transpiled.source.resolve()), "-o", "controller.o"], Path(folder))
        linked = []
        for file, functions in (("plain.elf", FUNCTIONS), ("tested.elf", (*FUNCTIONS, "selftest"))):
            roots = [f"-Wl,--undefined={name}_{function}" for function in functions]
            link = ["-nostdlib", "-Wl,--gc-sections", f"-Wl,--entry={name}_step", *roots]
            run_compiler([*command, "controller.o", *link, "-lgcc", "-o", file], Path(folder))
            linked.append(read_machine_code(Path(folder) / file, target.tools, version))
    return linked[0], linked[1]
