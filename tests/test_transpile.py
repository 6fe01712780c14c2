"""Generated C against the virtual machine and the reference, bit for bit; and what the files promise."""

import re
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controller import Controller, Input, Output, load_controller, lower, parse
from controller.errors import InputError, RunError
from controller.native import NativeProgram
from controller.operations import BY_OPCODE, OPERATIONS
from controller.reference import run_program
from controller.source import Apply, Constant, Last, Name, Source
from firmware_gen import compile_controller, compile_controllers, generate, transpile, write_report
from firmware_gen.transpiler.literals import literal
from firmware_gen.transpiler.names import mangle
from firmware_gen.transpiler.runtime_functions import operations_of, read_runtime_functions
from firmware_gen.transpiler.vectors import SPECIAL_BITS, bits_of, draw_inputs

ROOT = Path(__file__).parents[1]
GOLDEN = ROOT / "tests" / "golden"
FIGURE7 = GOLDEN / "figure7.controller.toml"

WARNINGS = ["-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Wmissing-prototypes", "-Werror", "-pedantic"]
BUILDS = [
    ("gcc", ("-O0",)),
    ("gcc", ("-O3",)),
    ("clang", ("-O0",)),
    ("clang", ("-O3",)),
    ("gcc", ("-std=gnu11", "-O3", "-march=native")),  # fuses multiplications and additions unless the file forbids it
    ("clang", ("-std=gnu11", "-O3", "-march=native")),
]
BUILD_IDS = ["-".join([compiler, *flags]) for compiler, flags in BUILDS]


def make_controller(text, inputs=("a0", "a1"), name="made", low=-50.0):
    return from_source(parse(text, inputs), inputs, name, low)


def from_source(source, inputs, name="made", low=-50.0):
    return Controller(
        name=name,
        period_s=0.02,
        inputs=tuple(Input(terminal, "1", -2.0, 2.0) for terminal in inputs),
        outputs=tuple(Output(f"j{i}", "position", "deg", low, 50.0, 1.5) for i in range(len(source.outputs))),
        source=source,
        program=lower(source, inputs),
    )


def run_command(*command, cwd):
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)


# --- the same bits ---------------------------------------------------------------------------------------------------


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


# --- the files -------------------------------------------------------------------------------------------------------

EVERYTHING = """(let ((n1 (tanh (+ (* 0.5 (last n1)) a0))) (n2 (sigmoid (* (last n3) n1))) (n3 (osc-wave a1 n2)))
  (list (integrate n3) (differentiate n2) (smooth n1 0.2) (osc-tri 1 n1) (osc-saw 2 a0) (memory a0 n3) (delay n1)
    (interpolate a0 n1 -2) (log (abs (sign (exp (min n1 (max a0 (cos (atan a1)))))))) (gt (if a0 a1 n1) 3) 7 -0 a1
    (% (sin a0) 1e-40) (ifltz a0 a1 n1)))"""
SHAPES = {
    "everything": make_controller(EVERYTHING),
    "no_terminal": make_controller("(list (osc-wave 1.5 0))", inputs=()),
    "unused": make_controller("(list 1 2)"),
    "no_operation": make_controller("(list a1)"),
    "in": make_controller("(list (+ a (* input_a state)))", inputs=("input_a", "a", "state")),
    "in_a": make_controller("(list (+ a_step (* a a_input_a)))", inputs=("a_step", "a", "a_input_a")),
    "made_": make_controller("(list (+ y (* v0 (integrate word))))", inputs=("y", "v0", "word")),
    "hard_names": make_controller("(list (+ int (* osc-like.name double)))", inputs=("int", "osc-like.name", "double")),
}


@pytest.mark.parametrize("name", SHAPES)
def test_compiles_without_a_warning_as_c_and_cpp(name, tmp_path):
    transpile(SHAPES[name], tmp_path, name)
    for compiler in ("gcc", "clang"):
        for level in ("-O0", "-O3"):
            command = (compiler, "-std=c99", "-ffp-contract=off", "-Wshadow", *WARNINGS, level, "-c", f"{name}.c")
            assert run_command(*command, cwd=tmp_path).stderr == ""
    for language in ("-std=c++98", "-std=c++17"):
        command = ("clang", "-x", "c++", language, "-Wall", "-Wextra", "-Werror", "-c", f"{name}.c")
        assert run_command(*command, cwd=tmp_path).stderr == ""


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("level", ["-Os", "-O3"])
def test_needs_nothing_from_outside_and_has_no_globals(name, level, tmp_path):
    transpile(SHAPES[name], tmp_path, name)
    assert run_command("gcc", "-std=c99", "-ffreestanding", level, "-c", f"{name}.c", cwd=tmp_path).stderr == ""
    kinds = {line.split()[-2] for line in run_command("nm", f"{name}.o", cwd=tmp_path).stdout.splitlines()}
    assert kinds <= {"T", "t", "r", "R"}  # code and constants: nothing undefined, no data, no bss


def test_every_arithmetic_line_does_one_operation_and_no_double_appears():
    generated = generate(SHAPES["everything"], "everything")
    body = generated.source.partition("void everything_step(")[2].partition("\n}")[0]
    lines = [line for line in body.splitlines() if line.startswith("  const float v")]
    assert len(lines) == len(SHAPES["everything"].program.instructions)
    for line in lines:
        code, _, comment = line.partition(";  // ")
        assert comment.startswith("("), line
        assert len(re.findall(r" [-+*/] ", code.partition(" = ")[2])) <= 1, line
    code = re.sub(r"//[^\n]*|#[^\n]*", "", generated.header + generated.source)
    assert not re.search(r"\bdouble\b|\bmalloc\b|\bmemcpy\b", code)
    assert not re.search(r"\d\.\d+(?:e[-+]?\d+)?(?![\dFe.])", code), "a literal without F"


def test_the_program_text_stands_in_the_header():
    header = generate(load_controller(FIGURE7)).header
    assert "//   (list\n//     (- (ifltz a0 pz a2) (% a1 t))\n" in header
    assert "figure7_input_s0 = 4,  // N, expected 0 to 30" in header
    assert "figure7_output_a1 = 1,  // position in deg, clamped to -65.7 to 65.7, 0 for a NaN" in header


def test_golden_files():
    # after an intended change: servolve transpile tests/golden/figure7.controller.toml --out tests/golden
    generated = generate(load_controller(FIGURE7))
    assert generated.unit.name == "figure7"
    assert generated.header == (GOLDEN / "figure7.h").read_text(encoding="utf-8")
    assert generated.source == (GOLDEN / "figure7.c").read_text(encoding="utf-8")


def test_two_processes_write_the_same_bytes(tmp_path):
    script = (
        "import sys, firmware_gen, controller;"
        "firmware_gen.transpile(controller.load_controller(sys.argv[1]), sys.argv[2], 'same')"
    )
    for seed in ("1", "2"):
        done = subprocess.run(
            [sys.executable, "-c", script, str(FIGURE7), str(tmp_path / seed)],
            env={"PYTHONHASHSEED": seed, "PATH": "/usr/bin:/bin"},
            cwd=ROOT,
            check=False,
        )
        assert done.returncode == 0
    for file in ("same.h", "same.c"):
        assert (tmp_path / "1" / file).read_bytes() == (tmp_path / "2" / file).read_bytes()


def test_only_the_functions_that_are_used_are_copied_and_from_one_source():
    runtime = "".join((ROOT / "controller" / "runtime" / f).read_text() for f in ("sv_math.h", "sv_operations.h"))

    def copied(text):
        source = generate(make_controller(text)).source
        found = re.findall(r"^((?://[^\n]*\n)+static inline [^\n]*?(sv_\w+)\(.*?^\}\n)", source, re.M | re.S)
        assert all(function in runtime for function, _ in found)
        return [name for _, name in found]

    assert copied("(list (+ a0 1))") == []
    assert copied("(list (sin a0))") == ["sv_quarter_turn", "sv_sin"]
    assert copied("(list (sigmoid (interpolate a0 a1 2)))") == [
        "sv_pow2",
        "sv_exp",
        "sv_sigmoid",
        "sv_clamp01",
        "sv_interpolate",
    ]


def test_the_table_calls_only_functions_of_the_runtime():
    functions = read_runtime_functions()
    for operation in OPERATIONS:
        for name in re.findall(r"\b(sv_\w+)\(", operation.c):
            assert name in functions
    assert operations_of("a * b", functions) == 1
    assert operations_of("sv_smooth(s, a, b)", functions) == 5  # two comparisons, -, *, +


NAMES = st.from_regex(r"[A-Za-z_][A-Za-z0-9_.-]{0,63}", fullmatch=True)


def unmangle(symbol):
    """Read escapes from left to right: only one name can give a symbol."""
    return re.sub(r"_x([0-9A-F]{2})_", lambda match: chr(int(match[1], 16)), symbol)


@settings(derandomize=True, max_examples=300)
@given(NAMES)
def test_mangling_can_be_undone(name):
    assert re.fullmatch(r"[A-Za-z0-9_]+", mangle(name))
    assert unmangle(mangle(name)) == name


@pytest.mark.parametrize(
    "name", ["a_x2E_b", "a.b", "a_.b", "_x", "_._x5F_", "__x", "a-.x", "osc-like.name", "x_x_x", "_x2D_-_x2D_"]
)
def test_names_that_look_like_escapes_are_mangled_apart(name):
    assert unmangle(mangle(name)) == name


def test_plain_names_stay_as_they_are():
    assert [mangle(name) for name in ("a0", "goal_dist", "T_1")] == ["a0", "goal_dist", "T_1"]


# --- what must not go unnoticed --------------------------------------------------------------------------------------

MAIN = """
#include <stdio.h>
#include "made.h"
int main(void) {{
  {before}
  printf("%d", (int)made_selftest());
  return 0;
}}
"""


def selftest_of(folder, *, before="", includes="", flags=("-O2",), compiler="gcc", libraries=()):
    """Compile and run the selftest of made.c as a program of its own."""
    (folder / "main.c").write_text(includes + MAIN.format(before=before))
    done = run_command(compiler, "-std=c99", *flags, "main.c", "made.c", "-o", "main", *libraries, cwd=folder)
    assert done.returncode == 0, done.stderr
    return int(run_command("./main", cwd=folder).stdout)


def change(path, old, new, count=1):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, count))


@pytest.fixture
def made(tmp_path):
    return transpile(make_controller("(list (* a0 1.5) (integrate (sin a1)))"), tmp_path, "made")


def test_selftest_passes_as_generated(made, tmp_path):
    assert selftest_of(tmp_path) == 0


@pytest.mark.parametrize(
    ("old", "new", "status"),
    [
        ("1.5F;", "1.50000012F;", 1),
        ("0.00833218824F", "0.0083331F", None),
        ("return y;\n}\n\nvoid made_init", "return s[0] = y + 0.0F * dt, dt;\n}\n\nvoid made_init", -5),
        ("state->s[0] = 0.0F", "(void)state", None),
        ("if (value != value)", "if (0)", -4),
        ("return low;", "return value;", -4),
        ("(-50.0F), 50.0F, 1.5F", "(-50.0F), 50.5F, 1.5F", -4),
        ("  y = factor * factor;\n  y = y + square;", "  y = __builtin_fmaf(factor, factor, square);", -2),
    ],
)
def test_selftest_notices_a_change_of_the_code(made, tmp_path, old, new, status):
    change(made.source, old, new)
    found = selftest_of(tmp_path, libraries=("-lm",))
    assert found == status if status is not None else found != 0


SLOW = "(list (* 30 (osc-tri 0.5 0)) (* 20 (osc-wave 0.7 0)) (smooth (tanh (integrate a0)) 0.001) (log (exp a1)))"


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("3.0F - y", "3.0F + y"),  # branches that the program reaches after a second
        ("y - 1.0F;\n  } else", "y + 1.0F;\n  } else"),
        ("x < 0.5F", "x < 0.75F"),
        ("x > -8388608.0F", "x > 8388608.0F"),
        ("y < 1.0F ? y : 0.99999994F", "y"),
        ("y = y - 1.0F;\n  }\n  y = x - y", "y = y + 1.0F;\n  }\n  y = x - y"),
        ("6.28318548F", "6.28318596F"),
        ("0.00138873095F", "0.00138873905F"),
        ("quadrant & 2U", "quadrant & 1U"),
        ("magnitude < 0.625F", "magnitude < 0.5F"),
        ("if (x > 88.7228317F", "if (x > 80.0F"),
        ("if (x < 1.17549435e-38F", "if (x < 0.0F"),
        ("w > 1.0F ? 1.0F : w", "w"),
    ],
)
def test_selftest_notices_changed_functions_of_slow_programs(old, new, tmp_path):
    source = transpile(make_controller(SLOW), tmp_path, "made").source
    head, mark, tail = source.read_text().partition("void made_init(")
    assert old in head
    source.write_text(head.replace(old, new, 1) + mark + tail)
    assert selftest_of(tmp_path) == -5


@pytest.mark.parametrize("step", [1, 12, 13, 24])
@pytest.mark.parametrize("table", ["inputs", "outputs"])
def test_selftest_notices_one_changed_bit_of_its_vectors(made, tmp_path, step, table):
    head, name, tail = made.source.read_text().partition(f"made_recorded_{table}[24]")
    rows = tail.split("\n")
    word = re.search(r"0x([0-9a-f]{8})U", rows[step])[1]
    rows[step] = rows[step].replace(word, f"{int(word, 16) ^ 0x00010000:08x}", 1)
    made.source.write_text(head + name + "\n".join(rows))
    assert selftest_of(tmp_path) == step


FLUSH = """
#if defined(__SSE2__)
#include <xmmintrin.h>
#define FLUSH() _mm_setcsr(_mm_getcsr() | 0x8040U)
#elif defined(__aarch64__)
#define FLUSH() __asm__ volatile("msr fpcr, %0" : : "r"(1UL << 24))
#else
#error "how are subnormals flushed to zero on this machine?"
#endif
"""


def test_selftest_notices_flushed_subnormals(made, tmp_path):
    assert selftest_of(tmp_path, includes=FLUSH, before="FLUSH();") == -1


@pytest.mark.parametrize("mode", ["FE_UPWARD", "FE_DOWNWARD", "FE_TOWARDZERO"])
def test_selftest_notices_another_rounding(made, tmp_path, mode):
    status = selftest_of(tmp_path, includes="#include <fenv.h>\n", before=f"fesetround({mode});", libraries=("-lm",))
    assert status == -3


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize("flag", ["-ffast-math", "-Ofast"])
def test_refuses_to_compile_with_fast_arithmetic(made, tmp_path, compiler, flag):
    done = run_command(compiler, flag, "-c", "made.c", cwd=tmp_path)
    assert done.returncode != 0
    assert "needs IEEE-754 arithmetic" in done.stderr


def test_refuses_a_header_of_another_run(made, tmp_path):
    other = transpile(make_controller("(list (* a0 1.25) (integrate (sin a1)))"), tmp_path / "other", "made")
    shutil.copy(other.header, made.header)
    done = run_command("gcc", "-c", "made.c", cwd=tmp_path)
    assert done.returncode != 0
    assert "are not of the same run" in done.stderr


def test_refuses_a_header_of_another_generator(made, tmp_path):
    change(made.header, "made_GENERATOR 3", "made_GENERATOR 4")
    assert "are not of the same run" in run_command("gcc", "-c", "made.c", cwd=tmp_path).stderr


# --- errors and the report -------------------------------------------------------------------------------------------


def test_symbols_of_two_controllers_never_meet():
    terminals = ("a", "init", "input_a", "output_j0", "a_state", "x5F_input", "step")
    symbols = {}
    for name in ("lamp", "lamp_input", "lamp.input", "lamp_output", "lamp_input_a", "lamp_x5F_input", "lamp_init"):
        controller = make_controller("(list a (+ a 1))", inputs=terminals, name=name)
        header = re.sub(r"//[^\n]*", "", generate(controller).header)
        for symbol in set(re.findall(r"\blamp\w*", header)):
            assert symbols.setdefault(symbol, name) == name
    assert len(symbols) > 100


@pytest.mark.parametrize("name", ["lamp_input", "lamp_output_a", "math", "String", "assert", "features", "stdio"])
def test_names_that_hide_or_collide_are_refused(name, tmp_path):
    with pytest.raises(InputError, match=f"--name '{name}' .*choose another name"):
        transpile(SHAPES["no_operation"], tmp_path, name)
    if name.islower() and "_" not in name:
        with pytest.raises(InputError, match=f"the controller's name '{name}' .*choose another one with --name"):
            transpile(make_controller("(list a0)", name=name), tmp_path)


def test_a_name_that_is_too_long_in_c_names_the_option(tmp_path):
    name = "a." * 31
    with pytest.raises(InputError, match=r"the controller's name .* makes a C name of 186 characters.*--name"):
        transpile(make_controller("(list a0)", name=name), tmp_path)
    transpile(make_controller("(list a0)", name=name), tmp_path, "short")


@pytest.mark.parametrize("name", ["", "a-b", "1a", "a b", "é", "a" * 65, "stdint", "Float", "../x"])
def test_a_bad_name_is_refused(name, tmp_path):
    with pytest.raises(InputError, match="name"):
        transpile(SHAPES["no_operation"], tmp_path, name)
    assert list(tmp_path.iterdir()) == []


def test_a_missing_compiler_is_named():
    with pytest.raises(InputError, match="there is no compiler 'no-such-cc'"):
        compile_controller(SHAPES["no_operation"], compiler="no-such-cc")


def test_the_package_of_the_compiler_is_named(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(InputError, match=r"install one, as with: apt-get install gcc$"):
        compile_controller(SHAPES["no_operation"])


def test_a_compiler_error_is_one_sentence():
    with pytest.raises(RunError, match=r"failed: .*IEEE-754"):
        compile_controller(SHAPES["no_operation"], flags=("-ffast-math",))


def test_the_report_states_sizes_and_counts(tmp_path):
    text = write_report(transpile(SHAPES["everything"], tmp_path, "everything")).read_text()
    assert "| `osc-wave` | 1 |" in text
    assert "| `j2` | deg | unbounded, or NaN | -50 to 50 |" not in text
    assert "| `j0` | deg | " in text and "may give" in text
    program = SHAPES["everything"].program
    assert f"| all | {len(program.instructions)} |" in text
    sections = text.split("\n## ")
    for name in ("Cortex-M4F", "Cortex-M0"):
        section = next(section for section in sections if section.startswith(name))
        assert section.count("0 bytes of writable data") == 2 and "refused" not in section
        for row in re.findall(r"^\| `(?:init|step|clamp|command)` \| (.*) \|$", section, re.M):
            code, stack, instructions, *cycles = map(int, row.split(" | "))
            assert 0 < code < 10_000 and 0 <= stack < 400
            assert 0 < instructions <= min(cycles)
        assert re.search(r"at \d+ MHz \|.* µs \| .* µs", section)
    here = sections[-1]
    assert here.startswith("This machine") and "0 bytes of writable data" in here
    code = int(re.search(r"(\d+) bytes of code", here)[1])
    step = re.search(r"\| `everything_step` \| (\d+) \| (\d+) \|", here)
    assert 0 < int(step[1]) <= code


def test_the_fingerprint_depends_on_more_than_the_program():
    units = [generate(make_controller("(list a0)", low=low), "made").unit for low in (-50.0, -49.0)]
    assert units[0].program_hash == units[1].program_hash
    assert units[0].fingerprint != units[1].fingerprint
