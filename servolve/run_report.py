"""The report of a run: one HTML file with everything in it, for the screen and for paper."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from controller import Controller, format_source
from controller.errors import InputError
from evolve.runs.history import open_history
from evolve.runs.record import (
    Ancestor,
    GenerationSummary,
    ancestors_of_each_generation,
    best_controller,
    best_of,
    generation_summaries,
    lineage,
)
from evolve.runs.run import is_finished
from evolve.runs.run_file import RunFile, read_run_file
from evolve.runs.run_folder import HISTORY, PARETO, VALIDATION, read_validation, write_whole
from evolve.settings import asked_objectives
from servolve.figures import RIG, SIM
from servolve.report import NARROW, Rows, render
from servolve.run_figures import fitness_figure, pareto_figure, population_figure
from servolve.run_films import Film, films_of
from servolve.show_run import generation_table, lineage_table, run_state
from servolve.tree_picture import tree_svg


@dataclass(frozen=True, eq=False)
class RunRecord:
    """Hold what a run's folder tells.

    Args:
        folder: the run's
        found: what its `run.toml` says
        state: how far it is
        generations: how each did
        nodes: sizes of each generation's individuals
        best: the best and its first parents, the latest first
        ancestors: how many individuals of each of their generations it descends from
        controller: the best
        validation: content of `validation.json`; None: the best is not chosen yet
        front: members of the Pareto front
    """

    folder: Path
    found: RunFile
    state: str
    generations: Sequence[GenerationSummary]
    nodes: Sequence[Sequence[int]]
    best: Sequence[Ancestor]
    ancestors: Sequence[int]
    controller: Controller
    validation: Mapping[str, Any] | None
    front: Sequence[Mapping[str, Any]]


def write_run_report(folder: Path, path: Path) -> str | None:
    """Write the report of a run, finished or not.

    Args:
        folder: the run's
        path: the HTML file, overwritten

    Returns:
        what the report lacks and why, or None

    Raises:
        InputError: the folder holds no generation, or is not as the run left it
        RunError: the report cannot be written
    """
    if not path.parent.is_dir() or path.is_dir():
        raise InputError(f"{path}: is no file in a folder that exists; name another HTML file")
    record = read_record(folder)
    films, lacking = films_of(folder, record.found, record.generations, (record.best[0], record.controller))
    write_whole(path, run_report_html(record, films, lacking).encode())
    return lacking


def read_record(folder: Path) -> RunRecord:
    """Return what a run's folder tells.

    Args:
        folder: the run's

    Raises:
        InputError: the folder holds no generation, or is not as the run left it
    """
    found = read_run_file(folder)
    best = best_of(folder)
    if best is None:
        raise InputError(f"{folder}: has no generation yet; go on with servolve evolve --resume {folder}")
    with open_history(folder / HISTORY) as connection:
        generations = generation_summaries(connection)
        sizes = "select nodes from evaluation where generation = ?"
        nodes = [[n for (n,) in connection.execute(sizes, (g.generation,))] for g in generations]
        line = lineage(connection, *best)
        counts = ancestors_of_each_generation(connection, *best)
    finished = is_finished(folder)
    return RunRecord(
        folder=folder,
        found=found,
        state=run_state(folder, found),
        generations=generations,
        nodes=nodes,
        best=line,
        ancestors=counts,
        controller=best_controller(folder),
        validation=read_validation(folder / VALIDATION) if finished else None,
        front=_json(folder / PARETO)["front"] if finished and (folder / PARETO).is_file() else (),
    )


def run_report_html(record: RunRecord, films: Sequence[Film], lacking: str | None) -> str:
    """Return the report as HTML; the same record and films give the same bytes.

    Args:
        record: what the run's folder tells
        films: strips of the best of some generations
        lacking: why there are no films, or None
    """
    from markupsafe import Markup

    found, settings = record.found, record.found.settings
    objectives = asked_objectives(settings)
    figures = {
        "fitness": fitness_figure(record.generations),
        "population": population_figure(record.generations, record.nodes),
        "pareto": pareto_figure(record.front, objectives) if record.front else "",
    }
    task_file = record.folder / found.task_file
    return render(
        "run_report.html.j2",
        title=f"{found.task} on {found.rig}, seed {found.seed}",
        lead=_lead(record),
        verdict=_verdict(record),
        colours={"rig": RIG, "sim": SIM},
        outcome=_outcome_rows(record.validation),
        run=_run_rows(record),
        films=films,
        film_note=lacking or _FILM_NOTE,
        redraw=settings.redraw,
        figures={name: Markup(svg) for name, svg in figures.items()},
        objectives=objectives,
        pareto=_pareto_rows(record.front, objectives),
        held_out=_held_out_rows(record.validation),
        lineage=_table(lineage_table(list(record.best), list(record.ancestors)), 2),
        tree=Markup(tree_svg(record.controller)),
        program=format_source(record.controller.source),
        generations=_table(generation_table(list(record.generations)), 1),
        settings=_setting_rows(found),
        versions=Rows((), tuple({**found.versions, **found.hashes}.items()), 2),
        task_text=task_file.read_text(encoding="utf-8") if found.task_file else "",
    )


_FILM_NOTE: Final = (
    "The best of some generations, all with the same goal on the rig as its file states it, in the physics that chooses"
    " the best."
)


def _lead(record: RunRecord) -> str:
    settings = record.found.settings
    method = {"gp": "tree genetic programming", "gep": "gene expression programming"}
    simulations = sum(g.simulations for g in record.generations)
    return (
        f"{method.get(record.found.engine, record.found.engine).capitalize()}, {settings.population} individuals,"
        f" {record.state}, {simulations} rollouts."
    )


def _verdict(record: RunRecord) -> str:
    """Say in a sentence how good the best is."""
    if record.validation is None:
        g = record.generations[-1]
        return f"Not judged yet. The best of generation {g.generation} hit {g.hits} of {g.conditions} conditions."
    v = record.validation["held_out"]
    return (
        f"Under {v['conditions']} unseen goals and rigs it ends {100 * v['mean_error_m']:.1f}{NARROW}cm from the goal"
        f" on average, hits {v['hits']:.0%}, falls in {v['falls']:.0%} and {_hopping(record.validation)}, with"
        f" {1000 * v['clearance_m']:.0f}{NARROW}mm under its feet."
    )


def _hopping(validation: Mapping[str, Any]) -> str:
    """Say in how many of the held-out conditions the best hops, and how often."""
    v = validation["held_out"]
    if v["hops_mean"] == 0:
        return "does not hop"
    often = f"{v['hops_mean']:.1f} times on average"
    if "conditions" not in validation:
        return f"hops {often}"
    hopping = sum(condition["hops"] > 0 for condition in validation["conditions"])
    return f"hops in {hopping} of {v['conditions']}, {often}"


def _outcome_rows(validation: Mapping[str, Any] | None) -> Rows | None:
    if validation is None:
        return None
    v, stated = validation["held_out"], validation.get("stated")
    rows = (
        ("mean error at the end", f"{100 * v['mean_error_m']:.2f}{NARROW}cm"),
        ("median error", f"{100 * v['median_error_m']:.2f}{NARROW}cm"),
        ("hits (1.5 cm at the end, at rest, upright)", f"{v['hits']:.0%}"),
        ("came within 1.5 cm at any time", f"{v['passed']:.0%}"),
        ("within 5 cm at the end, upright", f"{v['within_50_mm']:.0%}"),
        ("falls", f"{v['falls']:.0%}"),
        ("hops, mean and fewest", f"{v['hops_mean']:.1f}, {v['hops_min']}"),
        ("mean of the largest clearances", f"{1000 * v['clearance_m']:.0f}{NARROW}mm"),
        *((("hits on the rig as its file states it", f"{stated['hits']:.0%}"),) if stated else ()),
    )
    return Rows((), rows)


def _run_rows(record: RunRecord) -> Rows:
    best, found = record.best[0], record.found
    simulations = sum(g.simulations for g in record.generations)
    first = next((g.generation for g in record.generations if g.hit_all), None)
    rows = (
        ("engine", found.engine),
        ("best found in", f"generation {best.generation}, individual {best.individual}"),
        ("its size", f"{best.nodes} nodes, {len(record.controller.program.instructions)} instructions"),
        ("first to hit every condition", "none" if first is None else f"in generation {first}"),
        ("individuals examined", str(sum(g.population for g in record.generations))),
        ("rollouts", str(simulations)),
        ("time of the search", f"{sum(g.seconds for g in record.generations):.0f}{NARROW}s"),
    )
    return Rows((), rows)


def _held_out_rows(validation: Mapping[str, Any] | None) -> Rows | None:
    if validation is None or "conditions" not in validation:
        return None
    head = ("condition", "goal [cm]", "bearing [°]", "error [cm]", "hit", "passed", "fell", "hops", "clearance [mm]")
    rows = tuple(
        (
            *(str(number), f"{100 * c['goal_m']:.1f}", f"{57.29578 * c['bearing_rad']:.0f}"),
            *(f"{100 * c['final_error_m']:.2f}", *("yes" if c[key] else "–" for key in ("hit", "passed", "fell"))),
            *(str(c["hops"]), f"{1000 * c['clearance_m']:.0f}"),
        )
        for number, c in enumerate(validation["conditions"], 1)
    )
    return Rows(head, rows)


def _pareto_rows(front: Sequence[Mapping[str, Any]], objectives: Sequence[str]) -> Rows | None:
    if not front:
        return None
    head = ("generation", "individual", "fitness", "hits", *(name.replace("_", " ") for name in objectives))
    rows = tuple(
        (
            *(str(one["generation"]), str(one["individual"]), f"{one['fitness']:.4f}"),
            *(f"{one['hits']}/{one['conditions']}", *(f"{one[name]:g}" for name in objectives)),
        )
        for one in front
    )
    return Rows(head, rows, 0)


def _setting_rows(found: RunFile) -> Rows:
    """Return the run's numbers and what they mean."""
    fields = dataclasses.fields(found.settings)
    rows = tuple((f.name, f"{getattr(found.settings, f.name)}", str(f.metadata.get("meaning", ""))) for f in fields)
    return Rows((), rows, 3)


def _table(table: tuple[tuple[str, ...], list[tuple[str, ...]]], text_columns: int) -> Rows:
    head, rows = table
    return Rows(head, tuple(rows), text_columns)


def _json(path: Path) -> Any:  # noqa: ANN401  what json gives
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: not as the run wrote it ({error}); put back the file that it wrote") from None
