"""The record of a run: every individual of every generation, in one SQLite file."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Final, TypeAlias

from controller.errors import InputError, RunError

FORMAT: Final = 1
"""Version of the tables, kept as the file's `user_version`."""

SCHEMA: Final = """
create table program (
  hash text primary key,       -- sha256 of the lowered program's canonical form
  nodes integer not null,      -- nodes of the genotype that first gave it
  text text not null           -- its source, as that genotype gave it
) without rowid;
create table generation (
  generation integer primary key, -- from 0
  draw text not null,          -- hash of the conditions: goals and perturbations
  goals text not null,         -- distances of the goals [m], JSON
  phase real not null,         -- weight of the style points
  best real not null,          -- lowest main + phase * style of those that met all conditions
  mean real not null,          -- mean main + phase * style of the same
  hits integer not null,       -- individuals that hit the goal in every condition
  simulations integer not null, -- rollouts that it took
  seconds real not null        -- wall time, the one column that differs from run to run
);
create table evaluation (
  generation integer not null,
  individual integer not null, -- from 0
  program text not null references program (hash),
  genotype text,               -- as its engine writes it; null: the program's text
  nodes integer not null,      -- of the genotype
  operator text not null,      -- how it came to be
  parents text not null,       -- individuals of the generation before, JSON; the first gave what the others changed
  conditions integer not null, -- how many of the generation's conditions it met
  draw text not null,          -- hash of the generation's conditions
  main real not null,          -- mean main goal over the conditions met
  style real not null,         -- mean style points over the same
  hits integer not null,       -- conditions hit: within 1.5 cm at the end, at rest, upright
  passed integer not null,     -- conditions in which it came within 1.5 cm at any time, the papers' hit
  rank integer not null,       -- 0 is the best
  primary key (generation, individual)
) without rowid;
create table candidate (
  generation integer not null,
  place integer not null,      -- the best of the generation last
  individual integer not null, -- which may become the best of the run
  primary key (generation, place)
) without rowid;
create table outcome (
  condition text not null,     -- hash of goal and perturbation
  program text not null,       -- hash
  numbers text not null,       -- how the program did, JSON; kept while a later generation may meet the condition
  primary key (condition, program)
) without rowid;
"""
"""The tables; a page of the documentation is held to it."""

_DUMP = {
    "program": "select hash, nodes, text from program order by hash",
    "generation": (
        "select generation, draw, goals, phase, best, mean, hits, simulations from generation order by generation"
    ),
    "evaluation": (
        "select generation, individual, program, genotype, nodes, operator, parents, conditions, draw, main, style,"
        " hits, passed, rank from evaluation order by generation, individual"
    ),
    "candidate": "select generation, place, individual from candidate order by generation, place",
}
_BUSY_S: Final = 60.0  # how long a reader may keep a generation from being written
_INSERT_GENERATION: Final = "insert into generation values (?, ?, ?, ?, ?, ?, ?, ?, ?)"
_INSERT_EVALUATION: Final = "insert into evaluation values (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)"


@dataclass(frozen=True)
class EvaluationRow:
    """Hold what is recorded of one individual.

    Args:
        program: hash of its program
        nodes: nodes of its genotype
        text: source of its program
        genotype: its genotype as its engine writes it
        operator: how it came to be
        parents: individuals of the generation before
        conditions: how many of the generation's conditions it met
        main: mean main goal over those conditions
        style: mean style points over those conditions
        hits: how many of those it hit
        passed: in how many of those it came within 1.5 cm of the goal at any time
        rank: 0 is the best
    """

    program: str
    nodes: int
    text: str
    genotype: str
    operator: str
    parents: tuple[int, ...]
    conditions: int
    main: float
    style: float
    hits: int
    passed: int
    rank: int


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


Outcomes: TypeAlias = Mapping[tuple[str, str], tuple[float | bool, ...]]
"""Numbers of outcomes by program hash and condition key."""


class History:
    """Keep the record of one run open for writing, one transaction a generation.

    A transaction is in a rollback journal beside the file until it is on the disk: whoever opens the file after a
    crash finds the generations before it, whole.

    Args:
        path: the SQLite file, made if missing

    Raises:
        InputError: the file is no history, or one of another format
        RunError: it cannot be written
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._connection = sqlite3.connect(path, timeout=_BUSY_S, isolation_level=None)
            # a rollback journal and not a log: the file is the whole history, on network file systems too
            self._connection.execute("pragma journal_mode = delete")
            # as full, and the folder's entry of the journal as well: a generation that is told is on the disk
            self._connection.execute("pragma synchronous = extra")
            self._make_tables()
        except sqlite3.DatabaseError as error:
            raise self._failure(error) from error

    def __enter__(self) -> History:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._connection.close()

    def record(
        self,
        generation: GenerationRow,
        evaluations: Sequence[EvaluationRow],
        candidates: Sequence[int] = (),
        outcomes: Outcomes = MappingProxyType({}),
    ) -> None:
        """Record a whole generation and what the next one needs, or nothing of it.

        Args:
            generation: the generation
            evaluations: its individuals, in order
            candidates: individuals that may become the best of the run, the best last
            outcomes: all that a later generation can meet; those recorded before and not among them are dropped

        Raises:
            RunError: it cannot be written
        """
        try:
            with self._transaction() as connection:
                self._insert(connection, generation, evaluations)
                connection.executemany(
                    "insert into candidate values (?, ?, ?)",
                    [(generation.generation, place, individual) for place, individual in enumerate(candidates)],
                )
                _replace_outcomes(connection, outcomes)
        except sqlite3.IntegrityError:
            raise
        except sqlite3.DatabaseError as error:
            raise self._failure(error) from error

    def _insert(
        self, connection: sqlite3.Connection, generation: GenerationRow, evaluations: Sequence[EvaluationRow]
    ) -> None:
        """Insert a generation's own rows."""
        connection.executemany(
            "insert or ignore into program values (?, ?, ?)", [(e.program, e.nodes, e.text) for e in evaluations]
        )
        g = generation
        goals = json.dumps(g.goals)
        connection.execute(
            _INSERT_GENERATION,
            (g.generation, g.draw, goals, g.phase, g.best, g.mean, g.hits, g.simulations, g.seconds),
        )
        connection.executemany(
            _INSERT_EVALUATION,
            [
                (
                    *(generation.generation, individual, e.program, _own(connection, e), e.nodes, e.operator),
                    *(json.dumps(e.parents), e.conditions, generation.draw, e.main, e.style),
                    *(e.hits, e.passed, e.rank),
                )
                for individual, e in enumerate(evaluations)
            ],
        )

    def _make_tables(self) -> None:
        """Make the tables in a new file, all of them or none, and refuse a file with others."""
        check_format(self._connection, self._path, empty=True)
        if not _tables(self._connection):
            with self._transaction() as connection:
                for statement in SCHEMA.strip().removesuffix(";").split(";\n"):
                    connection.execute(statement)
                connection.execute(f"pragma user_version = {FORMAT}")

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        """Commit what is done inside, or undo it."""
        self._connection.execute("begin immediate")
        try:
            yield self._connection
            self._connection.execute("commit")
        except BaseException:
            # a full disk may have undone it already
            if self._connection.in_transaction:
                self._connection.execute("rollback")
            raise

    def _failure(self, error: sqlite3.DatabaseError) -> Exception:
        """Say what a failed write means to the user."""
        if isinstance(error, sqlite3.OperationalError):
            return RunError(
                f"{self._path}: cannot be written ({error}); the generations before are safe: {_remedy(error)}, then go"
                f" on with servolve evolve --resume {self._path.parent}"
            )
        return InputError(f"{self._path}: {_damaged(error)}")


def _remedy(error: sqlite3.OperationalError) -> str:
    """Say what lets a history be written again."""
    primary = error.sqlite_errorcode & 0xFF
    if primary in (sqlite3.SQLITE_READONLY, sqlite3.SQLITE_PERM):
        return "make the folder and its files writable"
    if primary in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
        return "close what else has it open"
    if primary == sqlite3.SQLITE_CANTOPEN:
        return "see that the folder is writable and has room"
    return "make room there"


def _damaged(error: sqlite3.DatabaseError) -> str:
    """Say that a file is no whole database."""
    return f"no history of a run, or a damaged one ({error}); put back a copy of the run's own, or start a new run"


def _own(connection: sqlite3.Connection, row: EvaluationRow) -> str | None:
    """Return a genotype's text unless it is the recorded text of its program."""
    (text,) = connection.execute("select text from program where hash = ?", (row.program,)).fetchone()
    return None if row.genotype == text else row.genotype


def _replace_outcomes(connection: sqlite3.Connection, outcomes: Outcomes) -> None:
    """Keep these outcomes and no others; only those that are gone or new are touched."""
    known = set(connection.execute("select program, condition from outcome"))
    gone = {condition for _, condition in known} - {condition for _, condition in outcomes}
    connection.executemany("delete from outcome where condition = ?", [(condition,) for condition in sorted(gone)])
    connection.executemany(
        "insert into outcome values (?, ?, ?)",
        (
            (condition, program, json.dumps(numbers))
            for (program, condition), numbers in outcomes.items()
            if (program, condition) not in known
        ),
    )


def _tables(connection: sqlite3.Connection) -> list[str]:
    return [name for (name,) in connection.execute("select name from sqlite_master where type = 'table'")]


def check_format(connection: sqlite3.Connection, path: Path, *, empty: bool = False) -> None:
    """Refuse a database that is no history of this format.

    Args:
        connection: to the file
        path: the file
        empty: whether a file without tables will do

    Raises:
        InputError: it is something else, or of another format
    """
    tables = _tables(connection)
    if not tables and empty:
        return
    if "generation" not in tables:
        raise InputError(f"{path}: not a history of a run; give the history.sqlite of a run folder")
    (found,) = connection.execute("pragma user_version").fetchone()
    if found != FORMAT:
        raise InputError(
            f"{path}: a history of format {found}, and this servolve reads format {FORMAT};"
            " read it with the servolve that wrote it, or run the evolution again"
        )


@contextmanager
def open_history(path: Path, *, empty: bool = False) -> Iterator[sqlite3.Connection]:
    """Open a history for reading; it may be written meanwhile, and what is read is whole.

    Args:
        path: the SQLite file
        empty: whether a file without tables will do, which a crash at the start of a run leaves

    Returns:
        a connection that holds one state of the file until it is closed; close it soon, as it keeps others from writing

    Raises:
        InputError: the file is missing, no history, or of another format
    """
    if not path.is_file():
        raise InputError(f"{path}: no such history; give the history.sqlite of a run folder")
    # not read-only: after a crash, the first who opens it undoes what was half written
    connection = sqlite3.connect(f"{path.resolve().as_uri()}?mode=rw", uri=True, timeout=_BUSY_S, isolation_level=None)
    try:
        connection.execute("pragma query_only = on")
        connection.execute("begin")
        check_format(connection, path, empty=empty)
        yield connection
    except sqlite3.OperationalError as error:
        raise InputError(f"{path}: cannot be read ({error}); see who else has it open, and its permissions") from None
    except sqlite3.DatabaseError as error:
        raise InputError(f"{path}: {_damaged(error)}") from None
    finally:
        connection.close()


def ordered_dump(path: Path) -> str:
    """Return all that a run's history says but the times, one line a row, in an order that depends on the run alone.

    Args:
        path: the SQLite file

    Returns:
        lines of JSON, the table's name first; equal for equal runs

    Raises:
        InputError: the file is missing or is no history
    """
    with open_history(path) as connection:
        return "".join(_lines(connection))


def _lines(connection: sqlite3.Connection) -> Iterable[str]:
    """Yield the rows as lines."""
    for table, query in _DUMP.items():
        for row in connection.execute(query):
            yield json.dumps([table, *row]) + "\n"
