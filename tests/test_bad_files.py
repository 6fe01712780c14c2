"""A wrong controller, rig or task file is refused in one sentence that says where and what to do."""

from __future__ import annotations

import re

import pytest
from bad_input import CONTROLLER, RIG, TASK, TWIN, edit, good_files, refused

from servolve.cli import main


@pytest.fixture
def folder(tmp_path):
    return good_files(tmp_path)


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
