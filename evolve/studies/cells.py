"""Run the cells of a study, level by seed: ordinary run folders, in worker processes, resumed where they stand."""

from __future__ import annotations

import fcntl
import multiprocessing
import os
import shutil
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from controller.errors import InputError, RunError
from evolve.runs.history import open_history
from evolve.runs.run import RunConfig, evolve, resume
from evolve.runs.run_file import load_again, read_run_file, versions
from evolve.runs.run_folder import HISTORY, RUN
from evolve.settings import Settings
from evolve.studies.study import Level, Scale, Study, level_settings, study_task

CELLS: Final = "cells"
_LOCK: Final = "study.lock"
_GENERATIONS: Final = """
select best, (
  select count(*) from evaluation where evaluation.generation = generation.generation and passed = ?
), simulations, seconds
from generation order by generation
"""


@dataclass(frozen=True)
class Cell:
    """Say what one run of a study is.

    Args:
        study: the study
        level: the point of its grid
        seed: of the run
        settings: of the run
        folder: of the run
    """

    study: Study
    level: Level
    seed: int
    settings: Settings
    folder: Path


@dataclass(frozen=True)
class Curve:
    """Hold what a cell's history says of its generations, (generations,) each.

    Args:
        best: lowest fitness
        passed: individuals that came within 1.5 cm of the goal in every condition, the papers' hit
        simulations: rollouts that were run
        seconds: wall time [s]
    """

    best: tuple[float, ...]
    passed: tuple[int, ...]
    simulations: tuple[int, ...]
    seconds: tuple[float, ...]


def make_cells(study: Study, scale: Scale, seeds: int, out: Path) -> list[Cell]:
    """Return the cells of a study, all levels of a seed before the next seed.

    Args:
        study: the study
        scale: how much of it is run
        seeds: how many, from 1
        out: folder of the study

    Returns:
        the cells

    Raises:
        InputError: a level's settings are wrong
    """
    levels = [(level, level_settings(study, scale, level)) for level in study.levels_at(scale)]
    return [
        Cell(study, level, seed, settings, out / CELLS / f"{level.name}-{seed}")
        for seed in range(1, seeds + 1)
        for level, settings in levels
    ]


def run_cells(cells: Sequence[Cell], out: Path, workers: int, done: Callable[[Cell, Curve], None]) -> None:
    """Run what is not done yet; what is not complete goes on from its last generation.

    The order in which cells run, and in which of the workers, changes nothing in them. If this process ends, in
    whatever way, its workers end too, and nothing but the generations that they were at is lost.

    Args:
        cells: the cells
        out: folder of the study, made if missing
        workers: processes, each of which runs one cell at a time on one thread
        done: called for each cell that is complete, those of earlier calls first

    Raises:
        InputError: the folder is in use, or holds something else than cells of this study
        RunError: a worker failed or was killed
    """
    _refuse_other_folder(out)
    with _claimed(out):
        _refuse_other_cells(cells, out)
        pending = []
        for cell in cells:
            curve = read_curve(cell)
            if curve is not None:
                done(cell, curve)
            else:
                pending.append(cell)
        if pending:
            _work(pending, min(workers, len(pending)), done)


def read_curve(cell: Cell) -> Curve | None:
    """Read a cell's generations from its history.

    Args:
        cell: the cell

    Returns:
        what the history says; None: it is not complete
    """
    path = cell.folder / HISTORY
    if not path.is_file():
        return None
    with open_history(path, empty=True) as connection:
        if connection.execute("select count(*) from sqlite_master").fetchone() == (0,):
            return None
        rows = connection.execute(_GENERATIONS, (cell.settings.goals,)).fetchall()
    return Curve(*zip(*rows, strict=True)) if len(rows) == cell.settings.generations else None


def _refuse_other_folder(out: Path) -> None:
    """Refuse a folder that holds something and is no study's."""
    if (out / RUN).exists():
        raise InputError(f"{out}: holds a run, and a study is many; give --out another folder")
    try:
        if out.is_dir() and not (out / CELLS).is_dir() and any(out.iterdir()):
            raise InputError(f"{out}: holds something else than a study; give --out another folder")
    except OSError as error:
        raise InputError(f"{out}: cannot be used ({error.strerror}); give --out another folder") from None


def _refuse_other_cells(cells: Sequence[Cell], out: Path) -> None:
    """Refuse a folder that holds a run which is no cell of this study, whatever its seed, before anything runs."""
    levels = {cell.level.name: cell for cell in cells}
    for path in sorted((out / CELLS).glob(f"*/{RUN}")):
        folder = path.parent
        level = folder.name.rpartition("-")[0]
        found = read_run_file(folder)
        load_again(folder, found)
        cell = levels.get(level)
        asked = cell and (study_task(cell.study).name, cell.study.rig, cell.study.engine, cell.settings)
        if asked != (found.task, found.rig, found.engine, found.settings) or folder.name != f"{level}-{found.seed}":
            raise InputError(
                f"{out}: holds another study, or this one at another scale, whose settings differ"
                f" ({CELLS}/{folder.name}); give --out another folder"
            )
        if found.versions != versions():
            raise InputError(f"{out}: holds this study as other versions ran it; give --out another folder")


def _run(cell: Cell) -> None:
    """Run a cell, in a worker."""
    if (cell.folder / RUN).is_file():
        resume(cell.folder, 1, lambda progress: None)
        return
    # whatever is there was killed before its run began
    shutil.rmtree(cell.folder, ignore_errors=True)
    task = study_task(cell.study)
    config = RunConfig(task, cell.folder, cell.seed, cell.settings, cell.study.rig, 1, cell.study.engine, decide=False)
    evolve(config, lambda progress: None)


def _work(pending: Sequence[Cell], workers: int, done: Callable[[Cell, Curve], None]) -> None:
    """Run cells in worker processes, each cell handed out when a worker is free."""
    context = multiprocessing.get_context("spawn")
    before = set(multiprocessing.active_children())
    queue = list(pending)
    running: dict[Future[None], Cell] = {}
    with ProcessPoolExecutor(workers, context, _end_with_parent) as executor:
        try:
            while queue or running:
                # a worker inherits what is blocked: the keyboard is the parent's alone, from the start
                mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
                while queue and len(running) < workers:
                    cell = queue.pop(0)
                    running[executor.submit(_run, cell)] = cell
                signal.pthread_sigmask(signal.SIG_SETMASK, mask)
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    cell = running.pop(future)
                    future.result()
                    curve = read_curve(cell)
                    if curve is None:
                        raise RunError(f"{cell.folder}: ended before its last generation; run the study again")
                    done(cell, curve)
        except BrokenProcessPool:
            raise RunError(
                "a worker of the study was killed; run it again with fewer --workers or more memory"
            ) from None
        finally:
            if running:
                # their histories hold every generation that was complete
                for child in set(multiprocessing.active_children()) - before:
                    child.terminate()


def _end_with_parent() -> None:
    """End with the parent process, however it ends."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _claimed(out: Path) -> Iterator[None]:
    """Keep a study's folder to one process; the system gives it back however that process ends."""
    try:
        (out / CELLS).mkdir(parents=True, exist_ok=True)
        lock = (out / _LOCK).open("w")
    except FileExistsError:
        raise InputError(f"{out}: is a file; give --out a folder") from None
    except OSError as error:
        raise InputError(f"{out}: cannot be used ({error.strerror}); give --out another folder") from None
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise InputError(
                f"{out}: another study is running there; wait for it, or give --out another folder"
            ) from None
        yield
