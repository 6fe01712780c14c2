"""The program text: reads back what it prints, and says where it is wrong."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.errors import InputError
from controller.source import Apply, Constant, Last, Name, Source
from controller.text import DEPTH_MAX, Place, format_source, parse

TERMINALS = ("t", "a0", "s0")


@given(st.data())
def test_printing_reads_back_the_same(programs, data):
    source = data.draw(programs.sources())
    text = format_source(source)
    again = parse(text, programs.terminals)
    assert format_source(again) == text
    # dataclasses compare -0 and 0 as equal; the text tells them apart
    assert again == source


def test_a_program_is_what_it_says():
    source = parse("; gait\n(list (+ t -1.5) ; sum\n\t(% a0 s0)\r\n)", TERMINALS)
    plus = Apply("+", (Name("t"), Constant(np.float32(-1.5))))
    assert source == Source((plus, Apply("%", (Name("a0"), Name("s0")))))
    assert format_source(source) == "(list (+ t -1.5) (% a0 s0))"


def test_definitions_and_last():
    text = "(let ((n (+ (last n) 1)) (m (* n (last k))) (k (sin m))) (list n (last m)))"
    source = parse(text, TERMINALS)
    assert [name for name, _ in source.definitions] == ["n", "m", "k"]
    assert source.outputs == (Name("n"), Last("m"))
    assert format_source(source) == text


def test_long_programs_print_one_output_a_line():
    outputs = [f"(+ (* a0 {i}.25) (* s0 (- t {i})))" for i in range(8)]
    text = "(list\n  " + "\n  ".join(outputs) + ")"
    assert format_source(parse(text, TERMINALS)) == text
    let = "(let (\n    (n (delay t)))\n  (list\n    " + "\n    ".join(outputs) + "))"
    assert format_source(parse(let, TERMINALS)) == let


def test_the_deepest_allowed_program_lives_without_recursion():
    depth = DEPTH_MAX
    text = "(list " + "(abs " * depth + "t" + ")" * depth + ")"
    assert format_source(parse(text, TERMINALS)).replace("\n ", "") == text


@pytest.mark.parametrize(
    ("text", "place", "what"),
    [
        ("", "line 1, column 1", "the end of the text"),
        ("  \n ", "line 2, column 2", "the end of the text"),
        ("list", "line 1, column 1", "'list'"),
        ("(list", "line 1, column 6", "close every parenthesis"),
        ("(list)", "line 1, column 6", "empty"),
        ("(list t))", "line 1, column 9", "remove it"),
        ("(list t) t", "line 1, column 10", "remove it"),
        ("(list\n (+ t\n  (sin a0)", "line 2, column 2", "add the missing )"),
        ("(list (+ t))", "line 1, column 8", "write (+ a b)"),
        ("(list (ifltz t t t t))", "line 1, column 8", "has 4 operands"),
        ("(list (sin))", "line 1, column 8", "has 0 operands"),
        ("(list (sine t))", "line 1, column 8", "did you mean 'sin'"),
        ("(list (load))", "line 1, column 8", "no operation"),
        ("(list ())", "line 1, column 8", "operation is missing"),
        ("(list (list t))", "line 1, column 8", "one list"),
        ("(list (let ((n 1)) n))", "line 1, column 8", "one let"),
        ("(list\n\n   ao)", "line 3, column 4", "unknown terminal 'ao'; did you mean 'a0'"),
        ("(list NaN)", "line 1, column 7", "not finite"),
        ("(list -inf)", "line 1, column 7", "not finite"),
        ("(list 1e39)", "line 1, column 7", "beyond the largest float"),
        ("(list 1e99999999999999999999)", "line 1, column 7", "beyond the largest float"),
        ("(list 0x1p3)", "line 1, column 7", "no decimal number"),
        ("(list 1.2.3)", "line 1, column 7", "no decimal number"),
        ("(list +)", "line 1, column 7", "not a value"),
        ("(list (last t))", "line 1, column 13", "write (delay t)"),
        ("(list (last n))", "line 1, column 13", "not defined"),
        ("(list (last))", "line 1, column 8", "(last name)"),
        ("(let ((n 1)) (list (last (n))))", "line 1, column 21", "(last name)"),
        ("(let ((n 1) (n 2)) (list n))", "line 1, column 14", "twice"),
        ("(let ((t 1)) (list t))", "line 1, column 8", "a terminal"),
        ("(let ((sin 1)) (list t))", "line 1, column 8", "word of the language"),
        ("(let ((2n 1)) (list t))", "line 1, column 8", "can not name"),
        ("(let ((n m) (m 1)) (list n))", "line 1, column 10", "unknown terminal 'm'"),
        ("(let ((n n)) (list n))", "line 1, column 10", "unknown terminal 'n'"),
        ("(let ((n 1 2)) (list n))", "line 1, column 12", "one expression"),
        ("(let ((n 1)) n)", "line 1, column 14", "(list e1 … en)"),
        ("(let (", "line 1, column 7", "let"),
        ("(let ((", "line 1, column 8", "can not name"),
    ],
)
def test_errors_name_place_and_remedy(text, place, what):
    with pytest.raises(InputError) as error:
        parse(text, TERMINALS)
    sentence = str(error.value)
    assert sentence.startswith(f"program, {place}: ")
    assert what in sentence
    assert ";" in sentence and "\n" not in sentence


@pytest.mark.parametrize("closed", [False, True])
def test_depth_100000_is_refused_in_one_sentence(closed):
    depth = 100_000
    text = "(list " + "(abs " * depth + ("t" + ")" * depth + ")" if closed else "")
    with pytest.raises(InputError, match=rf"line 1, column {7 + 5 * DEPTH_MAX}: .* nested more than {DEPTH_MAX} deep;"):
        parse(text, TERMINALS)


def test_size_is_bounded():
    with pytest.raises(InputError, match="characters; write at most"):
        parse("(list t)" + " " * (1 << 20), TERMINALS)


def test_the_place_of_the_text_in_its_file_counts():
    with pytest.raises(InputError, match=r"^lamp\.controller\.toml, line 4, column 12: "):
        parse("(list q)", TERMINALS, Place("lamp.controller.toml", 4, 6))
    with pytest.raises(InputError, match=r"^lamp\.controller\.toml, line 5, column 1: "):
        parse("(list\nq)", TERMINALS, Place("lamp.controller.toml", 4, 6))


@given(st.text(st.sampled_from("() \nabt0.5-+%ns;'\"lisetlast"), max_size=60))
def test_any_text_parses_or_gives_one_sentence(text):
    try:
        source = parse(text, TERMINALS)
    except InputError as error:
        assert re.match(r"^program, line \d+, column \d+: [^\n]*; [^\n]*$", str(error))
    else:
        assert parse(format_source(source), TERMINALS) == source
