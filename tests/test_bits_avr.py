"""The same bits on an AVR, whose floats are a library's: transpiled controllers, built as by Arduino, under simavr."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from toolchain import run_tool

from controller import load_controller
from controller.reference import run_program
from firmware_gen import transpile
from firmware_gen.transpiler.vectors import bits_of, draw_inputs

BITS = Path(__file__).parent / "bits"
LAMPS = sorted((Path(__file__).parent / "golden").glob("*.controller.toml"))
STEPS = 40
RANDOM, RANDOM_LONG = 3, 40

# the flags of Arduino's platform.txt, and warnings; nothing here forbids fusing but the file itself
FLAGS = [
    "-mmcu=atmega2560",
    "-std=gnu11",
    "-Os",
    "-ffunction-sections",
    "-fdata-sections",
    "-flto",
    "-Wl,--gc-sections",
]
WARNINGS = ["-Wall", "-Wextra", "-Wconversion", "-Wmissing-prototypes", "-Werror"]


def run_on_avr(controller, rows, folder):
    """Compile a controller for an ATmega2560 and step it there; return its selftest's answer and its outputs' bits."""
    transpile(controller, folder, "it")
    table = ",\n".join(
        "{" + ", ".join(f"0x{word:08x}UL" for word in row) + "}" for row in rows.view(np.uint32).tolist()
    )
    (folder / "rows.h").write_text(
        f'#include "it.h"\n#define ROWS_NINPUT {rows.shape[1]}\n#define ROWS_NOUTPUT {len(controller.outputs)}\n'
        "#define ROWS_STATE it_state\n#define ROWS_SELFTEST it_selftest\n#define ROWS_INIT it_init\n"
        f"#define ROWS_STEP it_step\nenum {{ kRowCount = {len(rows)}, kSteps = {STEPS} }};\n"
        f"static const uint32_t kRows[][{rows.shape[1]}] PROGMEM = {{{table}}};\n"
    )
    run_tool(["avr-gcc", *FLAGS, *WARNINGS, f"-I{folder}", "it.c", str(BITS / "avr.c"), "-o", "it.elf"], folder)
    text = run_tool(["simavr", "-m", "atmega2560", "-f", "16000000", "it.elf"], folder)
    words = np.array([int(word, 16) for word in re.findall(r"([0-9a-f]{8})\.$", text, re.MULTILINE)], np.uint32)
    assert len(words) == 1 + len(rows) * len(controller.outputs)
    return words[0].astype(np.int32), words[1:].view(np.float32).reshape(len(rows), -1)


def check(controller, folder):
    words = np.random.default_rng(5).integers(0, 2**32, (2, STEPS, len(controller.inputs), 2), dtype=np.uint32)
    words[0, ..., 1] = 0
    sequences = draw_inputs(words, controller.inputs)
    expected = [bits_of(run_program(controller.program, controller.period_s, rows)) for rows in sequences]
    status, found = run_on_avr(controller, sequences.reshape(-1, sequences.shape[2]), folder)
    assert status == 0
    assert np.array_equal(bits_of(found), np.concatenate(expected))


@pytest.mark.parametrize("path", LAMPS, ids=lambda path: path.name.split(".")[0])
def test_evolved_controllers_have_the_references_bits(path, tmp_path):
    check(load_controller(path), tmp_path)


def test_random_programs_have_the_references_bits(programs, tmp_path, request):
    for seed in range(RANDOM_LONG if request.config.getoption("--long") else RANDOM):
        folder = tmp_path / str(seed)
        folder.mkdir()
        check(programs.random_controller(1000 + seed), folder)
