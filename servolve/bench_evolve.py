"""`servolve bench evolve`: wall time to the same quality, servolve against a DEAP program.

Both sides breed with the same numbers and meet the same conditions. Outside the clock a judge that belongs to neither
lets the best of each generation meet conditions that neither has seen; the clock stops at the first that is good
enough. Opening pools of threads and processes is outside the clock on both sides, too.
"""

from __future__ import annotations

import dataclasses
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from controller import Controller, load_rig
from controller.errors import RunError
from evolve import Settings, Task, load_task
from evolve.conditions import Conditions, draw_conditions
from evolve.decide import NEAR_M
from evolve.evaluate import Cache, evaluate, simulate
from evolve.runs.run_plan import Plan, RunConfig, make_plan, open_pool
from evolve.search import Generation, ask, controller_of, phase_of, tell
from evolve.streams import Stream, generator
from servolve.deap_baseline import Baseline, DeapSearch, generation_conditions
from sim_models.rollouts import RolloutPool

THREADS: Final = 2
"""Threads of servolve, processes of DEAP."""

WITHOUT, WITH = "DEAP, no early stop, 2 ms", "DEAP, early stop, servolve's step"
BOUNDS: Final = {WITHOUT: 8.0, WITH: 2.0}
"""The two baselines, and how many times faster servolve is to be."""

FALL_M: Final = 0.5
"""What a controller that does not end upright is taken to be farther from its goal [m]."""

_FULL_TIMESTEP_S: Final = 0.002
_JUDGE_SEED: Final = 424242
_ALIKE_M: Final = 1e-3  # fitness that differs by less is the same
_ALIKE_SHARE: Final = 0.8  # of controllers; contacts are chaotic, and falls are seen once a period in Python


@dataclass(frozen=True)
class Contest:
    """Say what is measured.

    Args:
        task: the task
        settings: its numbers
        quality_m: mean distance from unseen goals at which the clock stops, `FALL_M` more for each that fell [m]
        conditions: how many unseen conditions judge
        seeds: of the runs
        limit_s: when a DEAP run is given up [s]
    """

    task: Task
    settings: Settings
    quality_m: float
    conditions: int
    seeds: tuple[int, ...]
    limit_s: float


@dataclass(frozen=True)
class Arrival:
    """Hold when a search was good enough.

    Args:
        seconds: wall time of its generations, the judge's left out [s]
        generations: how many it took
        quality_m: what the judge found at the end [m]
        arrived: whether it was good enough; otherwise it would have taken longer than `seconds`
    """

    seconds: float
    generations: int
    quality_m: float
    arrived: bool


def make_contest(seeds: int, *, quick: bool) -> Contest:
    """Return what `servolve bench evolve` measures.

    Args:
        seeds: how many runs of each side
        quick: fewer programs and less quality: it shows that all works, and little else

    Returns:
        the robust lamp's task; the numbers that decide how it breeds and how long it takes are pinned
    """
    task = load_task("lamp-robust")
    settings = dataclasses.replace(
        task.settings,
        population=60 if quick else 300,
        generations=25,
        tournament=6,
        elites=0,
        crossover=0.9,
        mutate_subtree=0.0,
        mutate_point=0.0,
        mutate_constant=0.0,
        selection="tournament",
        parsimony="none",
        objectives="",
        goals=6,
        nominal_goals=0,
        race_goals=2,
        race_share=0.3,
        time_limit_s=5.0,
        screen_timestep_s=0.005,
    )
    quality_m, limit_s = (0.2, 60.0) if quick else (NEAR_M, 240.0)
    return Contest(task, settings, quality_m, 12, tuple(range(1, seeds + 1)), limit_s)


def race(contest: Contest, told: Callable[[str], None]) -> list[dict[str, Any]]:
    """Run every side with every seed.

    Args:
        contest: what is measured
        told: called with what is being run

    Returns:
        a row for each side and seed

    Raises:
        RunError: the two implementations do not score the same controllers alike
    """
    check_alike(contest)
    rows = []
    for seed in contest.seeds:
        for side in ("servolve", *BOUNDS):
            told(f"{side}, seed {seed}")
            found = _arrival(contest, side, seed)
            rows.append({"side": side, "seed": seed, **_rounded(dataclasses.asdict(found))})
    return rows


def summary(contest: Contest, rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return how many times faster servolve was than each baseline, in medians over seeds.

    Args:
        contest: what was measured
        rows: from `race`

    Returns:
        a row for each baseline; a `ratio` is a lower bound where `censored` runs were given up
    """

    def column(side: str, name: str) -> list[Any]:
        return [row[name] for row in rows if row["side"] == side]

    found = []
    ours = statistics.median(column("servolve", "seconds"))
    for side, bound in BOUNDS.items():
        seconds, arrived = column(side, "seconds"), column(side, "arrived")
        ratio = statistics.median(seconds) / ours
        found.append(
            {
                "against": side,
                "seconds": round(statistics.median(seconds), 1),
                "servolve_seconds": round(ours, 1),
                "censored": arrived.count(False),
                "ratio_a_generation": round(_a_generation(rows, side) / _a_generation(rows, "servolve"), 2),
                "seeds": len(contest.seeds),
                "quality_m": contest.quality_m,
                "population": contest.settings.population,
                "goals": contest.settings.goals,
                "screen_timestep_s": contest.settings.screen_timestep_s,
                "ratio": round(ratio, 2),
                "bound": bound,
                "ok": ratio >= bound and all(column("servolve", "arrived")),
            }
        )
    return found


def _a_generation(rows: Sequence[dict[str, Any]], side: str) -> float:
    """Return the seconds that a generation takes."""
    own = [row for row in rows if row["side"] == side]
    return float(sum(row["seconds"] for row in own) / sum(row["generations"] for row in own))


def _arrival(contest: Contest, side: str, seed: int) -> Arrival:
    """Run one side until it is good enough, or out of generations or time."""
    judge_plan = search_plan(contest, _JUDGE_SEED)
    unseen = draw_conditions(generator(_JUDGE_SEED, Stream.HELD_OUT), contest.settings, contest.conditions, 3)
    with open_pool(judge_plan, "planar", _FULL_TIMESTEP_S) as judge:
        if side == "servolve":
            plan = search_plan(contest, seed)
            with open_pool(plan, plan.settings.screen_form, plan.settings.screen_timestep_s) as pool:
                best = (g.controllers[g.best(1)[0]] for g in search_generations(plan, pool))
                return _until_good(contest, best, judge, unseen)
        with DeapSearch(baseline(contest, side), seed, THREADS) as search:
            return _until_good(contest, search.generations(), judge, unseen)


def _until_good(contest: Contest, search: Iterator[Controller], judge: RolloutPool, unseen: Conditions) -> Arrival:
    """Ask for generations until the judge is content."""
    seconds, generations, quality_m = 0.0, 0, float("inf")
    while seconds < contest.limit_s and quality_m > contest.quality_m:
        start = time.perf_counter()
        best = next(search, None)
        seconds += time.perf_counter() - start
        if best is None:
            break
        generations += 1
        quality_m = quality(judge, best, unseen)
    return Arrival(seconds, generations, quality_m, quality_m <= contest.quality_m)


def quality(judge: RolloutPool, controller: Controller, unseen: Conditions) -> float:
    """Return how well a controller does.

    Args:
        judge: rollouts in the judge's physics
        controller: to be judged
        unseen: conditions, n

    Returns:
        mean distance from the goal at the end, `FALL_M` more for each that is not upright [m]
    """
    rows = np.arange(len(unseen), dtype=np.int32)
    end = simulate(judge, [controller], unseen, np.stack((np.zeros_like(rows), rows), axis=1)).statistics
    return float(np.mean(end["final_error"] + FALL_M * (end["upright_end"] == 0)))


def search_generations(plan: Plan, pool: RolloutPool) -> Iterator[Generation]:
    """Search as `servolve evolve` does, and yield each generation.

    Args:
        plan: from `search_plan`
        pool: rollouts in the physics of the search
    """
    cache = Cache()
    generation: Generation | None = None
    for number in range(plan.settings.generations):
        population = ask(plan.engine, plan.settings, plan.seed, generation)
        generation = tell(
            plan.task, plan.engine, plan.settings, plan.template, pool, cache, plan.seed, number, population
        )
        yield generation


def baseline(contest: Contest, side: str) -> Baseline:
    """Return one of the two DEAP programs.

    Args:
        contest: what is measured
        side: a key of `BOUNDS`
    """
    with_both = side == WITH
    timestep_s = contest.settings.screen_timestep_s if with_both else _FULL_TIMESTEP_S
    return Baseline(contest.task, contest.task.rig, contest.settings, timestep_s, stop_early=with_both)


def check_alike(contest: Contest, programs: int = 16) -> float:
    """Check that both implementations score the same controllers alike.

    Args:
        contest: what is measured
        programs: controllers to try, of a first generation

    Returns:
        share of them whose fitness is the same within a millimetre

    Raises:
        RunError: too few are
    """
    seed = contest.seeds[0]
    plan = search_plan(contest, seed)
    controllers = [
        controller_of(plan.engine, plan.template, individual)
        for individual in ask(plan.engine, plan.settings, seed, None)[:programs]
    ]
    conditions = generation_conditions(plan.settings, seed, 0, len(plan.rig.joints))
    with open_pool(plan, "planar", plan.settings.screen_timestep_s) as pool:
        names = [str(index) for index in range(len(controllers))]
        ours = evaluate(plan.task, pool, controllers, names, conditions, Cache())
    with DeapSearch(baseline(contest, WITH), seed, THREADS) as search:
        theirs = search.evaluate(0, [search.trees(controller.source) for controller in controllers])
    away = np.abs(ours.fitness(phase_of(0, plan.settings.generations)) - np.array(theirs))
    alike = float(np.mean(away <= _ALIKE_M))
    if alike < _ALIKE_SHARE:
        raise RunError(
            f"bench evolve: only {alike:.0%} of the controllers are worth the same on both sides; the times would say"
            " nothing"
        )
    return alike


def search_plan(contest: Contest, seed: int) -> Plan:
    """Return servolve's side.

    Args:
        contest: what is measured
        seed: of the run
    """
    config = RunConfig(contest.task, Path(), seed, contest.settings, threads=THREADS)
    return make_plan(config, load_rig(contest.task.rig))


def _rounded(row: dict[str, Any]) -> dict[str, Any]:
    return {name: round(value, 4) if isinstance(value, float) else value for name, value in row.items()}
