"""Searches by every method of selection: the same at any thread count, and what each promises about its population."""

from __future__ import annotations

import json
import sqlite3

import numpy as np
import pytest

from evolve import RunConfig, apply_overrides, evolve, load_task, ordered_dump, resume

TASK = load_task("lamp-robust")
SMALL = [
    "population=20",
    "generations=3",
    "goals=3",
    "race_goals=1",
    "time_limit_s=0.6",
    "decision_goals=3",
    "held_out_goals=2",
]
METHODS = (
    "selection=proportionate",
    "parsimony=lexicographic",
    "parsimony=tarpeian",
    "parsimony=double",
    "objectives=size,instructions,peak_torque",
    "redraw=false",
)


def run(folder, *overrides, threads=1, decide=False):
    settings = apply_overrides(TASK.settings, [*SMALL, "elites=2", *overrides])
    evolve(RunConfig(TASK, folder, 3, settings, None, threads, decide=decide), lambda _: None)
    return ordered_dump(folder / "history.sqlite")


def rows(folder, query):
    with sqlite3.connect(folder / "history.sqlite") as connection:
        return connection.execute(query).fetchall()


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return run(tmp_path_factory.mktemp("plain") / "run")


@pytest.mark.parametrize("method", METHODS)
def test_every_method_gives_the_same_run_at_any_thread_count_and_one_of_its_own(tmp_path, method, plain):
    one, two = run(tmp_path / "one", method), run(tmp_path / "two", method, threads=2)
    assert one == two != plain


@pytest.mark.parametrize("method", METHODS)
def test_every_method_goes_on_as_if_nothing_had_happened(tmp_path, method):
    def interrupt(progress):
        if progress.generation == 1:
            raise KeyboardInterrupt

    settings = apply_overrides(TASK.settings, [*SMALL, "elites=2", method])
    folder = tmp_path / "stopped"
    with pytest.raises(KeyboardInterrupt):
        evolve(RunConfig(TASK, folder, 3, settings, None, 1, decide=False), interrupt)
    resume(folder, 1, lambda _: None)
    assert ordered_dump(folder / "history.sqlite") == run(tmp_path / "whole", method)


def test_conditions_are_drawn_once_on_request(tmp_path):
    run(tmp_path / "run", "redraw=false")
    assert len(rows(tmp_path / "run", "select distinct draw, goals from generation")) == 1
    (simulations,) = zip(*rows(tmp_path / "run", "select simulations from generation order by generation"), strict=True)
    assert simulations[1] < simulations[0], "who is met again is remembered"


def test_tarpeian_control_simulates_no_condemned_and_spares_the_elite(tmp_path):
    run(tmp_path / "run", "parsimony=tarpeian", "tarpeian_share=1")
    found = rows(tmp_path / "run", "select generation, nodes, conditions, main, operator, rank from evaluation")
    for generation in range(3):
        sizes = np.mean([nodes for number, nodes, *_ in found if number == generation])
        for number, nodes, conditions, main, operator, rank in found:
            if number == generation and operator != "elite":
                assert (conditions == 0) == (nodes > sizes)
                assert np.isinf(main) == (conditions == 0)
                assert conditions or rank >= 2
            if operator == "elite":
                assert conditions > 0


def test_the_front_is_written_and_nobody_on_it_beats_another(tmp_path):
    run(tmp_path / "run", "objectives=size,peak_torque", decide=True)
    content = json.loads((tmp_path / "run" / "pareto.json").read_text())
    points = np.array([[one["fitness"], one["size"], one["peak_torque"]] for one in content["front"]])
    assert content["format"] == 1 and len(points) >= 1
    for one in points:
        assert not np.any(np.all(points <= one, axis=1) & np.any(points < one, axis=1))
    recorded = {
        (g, i): program
        for g, i, program in rows(tmp_path / "run", "select generation, individual, program from evaluation")
    }
    assert all(recorded[one["generation"], one["individual"]] == one["program"] for one in content["front"])
    assert all(one["conditions"] == 3 for one in content["front"])


def test_without_objectives_there_is_no_front(tmp_path):
    run(tmp_path / "run", decide=True)
    assert not (tmp_path / "run" / "pareto.json").exists()


@pytest.mark.parametrize("change", [["cache=false"], ["stop_early=false"], ["lean=false"], ["timer=true"]])
def test_what_saves_time_changes_no_history(tmp_path, change, plain):
    slow = run(tmp_path / "run", *change)
    assert without_counts(slow) == without_counts(plain)
    assert (slow == plain) == (change != ["cache=false"])


def without_counts(dump):
    """Return a history's lines without the number of simulations, which is what a cache changes."""
    lines = [json.loads(line) for line in dump.splitlines()]
    return [line[:-1] if line[0] == "generation" else line for line in lines]
