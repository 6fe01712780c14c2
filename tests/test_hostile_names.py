"""Names and units that C would trip over: refused in one sentence, or mangled and harmless."""

import subprocess
from dataclasses import replace

import numpy as np
import pytest

from controller import Controller, Input, Output, load_controller, lower, parse
from controller.errors import InputError
from controller.reference import run_program
from firmware_gen import compile_controller, generate, transpile
from firmware_gen.static_checks import WARNINGS, check_statically
from firmware_gen.transpiler.names import comment_text
from firmware_gen.transpiler.vectors import bits_of
from servolve.cli import main

FILE = """format = 1
program = "(list (+ {terminal} 1))"
[controller]
name = {name}
period_s = 0.02
[[input]]
name = {input}
unit = {unit}
low = -1
high = 1
[[output]]
name = {output}
kind = "position"
unit = "deg"
low = -60
high = 60
neutral = 0
"""
GOOD = {"terminal": "a0", "name": '"made"', "input": '"a0"', "unit": '"rad"', "output": '"a0"'}
BAD_NAMES = [
    '"a b"',
    '"a\\"b"',
    '"a\\nb"',
    '"a*/b"',
    '"a//b"',
    '"a??/b"',
    '"a\\\\b"',
    '"a;b"',
    '"../a"',
    '""',
    '"7a"',
    '"é"',
    f'"{"a" * 65}"',
    "7",
]


def written(folder, **changed):
    path = folder / "made.controller.toml"
    path.write_text(FILE.format(**(GOOD | changed)), encoding="utf-8")
    return path


@pytest.mark.parametrize("name", BAD_NAMES)
@pytest.mark.parametrize("place", ["name", "input", "output"])
def test_a_name_that_is_none_is_refused(place, name, tmp_path, capsys):
    path = written(tmp_path, **{place: name})
    assert main(["transpile", str(path), "--out", str(tmp_path / "c")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "made.controller.toml" in error and "Traceback" not in error
    assert not (tmp_path / "c").exists()


@pytest.mark.parametrize("name", ["a b", 'a"b', "a\nb", "a*/b", "a??/b", "a" * 65, "", "-a", "../../a", "a/b", "a;b"])
def test_a_name_on_the_command_line_that_is_none_is_refused(name, tmp_path, capsys):
    assert main(["transpile", str(written(tmp_path)), "--out", str(tmp_path / "c"), f"--name={name}"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "not a C identifier" in error
    assert not (tmp_path / "c").exists()


WORDS = [
    *("int", "double", "register", "volatile", "inline", "restrict", "_Bool", "static", "sizeof", "NULL", "main"),
    *("assert.h", "errno", "INFINITY", "linux", "unix", "i386", "__FILE__", "__LINE__", "defined", "asm", "class"),
    *("state", "inputs", "outputs", "command", "s", "held", "v0", "in_a", "u", "f", "word", "sv_sin", "float.x"),
    *("a-b", "a.b", "a_x2D_b", "a_x2E_b", "ninput", "noutput", "step", "x" * 64, "-".join("abcdefgh" * 3)),
]
TERMINALS = tuple(dict.fromkeys(WORDS))


def made_of(terminals, unit="1", name="made"):
    total = terminals[0]
    for terminal in terminals[1:]:
        total = f"(+ {total} {terminal})"
    source = parse(f"(list {total} (integrate {terminals[-1]}))", terminals)
    return Controller(
        name=name,
        period_s=0.02,
        inputs=tuple(Input(terminal, unit, -2.0, 2.0) for terminal in terminals),
        outputs=tuple(Output(output, "position", "deg", -50.0, 50.0, 1.5) for output in terminals[:2]),
        source=source,
        program=lower(source, terminals),
    )


def compiles(folder, name):
    for compiler in ("gcc", "clang"):
        command = [compiler, *WARNINGS, "-Wcomment", "-Wtrigraphs", "-trigraphs", "-Werror", "-c", f"{name}.c"]
        done = subprocess.run([*command, "-o", f"{name}.o"], cwd=folder, capture_output=True, text=True, check=False)
        assert done.stderr == ""
    command = ["clang", "-x", "c++", "-Wall", "-Werror", "-c", f"{name}.c", "-o", f"{name}.o"]
    assert subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False).stderr == ""


def test_words_of_c_are_harmless_as_terminals_and_joints(tmp_path):
    controller = made_of(TERMINALS)
    transpile(controller, tmp_path, "made")
    compiles(tmp_path, "made")
    inputs = np.random.default_rng(4).normal(size=(50, len(TERMINALS))).astype(np.float32)
    with compile_controller(controller) as compiled:
        assert compiled.selftest() == 0
        expected = run_program(controller.program, controller.period_s, inputs)
        assert np.array_equal(bits_of(compiled.run(inputs)), bits_of(expected))


@pytest.mark.parametrize("name", ["int", "register", "main", "linux", "__FILE__", "_", "_Bool", "a.b", "in", "x" * 64])
def test_words_of_c_are_harmless_as_a_controller(name, tmp_path):
    unit = transpile(made_of(("a", "b"), name=name), tmp_path).unit
    compiles(tmp_path, unit.name)


UNITS = ['"*/"', '"/*"', '"//"', '"m??/"', '"m\\\\"', '"\\""', '"%s%n"', '"µ·m²"', '"int x;"', '"#error"']


@pytest.mark.parametrize("unit", UNITS)
def test_a_unit_stays_in_its_comment(unit, tmp_path):
    plain = transpile(load_controller(written(tmp_path)), tmp_path / "plain")
    odd = transpile(load_controller(written(tmp_path, unit=unit)), tmp_path / "odd")
    compiles(odd.source.parent, "made")
    changed = [
        line
        for line, other in zip(odd.header.read_text().splitlines(), plain.header.read_text().splitlines(), strict=True)
        if line != other
    ]
    # the comment of the terminal, and the fingerprint
    assert [line.split("//")[0].strip() for line in changed if "FINGERPRINT" not in line] == ["made_input_a0 = 0"]
    if "/" not in unit:
        return
    misra = next(iter(check_statically(odd, ["cppcheck, MISRA C:2012"])))
    assert misra.findings == 0, misra


@pytest.mark.parametrize("text", ["a\nint x;", "a*/ int x; /*", "a??/", "a\\", 'a"b', "\x00", "é" * 20])
def test_a_controller_made_in_python_has_no_say_in_the_code_either(text, tmp_path):
    controller = replace(made_of(("a", "b")), name=text, task=text)
    with pytest.raises(InputError, match=r"C name|C identifier"):
        generate(replace(controller, name=text * 30))
    generated = transpile(controller, tmp_path, "made")
    compiles(tmp_path, "made")
    assert "int x" not in "\n".join(
        line.partition("//")[0] for line in (generated.header.read_text() + generated.source.read_text()).splitlines()
    )


def test_comments_keep_what_is_harmless():
    assert comment_text("(list (- a0 1.5e-3) (% b c))") == "(list (- a0 1.5e-3) (% b c))"
    assert comment_text("rad/s") == "rad/s" and comment_text("N*m^2") == "N*m^2"
    assert comment_text("/*/") == "__/" and comment_text("///") == "__/"
