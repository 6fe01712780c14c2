"""The demo: its folder, its goal, its gates, and the whole road with small numbers."""

from __future__ import annotations

import copy
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from controller.errors import InputError
from servolve import demo as module
from servolve.cli import main
from servolve.demo import goals_seen, judge, unseen_goal

HOPPER = Path(__file__).parent / "golden" / "lamp-hop.controller.toml"
TINY = {"population": 16, "generations": 2, "decision_goals": 3, "held_out_goals": 3, "hall_of_fame": 2, "goals": 2}
SET = [word for key, value in TINY.items() for word in ("--set", f"{key}={value}")]
LEFT = ("best.controller.toml", "lamp.h", "lamp.c", "sim.mcap", "rig.mcap", "strip.png", "report.html")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("demo") / "run"
    assert main(["evolve", "lamp-robust", "--seed", "5", "--out", str(folder), "--quiet", *SET]) == 0
    return folder


@pytest.fixture(scope="module")
def road(tmp_path_factory):
    """Take a controller that hops down the road; return the folder and what each command said."""
    out = tmp_path_factory.mktemp("road")
    shutil.copyfile(HOPPER, out / "best.controller.toml")
    found = module._road(module._Stages(Console(stderr=True)), out, 0.347)
    held_out = {"within_50_mm": 1.0, "mean_error_m": 0.01, "median_error_m": 0.01, "conditions": 24}
    return out, found | {"evolved": {"held_out": held_out}}


# the goal


def test_a_run_has_seen_the_goals_of_every_generation_of_the_choice_and_of_the_judgement(run):
    seen = goals_seen(run)
    assert len(seen) == TINY["generations"] * TINY["goals"] + TINY["decision_goals"] + TINY["held_out_goals"]
    assert all(0.1 <= goal <= 0.6 for goal in seen)
    assert len(set(seen)) == len(seen)


def test_the_demos_goal_is_unseen_and_always_the_same(run):
    seen = np.array(goals_seen(run))
    for seed in range(20):
        goal = unseen_goal(run, seed)
        assert np.abs(seen - goal).min() >= 0.001
        assert 0.2 <= goal <= 0.6
        assert goal == unseen_goal(run, seed)
    assert len({unseen_goal(run, seed) for seed in range(20)}) > 10


def test_a_goal_that_was_seen_is_drawn_again(run, monkeypatch):
    first = unseen_goal(run, 1)
    seen = goals_seen(run)
    monkeypatch.setattr(module, "goals_seen", lambda folder: [*seen, first + 0.0004])
    assert abs(unseen_goal(run, 1) - first) > 0.0005


# the road and its gates


def test_a_controller_that_hops_meets_every_gate(road):
    out, found = road
    gates = judge(found)
    assert [gate.name for gate in gates if not gate.passed] == []
    assert len(gates) == 8
    assert found["deployed"]["missed_deadlines"] == 0 and found["deployed"]["cycles"] >= 200
    assert found["recorded"]["values"] == 3 * found["deployed"]["cycles"]
    weak = max(joint["rmse_deg"] for joint in found["weak"]["joints"])
    assert weak > 4.0 * max(joint["rmse_deg"] for joint in found["compared"]["joints"])
    assert all((out / name).stat().st_size > 500 for name in LEFT)


@pytest.mark.parametrize(
    ("place", "value", "gate"),
    [
        (("evolved", "held_out", "within_50_mm"), 0.74, "the best passes its validation"),
        (("transpiled", "check", 0, "vm_differences"), 1, "C computes what the virtual machine does"),
        (("transpiled", "check", 0, "selftest"), 3, "C computes what the virtual machine does"),
        (("transpiled", "check"), [], "C computes what the virtual machine does"),
        (("recorded", "c"), 2, "the recorded terminals give the recorded outputs"),
        (("recorded", "vm"), 1, "the recorded terminals give the recorded outputs"),
        (("replayed", "bitwise"), False, "the log replays bit for bit"),
        (("deployed", "upright"), False, "the lamp ends upright"),
        (("deployed", "final_error_m"), 0.0501, "near its goal"),
        (("deployed", "hops"), 1, "having hopped"),
        (("compared", "joints", 1, "rmse_deg"), 1.01, "rig and simulation agree"),
        (("compared", "joints", 2, "rmse_deg"), None, "rig and simulation agree"),
    ],
)
def test_each_gate_can_fail_alone(road, place, value, gate):
    found = copy.deepcopy(road[1])
    *parents, last = place
    inside = found
    for key in parents:
        inside = inside[key]
    inside[last] = value
    assert [one.name for one in judge(found) if not one.passed] == [gate]


# the folder


def test_a_folder_of_someone_else_is_left_alone(tmp_path, capsys):
    (tmp_path / "thesis.tex").write_text("years of work")
    assert main(["demo", "--out", str(tmp_path)]) == 2
    assert "thesis" not in capsys.readouterr().out
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


def test_the_folder_of_an_earlier_demo_is_made_anew(tmp_path):
    module._make_folder(tmp_path)
    elsewhere = tmp_path.parent / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "kept").write_text("kept")
    (tmp_path / "old").mkdir()
    (tmp_path / "link").symlink_to(elsewhere)
    module._make_folder(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["demo.json"]
    assert (elsewhere / "kept").exists()


def test_a_file_for_a_folder_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="file"):
        module._make_folder(tmp_path / "file")


# all of it


@pytest.mark.slow
def test_the_whole_demo_with_small_numbers(tmp_path, capsys):
    out = tmp_path / "demo"
    status = main(["demo", "--out", str(out), "--seed", "3", "--json", *SET])
    printed = capsys.readouterr()
    told = json.loads(printed.out)
    assert told == json.loads((out / "demo.json").read_text("utf-8"))
    assert status == (0 if all(told["gates"].values()) else 1)
    # two generations of sixteen find no lamp that hops, and the demo must say so
    assert not told["gates"]["the best passes its validation"]
    (last,) = printed.err.strip().splitlines()[-1:]
    assert last.startswith("servolve: demo: gate not met: the best passes its validation: ")
    for gate in (
        "C computes what the virtual machine does",
        "the recorded terminals give the recorded outputs",
        "the log replays bit for bit",
        "rig and simulation agree",
    ):
        assert told["gates"][gate]
    assert all((out / name).is_file() for name in LEFT)
    assert {path.name for path in out.glob("evolution-*")} == {"evolution-3", "evolution-4", "evolution-5"}
    assert main(["replay", str(out / "rig.mcap")]) == 0
