"""Objectives against closed forms: fronts of lattices, room around points of a line, ranks, the worst case."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controller import load_rig
from evolve import load_task
from evolve.decide import Candidate, candidates_of, front, hall_of_fame
from evolve.evaluate import Evaluation
from evolve.gp.tree_gp import tree_gp
from evolve.objectives import crowding, fronts, pareto_ranks, points, worst_case
from evolve.search import controller_of
from evolve.settings import OBJECTIVES, Settings
from evolve.template import controller_template
from firmware_gen.transpiler.unit import make_unit

LATTICE = st.lists(st.tuples(*[st.integers(0, 4)] * 3), min_size=1, max_size=40).map(lambda rows: np.array(rows, float))


def dominates(one, other):
    return bool(np.all(one <= other) and np.any(one < other))


@pytest.mark.parametrize("shape", [(6, 6), (4, 3, 5), (7,)])
def test_a_lattice_sorts_into_its_diagonals(shape):
    lattice = np.array(list(itertools.product(*(range(side) for side in shape))), float)
    mixed = np.random.default_rng(0).permutation(lattice)
    assert fronts(mixed).tolist() == mixed.sum(axis=1).tolist()


@settings(derandomize=True, deadline=None, max_examples=60)
@given(drawn=LATTICE)
def test_a_front_is_one_behind_the_last_that_dominates_it(drawn):
    found = fronts(drawn)
    for index, point in enumerate(drawn):
        behind = [found[other] for other in range(len(drawn)) if dominates(drawn[other], point)]
        assert found[index] == max(behind, default=-1) + 1


@settings(derandomize=True, deadline=None, max_examples=60)
@given(drawn=LATTICE, seed=st.integers(0, 100))
def test_fronts_do_not_depend_on_the_order(drawn, seed):
    order = np.random.default_rng(seed).permutation(len(drawn))
    assert fronts(drawn[order]).tolist() == fronts(drawn)[order].tolist()


def test_crowding_is_the_neighbours_distance_in_parts_of_the_extent():
    line = np.array([(3.0, 1.0), (0.0, 4.0), (4.0, 0.0), (1.0, 2.0)])
    assert crowding(line).tolist() == [3 / 4 + 2 / 4, np.inf, np.inf, 3 / 4 + 3 / 4]
    even = np.stack((np.arange(11), 10.0 - np.arange(11)), axis=1)
    assert crowding(even)[1:-1] == pytest.approx(np.full(9, 0.4))
    assert crowding(line[:1]).tolist() == [np.inf]
    assert crowding(np.ones((3, 2)))[1] == 0


def test_ranks_take_fronts_then_room_then_fitness():
    stand = np.array([(3.0, 1.0), (0.0, 4.0), (4.0, 0.0), (1.0, 2.0), (5.0, 5.0), (np.inf, 0.0), (0.0, 0.0)])
    complete = np.array([True, True, True, True, True, True, False])
    assert pareto_ranks(stand, complete).tolist() == [3, 0, 1, 2, 4, 6, 5]


def test_without_a_second_objective_ranks_are_by_fitness():
    fitness = np.random.default_rng(1).random(50)
    assert pareto_ranks(fitness[:, None], np.ones(50, bool)).tolist() == np.argsort(np.argsort(fitness)).tolist()


def test_what_objectives_measure():
    task, numbers = load_task("lamp-robust"), Settings(population=12)
    rig = load_rig(task.rig)
    gp, template = tree_gp(task.terminals, 3, numbers), controller_template(task, rig, numbers)
    population = gp.start(np.random.default_rng(3))
    controllers = [controller_of(gp, template, individual) for individual in population]
    told = [worst_case(controller.program) for controller in controllers]
    assert told == [make_unit(controller).worst_case for controller in controllers]
    assert len(set(told)) > 3
    nodes = np.array([gp.nodes(individual) for individual in population])
    some = np.linspace(0, 1, 12)
    evaluation = Evaluation(some, some, np.ones(12, int), np.zeros(12, int), np.zeros(12, int), some[::-1])
    programs = [controller.program for controller in controllers]
    expected = np.stack((1.5 * some, nodes, told, some[::-1]), axis=1)
    assert np.array_equal(points(OBJECTIVES, evaluation, 0.5, nodes, programs), expected)


def candidate(controller, generation, individual, nodes):
    return Candidate(generation, individual, f"program {generation} {individual}", nodes, controller)


@pytest.fixture(scope="module")
def still():
    task = load_task("lamp-robust")
    return controller_template(task, load_rig(task.rig), task.settings)


def test_the_front_of_a_run_holds_whom_nobody_beats_in_everything(still):
    sizes = (9, 5, 7, 1, 1)
    judged = [candidate(still, 4, index, nodes) for index, nodes in enumerate(sizes)]
    main, zeros, two = np.array([0.1, 0.2, 0.3, 0.4, np.inf]), np.zeros(5), np.full(5, 2)
    evaluation = Evaluation(main, zeros, two, np.array([2, 1, 1, 0, 0]), two, zeros)
    found = front(("size", "peak_torque"), judged, evaluation)
    assert [(one["individual"], one["fitness"], one["size"], one["hits"]) for one in found] == [
        (0, 0.1, 9.0, 2),
        (1, 0.2, 5.0, 1),
        (3, 0.4, 1.0, 0),
    ]
    assert found[0] == {
        "generation": 4,
        "individual": 0,
        "program": "program 4 0",
        "fitness": 0.1,
        "hits": 2,
        "conditions": 2,
        "size": 9.0,
        "peak_torque": 0.0,
    }


def test_only_the_few_best_of_a_generation_compete_to_be_the_best_of_a_run(still):
    asked = Settings(generations=3, objectives="size", hall_of_fame=8)
    assert [candidates_of(asked, number) for number in range(3)] == [3, 3, 8]
    assert [candidates_of(Settings(generations=3), number) for number in range(3)] == [3, 3, 3]
    halls = [candidate(still, number, index, 1) for number in range(3) for index in range(candidates_of(asked, number))]
    hall = [(one.generation, one.individual) for one in hall_of_fame(halls, asked)]
    assert hall == [(2, 7), (2, 6), (2, 5), (1, 2), (1, 1), (1, 0), (0, 2), (0, 1)]
