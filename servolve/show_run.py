"""A run as text: how its generations did, where its best came from, and its program."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from controller import format_source
from controller.errors import InputError
from evolve.runs.history import open_history
from evolve.runs.record import (
    Ancestor,
    First,
    GenerationSummary,
    ancestors_of_each_generation,
    best_controller,
    best_of,
    first_everywhere,
    generation_summaries,
    lineage,
)
from evolve.runs.run import is_finished
from evolve.runs.run_file import RunFile, read_run_file
from evolve.runs.run_folder import HISTORY, locked

_TEXT_WIDTH: Final = 44


def run_lines(folder: Path) -> Iterator[str]:
    """Yield the lines that tell of a run: what it is, its generations, its best's lineage and program.

    Args:
        folder: the run's, which may be unfinished or being written

    Raises:
        InputError: there is no run in it
    """
    found = read_run_file(folder)
    state = run_state(folder, found)
    best = best_of(folder)
    yield f"run        {folder}: {found.task} on {found.rig}, engine {found.engine}, seed {found.seed}"
    yield f"state      {state}"
    if best is None:
        return
    with open_history(folder / HISTORY) as connection:
        generations = generation_summaries(connection)
        hit = first_everywhere(connection, "hits", found.settings.goals)
        passed = first_everywhere(connection, "passed", found.settings.goals)
        line = lineage(connection, *best)
        counts = ancestors_of_each_generation(connection, *best)
    controller = best_controller(folder)
    yield ""
    yield from _table(*generation_table(generations))
    yield ""
    yield f"hit every condition (1.5 cm at the end, at rest, upright): {_first(hit)}"
    yield f"passed within 1.5 cm in every condition, at any time:      {_first(passed)}"
    yield ""
    chosen = "best of the run" if is_finished(folder) else "best so far"
    yield f"{chosen}: generation {best[0]}, individual {best[1]}; it and its first parents:"
    yield ""
    yield from _table(*lineage_table(line, counts), text_columns=2)
    yield ""
    yield format_source(controller.source)


def _first(first: First | None) -> str:
    """Say who was first, and how many followed."""
    if first is None:
        return "nobody"
    return (
        f"first the {first.examined}. individual examined (generation {first.generation}, individual"
        f" {first.individual}), {first.count} in all"
    )


def run_state(folder: Path, found: RunFile) -> str:
    """Say how far a run is and how to go on with it.

    Args:
        folder: the run's
        found: what its `run.toml` says
    """
    done = 0
    if (folder / HISTORY).is_file():
        with open_history(folder / HISTORY, empty=True) as connection:
            if connection.execute("select count(*) from sqlite_master").fetchone() != (0,):
                (done,) = connection.execute("select count(*) from generation").fetchone()
    total = found.settings.generations
    if is_finished(folder):
        return f"finished, {done} generations"
    if done == total and not found.decide:
        return f"finished, {done} generations; a search alone, which chooses no best"
    how_far = f"{done} of {total} generations" if done < total else f"all {total} generations, the best not yet chosen"
    try:
        with locked(folder):
            return f"interrupted, {how_far}; go on with servolve evolve --resume {folder}"
    except InputError:
        return f"running, {how_far}"


def generation_table(generations: list[GenerationSummary]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return the head and the rows of the table of generations.

    Args:
        generations: how each did
    """
    head = ("generation", "best", "mean", "main", "hits", "passed", "nodes", "hit all", "distinct", "rollouts", "s")
    rows: list[tuple[str, ...]] = [
        (
            *(str(g.generation), f"{g.best:.4f}", f"{g.mean:.3f}", f"{g.main:.4f}"),
            *(f"{g.hits}/{g.conditions}", f"{g.passed}/{g.conditions}", str(g.nodes), str(g.hit_all)),
            *(f"{g.distinct}/{g.population}", str(g.simulations), f"{g.seconds:.1f}"),
        )
        for g in generations
    ]
    return head, rows


def lineage_table(line: list[Ancestor], counts: list[int]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return the head and the rows of the table of a lineage.

    Args:
        line: an individual and its first parents, the latest first
        counts: how many individuals of each of these generations it descends from
    """
    head = ("operator", "program", "generation", "individual", "parents", "fitness", "hits", "nodes", "ancestors")
    rows: list[tuple[str, ...]] = [
        (
            *(a.operator, textwrap.shorten(a.text, _TEXT_WIDTH, placeholder=" …")),
            *(str(a.generation), str(a.individual), ", ".join(map(str, a.parents)) or "–"),
            *(f"{a.fitness:.4f}", f"{a.hits}/{a.conditions}", str(a.nodes), str(count)),
        )
        for a, count in zip(line, counts, strict=True)
    ]
    return head, rows


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]], text_columns: int = 0) -> Iterator[str]:
    """Yield a table's lines, text to the left and numbers to the right."""
    widths = [max(len(row[column]) for row in (head, *rows)) for column in range(len(head))]
    for row in (head, *rows):
        cells: list[Any] = [
            cell.ljust(width) if column < text_columns else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        yield "  ".join(cells).rstrip()
