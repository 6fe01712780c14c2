"""Evolution: tasks, genetic programming, runs."""

from evolve.runs.history import ordered_dump
from evolve.runs.run import Progress, RunConfig, RunResult, evolve, resume
from evolve.settings import Settings, apply_overrides
from evolve.task import Task, load_task

__all__ = [
    "Progress",
    "RunConfig",
    "RunResult",
    "Settings",
    "Task",
    "apply_overrides",
    "evolve",
    "load_task",
    "ordered_dump",
    "resume",
]
