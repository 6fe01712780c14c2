"""The page on tasks: its files and commands work as they stand, its tables say what the code says."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from controller import load_rig
from evolve import load_task
from evolve.settings import Settings, describe
from servolve.cli import main
from sim_models.statistics import FIELDS

PAGE = (Path(__file__).parent.parent / "docs" / "tasks.md").read_text(encoding="utf-8")

# runs as small as may be: what is tested is that files and commands fit together
SMALL = [
    *("--population", "10", "--generations", "2", "--threads", "1", "--quiet", "--no-report"),
    *("--set", "time_limit_s=0.6", "--set", "goals=2", "--set", "race_goals=1", "--set", "stated_goals=1"),
    *("--set", "decision_goals=2", "--set", "held_out_goals=2", "--set", "hall_of_fame=2"),
]


def files():
    """Return the files that the page writes down, by name."""
    return dict(re.findall(r"^`([\w.-]+)`:\n\n```\w+\n(.*?)^```$", PAGE, re.S | re.M))


def commands():
    """Return the commands of its shell blocks."""
    lines = "".join(re.findall(r"^```sh\n(.*?)^```$", PAGE, re.S | re.M)).splitlines()
    assert all(line.startswith("servolve ") for line in lines)
    return [shlex.split(line)[1:] for line in lines]


def table(after):
    """Return the rows of the first table after a line, without its head."""
    block = PAGE.split(f"\n{after}\n", 1)[1].split("|\n\n", 1)[0]
    rows = [line.strip("|") for line in block[block.index("\n|") :].strip().splitlines()]
    return [tuple(cell.strip().replace("\\|", "|") for cell in re.split(r"(?<!\\)\|", row)) for row in rows[2:]]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    for name, text in files().items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_every_block_is_a_file_or_commands():
    assert set(files()) == {"walk.py", "sill.py", "crawler.xml", "crawler.rig.toml", "crawl.py"}
    assert len(re.findall(r"^```\w+$", PAGE, re.M)) == len(files()) + len(re.findall(r"^```sh$", PAGE, re.M))


def test_the_page_can_be_typed(folder, capsys):
    for command in commands():
        extra = SMALL if command[0] == "evolve" else ["--seconds", "0.5"] if command[0] == "simulate" else []
        assert main([*command, *extra]) == 0, (command, capsys.readouterr().err)
    for task in ("walk", "sill", "crawl"):
        assert f'task = "{task}"' in (folder / "runs" / task / "run.toml").read_text()
        assert (folder / "runs" / task / "best.controller.toml").is_file()
    assert (folder / "crawl.png").stat().st_size > 0


def test_every_statistic_is_listed():
    assert table("### Statistics") == [(f"`{name}`", unit, meaning) for name, unit, meaning in FIELDS]


def test_every_setting_is_listed():
    expected = [
        (f"`{one.name}`", one.value, one.allowed.replace(" | ", ", "), one.meaning) for one in describe(Settings())
    ]
    assert table("## Settings") == expected


def test_the_command_lists_the_settings(folder, capsys):
    assert main(["evolve", "walk.py", "--set", "elites=4", "--help-settings"]) == 0
    said = capsys.readouterr().out
    for name, value in (("population", "150"), ("goal_low_m", "0.2"), ("elites", "4"), ("selection", "tournament")):
        assert re.search(rf"^ *{name} +{value} ", said, re.M), said
    assert not (folder / "runs").exists()


def test_a_run_of_a_body_of_ones_own_goes_on_without_its_files(folder, capsys):
    assert main(["evolve", "crawl.py", "--out", "run", *SMALL]) == 0
    for name in ("best.controller.toml", "validation.json"):
        (folder / "run" / name).unlink()
    for name in files():
        (folder / name).unlink()
    assert main(["evolve", "--resume", "run", "--threads", "1", "--quiet", "--no-report"]) == 0, capsys.readouterr().err
    assert (folder / "run" / "best.controller.toml").is_file()


@pytest.mark.parametrize(
    ("file", "before", "after", "told"),
    [
        ("walk.py", '"upright_end"', '"upright"', r"walk\.py:8: .*upright"),
        ("walk.py", "return main, style", "return main", r"walk\.py: fitness gave"),
        ("walk.py", '"goal_met"', '"vx"', r"terminal 'vx' cannot be had on rig lamp-xc330"),
        ("walk.py", "population=150", "population=1", r"walk\.py: population is 1; give a number from 2"),
        ("sill.py", "traces=True", "traces=False", r"sill\.py:23: TypeError.*traces=True"),
        ("sill.py", "def scene(spec, settings):", "def scene(spec):", r"sill\.py: TypeError: scene\(\) takes 1"),
        ("sill.py", "mjGEOM_BOX", "mjGEOM_BRICK", r"sill\.py:13: AttributeError"),
        ("crawl.py", '"crawler.rig.toml"', '"crawler.toml"', r"crawler\.toml"),
        ("crawler.rig.toml", '"shoulder"\nmjcf_joint = "shoulder"', '"shoulder"\nmjcf_joint = "sholder"', r"sholder"),
        ("crawler.xml", 'name="foot_', 'name="leg_', r"crawler\.xml: no geom's name begins with 'foot'"),
        ("crawler.xml", 'name="elbow" joint', 'name="elbo" joint', r"crawler.*elbow"),
    ],
)
def test_a_mistake_is_one_sentence_and_leaves_no_folder(folder, capsys, file, before, after, told):
    text = files()[file]
    assert before in text
    (folder / file).write_text(text.replace(before, after), encoding="utf-8")
    task = file if file.endswith(".py") else "crawl.py"
    assert main(["evolve", task, "--out", "run", *SMALL]) == 2
    said = capsys.readouterr()
    assert said.out == "" and len(said.err.strip().splitlines()) == 1, said.err
    assert re.search(told, said.err), said.err
    assert not (folder / "run").exists()


def test_the_path_of_a_rig_is_seen_from_the_tasks_file(folder, tmp_path_factory, monkeypatch):
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    assert load_rig(load_task(str(folder / "crawl.py")).rig).path == folder / "crawler.rig.toml"
    assert load_task(str(folder / "walk.py")).rig == "lamp-xc330"
