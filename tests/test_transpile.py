"""What generated C promises: its files, its names, its report, and what is refused."""

import re
import subprocess
import sys

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_controllers import FIGURE7, GOLDEN, ROOT, SHAPES, WARNINGS, make_controller, run_command

from controller import load_controller
from controller.errors import InputError, RunError
from controller.operations import OPERATIONS
from firmware_gen import compile_controller, generate, transpile, write_report
from firmware_gen.transpiler.names import mangle
from firmware_gen.transpiler.runtime_functions import operations_of, read_runtime_functions

# the files


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


# errors and the report


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
        rows = re.findall(r"^\| `(?:init|step|clamp|command)` \| (.*) \|$", section, re.M)
        assert len(rows) == 2 * 4, "each function, at -Os and at -O2"
        for row in rows:
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
