"""Wrong input, through the real command line: status 2, one sentence that names file, place and remedy, no traceback.

What each sentence must name was written down before the parsers were, from the file formats alone.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from controller import load_rig
from servolve.cli import main

CONTROLLER = '''format = 1
program = """
(list
  (* 20 (osc-wave 1.5 0))
  (+ a0 (% px 0.1))
  (ifltz px -10 10))
"""

[controller]
name = "nod"
period_s = 0.02

[[input]]
name = "a0"
unit = "rad"
low = -1.06
high = 1.06

[[input]]
name = "px"
unit = "m"
low = -1.0
high = 1.0

[[output]]
name = "a0"
kind = "position"
unit = "deg"
low = -60.0
high = 60.0
neutral = 0.0

[[output]]
name = "a1"
kind = "position"
unit = "deg"
low = -65.0
high = 65.0
neutral = 0.0

[[output]]
name = "a2"
kind = "position"
unit = "deg"
low = -65.5
high = 65.5
neutral = 0.0
'''

TASK = """
from evolve.task import Task

def fitness(rollouts, goal_m):
    return rollouts.statistics["final_error"], 0.0 * goal_m

TASK = Task(name="walk", rig="lamp-xc330", terminals=("t", "px"), fitness=fitness)
"""

TWIN = 'format = 1\n[twin]\nname = "weak"\ntorque_scale = 0.8\n'

RIG = load_rig("lamp-xc330").text


def edit(text, old, new, count=1):
    """Replace the first occurrences; every case must really change its file."""
    assert old in text, old
    return text.replace(old, new, count)


def refused(capsys, arguments, *places, status=2):
    """Check that a command ends with one sentence that names the places, each a regular expression."""
    assert main([str(argument) for argument in arguments]) == status
    printed = capsys.readouterr()
    check_sentence(printed.err, *places)
    assert printed.out == ""


def check_sentence(err, *places):
    lines = err.strip().splitlines()
    assert len(lines) == 1, err
    (line,) = lines
    assert line.startswith("servolve: ")
    assert "Traceback" not in line
    for place in places:
        assert re.search(place, line, re.IGNORECASE), (place, line)
    # what is wrong; what to do
    assert re.search(r"; \S+ \S+", line), line
    assert len(line) < 600, line


@pytest.fixture
def folder(tmp_path):
    shutil.copy(load_rig("lamp-xc330").body, tmp_path / "lamp.xml")
    (tmp_path / "good.controller.toml").write_text(CONTROLLER)
    return tmp_path


def test_the_files_that_the_cases_spoil_are_good(folder, capsys):
    (folder / "rig.toml").write_text(RIG)
    (folder / "twin.toml").write_text(TWIN)
    good = folder / "good.controller.toml"
    assert main(["show", str(good)]) == 0
    log = folder / "log.mcap"
    deploy = ["deploy", str(good), "--rig", str(folder / "rig.toml"), "--twin", str(folder / "twin.toml")]
    assert main([*deploy, "--seconds", "0.1", "--log", str(log)]) == 0


# controller files

SECOND = "  (+ a0 (% px 0.1))"
LAST = "  (ifltz px -10 10))"
DEEP = "(list (* 20 (osc-wave 1.5 0)) px " + "(abs " * 100_000 + "a0" + ")" * 100_001

CONTROLLERS = {
    "unknown terminal": (edit(CONTROLLER, SECOND, "  (+ a0 (% py 0.1))"), [r"line 5", "'?py'?", "px"]),
    "misspelt operation": (edit(CONTROLLER, "osc-wave", "osc-weve"), [r"line 4", "osc-weve", "osc-wave"]),
    "too few operands": (edit(CONTROLLER, "(% px 0.1)", "(% px)"), [r"line 5", "%", r"\b(1|one)\b", "% a b|two|2"]),
    "too many operands": (edit(CONTROLLER, "(% px 0.1)", "(% px 0.1 2)"), [r"line 5", "%", r"\b3|three\b"]),
    "depth 100,000": (re.sub(r"\(list.*?\n\"", lambda _: DEEP + '\n"', CONTROLLER, flags=re.S), ["line 3", "dee?p"]),
    "NaN literal": (edit(CONTROLLER, "0.1", "nan"), ["line 5", "nan"]),
    "infinite literal": (edit(CONTROLLER, "0.1", "1e999"), ["line 5", "1e999"]),
    "huge exponent": (edit(CONTROLLER, "0.1", "1e999999999999"), ["line 5", "1e999999999999"]),
    "open parenthesis": (edit(CONTROLLER, LAST, LAST[:-1]), [r"\)|parenthes|closed"]),
    "parenthesis too many": (edit(CONTROLLER, LAST, LAST + ")"), ["line 6", r"\)|parenthes|after"]),
    "list of four": (edit(CONTROLLER, LAST, LAST[:-1] + " 0)"), ["4|four", "3|three", "output"]),
    "program is no list": (edit(CONTROLLER, "(list", "(+"), ["line 3", "list"]),
    "empty program": (re.sub(r"\(list.*?\n\"", '"', CONTROLLER, flags=re.S), ["line 3", "list", "end"]),
    "no program": (re.sub(r"program.*?\"\"\".*?\"\"\"\n", "", CONTROLLER, flags=re.S), ["program", "missing"]),
    "two inputs of one name": (edit(CONTROLLER, 'name = "px"', 'name = "a0"'), ["input", "a0", "twice"]),
    "two outputs of one name": (edit(CONTROLLER, 'name = "a1"', 'name = "a0"'), ["output", "a0", "twice"]),
    "an operation's name": (edit(CONTROLLER, 'name = "px"', 'name = "sin"'), ["input", "sin", "operation|word"]),
    "no name at all": (edit(CONTROLLER, 'name = "nod"', 'name = "2 nods"'), ["controller", "2 nods", "name"]),
    "missing limits": (edit(CONTROLLER, "low = -65.0\n", ""), ["output 2|a1", "low", "missing"]),
    "low above high": (edit(CONTROLLER, "low = -65.0", "low = 70.0"), ["a1", "low", "70"]),
    "low is NaN": (
        edit(CONTROLLER, "low = -65.0", "low = nan"),
        [f"line {CONTROLLER[: CONTROLLER.index('low = -65.0')].count(chr(10)) + 1}:", "a1", "low", "finite"],
    ),
    "low is a text": (edit(CONTROLLER, "low = -65.0", 'low = "-65"'), ["a1", "low", "number"]),
    "neutral out of range": (edit(CONTROLLER, "neutral = 0.0", "neutral = 90.0"), ["a0", "neutral", "90"]),
    "unknown unit": (edit(CONTROLLER, 'unit = "deg"', 'unit = "degrees"'), ["a0", "degrees", "deg"]),
    "unknown key": (edit(CONTROLLER, "neutral", "nuetral"), ["a0", "nuetral", "neutral"]),
    "unknown table": (CONTROLLER + "\n[notes]\n", ["notes"]),
    "negative period": (edit(CONTROLLER, "0.02", "-0.02"), ["period_s", r"-0\.02"]),
    "no period": (edit(CONTROLLER, "period_s = 0.02\n", ""), ["period_s", "missing"]),
    "another format": (edit(CONTROLLER, "format = 1", "format = 2"), ["format", "2"]),
    "filter above 1": (edit(CONTROLLER, "period_s", "filter = 1.5\nperiod_s"), ["filter", r"1\.5"]),
    "truncated": (CONTROLLER[: CONTROLLER.index("kind") + 8], ["line 25|TOML"]),
    "cut between tables": (CONTROLLER[: CONTROLLER.index("[[output]]")], ["output"]),
    "no TOML": ("(list a0)", ["line 1"]),
    "empty file": ("", ["program", "missing"]),
    "binary": (bytes(range(256)) * 8, ["UTF-8|text"]),
    "Latin-1": (edit(CONTROLLER, '"nod"', '"nöd"').encode("latin-1"), ["UTF-8"]),
    "a thousand brackets": ("program = " + "[" * 5000, ["TOML|nest|deep|bracket|line"]),
}


@pytest.mark.parametrize("case", CONTROLLERS)
def test_a_controller_file(folder, capsys, case):
    content, places = CONTROLLERS[case]
    path = folder / "bad.controller.toml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    refused(capsys, ["show", path], r"bad\.controller\.toml", *places)


@pytest.mark.parametrize(
    "command",
    [["eval", "--inputs", "x.csv"], ["transpile", "--out", "x"], ["simulate"], ["deploy", "--rig", "lamp-xc330"]],
)
def test_every_command_refuses_the_same_controller(folder, capsys, command, monkeypatch):
    monkeypatch.chdir(folder)
    path = folder / "bad.controller.toml"
    path.write_text(edit(CONTROLLER, "(% px 0.1)", "(% px)"))
    refused(capsys, [command[0], path, *command[1:]], r"bad\.controller\.toml", "line 5", "%")
    assert sorted(file.name for file in folder.iterdir()) == ["bad.controller.toml", "good.controller.toml", "lamp.xml"]


def test_a_controller_that_is_not_there(folder, capsys):
    refused(capsys, ["show", folder / "gone.controller.toml"], r"gone\.controller\.toml", "no such file")
    refused(capsys, ["show", folder / "runs" / "none"], "none", "no such file; name a run folder or a ")
    refused(capsys, ["evolve", "--resume", folder / ("x" * 300)], "xxx", "holds no run")


def test_a_folder_for_a_controller(folder, capsys):
    refused(capsys, ["show", folder], re.escape(str(folder)), "folder", r"best\.controller\.toml")


def test_a_controller_that_may_not_be_read(folder, capsys):
    # root may read anything: a name that is too long, and a NUL, can not be opened by anyone
    refused(capsys, ["show", folder / ("x" * 300 + ".controller.toml")], "x.controller.toml", "long|read")
    refused(capsys, ["show", str(folder) + "/a\0b.controller.toml"], "read|null|such")


@pytest.mark.parametrize("command", ["simulate", "deploy"])
@pytest.mark.parametrize(
    ("old", "new", "places"),
    [
        ('name = "px"', 'name = "vx"', ["vx", "lamp-xc330", "px"]),
        ('name = "a1"', 'name = "a9"', ["a9", "lamp-xc330", "a2"]),
        ("period_s = 0.02", "period_s = 0.01", ["period", r"0\.01", r"0\.02"]),
        ('kind = "position"\nunit = "deg"', 'kind = "velocity"\nunit = "deg/s"', ["a0", "velocity", "position"]),
    ],
)
def test_a_controller_that_does_not_fit_the_rig(folder, capsys, command, old, new, places):
    path = folder / "misfit.controller.toml"
    text = edit(CONTROLLER, old, new)
    path.write_text(text.replace(" px ", " vx ") if "vx" in new else text)
    refused(capsys, [command, path, "--rig", "lamp-xc330"], *places)


# rig files

SECOND_JOINT = RIG.index("[[joint]]", RIG.index("[[joint]]") + 1)


def second(old, new):
    """Change the second joint."""
    return RIG[:SECOND_JOINT] + edit(RIG[SECOND_JOINT:], old, new)


RIGS = {
    "two joints of one id": (second("id = 2", "id = 1"), ["joint 2|a1", r"\b1\b", "twice"]),
    "two joints of one name": (second('name = "a1"', 'name = "a0"'), ["a0", "twice"]),
    "missing limits": (second("high_rad = 1.147\n", ""), ["joint 2|a1", "high_rad", "missing"]),
    "low above high": (second("low_rad = -1.147", "low_rad = 2.0"), ["joint 2|a1", "low_rad|low", "2"]),
    "neutral out of limits": (second("neutral_rad = 0.0", "neutral_rad = 1.5"), ["joint 2|a1", "neutral", r"1\.5"]),
    "unknown servo": (second("xc330-m181", "xc330-m188"), ["joint 2|a1", "xc330-m188", "xc330-m181"]),
    "sign 0": (second("sign = 1", "sign = 0"), ["joint 2|a1", "sign"]),
    "gain beyond the register": (second("p_gain = 1450", "p_gain = 99999"), ["joint 2|a1", "p_gain", "99999"]),
    "gain is no whole number": (second("p_gain = 1450", "p_gain = 1450.5"), ["joint 2|a1", "p_gain", "whole|integer"]),
    "id for all": (second("id = 2", "id = 254"), ["joint 2|a1", "254"]),
    "limits beyond the encoder": (second("zero_tick = 2048", "zero_tick = 4000"), ["joint 2|a1", "tick|travel|4095"]),
    "no joints": (RIG[: RIG.index("[[joint]]")] + RIG[RIG.index("[[sensor]]") :], ["joint"]),
    "negative period": (edit(RIG, "period_s = 0.02", "period_s = -0.02"), ["period_s", r"-0\.02"]),
    "infinite period": (edit(RIG, "period_s = 0.02", "period_s = inf"), ["period_s", "finite"]),
    "no such body": (edit(RIG, '"lamp.xml"', '"lump.xml"'), [r"lump\.xml"]),
    "body elsewhere": (edit(RIG, '"lamp.xml"', '"/dev/null"'), ["body", "/dev/null"]),
    "unknown baud rate": (edit(RIG, "baud = 1000000", "baud = 12345"), ["baud", "12345", "57600"]),
    "unknown protocol": (edit(RIG, "dynamixel-2.0", "dynamixel-3.0"), ["protocol", "dynamixel-3.0"]),
    "too many volts": (edit(RIG, "supply_v = 5.0", "supply_v = 12.0"), ["supply_v", "12"]),
    "missing safety": (edit(RIG, "tilt_rad_max = 1.2\n", ""), ["safety", "tilt_rad_max", "missing"]),
    "unknown key": (edit(RIG, "homing_rad_s", "homing_rad"), ["safety", "homing_rad"]),
    "unknown stop": (edit(RIG, 'stop = "off"', 'stop = "brake"'), ["stop", "brake", "hold"]),
    "scale 0": (edit(RIG, "scale = 0.0001", "scale = 0.0"), ["sensor 1|x", "scale"]),
    "two sensors of one name": (edit(RIG, 'name = "y"', 'name = "x"'), ["sensor", "x", "twice"]),
    "two sensors in one field": (edit(RIG, "field = 1", "field = 0"), ["sensor", "field", "0"]),
    "pose in newton": (edit(RIG, 'unit = "m"', 'unit = "N"'), ["sensor 1|x", "unit", "m"]),
    "a joint's name taken": (edit(RIG, 'terminal = "s0"', 'terminal = "a0"'), ["terminal", "a0"]),
    "no number": (edit(RIG, "rate_hz = 100.0", 'rate_hz = "fast"'), ["sensor 1|x", "rate_hz", "number"]),
    "another format": (edit(RIG, "format = 1", "format = 2"), ["format", "2"]),
    "truncated": (RIG[: RIG.index("p_gain") + 7], ["line|TOML"]),
    "truncated between tables": (RIG[: RIG.index("[safety]")], ["safety|joint"]),
    "binary": (b"\x7fELF\x00\xff" * 99, ["UTF-8|text"]),
    "empty file": ("", ["rig|format"]),
}


@pytest.mark.parametrize("case", RIGS)
def test_a_rig_file(folder, capsys, case):
    content, places = RIGS[case]
    path = folder / "bad.rig.toml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    refused(capsys, ["deploy", folder / "good.controller.toml", "--rig", path], r"bad\.rig\.toml", *places)


@pytest.mark.parametrize("command", [["simulate"], ["deploy"]])
def test_every_command_refuses_the_same_rig(folder, capsys, command):
    path = folder / "bad.rig.toml"
    path.write_text(second("id = 2", "id = 1"))
    refused(capsys, [*command, folder / "good.controller.toml", "--rig", path], r"bad\.rig\.toml", "twice")
    refused(capsys, ["rig", "serve", path], r"bad\.rig\.toml", "twice")
    refused(capsys, ["evolve", "lamp", "--rig", path, "--out", folder / "run"], r"bad\.rig\.toml", "twice")


def test_a_body_without_the_rigs_joint(folder, capsys):
    path = folder / "bad.rig.toml"
    path.write_text(second('mjcf_joint = "a1"', 'mjcf_joint = "knee"'))
    refused(capsys, ["deploy", folder / "good.controller.toml", "--rig", path], r"lamp\.xml|bad\.rig", "knee", "a1")


def test_a_body_that_is_no_mjcf(folder, capsys):
    (folder / "bad.rig.toml").write_text(RIG)
    (folder / "lamp.xml").write_text("<mujoco><worldbody>")
    arguments = ["deploy", folder / "good.controller.toml", "--rig", folder / "bad.rig.toml"]
    refused(capsys, arguments, r"lamp\.xml", "XML|MJCF|MuJoCo")


def test_a_rig_that_is_not_there(folder, capsys):
    good = folder / "good.controller.toml"
    refused(capsys, ["deploy", good, "--rig", "lamp-xc303"], "lamp-xc303", "lamp-xc330")
    refused(capsys, ["deploy", good, "--rig", "toaster"], "toaster", "lamp-xc330")
    refused(capsys, ["deploy", good, "--rig", folder / "gone.toml"], r"gone\.toml", "no such file")
    refused(capsys, ["deploy", good, "--rig", folder], re.escape(str(folder)), "folder|directory")
    refused(capsys, ["rig", "serve", "toaster"], "toaster")


# task files

TASKS = {
    "syntax error": (edit(TASK, "return rollouts", "retrun rollouts"), [r"bad\.py:5", "syntax"]),
    "unknown import": ("import no_such_module_at_all\n" + TASK, [r"bad\.py:1", "no_such_module_at_all"]),
    "no task": (edit(TASK, "TASK =", "task ="), ["TASK"]),
    "not a task": (TASK + "\nTASK = 3\n", ["TASK", "int|3"]),
    "raises": ("raise SystemExit(0)\n", [r"bad\.py:1", "SystemExit"]),
    "missing fitness": (edit(TASK, ", fitness=fitness", ""), ["fitness"]),
    "fitness is no function": (edit(TASK, "fitness=fitness", "fitness=3"), ["fitness"]),
    "unknown terminal": (edit(TASK, '"px"', '"smell"'), ["smell", "px"]),
    "terminal listed twice": (edit(TASK, '("t", "px")', '("t", "t")'), ["t", "twice"]),
    "unknown rig": (edit(TASK, "lamp-xc330", "lamp-xc303"), ["lamp-xc303"]),
    "name is no name": (edit(TASK, '"walk"', '"a walk"'), ["a walk"]),
    "binary": (b"\x00\x01\x02" * 50, ["null|source|syntax|read"]),
    "not UTF-8": ("NAME = 'é'\n".encode("latin-1") + TASK.encode(), ["utf-8|unicode"]),
    "empty": ("", ["TASK"]),
    "deep": ("x = " + "(" * 10_000 + ")" * 10_000 + TASK, ["bad"]),
    "fitness raises": (edit(TASK, '"final_error"', '"final_eror"'), [r"bad\.py:5", "final_eror"]),
    "fitness of the wrong shape": (edit(TASK, ", 0.0 * goal_m", ""), ["fitness", "main"]),
}


@pytest.mark.parametrize("case", TASKS)
def test_a_task_file(folder, capsys, case):
    content, places = TASKS[case]
    path = folder / "bad.py"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    tiny = ["--population", "4", "--generations", "1", "--set", "goals=1", "--set", "time_limit_s=0.2", "--quiet"]
    out = ["--out", str(folder / "run")]
    place = "" if case in ("unknown rig", "unknown terminal") else r"bad\.py"
    refused(capsys, ["evolve", path, *tiny, *out], place, *places)


def test_a_task_that_is_not_there(folder, capsys):
    refused(capsys, ["evolve", "limp"], "limp", "lamp")
    refused(capsys, ["evolve", folder / "gone.py"], r"gone\.py")
    refused(capsys, ["evolve", folder], re.escape(str(folder)), "folder|directory|task")


# flags


@pytest.mark.parametrize(
    ("arguments", "places"),
    [
        (["dploy"], ["dploy", "deploy"]),
        (["--jsno"], ["--jsno"]),
        (["show"], ["show", "controller"]),
        (["show", "GOOD", "--as", "poem"], ["--as", "poem", "tree"]),
        (["deploy", "GOOD"], ["good", "which rig", "--rig"]),
        (["deploy", "GOOD", "--rig", "lamp-xc330", "--secons", "3"], ["--secons", "--seconds"]),
        (["deploy", "GOOD", "--rig", "lamp-xc330", "--seconds", "three"], ["--seconds", "three"]),
        (["deploy", "GOOD", "--rig", "lamp-xc330", "--seconds", "-3"], ["--seconds", "-3"]),
        (["deploy", "GOOD", "--rig", "lamp-xc330", "--seconds", "nan"], ["--seconds", "nan"]),
        (["deploy", "GOOD", "--rig", "lamp-xc330", "--goal", "nan"], ["--goal", "nan"]),
        (["deploy", "GOOD", "--rig", "lamp-xc330", "--derate", "0"], ["--derate", "0"]),
        (["deploy", "GOOD", "--rig", "lamp-xc330", "--seed", "-1"], ["--seed", "-1"]),
        (["deploy", "GOOD", "--rig", "lamp-xc330", "--fault", "gremlins=3"], ["gremlins", "drop"]),
        (["deploy", "GOOD", "--rig", "lamp-xc330", "--fault", "drop=lots"], ["drop", "lots"]),
        (["deploy", "GOOD", "--rig", "lamp-xc330", "--fault", "drop=2"], ["drop", "2"]),
        (["deploy", "GOOD", "--rig", "lamp-xc330", "--fault", "dead=99@1"], ["dead", "99"]),
        (["deploy", "GOOD", "--rig", "lamp-xc330", "--twin", "gone.toml"], [r"gone\.toml"]),
        (["deploy", "GOOD", "--rig", "lamp-xc330", "--log", "/no/such/folder/log.mcap"], ["/no/such/folder"]),
        (
            ["deploy", "GOOD", "--rig", "lamp-xc330", "--port", "/dev/no-such-tty", "--sensor-port", "x"],
            ["no-such-tty"],
        ),
        (["deploy", "GOOD", "--rig", "lamp-xc330", "--rig", "lamp-xl330"], ["--rig"]),
        (["deploy", "GOOD", "GOOD", "--rig", "lamp-xc330"], ["good"]),
        (["simulate", "GOOD", "--rig", "lamp-xc330", "--goal", "inf"], ["--goal", "inf"]),
        (["simulate", "GOOD", "--rig", "lamp-xc330", "--log", "/no/such/folder/log.mcap"], ["/no/such/folder"]),
        (["evolve", "lamp", "--seed", "-1"], ["--seed", "-1"]),
        (["evolve", "lamp", "--threads", "0"], ["--threads", "0"]),
        (["evolve", "lamp", "--population", "1"], ["population", "1"]),
        (["evolve", "lamp", "--set", "goals"], ["--set", "goals", "="]),
        (["evolve", "lamp", "--set", "gaols=3"], ["gaols", "goals"]),
        (["evolve", "lamp", "--set", "goals=few"], ["goals", "few"]),
        (["evolve", "lamp", "--set", "goal_low_m=2", "--set", "goal_high_m=1"], ["goal_low_m", "goal_high_m"]),
        (["evolve", "lamp", "--out", "/dev/null/run"], ["/dev/null/run"]),
        (["eval", "GOOD", "--inputs", "gone.csv"], [r"gone\.csv"]),
        (["transpile", "GOOD", "--out", "/dev/null/out"], ["/dev/null/out"]),
        (["transpile", "GOOD", "--out", "OUT", "--name", "two words"], ["two words"]),
        (["compare", "gone.mcap"], [r"gone\.mcap"]),
        (["compare", "GOOD"], [r"good\.controller\.toml", "MCAP"]),
        (["replay", "gone.mcap"], [r"gone\.mcap"]),
        (["replay", "GOOD"], [r"good\.controller\.toml", "MCAP"]),
        (["bench", "naps"], ["naps", "rollout"]),
        (["rig", "lst"], ["lst", "list"]),
        (["rig", "serve", "lamp-xc330", "--tcp", "70000"], ["70000"]),
        (["rig", "serve", "lamp-xc330", "--link", "/no/such/folder/tty"], ["/no/such/folder"]),
        (["demo", "--out", "/dev/null/demo"], ["/dev/null/demo"]),
    ],
    ids=" ".join,
)
def test_flags(folder, capsys, monkeypatch, arguments, places):
    monkeypatch.chdir(folder)
    names = {"GOOD": "good.controller.toml", "OUT": "out"}
    refused(capsys, [names.get(argument, argument) for argument in arguments], *places)


@pytest.mark.parametrize(
    ("old", "new", "places"),
    [
        ("torque_scale", "torqe_scale", ["torqe_scale", "torque_scale"]),
        ("0.8", "-0.8", ["torque_scale", r"-0\.8"]),
        ("0.8", "nan", ["torque_scale", "finite"]),
        ("0.8", "true", ["torque_scale", "number"]),
        ("format = 1", "format = 7", ["format", "7"]),
        ("[twin]", "[twine]", ["twin"]),
    ],
)
def test_a_twin_file(folder, capsys, old, new, places):
    path = folder / "bad-twin.toml"
    path.write_text(edit(TWIN, old, new))
    arguments = ["deploy", folder / "good.controller.toml", "--rig", "lamp-xc330", "--twin", path]
    refused(capsys, arguments, r"bad-twin\.toml", *places)


@pytest.mark.parametrize(
    ("text", "places"),
    [
        ("1,2,3\n", ["line 1", "3", "2"]),
        ("a0,px\n0.5,oops\n", ["line 2", "oops", "column 2"]),
        ("a0,pz\n0.5,1\n", ["line 1", "pz"]),
        ("a0,a0\n0.5,1\n", ["line 1", "a0", "twice"]),
        ("a0,px\n0.5,1e99\n", ["line 2", "1e99"]),
        ("a0,px\n0.5\n", ["line 2"]),
        ("é,px\n".encode("latin-1"), ["UTF-8"]),
    ],
)
def test_a_file_of_inputs(folder, capsys, text, places):
    path = folder / "bad.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    refused(capsys, ["eval", folder / "good.controller.toml", "--inputs", path], r"bad\.csv", *places)


# the process itself


@pytest.mark.parametrize(
    ("arguments", "places"),
    [
        (["show", "bad.controller.toml"], [r"bad\.controller\.toml", "line 5"]),
        (["deploy", "good.controller.toml", "--rig", "toaster"], ["toaster"]),
        (["evolve", "bad.py"], [r"bad\.py"]),
        (["compare", "good.controller.toml"], ["MCAP"]),
        (["deploy", "--frob"], ["--frob|controller|--rig"]),
    ],
    ids=" ".join,
)
def test_a_process_ends_with_status_2_and_one_sentence(folder, arguments, places):
    (folder / "bad.controller.toml").write_text(edit(CONTROLLER, "(% px 0.1)", "(% px)"))
    (folder / "bad.py").write_text("TASK = \n")
    command = [str(Path(sys.executable).with_name("servolve")), *arguments]
    ended = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 2, ended.stderr
    assert ended.stdout == ""
    check_sentence(ended.stderr, *places)


def test_a_defect_is_not_hidden(monkeypatch):
    def broken():
        raise ZeroDivisionError

    import servolve.cli

    monkeypatch.setattr(servolve.cli, "_app", lambda summaries: lambda arguments: broken())
    with pytest.raises(ZeroDivisionError):
        main(["show"])


def test_an_interrupt_is_one_sentence(monkeypatch, capsys):
    def interrupted(arguments):
        raise KeyboardInterrupt

    import servolve.cli

    monkeypatch.setattr(servolve.cli, "_app", lambda summaries: interrupted)
    refused(capsys, ["show"], "interrupted", status=1)


def test_a_missing_extra_is_named(monkeypatch, capsys):
    def without_mujoco(arguments):
        try:
            raise ModuleNotFoundError("No module named 'mujoco'", name="mujoco.batch")
        except ModuleNotFoundError as error:
            raise ImportError("Cannot import module") from error

    import servolve.cli

    monkeypatch.setattr(servolve.cli, "_app", lambda summaries: without_mujoco)
    refused(capsys, ["evolve"], "mujoco", r"servolve\[sim\]")


def test_an_unknown_command_is_told_without_the_extras(folder):
    # a fresh interpreter: here everything has been imported long since
    script = (
        "import sys\n"
        "class Without:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name.split('.')[0] in ('mujoco', 'matplotlib', 'jinja2', 'PIL', 'imageio'):\n"
        "            raise ModuleNotFoundError(f'No module named {name!r}', name=name)\n"
        "sys.meta_path.insert(0, Without())\n"
        "from servolve.cli import main\n"
        "sys.exit(main(sys.argv[1:]))\n"
    )
    for arguments, place in ((["dploy"], "dploy"), (["evolve", "lamp"], "mujoco")):
        command = [sys.executable, "-c", script, *arguments]
        ended = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=60, check=False)
        assert ended.returncode == 2, ended.stderr
        check_sentence(ended.stderr, place)
