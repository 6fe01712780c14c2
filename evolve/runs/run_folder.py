"""A run's folder: its files, who may write them, and how they are written so that a crash leaves none of them torn."""

from __future__ import annotations

import dataclasses
import errno
import fcntl
import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from controller.errors import InputError, RunError
from evolve.decide import Validation
from evolve.settings import Settings

RUN: Final = "run.toml"
HISTORY: Final = "history.sqlite"
BEST: Final = "best.controller.toml"
VALIDATION: Final = "validation.json"
PARETO: Final = "pareto.json"

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
        if (folder / RUN).exists():
            raise InputError(
                f"{folder}: holds a run already; give --out a new folder, or go on with it: servolve evolve --resume"
                f" {folder}"
            )
        if any(folder.iterdir()):
            raise InputError(f"{folder}: holds something already; give --out a new folder")
    except FileExistsError:
        raise InputError(f"{folder}: is a file; give --out a new folder") from None
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}); give --out another folder") from None


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a run's folder, so that no other process works on it; the lock goes with the process, however it ends.

    Args:
        folder: the run's, which exists

    Raises:
        InputError: another process works on it
    """
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        raise InputError(f"{folder}: another process is working on this run; wait for it, or stop it first") from None
    except OSError:
        # a file system without locks: the history still refuses a generation that is there already
        pass
    try:
        yield
    finally:
        os.close(handle)


def run_text(
    head: Mapping[str, str | int | float | bool],
    settings: Settings,
    versions: Mapping[str, str],
    hashes: Mapping[str, str],
) -> str:
    """Return the text of `run.toml`, the same for the same run.

    Args:
        head: task, rig, seed and the like
        settings: the run's numbers
        versions: of what computes
        hashes: sha256 of the files that the run is made of

    Returns:
        the text
    """
    tables = {"run": head, "settings": dataclasses.asdict(settings), "versions": versions, "hashes": hashes}
    lines = ["format = 1"]
    for name, table in tables.items():
        lines += ["", f"[{name}]", *(f"{key} = {_toml_value(value)}" for key, value in table.items())]
    return "\n".join(lines) + "\n"


def validation_text(
    best: Mapping[str, Any], validation: Validation, stated: Validation, conditions: Sequence[Mapping[str, Any]]
) -> str:
    """Return the text of `validation.json`.

    Args:
        best: where the best came from
        validation: how it did under conditions that did not choose it
        stated: how it did at the unseen goals on the rig as its file states it
        conditions: how it did under each held-out condition, with the goal's distance as "goal_m" [m]

    Returns:
        the text
    """
    content = {
        "format": 1,
        "best": dict(best),
        "held_out": finite(dataclasses.asdict(validation)),
        "stated": finite(dataclasses.asdict(stated)),
        "goal_m": [condition["goal_m"] for condition in conditions],
        "conditions": [finite(condition) for condition in conditions],
    }
    return json.dumps(content, indent=2, allow_nan=False) + "\n"


def finite(numbers: Mapping[str, Any]) -> dict[str, Any]:
    """Return numbers by name with None for those that are infinite, which JSON does not have.

    Args:
        numbers: numbers by name
    """
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in numbers.items()
    }


def read_validation(path: Path) -> dict[str, Any]:
    """Return the content of a `validation.json`, infinite where it says null.

    Args:
        path: the file

    Returns:
        its content

    Raises:
        InputError: it is missing, or not as the run wrote it
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if not {"best", "held_out"} <= content.keys():
            raise ValueError("best or held_out is not in it")
    except (OSError, ValueError, AttributeError) as error:
        raise InputError(f"{path}: not as the run wrote it ({error}); put back the file that it wrote") from None
    return {name: _infinite(value) for name, value in content.items()}


def _infinite(value: Any) -> Any:  # noqa: ANN401  whatever JSON holds
    """Return what JSON holds with infinity for null."""
    if isinstance(value, Mapping):
        return {name: _infinite(one) for name, one in value.items()}
    if isinstance(value, list):
        return [_infinite(one) for one in value]
    return math.inf if value is None else value


def pareto_text(front: Sequence[Mapping[str, Any]]) -> str:
    """Return the text of `pareto.json`.

    Args:
        front: what `evolve.decide.front` says of each candidate on it

    Returns:
        the text
    """
    return json.dumps({"format": 1, "front": [dict(one) for one in front]}, indent=2) + "\n"


def write_whole(path: Path, content: bytes) -> None:
    """Write a file so that it is there whole or not at all, after a power loss too.

    Args:
        path: the file
        content: its bytes

    Raises:
        RunError: it cannot be written
    """
    part = path.with_name(path.name + ".part")
    try:
        with part.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)  # noqa: PTH105 (one atomic call, as its name says)
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    except OSError as error:
        part.unlink(missing_ok=True)
        forbidden = error.errno in (errno.EACCES, errno.EPERM, errno.EROFS)
        remedy = "make the folder and its files writable" if forbidden else "make room there"
        raise RunError(
            f"{path}: cannot be written ({error.strerror}); {remedy}, then go on with servolve evolve --resume"
            f" {path.parent}"
        ) from None


def _toml_value(value: str | int | float | bool) -> str:
    """Write a scalar as TOML, floats so that they read back the same."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return repr(value)
