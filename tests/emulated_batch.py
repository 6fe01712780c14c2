"""Controllers on an emulated Cortex-M: images that run jobs from a file, and what the jobs answer."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from toolchain import run_tool

from controller import Controller
from controller.cycle import CycleSpec
from controller.native import lay_out_cycle
from controller.program import Program
from firmware_gen import transpile

ROOT = Path(__file__).parents[1]
RUNTIME = ROOT / "controller" / "runtime"
BITS = ROOT / "tests" / "bits"

RUNTIME_FILES = tuple(RUNTIME / name for name in ("sv_program.c", "sv_cycle.c", "sv_float.c"))
WARNINGS = ("-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Wmissing-prototypes", "-Werror")

Words = npt.NDArray[np.uint32]


@dataclass(frozen=True)
class Target:
    """Name a core, the board that QEMU has with it, and how it is compiled for.

    Args:
        name: for people
        machine: QEMU's name of the board, and our linker script's
        flags: of the compiler
        code_max: bytes that programs may fill of its flash
    """

    name: str
    machine: str
    flags: tuple[str, ...]
    code_max: int


M4F = Target(
    "Cortex-M4F",
    "mps2-an386",
    ("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard"),
    3_000_000,
)
M0 = Target("Cortex-M0", "microbit", ("-mcpu=cortex-m0", "-mthumb", "-mfloat-abi=soft"), 230_000)


@dataclass(frozen=True)
class Image:
    """Hold an image and which controllers are in it.

    Args:
        path: the ELF file
        target: what it runs on
        first: number of its first controller
        controllers: the controllers, (n,)
    """

    path: Path
    target: Target
    first: int
    controllers: tuple[Controller, ...]


def build_images(folder: Path, target: Target, controllers: Sequence[Controller], flags: Sequence[str]) -> list[Image]:
    """Compile controllers and link them, with the runtime, into as many images as the board's flash needs."""
    names = [f"c{i}" for i in range(len(controllers))]
    for controller, name in zip(controllers, names, strict=True):
        transpile(controller, folder, name)
    # as a careless project would: what forbids fusing is in the file itself
    compile_c(folder, target, ["-std=gnu11", *flags], [f"{name}.c" for name in names])
    own = [*RUNTIME_FILES, BITS / "batch.c", BITS / "start.c"]
    compile_c(folder, target, ["-std=c99", "-ffp-contract=off", "-Os"], own)
    images = []
    for first, end in _shares(_sizes(folder, names), target.code_max):
        glue = folder / f"programs{first}.c"
        glue.write_text(_glue(names[first:end]), encoding="utf-8")
        compile_c(folder, target, ["-std=c99"], [glue])
        objects = [*(f"{name}.o" for name in names[first:end]), *(f"{path.stem}.o" for path in [*own, glue])]
        path = folder / f"image{first}.elf"
        link = ["-nostartfiles", f"-L{BITS}", f"-T{BITS / target.machine}.ld", "-o", str(path)]
        run_tool(["arm-none-eabi-gcc", *target.flags, *objects, *link], folder)
        images.append(Image(path, target, first, tuple(controllers[first:end])))
    return images


def compile_c(folder: Path, target: Target, flags: Sequence[str], sources: Sequence[Path | str]) -> None:
    """Compile C files for a target into a folder, each into its own object."""
    if sources:
        paths = [f"-I{RUNTIME}", f"-I{BITS}", f"-I{folder}"]
        command = ["arm-none-eabi-gcc", *target.flags, *WARNINGS, *flags, *paths, "-c", *map(str, sources)]
        run_tool(command, folder)


def disassemble(path: Path) -> list[str]:
    """Return the mnemonics of an object or image."""
    text = run_tool(["arm-none-eabi-objdump", "-d", "--no-show-raw-insn", str(path)], path.parent)
    return re.findall(r"^\s*[0-9a-f]+:\t(\S+)", text, re.MULTILINE)


def run_image(image: Image, jobs: Sequence[Sequence[npt.ArrayLike]], lengths: Sequence[int]) -> list[Words]:
    """Boot an image once and have it do jobs.

    Args:
        image: from `build_images`
        jobs: each a sequence of arrays of 32-bit words
        lengths: words that each answers

    Returns:
        the answers, one for each job
    """
    folder = image.path.parent
    (folder / "jobs").write_bytes(b"".join(_bytes(part) for job in jobs for part in job))
    (folder / "answers").unlink(missing_ok=True)
    command = ["qemu-system-arm", "-M", image.target.machine, "-kernel", str(image.path), "-display", "none"]
    run_tool(
        [*command, "-monitor", "none", "-serial", "none", "-semihosting-config", "enable=on,target=native"], folder
    )
    answers = np.fromfile(folder / "answers", "<u4")
    assert len(answers) == sum(lengths)
    return np.split(answers, np.cumsum(lengths)[:-1])


def float_job() -> list[npt.ArrayLike]:
    """Ask for `sv_check_float` and FPSCR: two words."""
    return [[1]]


def fpscr_job(word: int) -> list[npt.ArrayLike]:
    """Set FPSCR: no answer."""
    return [[2, word]]


def compiled_job(number: int, rows: npt.NDArray[np.float32], nstep: int) -> list[npt.ArrayLike]:
    """Run a compiled controller of the image: its selftest's word, then the rows."""
    return [[3, number, len(rows), nstep], rows]


def vm_job(program: Program, period: float, rows: npt.NDArray[np.float32], nstep: int) -> list[npt.ArrayLike]:
    """Run a program on the virtual machine: one word, then the rows."""
    return [[4], np.float32(period), *_program(program), [len(rows), nstep], rows]


def cycle_job(spec: CycleSpec, goal: tuple[float, float], raw: npt.NDArray[np.int32]) -> list[npt.ArrayLike]:
    """Run the whole cycle: one word, then rows of terminals, outputs and goal counts."""
    packed = lay_out_cycle(spec)
    _, terminals, outputs, guards = packed.parts
    numbers = bytes(packed)[type(packed).period_s.offset :]
    arrays = [np.frombuffer(bytes(part), np.uint32) for part in (terminals, outputs, guards, numbers)]
    used = arrays[0][: len(spec.terminals) * len(arrays[0]) // len(terminals)]
    scalars = arrays[3][: type(packed).facing.offset // 4 + 3 - type(packed).period_s.offset // 4]
    return [[5], *_program(spec.program), used, arrays[1], arrays[2], scalars, np.float32(goal), [len(raw)], raw]


def _program(program: Program) -> list[npt.ArrayLike]:
    sizes = [len(program.inputs), len(program.constants), len(program.instructions), program.nstate]
    outputs = np.zeros((len(program.outputs) + 1) // 2 * 2, np.uint16)
    outputs[: len(program.outputs)] = program.outputs
    instructions = np.frombuffer(np.ascontiguousarray(program.instructions).tobytes(), np.uint32)
    constants = np.asarray(program.constants, np.float32)
    return [[*sizes, len(program.outputs)], constants, instructions, outputs.view(np.uint32)]


def _bytes(part: npt.ArrayLike) -> bytes:
    array = np.asarray(part)
    return (array if array.dtype.itemsize == 4 else array.astype(np.uint32)).tobytes()


def _sizes(folder: Path, names: Sequence[str]) -> list[int]:
    text = run_tool(["arm-none-eabi-size", *(f"{name}.o" for name in names)], folder) if names else ""
    return [int(line.split()[0]) for line in text.splitlines()[1:]]


def _shares(sizes: Sequence[int], size_max: int) -> list[tuple[int, int]]:
    """Return which runs of programs fit into an image each: first and end."""
    shares, first, total = [], 0, 0
    for i, size in enumerate(sizes):
        if total + size > size_max:
            shares.append((first, i))
            first, total = i, 0
        total += size
    return [*shares, (first, len(sizes))]


def _glue(names: Sequence[str]) -> str:
    """Return the table of an image's programs; one memory serves all, for they run one after the other."""
    lines = ['#include "batch.h"', *(f'#include "{name}.h"' for name in names), "union {", "  float none;"]
    lines += [f"  {name}_state {name};" for name in names] + ["} memory;"]
    for name in names:
        lines.append(f"static void {name}_begin(void) {{ {name}_init(&memory.{name}); }}")
        lines.append(f"static void {name}_go(const float* in, float* out) {{ {name}_step(&memory.{name}, in, out); }}")
    lines.append("const batch_program kPrograms[] = {")
    lines += [f"    {{{n}_ninput, {n}_noutput, {n}_selftest, {n}_begin, {n}_go}}," for n in names]
    return "\n".join([*lines, "    {0, 0, 0, 0, 0}};", ""])
