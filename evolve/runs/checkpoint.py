"""Checkpoints: what a generation leaves in the history, and the search that goes on from there."""

from __future__ import annotations

import dataclasses
import json
import sqlite3
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from controller import Controller, format_source
from controller.errors import InputError
from evolve.decide import Candidate
from evolve.engine import Engine, Individual
from evolve.evaluate import Cache, Outcome
from evolve.runs.history import EvaluationRow, GenerationRow, Outcomes, open_history
from evolve.search import Generation, controller_of
from evolve.settings import Settings

_POPULATION = """
select coalesce(genotype, text), operator, parents
from evaluation join program on hash = program
where generation = ? order by individual
"""
_CANDIDATES = """
select generation, individual, program, evaluation.nodes, coalesce(genotype, text)
from candidate join evaluation using (generation, individual) join program on hash = program
order by generation, place
"""
_COMPLETE = """
select generation,
  (select count(*) from evaluation e join program on hash = program where e.generation = g.generation),
  (select count(*) from candidate c join evaluation e using (generation, individual) where c.generation = g.generation)
from generation g order by generation
"""


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """Hold what a history says that a search needs to go on.

    Args:
        generations: how many are recorded
        population: individuals of the last of them
        hall: candidates for the best of the run, in order
        outcomes: what the last generation's programs did, as a later one may meet the same conditions
        simulations: rollouts run so far
        seconds: wall time of the search so far [s]
    """

    generations: int
    population: Sequence[Individual]
    hall: Sequence[Candidate]
    outcomes: Mapping[tuple[str, str], Outcome]
    simulations: int
    seconds: float


NOTHING = Checkpoint(0, (), (), {}, 0, 0.0)
"""Where a run begins."""


def read_checkpoint(path: Path, engine: Engine, template: Controller, settings: Settings) -> Checkpoint:
    """Return where a search stands.

    Args:
        path: the history; one that is missing stands at the beginning
        engine: the method
        template: the controller around the programs
        settings: the run's numbers

    Returns:
        the checkpoint

    Raises:
        InputError: the file is no history, or not a whole one of this engine, these terminals and these settings
    """
    if not path.exists():
        return NOTHING
    with open_history(path, empty=True) as connection:
        if connection.execute("select count(*) from sqlite_master").fetchone() == (0,):
            return NOTHING
        count, last, simulations, seconds = connection.execute(
            "select count(*), max(generation), total(simulations), total(seconds) from generation"
        ).fetchone()
        if count == 0:
            return NOTHING
        _check_whole(connection, path, settings)
        try:
            population = [
                Individual(engine.read(text), operator, tuple(json.loads(parents)))
                for text, operator, parents in connection.execute(_POPULATION, (last,))
            ]
            hall = [_candidate(engine, template, *row) for row in connection.execute(_CANDIDATES)]
            outcomes = _outcomes(connection)
        except (ValueError, TypeError) as error:
            raise InputError(
                f"{path}: does not fit the run's engine and task ({error}); restore the run's folder as it was"
            ) from error
    return Checkpoint(int(count), population, hall, outcomes, int(simulations), float(seconds))


def _check_whole(connection: sqlite3.Connection, path: Path, settings: Settings) -> None:
    """Refuse a history that lacks some of what its run wrote: what would be resumed were another run."""
    remedy = "put back the run's own history, or start a new run"
    try:
        rows = list(connection.execute(_COMPLETE))
        (told,) = connection.execute("pragma quick_check(1)").fetchone()
    except sqlite3.DatabaseError as error:
        raise InputError(f"{path}: damaged ({error}); {remedy}") from None
    if told != "ok":
        raise InputError(f"{path}: damaged ({' '.join(told.split())}); {remedy}")
    if [row[0] for row in rows] != list(range(len(rows))) or len(rows) > settings.generations:
        raise InputError(
            f"{path}: its generations are not 0, 1, 2… of the run's {settings.generations} without a gap; {remedy}"
        )
    for generation, individuals, candidates in rows:
        if individuals != settings.population or candidates == 0:
            raise InputError(
                f"{path}: generation {generation} holds {individuals} of {settings.population} individuals and"
                f" {candidates} candidates for the best; {remedy}"
            )


def _candidate(
    engine: Engine, template: Controller, generation: int, individual: int, program: str, nodes: int, text: str
) -> Candidate:
    """Return a candidate from its row."""
    controller = controller_of(engine, template, Individual(engine.read(text), "", ()))
    return Candidate(generation, individual, program, nodes, controller)


def _outcomes(connection: sqlite3.Connection) -> dict[tuple[str, str], Outcome]:
    """Return the recorded outcomes."""
    rows = connection.execute("select program, condition, numbers from outcome")
    return {(program, condition): Outcome(*json.loads(numbers)) for program, condition, numbers in rows}


def outcome_rows(cache: Cache, remembered: bool) -> Outcomes:
    """Return what is recorded of a cache.

    Args:
        cache: outcomes of the generation
        remembered: whether a later generation looks into it
    """
    if not remembered:
        return {}
    return {pair: dataclasses.astuple(outcome) for pair, outcome in cache.outcomes.items()}


def evaluation_rows(generation: Generation, engine: Engine) -> list[EvaluationRow]:
    """Return what is recorded of each individual.

    Args:
        generation: that has met its conditions
        engine: the method
    """
    evaluation = generation.evaluation
    return [
        EvaluationRow(
            program=program,
            nodes=int(generation.nodes[index]),
            text=format_source(controller.source),
            genotype=engine.write(individual),
            operator=individual.operator,
            parents=tuple(individual.parents),
            conditions=int(evaluation.met[index]),
            main=float(evaluation.main[index]),
            style=float(evaluation.style[index]),
            hits=int(evaluation.hits[index]),
            passed=int(evaluation.passed[index]),
            rank=int(generation.rank[index]),
        )
        for index, (individual, controller, program) in enumerate(
            zip(generation.population, generation.controllers, generation.programs, strict=True)
        )
    ]


def generation_row(generation: Generation, simulations: int, seconds: float) -> GenerationRow:
    """Return what is recorded of a generation.

    Args:
        generation: that has met its conditions
        simulations: rollouts that it took
        seconds: wall time that it took [s]
    """
    evaluation, conditions = generation.evaluation, generation.conditions
    complete = evaluation.met == len(conditions)
    fitness = evaluation.fitness(generation.phase)[complete]
    finite = fitness[np.isfinite(fitness)]
    return GenerationRow(
        generation.number,
        conditions.draw,
        tuple(conditions.goal_m.tolist()),
        generation.phase,
        float(fitness.min()),
        float(finite.mean()) if len(finite) else float("inf"),
        int(np.sum(complete & (evaluation.hits == len(conditions)))),
        simulations,
        seconds,
    )
