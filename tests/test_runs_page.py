"""docs/runs.md says what a run's folder holds, as the code has it."""

from __future__ import annotations

import json
import re
import sqlite3
from pathlib import Path

import pytest

import servolve.evolve
from evolve import RunConfig, apply_overrides, evolve, load_task
from evolve.runs.history import FORMAT, SCHEMA

PAGE = (Path(__file__).parent.parent / "docs" / "runs.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    task = load_task("lamp-robust")
    small = ["population=6", "generations=2", "goals=2", "race_goals=0", "time_limit_s=0.3", "decision_goals=2"]
    small += ["held_out_goals=2", "stated_goals=1", "hall_of_fame=2", "objectives=size"]
    out = tmp_path_factory.mktemp("page") / "run"
    text = b"# a copy is kept, whatever it says"
    evolve(RunConfig(task, out, 1, apply_overrides(task.settings, small), threads=1, task_text=text), lambda told: None)
    return out


def rows(heading):
    part = PAGE.split(f"## {heading}\n")[1].split("\n## ")[0]
    cells = [line.split("|")[1] for line in part.splitlines() if line.startswith("| `")]
    return [name for cell in cells for name in re.findall(r"`([\w./]+)`", cell)]


def test_the_schema_is_the_code_s():
    (block,) = re.findall(r"```sql\n(.*?)```", PAGE, re.S)
    assert block == SCHEMA.lstrip("\n")
    assert f"Format {FORMAT}," in PAGE


def test_a_history_has_these_tables(folder):
    made = sqlite3.connect(":memory:")
    made.executescript(re.findall(r"```sql\n(.*?)```", PAGE, re.S)[0])
    query = "select name, sql from sqlite_master where type = 'table' order by name"
    assert [name for name, _ in made.execute(query)] == [
        name for name, _ in sqlite3.connect(folder / "history.sqlite").execute(query)
    ]
    assert sqlite3.connect(folder / "history.sqlite").execute("pragma user_version").fetchone() == (FORMAT,)


def test_every_file_of_a_run_is_listed(folder):
    listed = set(rows("Files"))
    assert {path.name for path in folder.iterdir()} == listed - {"rig/", servolve.evolve.REPORT}


def test_every_field_of_a_condition_is_listed(folder):
    conditions = json.loads((folder / "validation.json").read_text())["conditions"]
    assert [list(condition) for condition in conditions] == [rows("validation.json")] * 2
