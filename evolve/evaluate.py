"""Evaluation: controllers meet conditions, each program once under each condition, the hopeless not all of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from controller import Controller
from evolve.conditions import Conditions
from evolve.task import FloatArray, Task, score
from sim_models.rollouts import RolloutPool, Rollouts, make_cases
from sim_models.statistics import HIT_M

REST_M_S = 0.02
"""A base slower than this during the last 0.2 s is at rest [m/s]."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """Hold how one program did under one condition.

    Args:
        main: main goal
        style: style points
        hit: within 1.5 cm of the goal at the end, at rest, upright
        passed: within 1.5 cm of the goal at any time, before any fall: the papers' hit
        peak_torque: largest |load| of any joint, 1 is its limit
    """

    main: float
    style: float
    hit: bool
    passed: bool
    peak_torque: float


@dataclass(eq=False)
class Cache:
    """Remember outcomes by program hash and condition key, and count what was simulated.

    Args:
        outcomes: what is known
        simulations: rollouts run so far
    """

    outcomes: dict[tuple[str, str], Outcome] = field(default_factory=dict)
    simulations: int = 0

    def forget_others(self, keys: Sequence[str]) -> None:
        """Drop the outcomes under other conditions than these, which no later generation meets again."""
        kept = set(keys)
        self.outcomes = {pair: outcome for pair, outcome in self.outcomes.items() if pair[1] in kept}


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Hold how a population did.

    Args:
        main: mean main goal over the conditions met, (population,)
        style: mean style points over the same, (population,)
        met: how many conditions each met, (population,)
        hits: how many of these it hit, (population,)
        passed: at how many of these it came within 1.5 cm at any time, (population,)
        peak_torque: largest |load| of any joint in any of these, 1 is its limit, (population,)
    """

    main: FloatArray
    style: FloatArray
    met: npt.NDArray[np.int64]
    hits: npt.NDArray[np.int64]
    passed: npt.NDArray[np.int64]
    peak_torque: FloatArray

    def fitness(self, phase: float) -> FloatArray:
        """Return main + phase * style, lower is better."""
        return self.main + phase * self.style


def spread(evaluation: Evaluation, simulated: npt.NDArray[np.bool_]) -> Evaluation:
    """Give whoever was not simulated a place: no condition met, and the worst of all results.

    Args:
        evaluation: how those did that were simulated, in order
        simulated: whether each was, (population,)

    Returns:
        how all did
    """
    nobody = {"main": np.inf, "style": 0.0, "met": 0, "hits": 0, "passed": 0, "peak_torque": np.inf}
    columns = {}
    for name, value in nobody.items():
        known = getattr(evaluation, name)
        columns[name] = np.full(len(simulated), value, known.dtype)
        columns[name][simulated] = known
    return Evaluation(**columns)


@dataclass(frozen=True)
class Race:
    """Say who meets all conditions.

    Args:
        first: conditions that everyone meets
        share: share of the programs that goes on to the others
        phase: weight of style points when they are ranked
    """

    first: int
    share: float
    phase: float


def is_hit(statistics: npt.NDArray[np.void]) -> npt.NDArray[np.bool_]:
    """Return which rollouts hit the goal: within 1.5 cm of it at the end, at rest, upright, the head untouched.

    Args:
        statistics: dtype `STATISTICS`, (nsim,)

    Returns:
        whether each did, (nsim,)
    """
    hit: npt.NDArray[np.bool_] = (
        (statistics["status"] == 0)
        & (statistics["upright_end"] == 1)
        & (statistics["final_error"] <= HIT_M)
        & (statistics["end_speed"] <= REST_M_S)
        & (statistics["head_touched"] == 0)
    )
    return hit


def is_passed(statistics: npt.NDArray[np.void]) -> npt.NDArray[np.bool_]:
    """Return which rollouts came within 1.5 cm of the goal at any time.

    Args:
        statistics: dtype `STATISTICS`, (nsim,)

    Returns:
        whether each did, (nsim,)

    Source: Gritz & Hahn 1997, §3.6.
    """
    passed: npt.NDArray[np.bool_] = (statistics["status"] == 0) & (statistics["first_hit_step"] >= 0)
    return passed


def evaluate(
    task: Task,
    pool: RolloutPool,
    controllers: Sequence[Controller],
    programs: Sequence[str],
    conditions: Conditions,
    cache: Cache,
    race: Race | None = None,
    *,
    remember: bool = True,
) -> Evaluation:
    """Let a population meet a generation's conditions.

    A fitness is the mean over the conditions met, whether they were met now or are remembered; a race only decides
    who meets how many.

    Args:
        task: whose fitness counts
        pool: where rollouts run
        controllers: the population, (population,)
        programs: hash of each one's program, (population,)
        conditions: goals and rigs
        cache: outcomes known from before, added to
        race: who meets all conditions; None: everyone
        remember: whether a program is simulated only once under each condition; False: each copy, anew

    Returns:
        how each did
    """
    if not remember:
        cache.outcomes.clear()
    copies = Counter(programs)
    distinct = list(copies)
    holder = dict(zip(programs, controllers, strict=True))
    everywhere = range(len(conditions))

    def meet(contestants: Sequence[str], rows: Sequence[int]) -> None:
        pairs = [
            (program, row)
            for program in contestants
            for row in rows
            if (program, conditions.keys[row]) not in cache.outcomes
            for _ in range(1 if remember else copies[program])
        ]
        _simulate(task, pool, holder, pairs, conditions, cache)

    met = dict.fromkeys(distinct, len(conditions))
    if race is None or not 0 < race.first < len(conditions):
        meet(distinct, everywhere)
    else:
        meet(distinct, everywhere[: race.first])
        standing = [
            np.mean([o.main + race.phase * o.style for o in _known(cache, program, conditions.keys[: race.first])])
            for program in distinct
        ]
        going_on = int(np.ceil(race.share * len(distinct)))
        order = np.argsort(standing, kind="stable")
        for place in order[going_on:].tolist():
            met[distinct[place]] = race.first
        meet([distinct[place] for place in sorted(order[:going_on].tolist())], everywhere[race.first :])
    outcomes = [_known(cache, program, conditions.keys[: met[program]]) for program in programs]
    return Evaluation(
        np.array([np.mean([o.main for o in known]) for known in outcomes]),
        np.array([np.mean([o.style for o in known]) for known in outcomes]),
        np.array([len(known) for known in outcomes]),
        np.array([sum(o.hit for o in known) for known in outcomes]),
        np.array([sum(o.passed for o in known) for known in outcomes]),
        np.array([max(o.peak_torque for o in known) for known in outcomes]),
    )


def simulate(
    pool: RolloutPool,
    controllers: Sequence[Controller],
    conditions: Conditions,
    index: npt.NDArray[np.int32],
    *,
    traces: bool = False,
) -> Rollouts:
    """Run rollouts of pairs of controller and condition.

    Args:
        pool: where rollouts run
        controllers: the controllers
        conditions: goals and rigs
        index: which controller under which condition, (nsim, 2)
        traces: whether to keep the state at every control instant

    Returns:
        the rollouts, nsim of them
    """
    which, rows = np.ascontiguousarray(index[:, 0]), np.ascontiguousarray(index[:, 1])
    cases = make_cases(which, conditions.goal_m[rows], conditions.bearing_rad[rows], rows)
    return pool.run(controllers, cases, conditions.perturbations, traces=traces)


def _known(cache: Cache, program: str, keys: Sequence[str]) -> list[Outcome]:
    return [cache.outcomes[program, key] for key in keys]


def _simulate(
    task: Task,
    pool: RolloutPool,
    holder: dict[str, Controller],
    pairs: Sequence[tuple[str, int]],
    conditions: Conditions,
    cache: Cache,
) -> None:
    """Run the pairs of program and condition and remember their outcomes."""
    if not pairs:
        return
    programs = list(dict.fromkeys(program for program, _ in pairs))
    place = {program: index for index, program in enumerate(programs)}
    index = np.array([(place[program], row) for program, row in pairs], np.int32)
    rollouts = simulate(pool, [holder[program] for program in programs], conditions, index, traces=task.traces)
    main, style = score(task, rollouts, conditions.goal_m[index[:, 1]])
    end = rollouts.statistics
    columns = main, style, is_hit(end), is_passed(end), end["peak_torque"].astype(np.float64)
    for (program, row), *outcome in zip(pairs, *(column.tolist() for column in columns), strict=True):
        cache.outcomes[program, conditions.keys[row]] = Outcome(*outcome)
    cache.simulations += len(pairs)
