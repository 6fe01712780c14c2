"""Whole runs, small ones: the same at any thread count, honest about what a fitness means, complete in their folder."""

from __future__ import annotations

import dataclasses
import json
import sqlite3
import tomllib

import numpy as np
import pytest

from controller import load_controller, load_rig, lower, parse, program_hash
from controller.native import NativeProgram
from evolve import RunConfig, apply_overrides, evolve, load_task, ordered_dump
from evolve.conditions import conditions, draw_conditions, pick
from evolve.decide import validate
from evolve.evaluate import Cache, Race, evaluate
from evolve.gp.tree_gp import tree_gp
from evolve.search import ask, tell
from evolve.streams import Stream, generator
from evolve.template import controller_template
from servolve.cli import main
from sim_models.perturbations import nominal_perturbations
from sim_models.rollouts import RolloutPool

TASK = load_task("lamp-robust")
SMALL = apply_overrides(
    TASK.settings,
    [
        "population=24",
        "generations=4",
        "goals=4",
        "race_goals=2",
        "race_share=0.4",
        "time_limit_s=1",
        "decision_goals=6",
        "held_out_goals=6",
        "hall_of_fame=6",
        "crossover=0.7",
        "mutate_subtree=0.1",
        "mutate_point=0.05",
        "mutate_constant=0.05",
    ],
)
RIG = load_rig(TASK.rig)
FILES = ("run.toml", "best.controller.toml", "validation.json")


def run(folder, threads=1, seed=5, settings=SMALL):
    told = []
    result = evolve(RunConfig(TASK, folder, seed, settings, None, threads), told.append)
    return result, told


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run") / "one"
    return (folder, *run(folder))


@pytest.fixture
def pool():
    with RolloutPool(RIG, form="planar", timestep_s=0.004, time_limit_s=1.0, threads=1, stop=TASK.stop) as opened:
        yield opened


@pytest.fixture(scope="module")
def method():
    return tree_gp(TASK.terminals, len(RIG.joints), SMALL), controller_template(TASK, RIG, SMALL)


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_the_same_seed_gives_the_same_run_at_any_thread_count(finished, tmp_path, threads):
    folder = finished[0]
    run(tmp_path / "again", threads)
    for name in FILES:
        assert (tmp_path / "again" / name).read_bytes() == (folder / name).read_bytes(), name
    assert ordered_dump(tmp_path / "again" / "history.sqlite") == ordered_dump(folder / "history.sqlite")


def test_another_seed_gives_another_run(finished, tmp_path):
    run(tmp_path / "other", seed=6)
    assert ordered_dump(tmp_path / "other" / "history.sqlite") != ordered_dump(finished[0] / "history.sqlite")


def test_every_generation_draws_its_conditions_anew(finished):
    with sqlite3.connect(finished[0] / "history.sqlite") as connection:
        draws, goals, phases = zip(*connection.execute("select draw, goals, phase from generation"), strict=True)
    assert len(set(draws)) == len(set(goals)) == SMALL.generations
    assert phases == tuple(np.sqrt(g / SMALL.generations) for g in range(SMALL.generations))
    assert all(0.1 <= goal <= 0.6 for text in goals for goal in json.loads(text))


def test_the_history_tells_where_everyone_came_from(finished):
    with sqlite3.connect(finished[0] / "history.sqlite") as connection:
        rows = connection.execute(
            "select generation, individual, program, operator, parents, conditions from evaluation"
        ).fetchall()
        texts = dict(connection.execute("select hash, text from program"))
    assert len(rows) == SMALL.generations * SMALL.population
    programs = {(generation, individual): program for generation, individual, program, *_ in rows}
    expected_parents = {"start": 0, "crossover": 2, "reproduction": 1}
    seen = set()
    for generation, individual, program, operator, parents_text, met in rows:
        parents = json.loads(parents_text)
        seen.add(operator)
        assert len(parents) == expected_parents.get(operator, 1)
        assert (operator == "start") == (generation == 0)
        assert met in (2, 4)
        assert program_hash(lower(parse(texts[program], TASK.terminals), TASK.terminals)) == program
        if operator == "reproduction":
            assert programs[generation - 1, parents[0]] == program
        assert (generation, individual) in programs
    assert {"start", "crossover", "reproduction"} <= seen


def test_the_best_is_reported_as_it_is(finished):
    folder, result, told = finished
    best = load_controller(folder)
    assert program_hash(best.program) == result.candidate.program == best.provenance["program_hash"]
    assert best.filter == SMALL.filter and best.slew_rad_s == SMALL.slew_rad_s
    assert best.provenance["seed"] == 5
    with sqlite3.connect(folder / "history.sqlite") as connection:
        (program,) = connection.execute(
            "select program from evaluation where generation = ? and individual = ?",
            (result.candidate.generation, result.candidate.individual),
        ).fetchone()
        simulations = connection.execute("select sum(simulations) from generation").fetchone()[0]
    assert program == result.candidate.program
    assert simulations == result.simulations == told[-1].simulations
    written = json.loads((folder / "validation.json").read_text())
    assert written["held_out"] == dataclasses.asdict(result.validation)
    assert written["stated"] == dataclasses.asdict(result.stated)
    assert result.stated.conditions == SMALL.stated_goals
    assert len(written["goal_m"]) == SMALL.held_out_goals
    assert tomllib.loads((folder / "run.toml").read_text())["settings"] == dataclasses.asdict(SMALL)
    assert [p.generation for p in told] == list(range(SMALL.generations))


def test_the_reported_figures_can_be_had_again(finished, method):
    folder, result, _ = finished
    held_out = draw_conditions(generator(5, Stream.HELD_OUT), SMALL, SMALL.held_out_goals, len(RIG.joints))
    with RolloutPool(RIG, form="free", timestep_s=0.002, time_limit_s=1.0, threads=2, stop=TASK.stop) as pool:
        assert validate(TASK, pool, load_controller(folder), held_out) == result.validation
        stated = draw_conditions(
            generator(5, Stream.STATED), SMALL, SMALL.stated_goals, len(RIG.joints), nominal=SMALL.stated_goals
        )
        assert validate(TASK, pool, load_controller(folder), stated) == result.stated
    decision = draw_conditions(generator(5, Stream.DECISION), SMALL, SMALL.decision_goals, len(RIG.joints))
    assert not set(held_out.keys) & set(decision.keys), "what chose the best does not judge it"


def test_the_golden_trace_is_what_the_program_answers(finished):
    best = load_controller(finished[0])
    inputs, outputs = (
        np.array([[int(bits, 16) for bits in row] for row in best.golden[key]], np.uint32).view(np.float32)
        for key in ("inputs", "outputs")
    )
    assert len(inputs) > 10
    raw = NativeProgram(best.program).run(best.period_s, inputs)
    low, high, neutral = (
        np.array([getattr(o, key) for o in best.outputs], np.float32) for key in ("low", "high", "neutral")
    )
    answered = np.clip(np.where(np.isnan(raw), neutral, raw), low, high)
    assert np.array_equal(answered.view(np.uint32), outputs.view(np.uint32))


def test_a_race_decides_who_meets_more_not_what_a_fitness_is(pool, method):
    gp, template = method
    population = ask(gp, SMALL, 1, None)
    numbers = dataclasses.replace(SMALL, race_goals=0)
    raced = tell(TASK, gp, SMALL, template, pool, Cache(), 1, 0, population)
    everyone = tell(TASK, gp, numbers, template, pool, Cache(), 1, 0, population)
    assert raced.conditions.keys == everyone.conditions.keys
    complete = raced.evaluation.met == 4
    assert 0 < complete.sum() < len(population)
    assert np.all(everyone.evaluation.met == 4)
    assert np.array_equal(raced.evaluation.main[complete], everyone.evaluation.main[complete])
    assert np.array_equal(raced.evaluation.style[complete], everyone.evaluation.style[complete])
    first = evaluate(TASK, pool, raced.controllers, raced.programs, pick(raced.conditions, [0, 1]), Cache(), None)
    assert np.array_equal(raced.evaluation.main[~complete], first.main[~complete])
    standing = first.fitness(0.0)
    assert standing[complete].max() <= standing[~complete].min()
    assert raced.rank[complete].max() < raced.rank[~complete].min()


def test_a_cache_saves_rollouts_and_changes_nothing(pool, method):
    gp, template = method
    start = ask(gp, SMALL, 2, None)
    population = [*start[:6], *start[:6], *start[:3]]
    without = dataclasses.replace(SMALL, cache=False, race_goals=0)
    within = dataclasses.replace(SMALL, race_goals=0)
    cold, cached, again = Cache(), Cache(), None
    plain = tell(TASK, gp, without, template, pool, cold, 2, 0, population)
    saved = tell(TASK, gp, within, template, pool, cached, 2, 0, population)
    assert cold.simulations == 15 * 4
    assert cached.simulations == len(set(saved.programs)) * 4 <= 6 * 4
    for one, other in (
        (plain, saved),
        (plain, again := tell(TASK, gp, within, template, pool, cached, 2, 0, population)),
    ):
        assert np.array_equal(one.evaluation.main, other.evaluation.main)
        assert np.array_equal(one.evaluation.style, other.evaluation.style)
        assert np.array_equal(one.evaluation.hits, other.evaluation.hits)
    assert again is not None and cached.simulations == len(set(saved.programs)) * 4, "nothing is simulated twice"


def test_new_conditions_are_not_answered_from_memory(pool, method):
    gp, template = method
    population = ask(gp, SMALL, 3, None)
    cache = Cache()
    first = tell(TASK, gp, SMALL, template, pool, cache, 3, 0, population)
    before = cache.simulations
    second = tell(TASK, gp, SMALL, template, pool, cache, 3, 1, population)
    assert cache.simulations - before > len(set(first.programs))
    assert not np.array_equal(first.evaluation.main, second.evaluation.main)
    assert {key for _, key in cache.outcomes} == set(second.conditions.keys), "old conditions are forgotten"


def test_a_lamp_that_holds_still_is_as_far_as_its_goal(pool, method):
    template = method[1]
    goals = np.array([0.4, 0.01, -0.2])
    met = conditions(goals, np.zeros(3), nominal_perturbations(3, 3))
    one = [evaluate(TASK, pool, [template], ["x"], pick(met, [i]), Cache()) for i in range(3)]
    assert [e.main[0] for e in one] == pytest.approx([0.4, 0.01, 0.2], abs=2e-3)
    assert [int(e.hits[0]) for e in one] == [0, 1, 0]


def test_a_race_of_unfit_takes_the_lowest(pool, method):
    template = method[1]
    fallers = dataclasses.replace(
        template,
        source=parse("(list 60 60 60)", TASK.terminals),
        program=lower(parse("(list 60 60 60)", TASK.terminals), TASK.terminals),
    )
    drawn = draw_conditions(generator(1, Stream.CONDITIONS), SMALL, 4, 3)
    evaluation = evaluate(TASK, pool, [fallers, template], ["f", "s"], drawn, Cache(), Race(2, 0.4, 0.0))
    assert evaluation.met.tolist() == [2, 4]
    assert evaluation.main[0] > evaluation.main[1] + 0.3, "a fall costs half a metre"


def test_the_command_prints_one_object_and_progress_apart(tmp_path, capsys):
    arguments = [
        "evolve",
        "lamp",
        "--out",
        str(tmp_path / "r"),
        "--seed",
        "2",
        "--population",
        "8",
        "--json",
        "--no-report",
    ]
    arguments += ["--generations", "2", "--set", "time_limit_s=0.4", "--set", "decision_goals=2"]
    assert main([*arguments, "--set", "held_out_goals=2", "--threads", "1"]) == 0
    said = capsys.readouterr()
    summary = json.loads(said.out)
    assert summary["held_out"]["conditions"] == 2
    assert summary["program_hash"] == program_hash(load_controller(summary["run"]).program)
    assert "generation 1 (2 of 2)" in said.err
