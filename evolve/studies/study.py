"""Studies: one setting of a search varied over a grid and over seeds, and claims about it that can be tested."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

from controller.errors import InputError
from evolve.settings import Settings, apply_overrides
from evolve.task import Task, load_task

ScaleName: TypeAlias = Literal["full", "reduced", "tiny"]


@dataclass(frozen=True)
class Level:
    """Name one point of a grid.

    Args:
        name: what tables and claims call it
        settings: ``KEY=VALUE`` each, what makes it this point
        number: its place on a scale; None: it has none
    """

    name: str
    settings: tuple[str, ...]
    number: float | None = None


@dataclass(frozen=True)
class Claim:
    """Say what a paper found, as comparisons of a level with a reference.

    Args:
        text: the statement
        kind: "worse": the level ends at a worse fitness than the reference; "alike": within the study's margin of it;
            "no better": not better than it by the margin or more
        pairs: names of level and reference, all of which must be so
    """

    text: str
    kind: Literal["worse", "alike", "no better"]
    pairs: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Scale:
    """Say how much of a study is run.

    Args:
        levels: names of the points of the grid
        seeds: how many, from 1, unless the command line says another number
        settings: ``KEY=VALUE`` each, beside the study's own
        reduced: what is less than in the paper, for the table
    """

    levels: tuple[str, ...]
    seeds: int
    settings: tuple[str, ...] = ()
    reduced: str = "nothing"


@dataclass(frozen=True)
class Study:
    """Declare a study: all that is decided before it runs.

    Args:
        name: what the command line calls it
        title: what is varied
        source: paper and figure
        task: name of the task
        rig: name of the rig
        engine: name of the method
        settings: ``KEY=VALUE`` each, as the paper had them
        axis: what the levels are, for tables and axes
        levels: the paper's grid
        claims: what the paper found
        metric: "raw": fitness, lower is better; "adjusted": 1 / (1 + fitness), higher is better
        margin: the difference that matters, as a share of the reference's median
        scales: how much is run, by name
    """

    name: str
    title: str
    source: str
    task: str
    rig: str
    engine: str
    settings: tuple[str, ...]
    axis: str
    levels: tuple[Level, ...]
    claims: tuple[Claim, ...]
    metric: Literal["raw", "adjusted"]
    margin: float
    scales: Mapping[ScaleName, Scale]

    def levels_at(self, scale: Scale) -> tuple[Level, ...]:
        """Return the points of the grid that a scale keeps, in the grid's order."""
        return tuple(level for level in self.levels if level.name in scale.levels)


def grid(setting: str, values: Iterable[float]) -> tuple[Level, ...]:
    """Return the levels of a setting that is a number.

    Args:
        setting: its name
        values: its values, in order

    Returns:
        a level for each
    """
    return tuple(Level(f"{value:g}", (f"{setting}={value:g}",), float(value)) for value in values)


def against(reference: str, *names: str) -> tuple[tuple[str, str], ...]:
    """Return the pairs that compare some levels with one reference.

    Args:
        reference: name of the reference
        names: names of the levels

    Returns:
        a pair for each level
    """
    return tuple((name, reference) for name in names)


def study_task(study: Study) -> Task:
    """Return the task of a study as it is on its rig.

    Args:
        study: the study
    """
    return load_task(study.task).for_rig(study.rig)


def level_settings(study: Study, scale: Scale, level: Level) -> Settings:
    """Return the settings of the runs of one level.

    Args:
        study: the study
        scale: how much of it is run
        level: the point of its grid

    Returns:
        the task's settings on the study's rig, then those of study, scale and level, each over the one before

    Raises:
        InputError: the task or a setting is unknown, or a value out of its range
    """
    try:
        return apply_overrides(study_task(study).settings, [*study.settings, *scale.settings, *level.settings])
    except InputError as error:
        raise InputError(f"study {study.name}, {study.axis} {level.name}: {error}") from None
