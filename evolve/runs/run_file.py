"""`run.toml`: what a run is, and the files beside it that a resumed run needs."""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree

import mujoco
import numpy as np

from controller import Rig, load_rig
from controller.errors import InputError
from controller.rig_file import rig_names
from evolve.runs.run_folder import RUN, run_text, write_whole
from evolve.settings import Settings, check
from evolve.streams import RNG_NAME
from evolve.task import Task, load_task

TASK_FILE: Final = "task.py"
RIG_FOLDER: Final = "rig"

_HEAD: Final = ("task", "task_file", "rig", "rig_file", "engine", "seed", "rng", "decide")
_KINDS: Final = {"seed": int, "decide": bool}  # of the head's values that are no text


@dataclass(frozen=True)
class RunFile:
    """Hold what `run.toml` says.

    Args:
        task: name of the task
        task_file: the task's file, as the folder keeps it; empty: the task is built in
        rig: name of the rig
        rig_file: the rig's file, as the folder keeps it or, if its body needs further files, where it was; empty:
            the rig comes with servolve
        engine: name of the method
        seed: of all chance
        rng: kind of random numbers
        decide: whether the best is chosen and judged after the search
        hashes: sha256 of what must not change while a run stands still, by name
        settings: the run's numbers
        versions: of what computes
        digest: sha256 of all that it says of the run and its settings
    """

    task: str
    task_file: str
    rig: str
    rig_file: str
    engine: str
    seed: int
    rng: str
    decide: bool
    hashes: Mapping[str, str]
    settings: Settings
    versions: Mapping[str, str]
    digest: str


def versions() -> dict[str, str]:
    """Return the versions of what computes, as results differ between them in the last digits."""
    return {"servolve": version("servolve"), "mujoco": mujoco.__version__, "numpy": np.__version__}


def begin_run_file(
    folder: Path,
    task: Task,
    task_text: bytes | None,
    rig: Rig,
    settings: Settings,
    *,
    engine: str,
    seed: int,
    decide: bool,
) -> RunFile:
    """Copy into a new run's folder what a resumed run needs, and write its `run.toml` last.

    Args:
        folder: the run's, empty
        task: the task
        task_text: content of the task's file; None: the task is built in
        rig: the rig
        settings: the run's numbers
        engine: name of the method
        seed: of all chance
        decide: whether the best is chosen and judged after the search

    Returns:
        what `run.toml` says

    Raises:
        RunError: a file cannot be written
    """
    if task_text is not None:
        write_whole(folder / TASK_FILE, task_text)
    head: dict[str, Any] = {
        "task": task.name,
        "task_file": "" if task_text is None else TASK_FILE,
        "rig": rig.name,
        "rig_file": _keep_rig(folder, rig),
        "engine": engine,
        "seed": seed,
        "rng": RNG_NAME,
        "decide": decide,
    }
    digest = _digest(tomllib.loads(run_text(head, settings, {}, {})))
    hashes = _hashes(task_text, rig, digest)
    content = RunFile(**head, hashes=hashes, settings=settings, versions=versions(), digest=digest)
    write_whole(folder / RUN, run_text(head, settings, content.versions, hashes).encode())
    return content


def read_run_file(folder: Path) -> RunFile:
    """Return what a run's `run.toml` says.

    Args:
        folder: the run's

    Returns:
        its content

    Raises:
        InputError: there is no run in the folder, or something in the file is wrong
    """
    path = folder / RUN
    try:
        there = path.is_file()
    except OSError:
        there = False  # no name that a file can have
    if not there:
        raise InputError(f"{folder}: holds no run, as there is no {RUN}; name the folder of a run that has begun")
    try:
        top = tomllib.loads(path.read_text(encoding="utf-8"))
        if top.get("format") != 1:
            raise ValueError(f"format is {top['format']!r}, not 1" if "format" in top else "there is no format in it")
        head, settings = top["run"], Settings(**top["settings"])
        for name in _HEAD:
            if type(head[name]) is not _KINDS.get(name, str):
                raise ValueError(f"{name} is {head[name]!r}")
        values = {name: head[name] for name in _HEAD}
        found = RunFile(
            **values,
            hashes=dict(top["hashes"]),
            settings=settings,
            versions=dict(top["versions"]),
            digest=_digest(top),
        )
    except (OSError, KeyError, ValueError, TypeError) as error:
        told = f"there is no {error.args[0]} in it" if isinstance(error, KeyError) else " ".join(str(error).split())
        raise InputError(
            f"{path}: not as this servolve writes it ({told}); put back the file that the run began with, or start a"
            " new run"
        ) from None
    check(settings, str(path))
    return found


def check_versions(folder: Path, found: RunFile) -> None:
    """Refuse to go on with a run that other versions began.

    Args:
        folder: the run's
        found: what its `run.toml` says

    Raises:
        InputError: a version differs
    """
    now = versions()
    began = {name: found.versions.get(name, "of no version") for name in now}
    differ = [f"{name} {began[name]} (here {now[name]})" for name in now if now[name] != began[name]]
    if differ:
        raise InputError(
            f"{folder}: began with {', '.join(differ)}, and results differ in the last digits;"
            " install that version, or give --any-version to go on with this one"
        )


def load_again(folder: Path, found: RunFile, task: Task | None = None) -> tuple[Task, Rig]:
    """Return a run's task and rig, unchanged since it began.

    Args:
        folder: the run's
        found: what its `run.toml` says
        task: the task, if neither its name nor the folder's copy brings it back

    Returns:
        task and rig

    Raises:
        InputError: either is missing or has changed
    """
    text = _text_of(folder / found.task_file) if found.task_file else None
    rig = _rig_of(folder, found)
    _refuse_changed(folder, found, rig, _hashes(text, rig, found.digest), found.hashes)
    if task is None:
        task = load_task(str(folder / found.task_file) if found.task_file else found.task)
        task = task.for_rig(None if found.rig_file else rig.name)
    return task, rig


def load_rig_again(folder: Path, found: RunFile) -> Rig:
    """Return a run's rig, unchanged since it began; its task is not looked at.

    Args:
        folder: the run's
        found: what its `run.toml` says

    Returns:
        the rig

    Raises:
        InputError: it is missing or has changed
    """
    rig = _rig_of(folder, found)
    now = _hashes(None, rig, found.digest)
    _refuse_changed(folder, found, rig, now, found.hashes.keys() & now.keys())
    return rig


def _rig_of(folder: Path, found: RunFile) -> Rig:
    """Load a run's rig from where it is kept."""
    path = folder / found.rig_file
    if found.rig_file and not path.is_file():
        raise InputError(f"{path}: the run's rig file is missing; put it back there")
    return load_rig(path) if found.rig_file else load_rig(found.rig)


def _refuse_changed(folder: Path, found: RunFile, rig: Rig, now: Mapping[str, str], names: Collection[str]) -> None:
    """Refuse to go on with what is not as it was when the run began."""
    places = {"task": folder / found.task_file, "rig": rig.path, "body": rig.body}
    for name in sorted(names):
        if now.get(name) != found.hashes[name]:
            what = f"the {name}" if name in places else "its seed or another of its entries"
            raise InputError(
                f"{places.get(name, folder / RUN)}: {what} has changed since the run began; put back the file that it"
                " began with, or start a new run"
            )


def _keep_rig(folder: Path, rig: Rig) -> str:
    """Copy a rig that does not come with servolve into the folder; return where a resumed run finds it."""
    if rig.name in rig_names() and load_rig(rig.name).path == rig.path:
        return ""
    if rig.body.parent != rig.path.parent or _names_files(rig.body):
        return str(rig.path.resolve())
    (folder / RIG_FOLDER).mkdir(exist_ok=True)
    write_whole(folder / RIG_FOLDER / rig.path.name, rig.path.read_bytes())
    write_whole(folder / RIG_FOLDER / rig.body.name, rig.body.read_bytes())
    return f"{RIG_FOLDER}/{rig.path.name}"


def _names_files(body: Path) -> bool:
    """Tell whether an MJCF needs meshes, textures or other files."""
    try:
        return any("file" in element.attrib for element in ElementTree.parse(body).iter())
    except ElementTree.ParseError:
        return True


def _hashes(task_text: bytes | None, rig: Rig, digest: str) -> dict[str, str]:
    """Return the sha256 of each file that a run is made of, and that of what `run.toml` says."""
    parts = {"rig": rig.text.encode(), "body": rig.body.read_bytes()}
    if task_text is not None:
        parts["task"] = task_text
    return {name: hashlib.sha256(content).hexdigest() for name, content in parts.items()} | {"run": digest}


def _digest(top: Mapping[str, Any]) -> str:
    """Return the sha256 of a run's head and settings, as they stand in its file and not as they are completed."""
    return hashlib.sha256(json.dumps([top["run"], top["settings"]], sort_keys=True).encode()).hexdigest()


def _text_of(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: the run's task file cannot be read ({error.strerror}); put it back there") from None
