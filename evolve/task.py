"""Tasks: what a controller is evolved for. A task is one Python file that binds `TASK`.

A task file needs little more than its fitness::

    from evolve.task import Settings, Task

    def fitness(rollouts, goal_m):
        end = rollouts.statistics
        return end["final_error"] + 0.5 * end["fallen"], end["end_joint_error"]

    TASK = Task(name="walk", rig="lamp-xc330", terminals=("t", "px"), fitness=fitness)
"""

from __future__ import annotations

import difflib
import importlib
import importlib.util
import re
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from types import ModuleType
from typing import TypeAlias

import mujoco
import numpy as np
import numpy.typing as npt

from controller.errors import InputError
from evolve.settings import Settings, check
from sim_models.rollouts import Rollouts, StopConditions

__all__ = ["BUILT_IN", "FloatArray", "Settings", "StopConditions", "Task", "load_task", "place_of", "score"]

FloatArray: TypeAlias = npt.NDArray[np.float64]
Fitness: TypeAlias = Callable[[Rollouts, FloatArray], tuple[FloatArray, FloatArray]]
Scene: TypeAlias = Callable[[mujoco.MjSpec, Settings], None]

BUILT_IN = {
    "lamp": "evolve.tasks.lamp",
    "lamp-robust": "evolve.tasks.lamp_robust",
    "lamp-limbo": "evolve.tasks.lamp_limbo",
    "jumper": "evolve.tasks.jumper",
}
"""Module of each task that has a name."""

_BUILT_IN_FOLDER = Path(__file__).resolve().parent / "tasks"
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_.-]{0,63}\Z")
_UNKNOWN = re.compile(r"(Settings|StopConditions|Task)\.__init__\(\) got an unexpected keyword argument '(\w+)'")


@dataclass(frozen=True)
class Task:
    """Describe a task.

    Args:
        name: of the task and of its controllers
        rig: name of the rig that it is for, or path of its file, seen from the task's file
        terminals: inputs of its controllers, all of which the rig must supply
        fitness: ``(rollouts, goal distances [m] (nsim,)) -> (main, style)``, lower is better, each (nsim,);
            a rollout's fitness is ``main + sqrt(g / G) * style`` in generation g of G
        settings: the numbers of its runs
        stop: when a rollout is over before its time
        traces: whether `fitness` reads ``rollouts.traces``, which costs memory
        engine: method that breeds, unless the command line says another
        scene: what stands in the body's way: ``(MjSpec, settings) -> None`` adds it before the model is compiled
        on: the task on other rigs, by name, where it differs there
    """

    name: str
    rig: str
    terminals: tuple[str, ...]
    fitness: Fitness
    settings: Settings = field(default_factory=Settings)
    stop: StopConditions = field(default_factory=StopConditions)
    traces: bool = False
    engine: str = "gp"
    scene: Scene | None = None
    on: Mapping[str, Task] = field(default_factory=dict)

    def for_rig(self, rig: str | None) -> Task:
        """Return the task as it is on a rig: another terminal set, other numbers.

        Args:
            rig: name of the rig; None: the task's own
        """
        return self.on.get(rig, self) if rig is not None else self

    def scene_with(self, settings: Settings) -> Callable[[mujoco.MjSpec], None] | None:
        """Return what adds the task's scene to a body, or None if it has none; its mistakes are told in one sentence.

        Args:
            settings: the run's numbers
        """
        scene = self.scene
        if scene is None:
            return None

        def add(spec: mujoco.MjSpec) -> None:
            try:
                scene(spec, settings)
            except Exception as error:
                raise InputError(_sentence(_file_of(scene, self.name), error)) from error

        return add


def load_task(name_or_path: str) -> Task:
    """Return a built-in task by name, or the task of a Python file by path.

    Args:
        name_or_path: a key of `BUILT_IN`, or a path that ends in ``.py``

    Returns:
        the checked task

    Raises:
        InputError: there is no such task, or the file does not hold one
    """
    if name_or_path in BUILT_IN:
        return _checked(importlib.import_module(BUILT_IN[name_or_path]), name_or_path)
    path = Path(name_or_path)
    if path.suffix != ".py" and not path.exists():
        close = difflib.get_close_matches(name_or_path, BUILT_IN, n=1)
        hint = f"did you mean {close[0]}?" if close else f"give one of {', '.join(BUILT_IN)}, or the path of a .py file"
        raise InputError(f"{name_or_path}: there is no such task; {hint}")
    if not path.is_file():
        kind = "a folder" if path.is_dir() else "missing"
        raise InputError(f"{name_or_path}: the task file is {kind}; give the path of a Python file that binds TASK")
    task = _checked(_run_file(path), name_or_path)
    beside = path.parent / task.rig
    return replace(task, rig=str(beside)) if beside.suffix == ".toml" and beside.is_file() else task


def score(task: Task, rollouts: Rollouts, goal_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Apply a task's fitness and check what it gives.

    Args:
        task: the task
        rollouts: finished rollouts
        goal_m: goal distance of each [m], (nsim,)

    Returns:
        main goal and style points of each rollout, infinite where not finite or where physics diverged, (nsim,) each

    Raises:
        InputError: the task's fitness failed, or gave something else than two numbers for each rollout
    """
    origin = _file_of(task.fitness, task.name)
    try:
        # what is not finite counts as infinitely bad below, and is no news on the screen
        with np.errstate(all="ignore"):
            given = task.fitness(rollouts, goal_m)
        parts = tuple(np.asarray(part, np.float64) for part in given)
    except Exception as error:
        traces_missing = rollouts.traces is None and isinstance(error, TypeError) and "NoneType" in str(error)
        remedy = "give Task(…) traces=True if you read rollouts.traces" if traces_missing else "correct the task file"
        raise InputError(_sentence(origin, error, remedy)) from error
    one_array = isinstance(given, np.ndarray) and given.ndim != 2  # of two rollouts it would look like a pair
    # one number for all is enough of a style, but no search is to be had of it
    shapes = ((goal_m.shape,), ((), goal_m.shape))
    if one_array or len(parts) != 2 or any(part.shape not in may for part, may in zip(parts, shapes, strict=True)):
        raise InputError(
            f"{origin}: fitness gave shapes {[part.shape for part in parts]}; return (main, style), one number each"
            f" for each of the {len(goal_m)} rollouts"
        )
    main, style = (np.broadcast_to(part, goal_m.shape) for part in parts)
    lost = (rollouts.statistics["status"] != 0) | ~np.isfinite(main) | ~np.isfinite(style)
    return np.where(lost, np.inf, main), np.where(lost, 0.0, style)


def place_of(task: Task, word: str = "") -> str:
    """Return where a task's file says something, for a message; the task's name where there is no such file or line.

    Args:
        task: the task
        word: a text that stands in quotes there; empty: the fitness
    """
    path = _file_of(task.fitness, task.name)
    code = getattr(task.fitness, "__code__", None)
    if code is None or path.resolve().parent == _BUILT_IN_FOLDER or not path.is_file():
        return task.name
    if not word:
        return f"{path}:{code.co_firstlineno}"
    quoted = re.compile(rf"([\"']){re.escape(word)}\1")
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    return next((f"{path}:{number}" for number, line in enumerate(lines, 1) if quoted.search(line)), task.name)


def _run_file(path: Path) -> ModuleType:
    """Execute a task file and return its module."""
    try:
        source = path.read_bytes()
        code = compile(source, str(path), "exec")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the file's permissions") from None
    except (SyntaxError, ValueError) as error:
        raise InputError(_sentence(path, error)) from None
    module = ModuleType("servolve_task")
    module.__file__ = str(path)
    try:
        exec(code, module.__dict__)
    except InputError:
        raise
    except (Exception, SystemExit) as error:
        raise InputError(_sentence(path, error)) from error
    return module


def _file_of(function: object, name: str) -> Path:
    """Return where a function of a task was written."""
    code = getattr(function, "__code__", None)
    return Path(code.co_filename if code is not None else name)


def _sentence(path: Path, error: BaseException, remedy: str = "correct the task file") -> str:
    """Say where in the file an error arose, what it was and what to do."""
    line = None
    if isinstance(error, SyntaxError):
        line = error.lineno
    else:
        frames = [f for f in traceback.extract_tb(error.__traceback__) if f.filename == str(path)]
        line = frames[-1].lineno if frames else None
    place = f"{path}:{line}" if line else f"{path}"
    told = error.msg if isinstance(error, SyntaxError) else str(error)
    unknown = _UNKNOWN.match(told)
    if unknown:
        return f"{place}: {_no_such_field(*unknown.groups())}"
    return f"{place}: {type(error).__name__}: {' '.join(told.split()) or 'no message'}; {remedy}"


def _no_such_field(name: str, given: str) -> str:
    """Say that a class of a task file has no such field, and which was meant."""
    known = [one.name for one in fields({"Settings": Settings, "StopConditions": StopConditions, "Task": Task}[name])]
    close = difflib.get_close_matches(given, known, n=1)
    hint = f"did you mean {close[0]}?" if close else f"known are {', '.join(known)}"
    return f"{name} has no {given!r}; {hint}"


def _checked(module: ModuleType, origin: str) -> Task:
    """Return a module's task if it is one."""
    task = getattr(module, "TASK", None)
    if not isinstance(task, Task):
        what = "nothing" if task is None else f"a {type(task).__name__}"
        raise InputError(
            f"{origin}: TASK is {what}; bind TASK = evolve.task.Task(name=…, rig=…, terminals=…, fitness=…)"
        )
    if not isinstance(task.name, str) or not _NAME.match(task.name):
        raise InputError(f"{origin}: the task's name {task.name!r} is no name; use letters, digits, '_', '.', '-'")
    if not callable(task.fitness):
        raise InputError(f"{origin}: the task's fitness is no function; give fitness(rollouts, goal_m)")
    if not isinstance(task.rig, str) or not task.rig:
        raise InputError(f"{origin}: the task's rig is {task.rig!r}; give the name of a rig or the path of a rig.toml")
    terminals = task.terminals
    if isinstance(terminals, str) or not terminals or not all(isinstance(name, str) for name in terminals):
        raise InputError(f"{origin}: the task's terminals are {terminals!r}; give a tuple of names, as ('t', 'px')")
    if len(set(terminals)) != len(terminals):
        raise InputError(f"{origin}: a terminal is listed twice in {terminals!r}; list each once")
    check(task.settings, origin)
    return task
