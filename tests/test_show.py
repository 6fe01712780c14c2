"""`servolve show`: the text parses back, the tree has every node, the C is the transpiler's."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from controller import Controller, Input, Output, lower, parse, save_controller
from controller.source import Apply, Constant, Name, Source
from firmware_gen import generate
from servolve.cli import main
from servolve.show import tree_lines

TEXT = "(list (+ a0 (ifltz px -28.4382 (- t a0))) (% t px))"
NAMES = ("t", "a0", "px")


def controller(source, names=NAMES):
    inputs = tuple(Input(name, "s" if name == "t" else "m", -1.0, 1.0) for name in names)
    outputs = tuple(Output(f"a{i}", "position", "deg", -60.0, 60.0, 0.0) for i in range(len(source.outputs)))
    return Controller("shown", 0.02, inputs, outputs, source, lower(source, names), 0.5, 10.0, "walk", {"seed": 3})


@pytest.fixture
def saved(tmp_path):
    path = tmp_path / "best.controller.toml"
    save_controller(controller(parse(TEXT, NAMES)), path)
    return path


def test_the_text_says_what_the_controller_is_and_parses_back(saved, capsys):
    assert main(["show", str(saved)]) == 0
    said = capsys.readouterr().out
    for words in ("shown", "walk", "20 ms", "px [m], -1 to 1", "a1 [deg], -60 to 60, neutral 0", "10 rad/s", "seed"):
        assert words in said
    assert parse(said[said.index("(list") :], NAMES) == parse(TEXT, NAMES)


def test_a_run_folder_shows_its_best(saved, capsys):
    assert main(["show", str(saved.parent)]) == 0
    of_the_folder = capsys.readouterr().out
    assert main(["show", str(saved), "--as", "text"]) == 0
    assert capsys.readouterr().out == of_the_folder


def test_the_tree_shows_every_node_under_its_parent(saved, capsys):
    assert main(["show", str(saved), "--as", "tree"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "a0 [deg]",
        "└─ +",
        "   ├─ a0",
        "   └─ ifltz",
        "      ├─ px",
        "      ├─ -28.4382",
        "      └─ -",
        "         ├─ t",
        "         └─ a0",
        "a1 [deg]",
        "└─ %",
        "   ├─ t",
        "   └─ px",
    ]


def test_definitions_and_values_of_the_step_before_show_too(capsys):
    source = parse("(let ((n (+ t (last n)))) (list n))", ["t"])
    assert list(tree_lines(controller(source, ("t",)))) == [
        "n",
        "└─ +",
        "   ├─ t",
        "   └─ (last n)",
        "a0 [deg]",
        "└─ n",
    ]


def test_a_deep_tree_shows_without_recursion():
    expression = Name("t")
    for _ in range(5000):
        expression = Apply("+", (Constant(np.float32(1)), expression))
    deep = dataclasses.replace(controller(parse(TEXT, NAMES)), source=Source((expression, Name("t"))))
    assert sum(1 for _ in tree_lines(deep)) == 2 + 10_001 + 1


def test_the_c_is_the_transpilers(saved, capsys):
    assert main(["show", str(saved), "--as", "c"]) == 0
    assert capsys.readouterr().out == generate(controller(parse(TEXT, NAMES))).source


@pytest.mark.parametrize("arguments", [["missing"], ["."], ["notes.txt"], ["best.controller.toml", "--as", "pdf"]])
def test_what_cannot_be_shown_is_refused(saved, arguments, capsys, monkeypatch):
    monkeypatch.chdir(saved.parent)
    (saved.parent / "notes.txt").write_text("no TOML at all")
    if arguments == ["."]:
        saved.unlink()
    assert main(["show", *arguments]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert len(said.err.strip().splitlines()) == 1
