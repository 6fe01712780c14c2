"""`servolve eval`: the same bits from every back end, printed as bits."""

from __future__ import annotations

import numpy as np
import pytest

from controller.controller_file import load_controller
from controller.reference import run_program
from servolve.cli import main

CONTROLLER = '''program = """(list (+ (delay a) b) (- a a) (integrate b))"""
[controller]
name = "x"
period_s = 0.5
[[input]]
name = "a"
unit = "1"
low = -1
high = 1
[[input]]
name = "b"
unit = "1"
low = -1
high = 1
'''
OUTPUTS = "".join(
    f'[[output]]\nname = "{name}"\nkind = "position"\nunit = "deg"\nlow = -60\nhigh = 60\nneutral = 2.5\n'
    for name in ("p", "q", "r")
)
BACKENDS = ["reference", "vm", "c"]


@pytest.fixture
def controller(tmp_path):
    path = tmp_path / "x.controller.toml"
    path.write_text(CONTROLLER + OUTPUTS)
    return path


def evaluate(capsys, controller, text, *arguments):
    """Run the command on a CSV text; return its status, lines of output, and errors."""
    path = controller.parent / "in.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    capsys.readouterr()
    status = main(["eval", str(controller), "--inputs", str(path), *arguments])
    told = capsys.readouterr()
    return status, told.out.splitlines(), told.err


@pytest.mark.parametrize("backend", BACKENDS)
def test_rows_are_successive_steps_and_outputs_are_clamped_bits(controller, capsys, backend):
    text = "a,b\n1,0.5\n-inf,200\nnan,-1\n0x40000000,-0x1\n".replace("-0x1", "0xbf800000")
    status, lines, errors = evaluate(capsys, controller, text, "--backend", backend)
    assert (status, errors) == (0, "")
    # p = last a + b: 0.5, 1 + 200 => 60, -inf => -60, NaN => 2.5; q = a - a: 0, NaN => 2.5, NaN, 0;
    # r += b / 2: 0.25, 100.25 => 60, 99.75 => 60, 99.25 => 60
    assert lines == [
        "p,q,r",
        "0x3f000000,0x00000000,0x3e800000",
        "0x42700000,0x40200000,0x42700000",
        "0xc2700000,0x40200000,0x42700000",
        "0x40200000,0x00000000,0x42700000",
    ]


def test_the_header_orders_the_columns(controller, capsys):
    _, plain, _ = evaluate(capsys, controller, "1,2\n3,4\n")
    _, same, _ = evaluate(capsys, controller, "a, b\r\n1, 2\r\n3, 4\r\n\r\n")
    _, swapped, _ = evaluate(capsys, controller, "\ufeffb,a\n2,1\n4,3")
    assert plain == same == swapped
    assert len(plain) == 3
    assert evaluate(capsys, controller, "a,b\n")[1] == ["p,q,r"]
    assert evaluate(capsys, controller, "")[1] == ["p,q,r"]


def test_cells_are_rounded_once(controller, capsys):
    # 1.00000017881393421… lies below a tie; through double it would go to the even side above
    _, lines, _ = evaluate(
        capsys, controller, "0,1.0000001788139342151495725\n0,1.0000001788139343261718751\n0,1e-45\n"
    )
    assert [line.split(",")[0] for line in lines[1:]] == ["0x3f800001", "0x3f800002", "0x00000001"]


def test_signs_of_zero_and_special_words(controller, capsys):
    text = "0,-0\n-0,-0.0\n0x80000000,0x80000000\n0,-INF\n0,+Infinity\n0,-nan\n"
    _, lines, _ = evaluate(capsys, controller, text)
    # p = last a + b: 0 + -0 = 0; 0 + -0 = 0; -0 + -0 = -0
    assert [line.split(",")[0] for line in lines[1:]] == [
        "0x00000000", "0x00000000", "0x80000000", "0xc2700000", "0x42700000", "0x40200000"
    ]  # fmt: skip


def test_back_ends_agree_on_figure_7(tmp_path, capsys, programs, figure_7_text):
    controller = tmp_path / "figure-7.controller.toml"
    controller.write_text(figure_7_text)
    loaded = load_controller(controller)
    names = [terminal.name for terminal in loaded.inputs]
    rows = programs.any_floats(np.random.default_rng(11), (2000, len(names)))
    text = ",".join(names) + "\n" + "\n".join(",".join(f"0x{w:08x}" for w in row) for row in rows.view(np.uint32))
    told = [evaluate(capsys, controller, text, "--backend", backend) for backend in BACKENDS]
    assert [status for status, *_ in told] == [0, 0, 0]
    assert told[0][1] == told[1][1] == told[2][1]
    expected = run_program(loaded.program, 0.02, rows)
    expected = np.where(np.isnan(expected), np.float32(0), expected).clip(-60, 60)
    bits = [[int(cell, 16) for cell in line.split(",")] for line in told[1][1][1:]]
    assert np.array(bits, np.uint32).view(np.float32).tolist() == expected.tolist()
    assert all(len(cell) == 10 and cell == cell.lower() for line in told[1][1][1:] for cell in line.split(","))


def test_a_controller_without_terminals_takes_empty_rows(tmp_path, capsys):
    path = tmp_path / "count.controller.toml"
    head = 'program = "(let ((n (+ (last n) 1))) (list n))"\n[controller]\nname = "n"\nperiod_s = 0.02\n'
    path.write_text(head + OUTPUTS.split("[[output]]", 2)[1].join(["[[output]]", ""]))
    assert evaluate(capsys, path, "\n\n\n")[1] == ["p", "0x3f800000", "0x40000000", "0x40400000"]


@pytest.mark.parametrize(
    ("text", "place", "what"),
    [
        ("a\n1\n", "line 1: ", "terminal 'b' is missing; add"),
        ("a,c\n1,2\n", "line 1, column 2: ", "'c' is no terminal; the controller has a,b"),
        ("a,a\n1,2\n", "line 1, column 2: ", "stands twice; remove"),
        ("a,b,c\n1,2,3\n", "line 1, column 3: ", "'c' is no terminal"),
        ("b,a\n1,2,3\n", "line 2: ", "has 3 cells; write 2: b,a"),
        ("a,b\n1,2\n\n3\n", "line 4: ", "has 1 cells; write 2: a,b"),
        ("b,a\n1,x\n", "line 2, column 2 (a): ", "'x' is no float32; write"),
        ("1,2\n1,\n", "line 2, column 2 (b): ", "'' is no float32"),
        ("1,2\n1,0x1234\n", "line 2, column 2 (b): ", "no float32"),
        ("1,2\n1,1e39\n", "line 2, column 2 (b): ", "no float32"),
        ("1,x\n1,2\n", "line 1, column 2 (b): ", "'x' is no float32"),
        ("1,\n", "line 1, column 2 (b): ", "'' is no float32"),
        ("1\n", "line 1: ", "has 1 cells; write 2: a,b"),
        ("a,1\n1,2\n", "line 1, column 2: ", "'1' is no terminal"),
        (b"a,b\n1,\xff\n", "", "not UTF-8 text"),
    ],
)
def test_wrong_inputs_are_one_sentence(controller, capsys, text, place, what):
    status, lines, errors = evaluate(capsys, controller, text)
    assert (status, lines) == (2, [])
    assert place in errors and what in errors
    assert errors.startswith(f"servolve: {controller.parent / 'in.csv'}") and errors.count("\n") == 1 and "; " in errors


def test_wrong_arguments_are_one_sentence(controller, capsys, tmp_path):
    for arguments, what in (
        (["--inputs", str(tmp_path)], "is a folder; name a CSV file"),
        (["--inputs", str(tmp_path / "no.csv")], "there is no such file"),
        (["--inputs", str(controller), "--backend", "gpu"], "eval --help"),
        ([], "eval --help"),
    ):
        assert main(["eval", str(controller), *arguments]) == 2
        told = capsys.readouterr()
        assert told.out == "" and told.err.count("\n") == 1 and what in told.err
