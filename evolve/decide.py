"""The decision: candidates meet unseen conditions in full physics, and further unseen ones judge the best."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from controller import Controller, Rig
from evolve.conditions import Conditions, draw_conditions
from evolve.evaluate import Cache, Evaluation, Race, evaluate, is_hit, is_passed, simulate
from evolve.objectives import fronts, points
from evolve.search import Generation
from evolve.settings import Settings, asked_objectives
from evolve.streams import Stream, generator
from evolve.task import Task, score
from sim_models.rollouts import RolloutPool
from sim_models.statistics import HIT_M

NEAR_M = 0.05
"""Within this of the goal is near [m]."""

_OF_A_GENERATION = 3  # its best, which may be the best of the run
_AS_GOOD = 0.1  # of the best's fitness: what so many conditions cannot tell apart
_RACE_SHARE_OF_CONDITIONS = 3  # a third of the conditions decides which candidates meet the others
_RACE_SHARE_OF_CANDIDATES = 0.4


@dataclass(frozen=True, eq=False)
class Candidate:
    """Hold a controller that may be the best of its run.

    Args:
        generation: in which it was found
        individual: its number there
        program: hash of its program
        nodes: nodes of its genotype
        controller: the controller
    """

    generation: int
    individual: int
    program: str
    nodes: int
    controller: Controller


@dataclass(frozen=True)
class Validation:
    """Hold how a controller did under conditions that nothing had seen, in the physics that decides.

    Args:
        conditions: how many
        mean_error_m: mean distance from the goal at the end [m]
        median_error_m: median of the same [m]
        hits: share within 1.5 cm of the goal at the end, at rest, upright, the head untouched
        within_15_mm: share within 1.5 cm at the end, upright
        within_50_mm: share within 5 cm at the end, upright
        passed: share that came within 1.5 cm at any time, the papers' hit
        falls: share that fell
        head_touched: share whose head touched anything
        hops_mean: mean number of hops
        hops_min: fewest hops
        clearance_m: mean over the rollouts of the largest clearance of all feet [m]
        main: mean main goal
        style: mean style points
    """

    conditions: int
    mean_error_m: float
    median_error_m: float
    hits: float
    within_15_mm: float
    within_50_mm: float
    passed: float
    falls: float
    head_touched: float
    hops_mean: float
    hops_min: int
    clearance_m: float
    main: float
    style: float


def hall_of_fame(halls: Sequence[Candidate], settings: Settings) -> list[Candidate]:
    """Return the candidates for the best of a run: those found last, each program once.

    Fitness of different generations does not compare, as their conditions differ and style is phased in; so each
    generation's best count alike, and the later ones have been selected longer.

    Args:
        halls: the best of each generation, in order
        settings: the run's numbers

    Returns:
        at most `settings.hall_of_fame`, the latest first
    """
    latest: dict[str, Candidate] = {}
    taken: Counter[int] = Counter()
    for candidate in reversed(halls):
        taken[candidate.generation] += 1
        if taken[candidate.generation] <= _OF_A_GENERATION:
            latest.setdefault(candidate.program, candidate)
    return list(latest.values())[: settings.hall_of_fame]


def candidates_of(settings: Settings, generation: int) -> int:
    """Return how many of a generation are candidates: few, but the last one's front where objectives are asked for.

    Args:
        settings: the run's numbers
        generation: its number, from 0
    """
    last = generation == settings.generations - 1
    return max(settings.hall_of_fame, _OF_A_GENERATION) if last and settings.objectives else _OF_A_GENERATION


def candidates(generation: Generation, count: int) -> list[Candidate]:
    """Return the best of a generation, the best last.

    Args:
        generation: that has met its conditions
        count: how many at most

    Returns:
        the candidates
    """
    return [
        Candidate(
            generation.number,
            index,
            generation.programs[index],
            int(generation.nodes[index]),
            generation.controllers[index],
        )
        for index in reversed(generation.best(count))
    ]


def stated_hits(
    task: Task, pool: RolloutPool, rig: Rig, settings: Settings, seed: int, hall: Sequence[Candidate]
) -> npt.NDArray[np.int64]:
    """Count how many unseen goals each candidate hits on the rig as its file states it.

    Args:
        task: what for
        pool: rollouts in the physics that counts
        rig: the rig
        settings: the run's numbers
        seed: of the run
        hall: the candidates

    Returns:
        hits, (candidates,)
    """
    return evaluate(task, pool, *_entries(hall), stated_conditions(settings, seed, len(rig.joints)), Cache()).hits


def stated_conditions(settings: Settings, seed: int, njoint: int) -> Conditions:
    """Draw the unseen goals that are met on the rig as its file states it.

    Args:
        settings: the run's numbers
        seed: of the run
        njoint: joints of the rig

    Returns:
        the conditions
    """
    n = settings.stated_goals
    return draw_conditions(generator(seed, Stream.STATED), settings, n, njoint, nominal=n)


def who_hit_most(hall: Sequence[Candidate], hits: npt.NDArray[np.int64], share: float) -> list[Candidate]:
    """Return the candidates that hit nearly as often as the best of them.

    The rig as its file states it is the best guess of the one on the bench: who fails there is out, however robust.

    Args:
        hall: the candidates
        hits: of each, (candidates,)
        share: of the most hits, what is enough

    Returns:
        at least one of them, in order
    """
    return [candidate for candidate, n in zip(hall, hits.tolist(), strict=True) if n >= share * hits.max()]


def decide(
    task: Task, pool: RolloutPool, rig: Rig, settings: Settings, seed: int, hall: Sequence[Candidate]
) -> tuple[Candidate, Validation, Conditions]:
    """Choose the best candidate under unseen conditions, and judge it under further ones.

    Args:
        task: whose fitness counts, style points in full
        pool: rollouts in the physics that decides
        rig: the rig
        settings: the run's numbers
        seed: of the run
        hall: the candidates, at least one

    Returns:
        the best, how it did under conditions that did not choose it, and these conditions
    """
    njoint = len(rig.joints)
    unseen = draw_conditions(generator(seed, Stream.DECISION), settings, settings.decision_goals, njoint)
    race = Race(max(1, settings.decision_goals // _RACE_SHARE_OF_CONDITIONS), _RACE_SHARE_OF_CANDIDATES, 1.0)
    evaluation = evaluate(task, pool, *_entries(hall), unseen, Cache(), race)
    best = hall[_simplest_of_the_best(evaluation, [candidate.nodes for candidate in hall])]
    held_out = draw_conditions(generator(seed, Stream.HELD_OUT), settings, settings.held_out_goals, njoint)
    return best, validate(task, pool, best.controller, held_out), held_out


def pareto(
    task: Task, pool: RolloutPool, rig: Rig, settings: Settings, seed: int, halls: Sequence[Candidate]
) -> list[dict[str, Any]]:
    """Return the Pareto front of a run's candidates, judged under the unseen conditions that choose the best.

    Args:
        task: whose fitness counts, style points in full
        pool: rollouts in the physics that decides
        rig: the rig
        settings: the run's numbers
        seed: of the run
        halls: the best of each generation, in order

    Returns:
        what `front` says of them; empty where the settings ask for no objectives
    """
    asked = asked_objectives(settings)
    if not asked:
        return []
    judged = list({candidate.program: candidate for candidate in halls}.values())
    unseen = draw_conditions(generator(seed, Stream.DECISION), settings, settings.decision_goals, len(rig.joints))
    return front(asked, judged, evaluate(task, pool, *_entries(judged), unseen, Cache()))


def front(asked: Sequence[str], judged: Sequence[Candidate], evaluation: Evaluation) -> list[dict[str, Any]]:
    """Return the Pareto front of candidates, the best fitness first.

    Args:
        asked: names of the objectives beside fitness
        judged: the candidates
        evaluation: how each did, over the same conditions

    Returns:
        of each: "generation", "individual", "program", "fitness", "hits" and "conditions", and the objectives by name
    """
    nodes = np.array([candidate.nodes for candidate in judged], np.int64)
    stand = points(asked, evaluation, 1.0, nodes, [candidate.controller.program for candidate in judged])
    finite = np.flatnonzero(np.isfinite(stand).all(axis=1))
    best = finite[fronts(stand[finite]) == 0]
    return [
        {
            "generation": judged[index].generation,
            "individual": judged[index].individual,
            "program": judged[index].program,
            "fitness": float(stand[index, 0]),
            "hits": int(evaluation.hits[index]),
            "conditions": int(evaluation.met[index]),
            **{name: float(value) for name, value in zip(asked, stand[index, 1:], strict=True)},
        }
        for index in best[np.argsort(stand[best, 0], kind="stable")].tolist()
    ]


def _entries(hall: Sequence[Candidate]) -> tuple[list[Controller], list[str]]:
    return [candidate.controller for candidate in hall], [candidate.program for candidate in hall]


def _simplest_of_the_best(evaluation: Evaluation, nodes: Sequence[int]) -> int:
    """Return the smallest of those whose fitness is as good as the best's; ties go to the fitter."""
    fitness = np.where(evaluation.met == evaluation.met.max(), evaluation.fitness(1.0), np.inf)
    good: list[int] = np.flatnonzero(fitness <= fitness.min() + _AS_GOOD * abs(fitness.min())).tolist()
    return min(good, key=lambda index: (nodes[index], fitness[index]))


def validate(task: Task, pool: RolloutPool, controller: Controller, conditions: Conditions) -> Validation:
    """Let one controller meet conditions.

    Args:
        task: whose fitness counts
        pool: where rollouts run
        controller: the controller
        conditions: goals and rigs

    Returns:
        how it did
    """
    rows = np.arange(len(conditions), dtype=np.int32)
    index = np.stack((np.zeros_like(rows), rows), axis=1)
    rollouts = simulate(pool, [controller], conditions, index, traces=task.traces)
    end = rollouts.statistics
    main, style = score(task, rollouts, conditions.goal_m)
    upright = end["upright_end"] == 1
    return Validation(
        conditions=len(conditions),
        mean_error_m=_mean(end["final_error"]),
        median_error_m=float(np.median(end["final_error"])),
        hits=_mean(is_hit(end)),
        within_15_mm=_mean(upright & (end["final_error"] <= HIT_M)),
        within_50_mm=_mean(upright & (end["final_error"] <= NEAR_M)),
        passed=_mean(is_passed(end)),
        falls=_mean(end["fallen"] != 0),
        head_touched=_mean(end["head_touched"]),
        hops_mean=_mean(end["hops"]),
        hops_min=int(end["hops"].min()),
        clearance_m=_mean(end["max_clearance"]),
        main=_mean(main),
        style=_mean(style),
    )


def _mean(values: npt.NDArray[np.generic]) -> float:
    return float(np.mean(values.astype(np.float64)))
