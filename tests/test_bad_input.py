"""Wrong input, through the real command line: status 2, one sentence that names file, place and remedy, no traceback.

What each sentence must name was written down before the parsers were, from the file formats alone.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from bad_input import CONTROLLER, TWIN, check_sentence, edit, good_files, refused

from servolve.cli import main


@pytest.fixture
def folder(tmp_path):
    return good_files(tmp_path)


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
