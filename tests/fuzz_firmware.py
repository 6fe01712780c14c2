"""Fuzz the firmware: its packets, its sensor lines, its bus, and all of it with three rigs, under libFuzzer.

Run as a program for as long as you like: ``python tests/fuzz_firmware.py --seconds 300 --out build/fuzz``. What is
found stays in the folder: the corpus, and each input that breaks something, as fuzz-TARGET-crash-….
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
FUZZ = Path(__file__).with_name("fuzz")
RUNTIME = ROOT / "firmware_gen" / "runtime"
COMPILE = "clang -std=c99 -g -O1 -Wall -Wextra -Werror -fsanitize=fuzzer,address,undefined -fno-sanitize-recover=all"
INPUT_BYTES_MAX = 4096

PARSERS = {
    "packets": ("packets1", "packets2"),
    "lines": ("lines",),
    "bus": ("bus", "bus_late", "bus_line", "bus_replies", "packets1", "packets2", "rig"),
}
"""Target => the runtime's sources that it is made of."""

GOLDEN = Path(__file__).with_name("golden")
IMAGES = {
    "lamp-xc330": GOLDEN / "lamp-robust.controller.toml",
    "lamp-sts3215": GOLDEN / "lamp-sts.controller.toml",
    "jumper-xc330": FUZZ / "turn.controller.toml",
}
"""Rig => the controller that is put on it: of positions, or of speeds."""

# the manuals' frames: what parsers see on a good day
FRAMES = (
    "FFFFFD00 01 0700 55 00 0604 26 655D",
    "FFFFFD00 01 0800 55 00 A6000000 8CC0",
    "FFFFFD00 01 0400 55 00 A10C",
    "FFFFFD00 FE 0900 82 8400 0400 01 02 CEFA",
    "FFFF 01 02 00 FC",
    "FFFF 01 03 00 20 DB",
    "FFFF FE 06 82 1E 02 0B 0C 42",
)
LINES = (b"$F,7,1000,-42*77\n", b"$P,1,2000,1,2,3,4,5,6*64\r\n", b"$E*45\n", b"$E,17,123456,button pressed*38\n")

# what may happen while the firmware waits: see happen() in fuzz_firmware.c
ARM_AND_START, START, HELP, STATUS, GOAL, STOP = (3 | number << 3 for number in (2, 1, 5, 6, 4, 3))
WRONG_ANSWER, INPUTS, SENSORS_SILENT = 6, 5, 8


class Figures(NamedTuple):
    """Say what a target has done."""

    executions: int
    edges: int
    inputs: int


def build_parser(name, folder):
    """Return the fuzzer of one part of the runtime."""
    return _compile(name, folder, [FUZZ / f"fuzz_{name}.c", *(RUNTIME / f"sv_{part}.c" for part in PARSERS[name])])


def build_image(rig, folder):
    """Return the fuzzer of a whole firmware: of the very project that servolve writes for a rig."""
    project = folder / f"project-{rig}"
    servolve = Path(sys.executable).with_name("servolve")
    command = [servolve, "firmware", IMAGES[rig], "--rig", rig, "--board", "host", "--out", project, "--force"]
    subprocess.run([str(part) for part in command], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    sources = [*project.glob("runtime/*.c"), *(path for path in project.glob("src/*.c") if path.name != "main.c")]
    return _compile(rig, folder, [FUZZ / "fuzz_firmware.c", *sources], [project / "runtime", project / "src"])


def _compile(name, folder, sources, includes=(RUNTIME, ROOT / "controller" / "runtime")):
    if shutil.which("clang") is None:
        raise RuntimeError("fuzzing needs clang with libFuzzer; .ci/system-packages fetches them")
    target = folder / f"fuzz-{name}"
    flags = [f"-I{path}" for path in (*includes, FUZZ)]
    subprocess.run([*COMPILE.split(), *flags, *map(str, sorted(sources)), "-o", str(target)], check=True)
    return target


def write_corpus(name, folder):
    """Return the folder with the inputs to start from."""
    corpus = folder / f"corpus-{name}"
    corpus.mkdir(exist_ok=True)
    for number, seed in enumerate(_seeds(name)):
        (corpus / f"seed-{number}").write_bytes(seed)
    return corpus


def _seeds(name):
    frames = [bytes.fromhex(frame) for frame in FRAMES]
    if name == "packets":
        return [bytes((protocol, 1, 0)) + frame for frame in frames for protocol in (0, 1)] + [
            bytes((1, 1, 0)) + b"".join(frames)
        ]
    if name == "lines":
        return [bytes(5) + bytes((0, 200, len(line))) + line for line in LINES]
    if name == "bus":
        # protocol and joints; then a question of 4 bytes, answered by a frame in one piece, or by its echo
        return [
            bytes((protocol, 2)) + bytes((3, 0, kind, 0, 132, 0, 0, how)) + frame
            for frame in frames
            for protocol in (0, 1, 2)
            for kind in range(6)
            for how in (1 | len(frame) << 2, 3)
        ]
    calm = bytes(1500)
    runs = [bytes((0, ARM_AND_START)) + calm, bytes((0, START)) + calm, bytes((0, HELP, STATUS, GOAL)) + calm[:200]]
    faults = [
        bytes((0, ARM_AND_START)) + calm[:at] + bytes((event, value)) + calm
        for at in (20, 200, 700)
        for event, value in (
            *((WRONG_ANSWER, 1 << bit) for bit in range(6)),
            (INPUTS | 1 << 3, 0),
            (SENSORS_SILENT, 1),
            (SENSORS_SILENT, 4),
            (STOP, 0),
        )
    ]
    wrapping = [bytes((129, ARM_AND_START)) + calm, bytes((128,)) + calm]
    return [*runs, *wrapping, bytes((1,)) + calm, *faults]


def fuzz(target, corpus, *limits):
    """Run a target; raise if it breaks.

    Args:
        target: the fuzzer
        corpus: the inputs to start from; new ones join them
        limits: libFuzzer's, as "-runs=1000"
    """
    command = [
        str(target),
        str(corpus),
        f"-max_len={INPUT_BYTES_MAX}",
        "-len_control=0",
        "-print_final_stats=1",
        f"-artifact_prefix={target}-",
        *limits,
    ]
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    if done.returncode:
        raise RuntimeError(f"{target.name} has found something:\n{done.stderr[-6000:]}")
    executions = int(re.findall(r"number_of_executed_units:\s*(\d+)", done.stderr)[-1])
    edges = int(re.findall(r"cov: (\d+)", done.stderr)[-1])
    return Figures(executions, edges, len(list(corpus.iterdir())))


def reached(target, corpus):
    """Return the names of the functions that a corpus reaches.

    Args:
        target: the fuzzer
        corpus: the inputs
    """
    command = [str(target), str(corpus), f"-max_len={INPUT_BYTES_MAX}", "-runs=0", "-print_coverage=1"]
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=True)
    return set(re.findall(r"^COVERED_FUNC: .* (\w+) \S+$", done.stderr, re.MULTILINE))


def _main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("targets", nargs="*", default=[*PARSERS, *IMAGES], help="left out: all")
    parser.add_argument("--seconds", type=int, default=60, help="for each target")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "fuzz")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    os.nice(10)
    for name in options.targets:
        target = (build_parser if name in PARSERS else build_image)(name, options.out)
        figures = fuzz(target, write_corpus(name, options.out), f"-max_total_time={options.seconds}")
        sys.stdout.write(
            f"{name:<14} {figures.executions} executions, {figures.edges} edges, {figures.inputs} inputs\n"
        )
        sys.stdout.flush()


if __name__ == "__main__":
    _main()
