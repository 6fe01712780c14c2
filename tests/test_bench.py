"""Benches: both sides do the same work, and bounds decide the exit status. No test here looks at a clock."""

from __future__ import annotations

import json

import numpy as np
import pytest

import servolve.bench
import sim_models.bench
from controller import load_rig
from controller.errors import RunError
from controller.native import NativeProgram
from servolve.cli import main
from sim_models.bench import bench_rollout, random_controller


@pytest.fixture
def short(monkeypatch):
    """Make the work small; it stays the same work."""
    monkeypatch.setattr(sim_models.bench, "_SECONDS", 0.3)
    monkeypatch.setattr(sim_models.bench, "_PROGRAMS", 2)


@pytest.mark.parametrize("seed", range(4))
def test_programs_have_the_size_asked_for(seed):
    controller = random_controller(np.random.default_rng(seed), load_rig("lamp-xc330"), 150)
    assert len(controller.program.instructions) == 150
    inputs = np.random.default_rng(0).uniform(-1, 1, (20, len(controller.inputs))).astype(np.float32)
    assert NativeProgram(controller.program).run(0.02, inputs).shape == (20, 3)


@pytest.mark.parametrize("form", ["planar", "free"])
@pytest.mark.parametrize("threads", [1, 2])
def test_both_sides_move_alike(short, form, threads):
    # it raises RunError if they do not
    found = bench_rollout(load_rig("lamp-xc330"), threads=threads, repeats=3, form=form)
    assert (found.form, found.threads, found.repeats) == (form, threads, 3)
    assert found.ratio in (found.ratio_to_batch, found.ratio_to_module) and found.ratio > 0


def test_sides_that_differ_are_refused(short, monkeypatch):
    angles = sim_models.bench._goal_angles
    monkeypatch.setattr(sim_models.bench, "_goal_angles", lambda rig, counts: angles(rig, counts) + 0.01)
    with pytest.raises(RunError, match="did not move alike"):
        bench_rollout(load_rig("lamp-xc330"), threads=1, repeats=1)


@pytest.mark.parametrize(("bound", "status"), [(0.0, 0), (1e9, 1)])
def test_bounds_decide_the_status(short, monkeypatch, capsys, bound, status):
    monkeypatch.setattr(servolve.bench, "ROLLOUT_RATIO_MIN", bound)
    monkeypatch.setattr(servolve.bench, "SHIPPED_RATIO_MIN", bound)
    assert main(["bench", "rollout", "--json"]) == status
    told = capsys.readouterr()
    rows = json.loads(told.out.splitlines()[-1])["rollout"]
    assert [(row["timers"], row["form"], row["threads"]) for row in rows] == [
        (timers, form, threads)
        for timers in ("as shipped", "off on both sides")
        for form in ("planar", "free")
        for threads in (1, 2)
    ]
    assert all(row["ok"] is (status == 0) and row["ratio"] > 0 for row in rows)
    assert ("below their bounds" in told.err) is (status == 1)


def test_an_unknown_bench_is_told(capsys):
    assert main(["bench", "frobnicate"]) == 2
    assert "choose one of rollout" in capsys.readouterr().err
