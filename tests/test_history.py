"""A run's history: whole generations or nothing, and a dump that depends on the run alone."""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import sqlite3

import pytest

from controller.errors import InputError, RunError
from evolve.runs.history import EvaluationRow, GenerationRow, History, open_history, ordered_dump
from evolve.runs.record import First, first_everywhere

GENERATION = GenerationRow(0, "draw", (0.1, 0.4), 0.5, 0.2, 0.3, 1, 8, 1.5)
ROWS = [
    EvaluationRow("bb", 3, "(list t)", "(list t)", "start", (), 2, 0.25, 0.125, 1, 2, 0),
    EvaluationRow("aa", 5, "(list px)", "+xab", "crossover", (3, 7), 4, float("inf"), 0.0, 0, 0, 2),
    EvaluationRow("bb", 9, "(list (+ t 0))", "(list (+ t 0))", "reproduction", (0,), 2, 0.25, 0.125, 1, 2, 1),
]


def written(path, generations, rows=ROWS):
    with History(path) as history:
        for generation in generations:
            history.record(generation, rows, [2, 0])
    return ordered_dump(path)


def test_the_dump_holds_everything_but_the_times(tmp_path):
    lines = [json.loads(line) for line in written(tmp_path / "a.sqlite", [GENERATION]).splitlines()]
    assert lines == [
        ["program", "aa", 5, "(list px)"],
        ["program", "bb", 3, "(list t)"],
        ["generation", 0, "draw", "[0.1, 0.4]", 0.5, 0.2, 0.3, 1, 8],
        ["evaluation", 0, 0, "bb", None, 3, "start", "[]", 2, "draw", 0.25, 0.125, 1, 2, 0],
        ["evaluation", 0, 1, "aa", "+xab", 5, "crossover", "[3, 7]", 4, "draw", float("inf"), 0.0, 0, 0, 2],
        ["evaluation", 0, 2, "bb", "(list (+ t 0))", 9, "reproduction", "[0]", 2, "draw", 0.25, 0.125, 1, 2, 1],
        ["candidate", 0, 0, 2],
        ["candidate", 0, 1, 0],
    ]


def test_times_do_not_show_and_everything_else_does(tmp_path):
    first = written(tmp_path / "a.sqlite", [GENERATION])
    assert first == written(tmp_path / "b.sqlite", [dataclasses.replace(GENERATION, seconds=99.0)])
    for index, change in enumerate(({"draw": "x"}, {"goals": (0.1,)}, {"best": 0.1}, {"hits": 2}, {"simulations": 9})):
        assert first != written(tmp_path / f"g{index}.sqlite", [dataclasses.replace(GENERATION, **change)])
    for index, change in enumerate(({"program": "cc"}, {"operator": "elite"}, {"parents": (1,)}, {"main": 1.0})):
        rows = [dataclasses.replace(ROWS[0], **change), *ROWS[1:]]
        assert first != written(tmp_path / f"e{index}.sqlite", [GENERATION], rows)


def test_the_order_of_writing_does_not_show(tmp_path):
    later = dataclasses.replace(GENERATION, generation=1)
    assert written(tmp_path / "a.sqlite", [GENERATION, later]) == written(tmp_path / "b.sqlite", [later, GENERATION])


def test_the_first_to_do_it_everywhere_is_counted_from_the_start(tmp_path):
    # rows' hits and passed: (1, 2), (0, 0), (1, 2) of 2 conditions
    path = tmp_path / "a.sqlite"
    hit = [ROWS[0], dataclasses.replace(ROWS[2], hits=2), dataclasses.replace(ROWS[2], hits=2)]
    later = [dataclasses.replace(GENERATION, generation=number) for number in (1, 2)]
    with History(path) as history:
        for generation, rows in zip((GENERATION, *later), (ROWS, hit, hit), strict=True):
            history.record(generation, rows, [0])
    with open_history(path) as connection:
        assert first_everywhere(connection, "hits", 2) == First(1, 1, examined=5, count=4)
        assert first_everywhere(connection, "passed", 2) == First(0, 0, examined=1, count=8)
        assert first_everywhere(connection, "hits", 3) is None


def test_a_generation_is_recorded_whole_or_not_at_all(tmp_path):
    path = tmp_path / "a.sqlite"
    before = written(path, [GENERATION])
    broken = [*ROWS, dataclasses.replace(ROWS[0], main=None)]
    with History(path) as history, pytest.raises(sqlite3.IntegrityError):
        history.record(dataclasses.replace(GENERATION, generation=1), broken)
    assert ordered_dump(path) == before


def test_a_write_that_was_killed_half_way_leaves_no_trace(tmp_path):
    path = tmp_path / "a.sqlite"
    before = written(path, [GENERATION])
    child = os.fork()
    if child == 0:
        connection = sqlite3.connect(path, isolation_level=None)
        # so little memory that the file itself is changed before the transaction is over
        connection.execute("pragma cache_size = 1")
        connection.execute("begin immediate")
        connection.execute("update evaluation set main = 7")
        rows = [(f"{number}", 1, "x" * 5000) for number in range(200)]
        connection.executemany("insert into program values (?, ?, ?)", rows)
        os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(child, 0)
    assert (tmp_path / "a.sqlite-journal").stat().st_size > 0
    assert ordered_dump(path) == before, "whoever opens it first, a reader too, undoes what was half written"
    assert not (tmp_path / "a.sqlite-journal").exists()


def test_a_file_that_may_not_be_written_is_not_said_to_lack_room(tmp_path):
    path = tmp_path / "run" / "history.sqlite"
    path.parent.mkdir()
    before = written(path, [GENERATION])
    with History(path) as history:
        history._connection.execute("pragma query_only = on")  # SQLite refuses as in a folder that is read-only
        with pytest.raises(RunError, match=f"readonly.*make the folder and its files writable, .*{path.parent}"):
            history.record(dataclasses.replace(GENERATION, generation=1), ROWS)
    assert ordered_dump(path) == before


def test_a_file_that_another_keeps_is_said_to_be_so(tmp_path, monkeypatch):
    monkeypatch.setattr("evolve.runs.history._BUSY_S", 0.01)
    path = tmp_path / "history.sqlite"
    written(path, [GENERATION])
    with History(path) as history, open_history(path) as reader:
        reader.execute("select * from generation").fetchone()
        with pytest.raises(RunError, match="close what else has it open"):
            history.record(dataclasses.replace(GENERATION, generation=1), ROWS)


def test_numbers_survive_bit_by_bit(tmp_path):
    value = 0.1 + 0.2
    dump = written(tmp_path / "a.sqlite", [GENERATION], [dataclasses.replace(ROWS[0], main=value)])
    assert json.loads(dump.splitlines()[2])[10] == value


@pytest.mark.parametrize("content", [None, b"", b"not a database, though long enough to look like one" * 40])
def test_what_is_no_history_is_said_so(tmp_path, content):
    path = tmp_path / "history.sqlite"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=r"history\.sqlite"):
        ordered_dump(path)
