"""The search: ask for a population, meet the generation's conditions, tell how it did."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from controller import Controller, lower, program_hash
from evolve.conditions import Conditions, draw_conditions
from evolve.engine import Choose, Engine, Individual
from evolve.evaluate import Cache, Evaluation, Race, evaluate, spread
from evolve.objectives import pareto_ranks, points
from evolve.selection import bucket_ranks, condemned, ranks, roulette, shares, smaller_of_two, tournament
from evolve.settings import Settings, asked_objectives
from evolve.streams import Stream, generator
from evolve.task import Task
from sim_models.rollouts import RolloutPool


@dataclass(frozen=True, eq=False)
class Generation:
    """Hold a generation that has met its conditions.

    Args:
        number: from 0
        population: its individuals, (population,)
        controllers: their controllers, (population,)
        programs: hash of each one's program, (population,)
        conditions: what they met
        phase: weight of the style points
        evaluation: how they did
        nodes: size of each, (population,)
        rank: rank of each, 0 is the best, (population,)
    """

    number: int
    population: Sequence[Individual]
    controllers: Sequence[Controller]
    programs: Sequence[str]
    conditions: Conditions
    phase: float
    evaluation: Evaluation
    nodes: npt.NDArray[np.int64]
    rank: npt.NDArray[np.int64]

    @property
    def complete(self) -> npt.NDArray[np.bool_]:
        """Return who met all conditions, (population,)."""
        return np.asarray(self.evaluation.met == len(self.conditions))

    def best(self, count: int) -> list[int]:
        """Return the best individuals of different programs that met all conditions, best first."""
        found: dict[str, int] = {}
        for index in np.argsort(self.rank).tolist():
            if self.complete[index]:
                found.setdefault(self.programs[index], index)
        return list(found.values())[:count]


def phase_of(generation: int, generations: int) -> float:
    """Return the weight of style points, sqrt(g / G): none in the first generation, near 1 in the last.

    Args:
        generation: from 0
        generations: how many there are

    Returns:
        the weight, 0 to 1

    Source: Gritz & Hahn 1997, §3.5.
    """
    return float(np.sqrt(generation / generations))


def ask(engine: Engine, settings: Settings, seed: int, before: Generation | None) -> list[Individual]:
    """Return the population that follows a generation, or the first one.

    Chance comes from the seed and the generation's number alone, so a search can go on from any generation.

    Args:
        engine: the method
        settings: the run's numbers
        seed: of the run
        before: the generation before, None: there is none

    Returns:
        the population
    """
    if before is None:
        return engine.start(generator(seed, Stream.START))
    rng = generator(seed, Stream.VARIATION, before.number + 1)
    elite = np.argsort(before.rank)[: settings.elites].tolist()
    return engine.breed(rng, before.population, _chooser(settings, before), elite)


def _chooser(settings: Settings, before: Generation) -> Choose:
    """Return how a parent is drawn from a generation."""
    choose: Choose = partial(tournament, rank=before.rank, size=settings.tournament)
    if settings.selection == "proportionate":
        wheel = np.cumsum(shares(before.evaluation.fitness(before.phase), before.complete))
        choose = partial(roulette, wheel=wheel)
    if settings.parsimony == "double":
        return partial(smaller_of_two, choose=choose, nodes=before.nodes, size=settings.double_size)
    return choose


def tell(
    task: Task,
    engine: Engine,
    settings: Settings,
    template: Controller,
    pool: RolloutPool,
    cache: Cache,
    seed: int,
    number: int,
    population: Sequence[Individual],
) -> Generation:
    """Let a population meet the conditions of its generation and rank it.

    Args:
        task: whose fitness counts
        engine: the method
        settings: the run's numbers
        template: the controller around the programs
        pool: where rollouts run
        cache: outcomes known from before
        seed: of the run
        number: of the generation, from 0
        population: the individuals

    Returns:
        the generation
    """
    rng = generator(seed, Stream.CONDITIONS, number if settings.redraw else 0)
    njoint = len(template.outputs)
    conditions = draw_conditions(rng, settings, settings.goals, njoint, nominal=settings.nominal_goals)
    cache.forget_others(conditions.keys)
    controllers = [controller_of(engine, template, individual) for individual in population]
    programs = [program_hash(controller.program) for controller in controllers]
    nodes = np.array([engine.nodes(individual) for individual in population], np.int64)
    phase = phase_of(number, settings.generations)
    race = Race(settings.race_goals, settings.race_share, phase)
    simulated = _simulated(settings, seed, number, population, nodes)
    some = np.flatnonzero(simulated).tolist()
    evaluation = spread(
        evaluate(
            task,
            pool,
            [controllers[index] for index in some],
            [programs[index] for index in some],
            conditions,
            cache,
            race,
            remember=settings.cache,
        ),
        simulated,
    )
    rank = _ranks(settings, evaluation, evaluation.met == len(conditions), phase, nodes, controllers)
    return Generation(number, population, controllers, programs, conditions, phase, evaluation, nodes, rank)


def _simulated(
    settings: Settings, seed: int, number: int, population: Sequence[Individual], nodes: npt.NDArray[np.int64]
) -> npt.NDArray[np.bool_]:
    """Return who is simulated: everyone, or under Tarpeian control all but some of the larger; the elite always is."""
    if settings.parsimony != "tarpeian":
        return np.ones(len(population), np.bool_)
    elite = np.array([individual.operator == "elite" for individual in population])
    return elite | ~condemned(generator(seed, Stream.PARSIMONY, number), nodes, settings.tarpeian_share)


def _ranks(
    settings: Settings,
    evaluation: Evaluation,
    complete: npt.NDArray[np.bool_],
    phase: float,
    nodes: npt.NDArray[np.int64],
    controllers: Sequence[Controller],
) -> npt.NDArray[np.int64]:
    """Rank a population as the settings ask."""
    asked = asked_objectives(settings)
    if asked:
        programs = [controller.program for controller in controllers]
        return pareto_ranks(points(asked, evaluation, phase, nodes, programs), complete)
    if settings.parsimony == "lexicographic":
        return bucket_ranks(evaluation.fitness(phase), complete, nodes, settings.parsimony_ratio)
    return ranks(evaluation.fitness(phase), complete, nodes)


def controller_of(engine: Engine, template: Controller, individual: Individual) -> Controller:
    """Return the template with an individual's program in it.

    Args:
        engine: the method
        template: the controller around the programs
        individual: whose program

    Returns:
        the controller
    """
    expression = engine.source(individual)
    names = [terminal.name for terminal in template.inputs]
    return dataclasses.replace(template, source=expression, program=lower(expression, names))
