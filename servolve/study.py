"""`servolve study`: rerun a convergence experiment of the founding papers, and judge what they found."""

from __future__ import annotations

import json
import os
import sys
from collections import defaultdict
from pathlib import Path
from typing import Annotated, Any, Final

from cyclopts import Parameter
from rich.console import Console
from rich.table import Table

from controller.errors import InputError, RunError
from evolve.runs.run_folder import write_whole
from evolve.studies.cells import Cell, Curve, make_cells, run_cells
from evolve.studies.papers import STUDIES
from evolve.studies.study import ScaleName, Study
from servolve.study_figure import study_figure
from servolve.study_report import METRICS, Finished, fragment, generations_csv, rows, table_csv
from servolve.study_verdict import judge

_OUT: Final = Path("studies")
_SEEDS_MAX: Final = 1000
_WORKERS_MAX: Final = 1024


def study(
    name: str,
    /,
    *,
    out: Path | None = None,
    workers: int | None = None,
    seeds: int | None = None,
    scale: ScaleName = "reduced",
    quiet: Annotated[bool, Parameter(negative="")] = False,
    json_: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> int:
    """Rerun a convergence experiment of the papers: tables, a figure, and a verdict on each claim by rank tests.

    Every run is kept, so the same command goes on where it was stopped, and more seeds add to it.
    The same study gives the same files with any number of workers.

    Args:
        name: which; `list` lists them
        out: folder of the study; left out: studies/NAME-SCALE
        workers: processes, one thread each; left out: one per CPU
        seeds: how many runs of each level; left out: as the scale says
        scale: full: the paper's grid; reduced: about half a core-hour; tiny: seconds, to see that it runs
        quiet: no progress
        json_: print one JSON object

    Returns:
        exit status
    """
    if name == "list":
        _list(json_)
        return 0
    if name not in STUDIES:
        raise InputError(f"study {name}: there is no such study; choose one of {', '.join(STUDIES)}")
    chosen = STUDIES[name]
    workers = _count("--workers", len(os.sched_getaffinity(0)) if workers is None else workers, _WORKERS_MAX)
    seeds = _count("--seeds", chosen.scales[scale].seeds if seeds is None else seeds, _SEEDS_MAX)
    folder = out if out is not None else _OUT / f"{name}-{scale}"
    finished = run_study(chosen, scale, seeds, folder, workers, quiet)
    write_study(finished, folder)
    if json_:
        print(json.dumps(_summary(finished, folder)))
    elif not quiet:
        _print(finished, folder)
    return 0


def run_study(chosen: Study, scale: ScaleName, seeds: int, folder: Path, workers: int, quiet: bool) -> Finished:
    """Run the cells of a study that are not done yet.

    Args:
        chosen: the study
        scale: how much of it
        seeds: how many, from 1
        folder: of the study
        workers: processes
        quiet: no progress

    Returns:
        the study with all its cells

    Raises:
        InputError: settings or folder are wrong
        RunError: interrupted, or a run failed
    """
    cells = make_cells(chosen, chosen.scales[scale], seeds, folder)
    found: dict[str, dict[int, Curve]] = defaultdict(dict)

    def done(cell: Cell, curve: Curve) -> None:
        found[cell.level.name][cell.seed] = curve
        if not quiet:
            count = sum(len(curves) for curves in found.values())
            print(
                f"{count}/{len(cells)}: {chosen.axis} {cell.level.name}, seed {cell.seed}: best {curve.best[-1]:.4f}"
                f" ({sum(curve.simulations)} rollouts, {sum(curve.seconds):.0f} s)",
                file=sys.stderr,
                flush=True,
            )

    try:
        run_cells(cells, folder, workers, done)
    except KeyboardInterrupt:
        raise RunError(f"interrupted from the keyboard; the same command goes on in {folder} where it was") from None
    ordered = {
        level.name: tuple(found[level.name][seed] for seed in range(1, seeds + 1))
        for level in chosen.levels_at(chosen.scales[scale])
    }
    return Finished(chosen, scale, seeds, ordered)


def write_study(finished: Finished, folder: Path) -> None:
    """Write NAME.csv, NAME.generations.csv, NAME.md, NAME.svg and NAME.png.

    Args:
        finished: the study
        folder: where they go

    Raises:
        RunError: they cannot be written
    """
    name = finished.study.name
    files = {
        "csv": table_csv(finished).encode(),
        "generations.csv": generations_csv(finished).encode(),
        "md": fragment(finished, f"{name}.svg").encode(),
        **study_figure(finished),
    }
    try:
        for ending, content in files.items():
            write_whole(folder / f"{name}.{ending}", content)
    except RunError:
        raise RunError(f"{folder}: cannot be written; make room there, then give the same command again") from None


def _count(option: str, value: int, high: int) -> int:
    """Check a count."""
    if not 1 <= value <= high:
        raise InputError(f"{option} {value}: not from 1 to {high}; give a number in this range")
    return value


def _list(as_json: bool) -> None:
    """Print the studies that there are."""
    if as_json:
        print(json.dumps([_declaration(declared) for declared in STUDIES.values()]))
        return
    table = Table("study", "what is varied", "the paper's grid", "source")
    for declared in STUDIES.values():
        grid = ", ".join(level.name for level in declared.levels)
        table.add_row(declared.name, declared.title, grid, declared.source)
    Console().print(table)


def _declaration(declared: Study) -> dict[str, Any]:
    """Return a study as `list --json` prints it."""
    return {
        "name": declared.name,
        "title": declared.title,
        "source": declared.source,
        "task": declared.task,
        "rig": declared.rig,
        "engine": declared.engine,
        "grid": [level.name for level in declared.levels],
        "scales": {name: list(scale.levels) for name, scale in declared.scales.items()},
        "claims": [claim.text for claim in declared.claims],
    }


def _summary(finished: Finished, folder: Path) -> dict[str, Any]:
    """Return what `--json` prints."""
    seconds = sum(sum(curve.seconds) for curves in finished.curves.values() for curve in curves)
    return {
        "study": finished.study.name,
        "scale": finished.scale_name,
        "seeds": finished.seeds,
        "folder": str(folder),
        "metric": METRICS[finished.study.metric],
        "levels": [vars(row) for row in rows(finished)],
        "claims": [
            {
                "claim": test.claim.text,
                "verdict": test.verdict,
                "left_out": list(test.left_out),
                "pairs": [vars(pair) for pair in test.pairs],
            }
            for test in judge(finished.study, finished.final)
        ],
        "core_seconds": round(seconds, 1),
    }


def _print(finished: Finished, folder: Path) -> None:
    """Print table and verdicts for people."""
    console = Console()
    table = Table(finished.study.axis, METRICS[finished.study.metric], "interval", "hit in every case")
    for row in rows(finished):
        interval = f"{row.low:.3f} – {row.high:.3f} ({row.coverage:.0%})"
        table.add_row(row.level, f"{row.median:.3f}", interval, f"{row.hit_runs} of {row.runs} runs")
    console.print(table)
    for test in judge(finished.study, finished.final):
        console.print(f"{test.verdict}: {test.claim.text}", highlight=False)
    console.print(f"{folder / finished.study.name}.md, .csv, .svg", highlight=False)
