"""What a run's history tells: its generations, and where an individual came from."""

from __future__ import annotations

import json
import sqlite3
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from controller import Controller, load_controller
from controller.errors import InputError
from evolve.engine import Individual
from evolve.engines import make_engine
from evolve.runs.history import open_history
from evolve.runs.run_file import load_again, read_run_file
from evolve.runs.run_folder import BEST, HISTORY, VALIDATION
from evolve.search import controller_of
from evolve.template import controller_template

_GENERATIONS = """
select g.generation, e.individual, g.phase, g.best, g.mean, e.main, e.hits, e.passed, e.conditions, e.nodes, g.hits,
  (select count(distinct program) from evaluation where generation = g.generation),
  (select count(*) from evaluation where generation = g.generation),
  g.simulations, g.seconds
from generation g join evaluation e on e.generation = g.generation and e.rank = 0 order by g.generation
"""
_INDIVIDUAL = """
select operator, parents, program, e.nodes, main, style, main + phase * style, e.hits, passed, conditions, text,
  genotype
from evaluation e join generation using (generation) join program on hash = program
where generation = ? and individual = ?
"""


@dataclass(frozen=True)
class GenerationSummary:
    """Say how a generation did.

    Args:
        generation: from 0
        individual: its best
        phase: weight of the style points
        best: fitness of the best
        mean: mean fitness of those that met all conditions
        main: main goal of the best
        hits: conditions that the best hit
        passed: conditions in which the best came within 1.5 cm at any time
        conditions: how many the best met
        nodes: of the best
        hit_all: individuals that hit the goal in every condition
        distinct: different programs
        population: individuals
        simulations: rollouts that it took
        seconds: wall time that it took [s]
    """

    generation: int
    individual: int
    phase: float
    best: float
    mean: float
    main: float
    hits: int
    passed: int
    conditions: int
    nodes: int
    hit_all: int
    distinct: int
    population: int
    simulations: int
    seconds: float


@dataclass(frozen=True)
class First:
    """Hold the first individual of a run that could do something.

    Args:
        generation: in which it lived
        individual: its number there
        examined: individuals bred up to it, itself among them
        count: how many of the run could
    """

    generation: int
    individual: int
    examined: int
    count: int


@dataclass(frozen=True)
class Ancestor:
    """Hold one individual of a lineage.

    Args:
        generation: in which it lived
        individual: its number there
        operator: how it came to be
        parents: individuals of the generation before; the first gave what the others changed
        program: hash
        nodes: of its genotype
        main: mean main goal over the conditions met
        style: mean style points over the same
        fitness: main and style as weighted in its generation
        hits: conditions hit
        passed: conditions in which it came within 1.5 cm at any time
        conditions: how many it met
        text: source of its program
        genotype: as its engine writes it; None: the program's text
    """

    generation: int
    individual: int
    operator: str
    parents: tuple[int, ...]
    program: str
    nodes: int
    main: float
    style: float
    fitness: float
    hits: int
    passed: int
    conditions: int
    text: str
    genotype: str | None


def generation_summaries(connection: sqlite3.Connection) -> list[GenerationSummary]:
    """Return how each generation did, in order.

    Args:
        connection: to a history, as `open_history` gives it
    """
    return [GenerationSummary(*row) for row in connection.execute(_GENERATIONS)]


def first_everywhere(connection: sqlite3.Connection, what: Literal["hits", "passed"], conditions: int) -> First | None:
    """Return the first individual that hit, or passed, in every condition of its generation, and how many did so.

    Args:
        connection: to a history
        what: hits: at the end, at rest, upright; passed: within 1.5 cm at any time
        conditions: of a generation

    Returns:
        the first of them in the order in which they were bred; None: nobody did
    """
    population = "(select count(*) from evaluation b where b.generation < a.generation)"
    row = connection.execute(
        f"select generation, individual, {population} + individual + 1,"
        f" (select count(*) from evaluation where {what} = :n) from evaluation a where {what} = :n"
        " order by generation, individual limit 1",
        {"n": conditions},
    ).fetchone()
    return None if row is None else First(*row)


def ancestor(connection: sqlite3.Connection, generation: int, individual: int) -> Ancestor:
    """Return one individual.

    Args:
        connection: to a history
        generation: in which it lived
        individual: its number there

    Raises:
        InputError: the history has no such individual
    """
    row = connection.execute(_INDIVIDUAL, (generation, individual)).fetchone()
    if row is None:
        raise InputError(f"generation {generation} has no individual {individual}; put back the run's own history")
    operator, parents, *others = row
    return Ancestor(generation, individual, operator, tuple(json.loads(parents)), *others)


def lineage(connection: sqlite3.Connection, generation: int, individual: int) -> list[Ancestor]:
    """Return an individual and its first parents back to the first generation, the latest first.

    Args:
        connection: to a history
        generation: in which it lived
        individual: its number there
    """
    line = [ancestor(connection, generation, individual)]
    while line[-1].parents:
        line.append(ancestor(connection, line[-1].generation - 1, line[-1].parents[0]))
    return line


def ancestors_of_each_generation(connection: sqlite3.Connection, generation: int, individual: int) -> list[int]:
    """Return how many individuals of each generation an individual descends from, the latest first.

    Args:
        connection: to a history
        generation: in which it lived
        individual: its number there
    """
    alive, counts = {individual}, []
    for number in range(generation, -1, -1):
        counts.append(len(alive))
        rows = connection.execute("select individual, parents from evaluation where generation = ?", (number,))
        alive = {parent for child, parents in rows if child in alive for parent in json.loads(parents)}
    return counts


def best_of(folder: Path) -> tuple[int, int] | None:
    """Return generation and individual of a run's best: the chosen one, or the last generation's.

    Args:
        folder: the run's

    Returns:
        both numbers; None: there is no generation yet
    """
    if (folder / BEST).is_file():
        try:
            best = json.loads((folder / VALIDATION).read_text(encoding="utf-8"))["best"]
            return int(best["generation"]), int(best["individual"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InputError(
                f"{folder / VALIDATION}: not as the run wrote it ({error}); put back the file that it wrote"
            ) from None
    if not (folder / HISTORY).is_file():
        return None
    with open_history(folder / HISTORY, empty=True) as connection:
        if connection.execute("select count(*) from sqlite_master").fetchone() == (0,):
            return None
        rows = generation_summaries(connection)
    return (rows[-1].generation, rows[-1].individual) if rows else None


def controllers_of(folder: Path, which: list[tuple[int, int]]) -> list[Controller]:
    """Return the controllers of individuals, as they were simulated.

    Args:
        folder: the run's
        which: generation and individual of each

    Returns:
        the controllers

    Raises:
        InputError: the folder is not as the run left it
    """
    found = read_run_file(folder)
    task, rig = load_again(folder, found)
    template = controller_template(task, rig, found.settings)
    engine = make_engine(found.engine, task.terminals, len(template.outputs), found.settings)
    with open_history(folder / HISTORY) as connection:
        rows = [ancestor(connection, *place) for place in which]
    genotypes = [engine.read(row.text if row.genotype is None else row.genotype) for row in rows]
    return [controller_of(engine, template, Individual(genotype, "", ())) for genotype in genotypes]


def best_controller(folder: Path) -> Controller:
    """Return the best controller of a run, finished or not.

    Args:
        folder: the run's

    Raises:
        InputError: it has none yet
    """
    if (folder / BEST).is_file():
        return load_controller(folder)
    best = best_of(folder)
    if best is None:
        raise InputError(f"{folder}: has no generation yet; go on with servolve evolve --resume {folder}")
    return controllers_of(folder, [best])[0]
