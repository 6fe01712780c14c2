"""The record of a run: every individual of every generation, in one SQLite file."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

from controller.errors import InputError

_SCHEMA = """
create table if not exists program (
  hash text primary key,  -- sha256 of the lowered program's canonical form
  nodes integer not null, -- nodes of the genotype that first gave it
  text text not null      -- its source
) without rowid;
create table if not exists generation (
  generation integer primary key,
  draw text not null,       -- hash of the conditions: goals and perturbations
  goals text not null,      -- distances of the goals [m], JSON
  phase real not null,      -- weight of the style points
  best real not null,       -- lowest main + phase * style of those that met all conditions
  mean real not null,       -- mean main + phase * style of the same
  hits integer not null,    -- individuals that hit the goal in every condition
  simulations integer not null,
  seconds real not null     -- wall time, the one column that differs from run to run
);
create table if not exists evaluation (
  generation integer not null,
  individual integer not null,
  program text not null references program (hash),
  operator text not null,   -- how it came to be
  parents text not null,    -- individuals of the generation before, JSON
  conditions integer not null, -- how many of the generation's conditions it met
  draw text not null,
  main real not null,       -- means over those conditions
  style real not null,
  primary key (generation, individual)
) without rowid;
"""

_DUMP = {
    "program": "select hash, nodes, text from program order by hash",
    "generation": (
        "select generation, draw, goals, phase, best, mean, hits, simulations from generation order by generation"
    ),
    "evaluation": (
        "select generation, individual, program, operator, parents, conditions, draw, main, style"
        " from evaluation order by generation, individual"
    ),
}


@dataclass(frozen=True)
class EvaluationRow:
    """Hold what is recorded of one individual.

    Args:
        program: hash of its program
        nodes: nodes of its genotype
        text: source of its program
        operator: how it came to be
        parents: individuals of the generation before
        conditions: how many of the generation's conditions it met
        main: mean main goal over those conditions
        style: mean style points over those conditions
    """

    program: str
    nodes: int
    text: str
    operator: str
    parents: tuple[int, ...]
    conditions: int
    main: float
    style: float


@dataclass(frozen=True)
class GenerationRow:
    """Hold what is recorded of one generation.

    Args:
        generation: its number, from 0
        draw: hash of its conditions
        goals: distances of the goals [m]
        phase: weight of the style points
        best: lowest fitness
        mean: mean fitness of those that met all conditions
        hits: individuals that hit the goal in every condition
        simulations: how many were run
        seconds: wall time [s]
    """

    generation: int
    draw: str
    goals: tuple[float, ...]
    phase: float
    best: float
    mean: float
    hits: int
    simulations: int
    seconds: float


class History:
    """Keep the record of one run open for writing, one transaction a generation.

    Args:
        path: the SQLite file, made if missing
    """

    def __init__(self, path: Path) -> None:
        self._connection = sqlite3.connect(path)
        self._connection.executescript(_SCHEMA)

    def __enter__(self) -> History:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._connection.close()

    def record(self, generation: GenerationRow, evaluations: Sequence[EvaluationRow]) -> None:
        """Record a whole generation, or nothing of it."""
        with self._connection as connection:
            connection.executemany(
                "insert or ignore into program values (?, ?, ?)", [(e.program, e.nodes, e.text) for e in evaluations]
            )
            connection.execute(
                "insert into generation values (?, ?, ?, ?, ?, ?, ?, ?, ?)",
                (
                    generation.generation,
                    generation.draw,
                    json.dumps(generation.goals),
                    generation.phase,
                    generation.best,
                    generation.mean,
                    generation.hits,
                    generation.simulations,
                    generation.seconds,
                ),
            )
            connection.executemany(
                "insert into evaluation values (?, ?, ?, ?, ?, ?, ?, ?, ?)",
                [
                    (
                        generation.generation,
                        individual,
                        e.program,
                        e.operator,
                        json.dumps(e.parents),
                        e.conditions,
                        generation.draw,
                        e.main,
                        e.style,
                    )
                    for individual, e in enumerate(evaluations)
                ],
            )


def ordered_dump(path: Path) -> str:
    """Return all that a run's history says but the times, one line a row, in an order that depends on the run alone.

    Args:
        path: the SQLite file

    Returns:
        lines of JSON, the table's name first; equal for equal runs

    Raises:
        InputError: the file is missing or is no history
    """
    if not path.is_file():
        raise InputError(f"{path}: no such history; give the history.sqlite of a run folder")
    connection = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)
    try:
        return "".join(_lines(connection))
    except sqlite3.DatabaseError as error:
        raise InputError(f"{path}: not a history of a run ({error}); give the history.sqlite of a run folder") from None
    finally:
        connection.close()


def _lines(connection: sqlite3.Connection) -> Iterable[str]:
    """Yield the rows as lines."""
    for table, query in _DUMP.items():
        for row in connection.execute(query):
            yield json.dumps([table, *row]) + "\n"
