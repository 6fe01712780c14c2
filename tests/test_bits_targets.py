"""The same bits everywhere: reference, virtual machine, C on this machine, C on emulated Cortex-M4F and Cortex-M0.

The short form runs with every `make test`; `--long` is the whole claim, see `sizes`.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from emulated_batch import (
    M0,
    M4F,
    build_images,
    compile_c,
    compiled_job,
    disassemble,
    float_job,
    fpscr_job,
    run_image,
    vm_job,
)

from controller import Controller, load_controller
from controller.native import NativeProgram
from controller.operations import BY_OPCODE, OPERATIONS
from controller.reference import run_program
from firmware_gen import compile_controllers, transpile
from firmware_gen.transpiler.vectors import bits_of, draw_inputs

GOLDEN = Path(__file__).parent / "golden"
LAMPS = sorted(GOLDEN.glob("*.controller.toml"))

STEPS = 1_000  # of a sequence, state carried over all of them
INSTRUCTIONS_MIN = 16

HOST_BUILDS = [(compiler, level) for compiler in ("gcc", "clang") for level in ("-O0", "-O1", "-O2", "-O3")]
TARGET_BUILDS = [(M4F, "-O2"), (M0, "-Os")]
TARGET_BUILDS_LONG = [(target, level) for target in (M4F, M0) for level in ("-O0", "-Os", "-O2", "-O3")]

SUBNORMALS_FLUSHED, ROUNDING_WRONG = -1, -3  # answers of the selftest
SV_ERROR_FLOAT = -8


@dataclass(frozen=True)
class Case:
    """Hold a controller, sequences of inputs and the reference's answers.

    Args:
        controller: the controller
        sequences: terminals, (nsequence, STEPS, ninput)
        expected: the reference's bits, (nsequence, STEPS, noutput)
    """

    controller: Controller
    sequences: npt.NDArray[np.float32]
    expected: npt.NDArray[np.uint32]

    @property
    def rows(self):
        return self.sequences.reshape(-1, self.sequences.shape[2])


def sizes(long):
    """Return how many random programs, how many of them have many inputs, and how many sequences those have."""
    return (200, 10, 100) if long else (20, 0, 2)


def random_controllers(programs, n):
    """Return the first random programs that are worth a build."""
    found, seed = [], 0
    while len(found) < n:
        controller = programs.random_controller(seed)
        if len(controller.program.instructions) >= INSTRUCTIONS_MIN:
            found.append(controller)
        seed += 1
    return found


def make_case(controller, nsequence, seed):
    """Draw sequences in turn within the ranges, so that states stay alive, and of values that arithmetic is hard on."""
    words = np.random.default_rng(seed).integers(
        0, 2**32, (nsequence, STEPS, len(controller.inputs), 2), dtype=np.uint32
    )
    words[::2, ..., 1] = 0
    sequences = draw_inputs(words, controller.inputs)
    expected = [bits_of(run_program(controller.program, controller.period_s, rows)) for rows in sequences]
    return Case(controller, sequences, np.array(expected))


@pytest.fixture(scope="module")
def cases(request, programs):
    nprogram, nmuch, nsequence = sizes(request.config.getoption("--long"))
    controllers = [*(load_controller(path) for path in LAMPS), *random_controllers(programs, nprogram)]
    much = len(LAMPS) + nmuch
    return [make_case(c, nsequence if i < much else 2, i) for i, c in enumerate(controllers)]


def pytest_generate_tests(metafunc):
    if "target_build" in metafunc.fixturenames:
        builds = TARGET_BUILDS_LONG if metafunc.config.getoption("--long") else TARGET_BUILDS
        metafunc.parametrize("target_build", builds, ids=[f"{target.name}{level}" for target, level in builds])


def differences(case, found):
    """Return how many outputs differ, all NaNs being equal.

    Args:
        case: what was run
        found: as many outputs as its own, in any shape
    """
    return int(np.count_nonzero(bits_of(np.asarray(found).reshape(case.expected.shape)) != case.expected))


def test_the_programs_use_every_operation_and_states_stay_alive(cases):
    used = {op for case in cases for op in case.controller.program.instructions["op"].tolist()}
    assert used == set(BY_OPCODE) == {operation.opcode for operation in OPERATIONS}
    assert any(case.controller.source.definitions for case in cases)
    stateful = [case for case in cases if case.controller.program.nstate]
    assert len(stateful) > len(cases) // 2
    last = np.concatenate([case.expected[0, STEPS // 2 :].ravel() for case in stateful])
    assert len(np.unique(last)) > len(last) // 10


def test_the_virtual_machine_has_the_references_bits(cases):
    for case in cases:
        machine = NativeProgram(case.controller.program)
        found = [machine.run(case.controller.period_s, rows) for rows in case.sequences]
        assert differences(case, found) == 0, case.controller.name


@pytest.mark.parametrize(("compiler", "level"), HOST_BUILDS, ids=["".join(build) for build in HOST_BUILDS])
def test_c_on_this_machine_has_the_references_bits(cases, compiler, level):
    with compile_controllers([case.controller for case in cases], compiler=compiler, flags=(level,)) as built:
        for case, compiled in zip(cases, built, strict=True):
            assert compiled.selftest() == 0
            assert differences(case, [compiled.run(rows) for rows in case.sequences]) == 0, case.controller.name


def test_c_on_a_microcontroller_has_the_references_bits(cases, target_build, tmp_path):
    target, level = target_build
    for image in build_images(tmp_path, target, [case.controller for case in cases], [level]):
        share = cases[image.first : image.first + len(image.controllers)]
        jobs = [compiled_job(i, case.rows, STEPS) for i, case in enumerate(share)]
        answers = run_image(image, jobs, [1 + case.expected.size for case in share])
        for case, answer in zip(share, answers, strict=True):
            assert answer[0] == 0, f"{case.controller.name}: selftest {answer[0].astype(np.int32)}"
            assert differences(case, answer[1:].view(np.float32)) == 0, case.controller.name


@pytest.mark.parametrize("target", [M4F, M0], ids=lambda target: target.name)
def test_the_virtual_machine_on_a_microcontroller_has_the_references_bits(cases, target, tmp_path):
    (image,) = build_images(tmp_path, target, [], [])
    jobs = [vm_job(case.controller.program, case.controller.period_s, case.rows, STEPS) for case in cases]
    answers = run_image(image, jobs, [1 + case.expected.size for case in cases])
    for case, answer in zip(cases, answers, strict=True):
        assert answer[0] == 0, f"{case.controller.name}: sv_verify {answer[0].astype(np.int32)}"
        assert differences(case, answer[1:].view(np.float32)) == 0, case.controller.name


# --- what the claim rests on, and that its failure would be seen -----------------------------------------------------

FZ, TOWARDS_INFINITY, TOWARDS_ZERO = 1 << 24, 1 << 22, 3 << 22  # bits of FPSCR
MODES = 0xFFC00000 & ~0xF0000000  # all that change what arithmetic does: AHP, DN, FZ, rounding


@pytest.mark.parametrize("target", [M4F, M0], ids=lambda target: target.name)
def test_boots_with_subnormals_and_rounding_to_nearest(target, tmp_path):
    (image,) = build_images(tmp_path, target, [], [])
    (answer,) = run_image(image, [float_job()], [2])
    assert answer[0] == 0 and answer[1] & MODES == 0


@pytest.mark.parametrize(
    ("mode", "status"),
    [(FZ, SUBNORMALS_FLUSHED), (TOWARDS_INFINITY, ROUNDING_WRONG), (TOWARDS_ZERO, ROUNDING_WRONG)],
    ids=["flush to zero", "towards infinity", "towards zero"],
)
def test_a_wrong_mode_of_the_fpu_is_noticed(mode, status, tmp_path):
    controller = load_controller(LAMPS[0])
    (image,) = build_images(tmp_path, M4F, [controller], ["-O2"])
    no_row = compiled_job(0, np.empty((0, len(controller.inputs)), np.float32), 1)
    jobs = [no_row, fpscr_job(mode), float_job(), no_row, fpscr_job(0), float_job(), no_row]
    found = [list(answer.astype(np.int32)) for answer in run_image(image, jobs, [1, 0, 2, 1, 0, 2, 1])]
    assert found[0] == [0] and found[3] == [status] and found[6] == [0]
    assert found[2][0] == SV_ERROR_FLOAT and found[2][1] & MODES == mode and found[5][0] == 0


FUSED = {f"v{negated}fm{sign}.f32" for negated in ("", "n") for sign in "as"}


def test_nothing_is_fused_though_the_compiler_would(cases, tmp_path):
    (image,) = build_images(tmp_path, M4F, [case.controller for case in cases[: len(LAMPS) + 4]], ["-O3"])
    code = disassemble(image.path)
    assert code.count("vmul.f32") > 100 and code.count("vadd.f32") > 100
    assert not FUSED & set(code)
    # the same files without what forbids it
    shutil.rmtree(tmp_path)
    source = transpile(cases[len(LAMPS)].controller, tmp_path, "fused").source
    text = source.read_text()
    assert '#pragma GCC optimize("fp-contract=off")' in text
    source.write_text(text.replace('#pragma GCC optimize("fp-contract=off")', ""))
    compile_c(tmp_path, M4F, ["-std=gnu11", "-O3"], ["fused.c"])
    assert FUSED & set(disassemble(tmp_path / "fused.o"))
