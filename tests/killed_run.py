"""A run that is killed again and again, in processes of its own, until it is done: what `test_killed_run.py` starts.

python killed_run.py FOLDER ENGINE SEED KILLS
"""

from __future__ import annotations

import json
import os
import random
import signal
import sqlite3
import sys
import time
import traceback
from pathlib import Path

from evolve import RunConfig, apply_overrides, evolve, load_task, resume

TASK_FILE = Path(__file__).parent / "killed_task.py"
SEED = 7


def config(folder: Path, numbers=(), **others) -> RunConfig:
    """Say what the runs are: small, and in nothing like a built-in task that may change meanwhile."""
    task = load_task(str(TASK_FILE))
    settings = apply_overrides(task.settings, numbers)
    return RunConfig(task, folder, SEED, settings, task_text=TASK_FILE.read_bytes(), **others)


def start(folder: Path, engine: str, threads: int, progress=lambda progress: None):
    return evolve(config(folder, threads=threads, engine=engine), progress)


def work(folder: Path, engine: str, threads: int, steps: int) -> None:
    """Begin the run or go on with it; die at the given step of SQLite's virtual machine, 0: do not."""
    if steps:
        connect = sqlite3.connect

        def watched(*arguments, **options):
            connection = connect(*arguments, **options)
            connection.set_progress_handler(lambda: os.kill(os.getpid(), signal.SIGKILL), steps)
            return connection

        sqlite3.connect = watched
    if (folder / "run.toml").exists():
        resume(folder, threads, lambda progress: None)
    else:
        for left in folder.iterdir() if folder.exists() else ():
            left.unlink()
        start(folder, engine, threads)


def attempt(folder: Path, engine: str, threads: int, steps: int, when) -> str:
    """Let a process work until it is done or until `when` says to kill it."""
    child = os.fork()
    if child == 0:
        try:
            work(folder, engine, threads, steps)
        except BaseException:
            traceback.print_exc()
            os._exit(1)
        os._exit(0)
    began = time.monotonic()
    while True:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return "killed" if os.WIFSIGNALED(status) else "done" if status == 0 else "failed"
        if when(time.monotonic() - began):
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return "killed"


def seen_for_the(nth: int, path: Path):
    """Return what tells whether a file is there for the nth time."""
    state = {"there": False, "times": 0}

    def seen() -> bool:
        there = path.exists()
        state["times"] += there and not state["there"]
        state["there"] = there
        return state["times"] >= nth

    return seen


def main(folder: Path, engine: str, seed: int, kills: int) -> None:
    chance = random.Random(seed)
    # at a step of SQLite's work on a generation, at some time, while a transaction is on its way to the disk
    kinds = chance.sample(["step", "time", "commit"], k=kills, counts=[kills] * 3)
    kinds = ["step", *kinds, "replace", "replace"]
    moments: dict[str, int] = {}
    status = "killed"
    for count, kind in enumerate([*kinds, "never"]):
        delay, steps = chance.uniform(0.0, 0.15), chance.randrange(1, 500)
        commit = seen_for_the(chance.randrange(1, 3), folder / "history.sqlite-journal")
        status = attempt(
            folder,
            engine,
            threads=1 + count % 3,
            steps=steps if kind == "step" else 0,
            when={
                "time": lambda elapsed, delay=delay: elapsed > delay,
                "commit": lambda elapsed, commit=commit: commit(),
                "replace": lambda elapsed: (folder / "validation.json.part").exists(),
            }.get(kind, lambda elapsed: False),
        )
        if status != "killed":
            break
        moments[kind] = moments.get(kind, 0) + 1
    sys.stdout.write(json.dumps({"status": status, "moments": moments}))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))
