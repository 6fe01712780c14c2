"""What each measure that saves time gives: the same populations evaluated with and without it.

The populations are those of one search, so all ways of evaluating them do the same work for the same fitness, but for
the race, which leaves the hopeless their fitness over fewer conditions.
"""

from __future__ import annotations

import dataclasses
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

from controller import program_hash
from evolve.engine import Individual
from evolve.evaluate import Cache, Race, evaluate
from evolve.runs.run_plan import Plan, open_pool
from evolve.search import controller_of, phase_of
from servolve.bench_evolve import THREADS, WITHOUT, Contest, baseline, search_generations, search_plan
from servolve.deap_baseline import DeapSearch, generation_conditions

MEASURES: Final[dict[str, dict[str, Any]]] = {
    "native loop": {},
    "no timer callback": {"timer": True},
    "lean model": {"lean": False},
    "early stop": {"stop_early": False},
    "screening step": {"screen_timestep_s": 0.002},
    "race": {"race_goals": 0},
    "cache": {"cache": False},
}
"""The measures in the order in which they are added, each with the settings that take it away."""

_EVERY: Final = 3  # generations of the search between two populations


@dataclass(frozen=True, eq=False)
class Sample:
    """Hold a part of a generation.

    Args:
        number: of the generation
        population: its first individuals
    """

    number: int
    population: Sequence[Individual]


def measure(
    contest: Contest, told: Callable[[str], None], *, populations: int = 3, size: int = 60, turns: int = 3
) -> list[dict[str, Any]]:
    """Time all ways of evaluating the same populations, by turns.

    Args:
        contest: what is measured; its first seed counts
        told: called with what is being run
        populations: how many generations of one search, evenly spaced
        size: individuals of each
        turns: how often each is timed

    Returns:
        a row for each measure: seconds with it and all before it, the factor that it gives there, the factor against
        the DEAP program so far, and the factor that all lose without it
    """
    told("populations")
    samples = _samples(contest, populations, size)
    removed = list(MEASURES.values())
    ways: dict[str, Callable[[], float]] = {"deap": lambda: _deap_seconds(contest, samples)}
    for added in range(len(removed)):
        ways[f"with {added}"] = _way(contest, samples, removed[added + 1 :])
    for left_out in range(1, len(removed)):
        ways[f"without {left_out}"] = _way(contest, samples, [removed[left_out]])
    times: dict[str, list[float]] = {name: [] for name in ways}
    for turn in range(turns):
        for name, way in ways.items():
            told(f"{name}, turn {turn + 1}")
            times[name].append(way())
    rows = []
    for place, name in enumerate(MEASURES):
        own, before = times[f"with {place}"], times[f"with {place - 1}" if place else "deap"]
        rows.append(
            {
                "measure": name,
                "seconds": round(statistics.median(own), 2),
                "factor": _ratio(before, own),
                "factor_so_far": _ratio(times["deap"], own),
                "left_out": _ratio(times[f"without {place}"], times[f"with {len(removed) - 1}"]) if place else None,
            }
        )
    return rows


def _ratio(above: Sequence[float], below: Sequence[float]) -> float:
    """Return the median of ratios, each of two times of the same turn."""
    return round(statistics.median(a / b for a, b in zip(above, below, strict=True)), 2)


def _samples(contest: Contest, populations: int, size: int) -> list[Sample]:
    """Search, and keep some of the populations."""
    plan = search_plan(contest, contest.seeds[0])
    found: list[Sample] = []
    with open_pool(plan, plan.settings.screen_form, plan.settings.screen_timestep_s) as pool:
        for generation in search_generations(plan, pool):
            if generation.number % _EVERY == 0:
                found.append(Sample(generation.number, generation.population[:size]))
            if len(found) == populations:
                break
    return found


def _way(contest: Contest, samples: Sequence[Sample], removed: Sequence[dict[str, Any]]) -> Callable[[], float]:
    """Return what times servolve without some measures."""
    changes = {name: value for change in removed for name, value in change.items()}
    settings = dataclasses.replace(contest.settings, **changes)
    plan = search_plan(dataclasses.replace(contest, settings=settings), contest.seeds[0])
    return lambda: _seconds(plan, samples)


def _seconds(plan: Plan, samples: Sequence[Sample]) -> float:
    """Return how long servolve takes."""
    settings, seconds = plan.settings, 0.0
    with open_pool(plan, settings.screen_form, settings.screen_timestep_s) as pool:
        for sample in samples:
            start = time.perf_counter()
            conditions = generation_conditions(settings, plan.seed, sample.number, len(plan.rig.joints))
            controllers = [controller_of(plan.engine, plan.template, individual) for individual in sample.population]
            programs = [program_hash(controller.program) for controller in controllers]
            race = Race(settings.race_goals, settings.race_share, phase_of(sample.number, settings.generations))
            evaluate(plan.task, pool, controllers, programs, conditions, Cache(), race, remember=settings.cache)
            seconds += time.perf_counter() - start
    return seconds


def _deap_seconds(contest: Contest, samples: Sequence[Sample]) -> float:
    """Return how long the DEAP program without early stop and screening step takes."""
    plan, seconds = search_plan(contest, contest.seeds[0]), 0.0
    with DeapSearch(baseline(contest, WITHOUT), contest.seeds[0], THREADS) as search:
        for sample in samples:
            trees = [search.trees(plan.engine.source(individual)) for individual in sample.population]
            start = time.perf_counter()
            search.evaluate(sample.number, trees)
            seconds += time.perf_counter() - start
    return seconds
