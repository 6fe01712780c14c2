"""A run that is killed at random moments, also in the middle of a write, ends as if it had not been."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import pytest

from evolve import ordered_dump

KILLED_RUN = Path(__file__).parent / "killed_run.py"

_specification = importlib.util.spec_from_file_location("killed_run", KILLED_RUN)
killed_run = importlib.util.module_from_spec(_specification)
_specification.loader.exec_module(killed_run)


@pytest.mark.parametrize(("engine", "seed"), [("gp", 1), ("gep", 3)])
def test_killed_again_and_again(tmp_path, engine, seed):
    killed_run.start(tmp_path / "whole", engine, 2)
    arguments = [tmp_path / "run", engine, seed, 8]
    said = subprocess.run(
        [sys.executable, KILLED_RUN, *map(str, arguments)], capture_output=True, text=True, timeout=300, check=True
    )
    ended = json.loads(said.stdout)
    assert ended["status"] == "done", said.stderr
    assert ended["moments"]["step"] >= 1, ended
    for name in ("run.toml", "best.controller.toml", "validation.json"):
        assert (tmp_path / "run" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes(), name
    assert ordered_dump(tmp_path / "run" / "history.sqlite") == ordered_dump(tmp_path / "whole" / "history.sqlite")
