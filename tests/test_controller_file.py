"""Controller files: hand-written ones load, saved ones load back the same, wrong ones are one sentence."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.canonical import program_hash
from controller.controller import Controller, Input, Output
from controller.controller_file import controller_text, load_controller, parse_controller, save_controller
from controller.errors import InputError
from controller.lowering import lower
from controller.native import NativeProgram
from controller.text import format_source, parse
from servolve.cli import main

GOOD = '''format = 1
program = """
(list (+ a0 1.5)
      (ifltz px a0 -2))
"""

[controller]
name = "lamp"
period_s = 0.02

[[input]]
name = "a0"
unit = "rad"
low = -1.1
high = 1.1

[[input]]
name = "px"
unit = "m"
low = -1
high = 1

[[output]]
name = "a0"
kind = "position"
unit = "deg"
low = -60
high = 60
neutral = 0

[[output]]
name = "a1"
kind = "position"
unit = "rad"
low = -1.0
high = 1.0
neutral = 0.25
'''


def test_a_hand_written_file_loads(tmp_path):
    path = tmp_path / "lamp.controller.toml"
    path.write_text(GOOD)
    controller = load_controller(path)
    assert (controller.name, controller.period_s) == ("lamp", 0.02)
    assert controller.inputs == (Input("a0", "rad", -1.1, 1.1), Input("px", "m", -1, 1))
    assert controller.outputs[1] == Output("a1", "position", "rad", -1, 1, 0.25)
    assert (controller.filter, controller.slew_rad_s, controller.task) == (1, 0, None)
    assert format_source(controller.source) == "(list (+ a0 1.5) (ifltz px a0 -2))"
    rows = np.array([(1, -1), (2, 1)], np.float32)
    assert NativeProgram(controller.program).run(0.02, rows).tolist() == [[2.5, 1], [3.5, -2]]


def test_format_may_be_missing_and_windows_line_ends_are_fine():
    assert controller_text(parse_controller(GOOD.replace("format = 1\n", ""), "x")) == controller_text(
        parse_controller(GOOD.replace("\n", "\r\n"), "x")
    )


def test_figure_7_parses_and_prints_back_the_same(figure_7_text):
    controller = parse_controller(figure_7_text, "figure-7")
    written = re.search(r'"""\n(.*?)"""', figure_7_text, re.DOTALL)[1]
    assert format_source(controller.source).split() == written.split()
    assert "15.4963" in written and "-28.4382" in written and "16.5266" in written
    again = parse_controller(controller_text(controller), "again")
    assert again.source == controller.source
    assert program_hash(again.program) == program_hash(controller.program)


def test_the_manual_s_examples_load():
    manual = (Path(__file__).parent.parent / "docs" / "controller.md").read_text()
    example = re.search(r"```toml\n(.*?)```", manual, re.DOTALL)[1]
    controller = parse_controller(example, "controller.md")
    assert (controller.name, controller.filter, controller.slew_rad_s) == ("rocker", 0.6, 12)
    network = re.search(r"\n    \(let (?:.*\n    )*.*\n", manual)[0]
    source = parse(network, ())
    swing = NativeProgram(lower(source, ())).run(0.02, np.empty((200, 0), np.float32))
    assert [name for name, _ in source.definitions] == ["u", "v"]
    # it oscillates by itself
    assert (np.diff(np.sign(swing[:, 0])) != 0).sum() > 10


def test_a_run_folder_is_its_best_controller(tmp_path):
    (tmp_path / "best.controller.toml").write_text(GOOD)
    assert load_controller(str(tmp_path)).name == "lamp"


plain = st.one_of(
    st.text(st.characters(codec="utf-8"), max_size=20), st.booleans(), st.integers(-(2**53), 2**53), st.floats()
)


@given(st.data())
def test_saved_controllers_load_back_the_same(programs, data):
    source = data.draw(programs.sources())
    limits = st.tuples(*[st.floats(-1e6, 1e6)] * 3).map(sorted)
    outputs = []
    for i in range(len(source.outputs)):
        low, neutral, high = data.draw(limits)
        outputs.append(Output(f"a{i}", "velocity", "deg/s", low, high, neutral))
    golden = {"inputs": [["0x00000001"] * 4] * 2, "outputs": [["0x7fc00000"] * len(outputs)] * 2}
    controller = Controller(
        name=data.draw(st.from_regex(r"[A-Za-z_][A-Za-z0-9_.-]{0,63}", fullmatch=True)),
        period_s=data.draw(st.floats(1e-4, 10)),
        inputs=tuple(Input(name, "1", -1.0, 1.0) for name in programs.terminals),
        outputs=tuple(outputs),
        source=source,
        program=lower(source, programs.terminals),
        filter=data.draw(st.floats(1e-6, 1)),
        slew_rad_s=data.draw(st.floats(0, 1e6)),
        task=data.draw(st.one_of(st.none(), st.text(st.characters(codec="utf-8"), max_size=20))),
        provenance=data.draw(st.dictionaries(st.text(st.characters(codec="utf-8"), max_size=8), plain, max_size=3)),
        golden=golden if data.draw(st.booleans()) else {},
    )
    text = controller_text(controller)
    again = parse_controller(text, "again")
    assert controller_text(again) == text
    assert (again.inputs, again.outputs, again.golden) == (controller.inputs, controller.outputs, controller.golden)
    assert (again.name, again.period_s, again.filter) == (controller.name, controller.period_s, controller.filter)
    assert (again.slew_rad_s, again.task) == (controller.slew_rad_s, controller.task)
    assert repr(dict(again.provenance)) == repr(dict(controller.provenance))
    assert program_hash(again.program) == program_hash(controller.program)


def test_saving_replaces_whole_files(tmp_path):
    path = tmp_path / "x.controller.toml"
    controller = parse_controller(GOOD, "x")
    path.write_text("old")
    save_controller(controller, path)
    assert path.read_text() == controller_text(controller)
    assert [entry.name for entry in tmp_path.iterdir()] == ["x.controller.toml"]
    with pytest.raises(InputError, match="can not be written"):
        save_controller(controller, tmp_path / "no" / "x.controller.toml")


# (what to replace, by what, place, words of the sentence)
WRONG = {
    "unknown terminal": ("(+ a0 1.5)", "(+ ao 1.5)", "line 3, column 10", "unknown terminal 'ao'; did you mean 'a0'"),
    "unknown operation": ("ifltz", "iflz", "line 4, column 8", "did you mean 'ifltz'"),
    "wrong arity": ("(+ a0 1.5)", "(+ a0)", "line 3, column 8", "write (+ a b)"),
    "NaN literal": ("1.5", "nan", "line 3, column 13", "not finite"),
    "infinite literal": ("1.5", "-inf", "line 3, column 13", "not finite"),
    "too large literal": ("1.5", "1e400", "line 3, column 13", "beyond the largest float"),
    "unclosed": ("-2))", "-2)", "line 5, column 1", "close every parenthesis"),
    "too deep": (
        "(+ a0 1.5)",
        "(abs " * 100_000 + "a0" + ")" * 100_000,
        "line 3, column 5007",
        "nested more than 1000 deep",
    ),
    "one output missing": ("(ifltz px a0 -2)", "", "line 2", "has 1 expression, but there are 2 [[output]]"),
    "too many expressions": ("-2))", "-2) 1)", "line 2", "has 3 expressions"),
    "duplicate input": ('name = "px"', 'name = "a0"', "line 18: input 2 (a0)", "used twice"),
    "duplicate output": ('name = "a1"', 'name = "a0"', "line 32: output 2 (a0)", "used twice"),
    "operation's name": ('name = "px"', 'name = "sin"', "line 18: input 2 (sin)", "word of the program text"),
    "bad name": ('name = "px"', 'name = "2x"', "line 18: input 2", "can not be a name"),
    "bad controller name": ('name = "lamp"', 'name = "my lamp"', "line 8: [controller]", "can not be a name"),
    "missing limits": ("low = -60\n", "", "line 23: output 1 (a0)", "low is missing"),
    "missing neutral": ("neutral = 0.25\n", "", "line 31: output 2 (a1)", "neutral is missing"),
    "low above high": ("low = -60", "low = 61", "line 27: output 1 (a0)", "above high"),
    "neutral outside": ("neutral = 0\n", "neutral = 61\n", "line 29: output 1 (a0)", "outside -60 to 60"),
    "infinite limit": ("high = 60", "high = inf", "line 28: output 1 (a0)", "not finite"),
    "limit beyond float32": ("high = 60", "high = 1e39", "line 28: output 1 (a0)", "out of range"),
    "text for a number": ("high = 60", 'high = "60"', "line 28: output 1 (a0)", "write a number"),
    "unknown kind": ('kind = "position"', 'kind = "torque"', "line 25: output 1 (a0)", "known: position, velocity"),
    "unit of another kind": ('unit = "deg"', 'unit = "deg/s"', "line 26: output 1 (a0)", "did you mean 'deg'"),
    "unknown key": ("neutral = 0\n", "neutral = 0\nnuetral = 0\n", "line 30: output 1 (a0)", "did you mean 'neutral'"),
    "unknown table": ("[controller]", "[controler]\nx=1\n[controller]", "line 7", "did you mean 'controller'"),
    "zero period": ("period_s = 0.02", "period_s = 0", "line 9: [controller]", "out of range"),
    "missing period": ("period_s = 0.02\n", "", "line 7: [controller]", "period_s is missing"),
    "boolean period": ("period_s = 0.02", "period_s = true", "line 9: [controller]", "write a number"),
    "huge integer": ("period_s = 0.02", "period_s = 1" + "0" * 400, "line 9: [controller]", "not finite"),
    "endless integer": ("period_s = 0.02", "period_s = 1" + "0" * 5000, "", "value out of range"),
    "filter of 0": ("period_s = 0.02", "period_s = 0.02\nfilter = 0", "line 10: [controller]", "out of range"),
    "negative slew": ("period_s = 0.02", "period_s = 0.02\nslew_rad_s = -1", "line 10", "out of range"),
    "another format": ("format = 1", "format = 2", "line 1", "this version reads `format = 1`"),
    "boolean format": ("format = 1", "format = true", "line 1", "this version reads `format = 1`"),
    "format as text": ("format = 1", 'format = "1"', "line 1", "this version reads `format = 1`"),
    "missing program": ("program =", "[provenance]\nx =", "top level", "program is missing"),
    "missing controller": (
        '[controller]\nname = "lamp"\nperiod_s = 0.02\n',
        "",
        "top level",
        "[controller] is missing",
    ),
    "program is a number": ("format = 1", "program = 3\n[golden]", "line 1", "write a text in quotes"),
    "table for a list": ("[[output]]", "[output]", "line 31, column 9", "not valid TOML"),
    "list for a table": ("[controller]", "[[controller]]", "line 7", "write a table [controller]"),
    "same key twice": ("low = -60", "low = -60\nlow = -60", "line 28", "not valid TOML"),
    "truncated": ('unit = "rad"\nlow = -1.0', 'unit = "ra\x00', "line 34", "not valid TOML"),
    "golden of another width": (
        "[controller]",
        '[golden]\ninputs = [["0x00000000"]]\noutputs = []\n[controller]',
        "line 8: [golden]",
        "write rows of 2 float32 bit patterns",
    ),
    "nested provenance": ("[controller]", "[provenance]\nx = {a = 1}\n[controller]", "line 8", "not plain"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_files_are_one_sentence(tmp_path, capsys, case):
    old, new, place, what = WRONG[case]
    assert old in GOOD
    path = tmp_path / "wrong.controller.toml"
    path.write_text(GOOD.replace(old, new, 1))
    with pytest.raises(InputError) as error:
        load_controller(path)
    sentence = str(error.value)
    assert sentence.startswith(str(path)), sentence
    assert place in sentence and what in sentence, sentence
    assert "; " in sentence and "\n" not in sentence, sentence
    # and through the command line: status 2, that sentence, no traceback
    assert main(["eval", str(path), "--inputs", str(path)]) == 2
    told = capsys.readouterr()
    assert told.out == "" and told.err == f"servolve: {sentence}\n"


def test_no_file_to_speak_of(tmp_path):
    cases = {
        "folder": "without best.controller.toml; give",
        "missing": "no such file; name",
        "garbage": "not UTF-8 text; save",
        "empty": "program is missing; add",
        "cut": "may be truncated: complete",
        "large": "larger than",
        "toml": "not valid TOML",
    }
    (tmp_path / "folder").mkdir()
    (tmp_path / "garbage").write_bytes(bytes(range(256)))
    (tmp_path / "empty").write_text("")
    (tmp_path / "cut").write_text(GOOD[:60])
    (tmp_path / "large").write_text(" " * (1 << 21))
    (tmp_path / "toml").write_text("(list 1 2 3)")
    for name, what in cases.items():
        with pytest.raises(InputError) as error:
            load_controller(tmp_path / name)
        assert str(error.value).startswith(str(tmp_path / name)) and what in str(error.value), str(error.value)


def test_any_cut_of_a_file_is_refused_in_one_sentence():
    for end in range(len(GOOD)):
        try:
            parse_controller(GOOD[:end], "cut.toml")
        except InputError as error:
            assert re.match(r"cut\.toml[^\n]*; [^\n]*$", str(error)), str(error)
        else:
            # all that can be missing without a trace is the last line's end
            assert GOOD[end:].strip() in ("", ".25", "25", "5")


@pytest.mark.parametrize(
    ("written", "place"),
    [
        ('program = "(list (+ a0 q) 1)"', "line 2, column 24: "),
        ("program = '''(list\n (+ a0 q) 1)'''", "line 3, column 8: "),
        ('"program" = """(list\n\n (+ a0 q) 1)"""', "line 4, column 8: "),
        ('program = "(list\\n (+ a0 q) 1)"', "program, line 2, column 8: "),
    ],
)
def test_places_count_in_the_file(written, place):
    text = re.sub(r'program = """.*?"""', lambda _: written, GOOD, count=1, flags=re.DOTALL)
    with pytest.raises(InputError, match=f"^x.toml, {place}unknown terminal 'q'"):
        parse_controller(text, "x.toml")


@pytest.mark.parametrize("limit", ["1e38", "1000001", "1.0000001e6"])
def test_limits_stay_far_below_infinity(limit):
    with pytest.raises(InputError, match=r"high .* is out of range; write a number from -1e\+06 to 1e\+06"):
        parse_controller(GOOD.replace("high = 60", f"high = {limit}"), "x")
    parse_controller(GOOD.replace("high = 60", "high = 1e6"), "x")


def test_numbers_of_the_file_are_rounded_once():
    # just above half-way between 1 and the next float; rounded to double first, it falls on half-way, and to 1
    above = "1.0000000596046447753906250000000001"
    for text in (above, above.replace("0000059", "000_0059")):
        controller = parse_controller(GOOD.replace("high = 60", f"high = {text}"), "x")
        assert np.float32(controller.outputs[0].high) == np.float32(1.0000001)
    assert parse_controller(GOOD, "x").period_s == 0.02
    big = parse_controller(GOOD.replace("high = 1.1", f"high = {2**60 + 2**36 + 1}"), "x")
    assert np.float32(big.inputs[0].high) == np.float32(2.0**60 + 2.0**37)


def test_a_byte_order_mark_is_named():
    with pytest.raises(InputError, match="x, line 1: begins with a byte-order mark; save"):
        parse_controller("\ufeff" + GOOD, "x")


@pytest.mark.parametrize("text", ["a." * 300_000 + "a = 1", "[" + "'b' . " * 100_000 + "c]", "x = {" + "a." * 200_000])
def test_a_key_of_many_parts_is_refused_first(text):
    with pytest.raises(InputError, match="x, line 2: a key has more than 256 parts; write a flat controller file"):
        parse_controller("format = 1\n" + text, "x")


def test_counts_agree_with_their_nouns():
    with pytest.raises(InputError, match=r"has 1 expression, but there are 2 \[\[output\]\];"):
        parse_controller(re.sub(r"\(list.*?\n\"\"\"", '(list a0)\n"""', GOOD, flags=re.DOTALL), "x")
    with pytest.raises(InputError, match=r"has 2 expressions, but there is 1 \[\[output\]\];"):
        parse_controller(GOOD[: GOOD.rindex("[[output]]")], "x")


def test_both_rules_of_names_are_one():
    with pytest.raises(InputError) as wrong_key:
        parse_controller(GOOD.replace('name = "lamp"', 'name = "1lamp"'), "x")
    with pytest.raises(InputError) as wrong_name:
        parse("(let ((1a 1)) (list a))", ["a"])
    rule = "use a letter or _, then up to 63 letters, digits or any of _ . -"
    assert rule in str(wrong_key.value) and rule in str(wrong_name.value)
