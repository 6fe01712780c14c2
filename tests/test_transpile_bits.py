"""Generated C against the virtual machine and the reference, bit for bit."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_controllers import FIGURE7, WARNINGS, from_source, make_controller, run_command

from controller import load_controller
from controller.native import NativeProgram
from controller.operations import BY_OPCODE, OPERATIONS
from controller.reference import run_program
from controller.source import Apply, Constant, Last, Name, Source
from firmware_gen import compile_controller, compile_controllers
from firmware_gen.transpiler.literals import literal
from firmware_gen.transpiler.vectors import SPECIAL_BITS, bits_of, draw_inputs

BUILDS = [
    ("gcc", ("-O0",)),
    ("gcc", ("-O3",)),
    ("clang", ("-O0",)),
    ("clang", ("-O3",)),
    ("gcc", ("-std=gnu11", "-O3", "-march=native")),  # fuses multiplications and additions unless the file forbids it
    ("clang", ("-std=gnu11", "-O3", "-march=native")),
]
BUILD_IDS = ["-".join([compiler, *flags]) for compiler, flags in BUILDS]


@pytest.fixture(scope="module")
def figure7():
    """Figure 7 of Gritz & Hahn 1995 with 100,000 random inputs and the slow reference's answers."""
    controller = load_controller(FIGURE7)
    words = np.random.default_rng(7).integers(0, 2**32, (100_000, len(controller.inputs), 2), dtype=np.uint32)
    inputs = draw_inputs(words, controller.inputs)
    return controller, inputs, bits_of(run_program(controller.program, controller.period_s, inputs))


def test_the_random_inputs_try_everything(figure7):
    _, inputs, expected = figure7
    assert len(inputs) == 100_000
    for bits in SPECIAL_BITS:
        found = np.isnan(inputs) if bits == 0x7FC00000 else inputs.view(np.uint32) == bits
        assert found.any(axis=0).all(), f"{bits:08x} is missing"
    outputs = expected.view(np.float32)
    assert np.isnan(outputs).any() and np.isinf(outputs).any()
    assert (np.isfinite(outputs).mean(axis=0) > 0.5).all()


def test_figure_7_reference_and_virtual_machine_agree(figure7):
    controller, inputs, expected = figure7
    found = bits_of(NativeProgram(controller.program).run(controller.period_s, inputs))
    assert np.count_nonzero(found != expected) == 0


@pytest.mark.parametrize(("compiler", "flags"), BUILDS, ids=BUILD_IDS)
def test_figure_7_reference_and_c_agree(figure7, compiler, flags):
    controller, inputs, expected = figure7
    with compile_controller(controller, compiler=compiler, flags=flags) as compiled:
        assert compiled.selftest() == 0
        assert np.count_nonzero(bits_of(compiled.run(inputs)) != expected) == 0


INPUTS = ("a0", "osc-like.name", "t_x")
PROGRAMS = 32


def random_source(rng):
    """A program with definitions that refer to each other and to the step before, over all operations."""
    known = list(INPUTS)
    names = [f"n{i}" for i in range(rng.integers(0, 4))]
    table = [operation for operation in OPERATIONS if not operation.internal]

    def expression(depth):
        choice = rng.random()
        if depth == 0 or choice < 0.15:
            if names and choice < 0.05:
                return Last(str(rng.choice(names)))
            if choice < 0.11:
                scale = 10.0 ** rng.integers(-3, 3)
                return Constant(np.float32(rng.normal() * scale if rng.random() < 0.8 else rng.integers(-2, 3)))
            return Name(str(rng.choice(known)))
        operation = table[rng.integers(len(table))]
        return Apply(operation.name, tuple(expression(depth - 1) for _ in range(operation.arity)))

    definitions = []
    for name in names:
        definitions.append((name, expression(4)))
        known.append(name)
    return Source(tuple(expression(int(depth)) for depth in rng.integers(2, 6, rng.integers(1, 5))), tuple(definitions))


@pytest.fixture(scope="module")
def random_programs():
    """Random programs, each with sequences of steps and the slow reference's answers."""
    rng = np.random.default_rng(11)
    made = []
    for _ in range(PROGRAMS):
        controller = from_source(random_source(rng), INPUTS)
        words = rng.integers(0, 2**32, (4, 25, len(INPUTS), 2), dtype=np.uint32)
        words[:2, :, :, 1] = 0  # two sequences within the ranges, so that states stay alive
        inputs = draw_inputs(words, controller.inputs)
        expected = [bits_of(run_program(controller.program, controller.period_s, rows)) for rows in inputs]
        made.append((controller, inputs, expected))
    return made


def test_the_random_programs_use_every_operation(random_programs):
    counts = Counter(
        BY_OPCODE[op].name for made in random_programs for op in made[0].program.instructions["op"].tolist()
    )
    assert all(counts[operation.name] >= 3 for operation in OPERATIONS), counts
    outputs = np.concatenate([rows.ravel() for made in random_programs for rows in made[2]]).view(np.float32)
    assert len(np.unique(outputs)) > 2_000


def test_random_programs_reference_and_virtual_machine_agree(random_programs):
    for controller, inputs, expected in random_programs:
        machine = NativeProgram(controller.program)
        for rows, answer in zip(inputs, expected, strict=True):
            assert np.array_equal(bits_of(machine.run(controller.period_s, rows)), answer)


@pytest.mark.parametrize(("compiler", "flags"), BUILDS, ids=BUILD_IDS)
def test_random_programs_reference_and_c_agree(random_programs, compiler, flags):
    with compile_controllers([made[0] for made in random_programs], compiler=compiler, flags=flags) as built:
        for compiled, (_, inputs, expected) in zip(built, random_programs, strict=True):
            assert compiled.selftest() == 0
            for rows, answer in zip(inputs, expected, strict=True):
                assert np.array_equal(bits_of(compiled.run(rows)), answer)


def expressions(definitions):
    """Trees over all operations."""
    names = st.sampled_from(INPUTS).map(Name)
    constants = st.floats(width=32, allow_nan=False, allow_infinity=False).map(lambda x: Constant(np.float32(x)))
    lasts = [st.sampled_from(definitions).map(Last)] if definitions else []
    operations = [operation for operation in OPERATIONS if not operation.internal]

    def applied(children):
        return st.one_of(
            [st.tuples(*[children] * o.arity).map(lambda x, name=o.name: Apply(name, x)) for o in operations]
        )

    return st.recursive(st.one_of(names, constants, *lasts), applied, max_leaves=12)


@st.composite
def sources(draw):
    names = ["n0", "n1"][: draw(st.integers(0, 2))]
    definitions = tuple((name, draw(expressions(names))) for name in names)
    return Source(tuple(draw(st.lists(expressions(names), min_size=1, max_size=3))), definitions)


STEPS = st.lists(st.tuples(*[st.floats(width=32)] * len(INPUTS)), min_size=1, max_size=6)


@settings(derandomize=True, deadline=None, max_examples=60)
@given(sources(), STEPS, st.sampled_from(BUILDS))
def test_any_program_reference_virtual_machine_and_c_agree(source, steps, build):
    controller = from_source(source, INPUTS)
    inputs = np.array(steps, np.float32)
    expected = bits_of(run_program(controller.program, controller.period_s, inputs))
    machine = NativeProgram(controller.program).run(controller.period_s, inputs)
    assert np.array_equal(bits_of(machine), expected)
    with compile_controller(controller, compiler=build[0], flags=build[1]) as compiled:
        assert compiled.selftest() == 0
        assert np.array_equal(bits_of(compiled.run(inputs)), expected)


def test_the_clamp_makes_nan_neutral_and_keeps_the_limits():
    controller = make_controller("(list a0)")
    values = np.array([np.nan, np.inf, -np.inf, 50.0, 50.000004, -50.0, -51.0, -0.0, 1e-42, 3.0], np.float32)
    expected = np.array([1.5, 50.0, -50.0, 50.0, 50.0, -50.0, -50.0, -0.0, 1e-42, 3.0], np.float32)
    with compile_controller(controller) as compiled:
        found = compiled.clamp(values[:, np.newaxis])[:, 0]
    assert np.array_equal(bits_of(found), bits_of(expected))


def test_literals_read_back_to_the_same_bits(tmp_path):
    rng = np.random.default_rng(3)
    bits = np.concatenate([np.array(SPECIAL_BITS, np.uint32), rng.integers(0, 2**32, 4_000, dtype=np.uint32)])
    bits = bits[np.isfinite(bits.view(np.float32))]
    values = ",\n".join(literal(value) for value in bits.view(np.float32))
    (tmp_path / "table.c").write_text(
        f"#include <stdio.h>\n#include <string.h>\nstatic const float table[] = {{{values}}};\nint main(void) {{\n"
        f'for (int i = 0; i < {len(bits)}; i++) {{ unsigned u; memcpy(&u, &table[i], 4); printf("%u\\n", u); }}\n'
        "return 0; }\n"
    )
    for compiler in ("gcc", "clang"):
        assert run_command(compiler, "-std=c99", *WARNINGS, "table.c", "-o", "table", cwd=tmp_path).stderr == ""
        lines = run_command("./table", cwd=tmp_path).stdout.split()
        assert np.array_equal(np.array(lines, np.uint32), bits)
