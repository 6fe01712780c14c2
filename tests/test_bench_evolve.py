"""The race against DEAP: an implementation of its own comes to the same, and a tiny race gives sane tables."""

from __future__ import annotations

import dataclasses
import json
import random
import sys

import numpy as np
import pytest
from deap import gp

import servolve.bench
import servolve.bench_evolve
from controller import load_rig
from controller.errors import InputError, RunError
from controller.native import NativeProgram
from evolve.conditions import draw_conditions
from evolve.evaluate import simulate
from evolve.runs.run_plan import open_pool
from evolve.search import ask, controller_of
from evolve.streams import Stream, generator
from servolve.bench_evolve import (
    BOUNDS,
    WITH,
    WITHOUT,
    Contest,
    baseline,
    check_alike,
    make_contest,
    quality,
    search_plan,
    summary,
)
from servolve.bench_measures import MEASURES
from servolve.cli import main
from servolve.deap_baseline import DeapSearch, from_expression, primitive_set, to_expression
from servolve.deap_rollout import TERMINALS, make_cases, make_loop, rollout
from sim_models.statistics import STATISTICS

NCONDITION = 3


@pytest.fixture(scope="module")
def contest():
    full = make_contest(1, quick=True)
    settings = dataclasses.replace(full.settings, population=8, goals=3, time_limit_s=2.0)
    return dataclasses.replace(full, settings=settings)


@pytest.fixture(scope="module")
def plan(contest):
    return search_plan(dataclasses.replace(contest, settings=dataclasses.replace(contest.settings, population=40)), 3)


@pytest.fixture(scope="module")
def controllers(plan):
    return [controller_of(plan.engine, plan.template, each) for each in ask(plan.engine, plan.settings, 3, None)]


@pytest.fixture(scope="module")
def conditions(plan):
    return draw_conditions(generator(5, Stream.HELD_OUT), plan.settings, NCONDITION, 3)


def both_sides(plan, controllers, conditions, timestep_s, stop_early=True):
    """Return the statistics of the native rollouts and of those in Python, (ncontroller * ncondition,) each."""
    index = np.array([(i, j) for i in range(len(controllers)) for j in range(NCONDITION)], np.int32)
    with open_pool(plan, "planar", timestep_s) as pool:
        native = simulate(pool, controllers, conditions, index).statistics
    limit_s, stop = plan.settings.time_limit_s, plan.task.stop
    loop = make_loop(plan.rig, plan.template, timestep_s, limit_s, stop, stop_early=stop_early)
    cases = make_cases(loop, conditions)
    pset = primitive_set(plan.settings)
    slow = []
    for controller in controllers:
        programs = [gp.compile(from_expression(pset, each), pset) for each in controller.source.outputs]
        slow += [rollout(loop, case, programs) for case in cases]
    return native, np.array(slow)


@pytest.mark.parametrize("timestep_s", [0.004, 0.005])
def test_the_same_controller_under_the_same_condition_ends_at_the_same_place(plan, controllers, conditions, timestep_s):
    # float64 and float32 part where contacts are chaotic, and a fall between two control instants is seen later
    native, slow = both_sides(plan, controllers, conditions, timestep_s)
    assert np.mean(np.abs(native["final_error"] - slow["final_error"]) < 1e-6) >= 0.9
    for name in ("alive_steps", "fallen", "upright_end", "hops", "first_hit_step", "arrive_step", "idle_steps"):
        assert np.mean(native[name] == slow[name]) >= 0.9, name
    for name in ("end_speed", "end_joint_error", "end_joint_speed", "max_clearance", "joint_path_after_hit", "path"):
        assert np.mean(np.abs(native[name] - slow[name]) < 1e-4) >= 0.9, name
    # it says something: they move, some fall, some hop
    assert np.ptp(native["final_error"]) > 0.1 and 0 < np.mean(native["fallen"] != 0) < 1


def test_an_early_stop_changes_no_statistic(plan, controllers, conditions):
    _, early = both_sides(plan, controllers[:8], conditions, 0.005)
    _, late = both_sides(plan, controllers[:8], conditions, 0.005, stop_early=False)
    assert any(early["fallen"])
    for name in STATISTICS.names:
        np.testing.assert_array_equal(early[name], late[name])


def test_trees_are_the_programs_that_servolve_runs(plan, controllers):
    pset = primitive_set(plan.settings)
    inputs = np.random.default_rng(0).uniform(-2, 2, (50, len(TERMINALS))).astype(np.float32)
    inputs[:10, 4] = 0.0
    for controller in controllers:
        trees = [from_expression(pset, each) for each in controller.source.outputs]
        assert tuple(to_expression(tree) for tree in trees) == controller.source.outputs
        found = NativeProgram(controller.program).run(0.02, inputs)
        functions = [gp.compile(tree, pset) for tree in trees]
        wanted = [[function(*row) for function in functions] for row in inputs.astype(float).tolist()]
        # a difference that binary32 rounds to 0 chooses another branch
        assert np.mean(np.isclose(found, wanted, rtol=1e-3, atol=1e-3, equal_nan=True)) > 0.97


def test_bred_trees_keep_the_bounds_and_come_again_from_the_same_seed(contest):
    settings = dataclasses.replace(contest.settings, population=4, generations=3, goals=1, time_limit_s=0.2)
    small = dataclasses.replace(contest, settings=dataclasses.replace(settings, nodes_max=60))
    runs = []
    with DeapSearch(baseline(small, WITH), 7, 1) as search:
        for _ in range(2):
            random.random()
            runs.append([controller.source for controller in search.generations()])
            for source in runs[-1]:
                for tree in search.trees(source):
                    assert tree.height <= settings.depth_max and len(tree) <= 127
    assert runs[0] == runs[1] and len(runs[0]) == 3


def test_the_baselines_differ_in_stop_and_step(contest):
    without, with_both = baseline(contest, WITHOUT), baseline(contest, WITH)
    assert (without.timestep_s, without.stop_early) == (0.002, False)
    assert (with_both.timestep_s, with_both.stop_early) == (contest.settings.screen_timestep_s, True)
    assert without.settings == with_both.settings


def test_a_standing_lamp_is_as_far_as_its_goals(plan, conditions):
    with open_pool(plan, "planar", 0.004) as judge:
        assert quality(judge, plan.template, conditions) == pytest.approx(np.mean(conditions.goal_m), abs=0.02)


def test_factors_are_medians_over_seeds(contest):
    sides = ("servolve", *BOUNDS)
    seconds = {"servolve": (1.0, 2.0, 9.0), WITHOUT: (16.0, 30.0, 40.0), WITH: (3.0, 5.0, 60.0)}
    rows = [
        {
            "side": side,
            "seed": seed,
            "seconds": seconds[side][seed],
            "generations": 3,
            "arrived": side != WITH or seed < 2,
        }
        for side in sides
        for seed in range(3)
    ]
    without, with_both = summary(contest, rows)
    assert (without["ratio"], without["ok"], without["censored"]) == (15.0, True, 0)
    assert (with_both["ratio"], with_both["ok"], with_both["censored"]) == (2.5, True, 1)
    assert without["ratio_a_generation"] == pytest.approx(86 / 12, abs=0.01)
    rows[0]["arrived"] = False
    assert not summary(contest, rows)[0]["ok"]


@pytest.fixture
def tiny(monkeypatch, contest):
    """Make the work small; it stays the same work."""
    small = dataclasses.replace(contest, quality_m=10.0, conditions=2)

    def make(seeds: int, *, quick: bool) -> Contest:
        return dataclasses.replace(small, seeds=tuple(range(1, seeds + 1)))

    monkeypatch.setattr(servolve.bench_evolve, "make_contest", make)
    monkeypatch.setattr(servolve.bench_evolve, "THREADS", 1)
    monkeypatch.setattr(servolve.bench, "_QUICK", {"populations": 1, "size": 3, "turns": 1})


def test_a_tiny_race_gives_sane_tables(tiny, capsys):
    assert main(["bench", "evolve", "--quick", "--json"]) == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert [row["against"] for row in found["evolve"]] == list(BOUNDS)
    assert all(row["ratio"] > 0 and row["seeds"] == 1 and "bound" not in row for row in found["evolve"])
    assert [row["side"] for row in found["evolve_runs"]] == ["servolve", *BOUNDS]
    for row in found["evolve_runs"]:
        assert row["arrived"] and row["generations"] == 1 and row["seconds"] > 0 and 0 < row["quality_m"] <= 10
    assert [row["measure"] for row in found["evolve_measures"]] == list(MEASURES)
    assert all(
        row["seconds"] > 0 and row["factor"] > 0 and row["factor_so_far"] > 0 for row in found["evolve_measures"]
    )
    assert [row["left_out"] is None for row in found["evolve_measures"]] == [True] + [False] * (len(MEASURES) - 1)


def test_sides_that_differ_are_refused(contest, monkeypatch):
    monkeypatch.setattr(servolve.bench_evolve, "THREADS", 1)
    monkeypatch.setattr(servolve.bench_evolve, "_ALIKE_M", -1.0)
    with pytest.raises(RunError, match="worth the same on both sides"):
        check_alike(contest, 2)


def test_other_terminals_are_refused(plan):
    other = dataclasses.replace(plan.template, inputs=plan.template.inputs[:3])
    with pytest.raises(InputError, match="DEAP baseline"):
        make_loop(load_rig("lamp-xc330"), other, 0.004, 1.0, plan.task.stop, stop_early=True)


def test_the_number_of_seeds_is_checked(capsys):
    assert main(["bench", "evolve", "--seeds", "0"]) == 2
    assert "--seeds 0" in capsys.readouterr().err


def test_a_missing_deap_is_told(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "deap", None)
    for name in ("bench_evolve", "bench_measures", "deap_baseline"):
        monkeypatch.delitem(sys.modules, f"servolve.{name}")
    assert main(["bench", "evolve"]) == 2
    assert "needs deap; install it with: pip install 'servolve[dev]'" in capsys.readouterr().err
