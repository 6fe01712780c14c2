"""A run's folder: `run.toml`, `history.sqlite`, `best.controller.toml`, `validation.json`."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from controller.errors import InputError
from evolve.decide import Validation
from evolve.settings import Settings

RUN: Final = "run.toml"
HISTORY: Final = "history.sqlite"
BEST: Final = "best.controller.toml"
VALIDATION: Final = "validation.json"

_NAMED_RUNS_MAX: Final = 10_000


def free_folder(parent: Path, name: str) -> Path:
    """Return the first of ``name``, ``name-2``, ``name-3``… that is not there yet.

    Args:
        parent: where runs are kept
        name: of the run

    Returns:
        a path that does not exist

    Raises:
        InputError: all names are taken
    """
    for number in range(1, _NAMED_RUNS_MAX):
        folder = parent / (name if number == 1 else f"{name}-{number}")
        if not folder.exists():
            return folder
    raise InputError(f"{parent}: holds {_NAMED_RUNS_MAX - 1} runs called {name}; remove some or give --out")


def make_folder(folder: Path) -> None:
    """Make a run's folder.

    Args:
        folder: which must not exist, or be empty

    Raises:
        InputError: it is a file, holds something, or cannot be made
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise InputError(f"{folder}: holds something already; give --out a new folder")
    except FileExistsError:
        raise InputError(f"{folder}: is a file; give --out a new folder") from None
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}); give --out another folder") from None


def run_text(head: Mapping[str, str | int | float | bool], settings: Settings, versions: Mapping[str, str]) -> str:
    """Return the text of `run.toml`, the same for the same run.

    Args:
        head: task, rig, seed and the like
        settings: the run's numbers
        versions: of what computes

    Returns:
        the text
    """
    tables = {"run": head, "settings": dataclasses.asdict(settings), "versions": versions}
    lines = ["format = 1"]
    for name, table in tables.items():
        lines += ["", f"[{name}]", *(f"{key} = {_toml_value(value)}" for key, value in table.items())]
    return "\n".join(lines) + "\n"


def validation_text(best: Mapping[str, Any], validation: Validation, goal_m: list[float]) -> str:
    """Return the text of `validation.json`.

    Args:
        best: where the best came from
        validation: how it did under conditions that did not choose it
        goal_m: distances of the goals there [m]

    Returns:
        the text
    """
    content = {"format": 1, "best": dict(best), "held_out": dataclasses.asdict(validation), "goal_m": goal_m}
    return json.dumps(content, indent=2) + "\n"


def write_whole(path: Path, text: str) -> None:
    """Write a file so that it is there whole or not at all.

    Args:
        path: the file
        text: its text
    """
    part = path.with_name(path.name + ".part")
    part.write_text(text)
    os.replace(part, path)  # noqa: PTH105 (one atomic call, as its name says)


def _toml_value(value: str | int | float | bool) -> str:
    """Write a scalar as TOML, floats so that they read back the same."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return repr(value)
