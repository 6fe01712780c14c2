"""`servolve evolve`: evolve a controller."""

from __future__ import annotations

import dataclasses
import json
import math
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from cyclopts import Parameter
from rich.console import Console
from rich.live import Live
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as ProgressBar
from rich.table import Table

import evolve as evolution
from controller.errors import InputError, RunError
from evolve.decide import Validation
from evolve.runs.run import is_finished
from evolve.runs.run_file import read_run_file
from evolve.runs.run_folder import finite, free_folder
from evolve.runs.run_plan import Plan
from evolve.settings import describe
from evolve.task import BUILT_IN

RUNS: Final = Path("runs")
REPORT: Final = "report.html"

_SEED_MAX: Final = 2**63 - 1
_THREADS_MAX: Final = 1024
_LOG_EVERY_S: Final = 10.0  # between lines where standard error is no terminal


def evolve(
    task: str | None = None,
    /,
    *,
    rig: str | None = None,
    engine: Literal["gp", "gep"] | None = None,
    out: Path | None = None,
    seed: int | None = None,
    population: int | None = None,
    generations: int | None = None,
    threads: int | None = None,
    set_: Annotated[list[str] | None, Parameter(name="--set", negative="")] = None,
    resume: Annotated[Path | None, Parameter(negative="")] = None,
    any_version: Annotated[bool, Parameter(negative="")] = False,
    help_settings: Annotated[bool, Parameter(negative="")] = False,
    report: Annotated[bool, Parameter(name="--report", negative="--no-report")] = True,
    quiet: Annotated[bool, Parameter(negative="")] = False,
    json_: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> int:
    """Evolve a controller for a task and leave a run folder; the best is its best.controller.toml.

    The same task, settings and seed give the same run at any number of threads, and with any interruptions: a run that
    was stopped goes on with --resume.

    Args:
        task: lamp (one goal), lamp-robust (any goal in 10 to 60 cm), lamp-limbo (a pole across the way), jumper (any
            direction), or the path of a task's Python file
        rig: name or path of the rig; left out: the task's own
        engine: gp (tree genetic programming) or gep (gene expression programming); left out: the task's own
        out: folder of the run, new or empty; left out: runs/TASK-SEED
        seed: of all chance; left out: 1
        population: individuals of a generation
        generations: how many
        threads: threads that simulate; left out: one per CPU
        set_: KEY=VALUE, one of the run's settings, as often as needed
        resume: go on with the run in this folder; nothing else but --threads and what is printed can be given
        any_version: resume a run that another version of servolve, MuJoCo or numpy began
        help_settings: list what --set takes, with the task's values, and do nothing
        report: write the run's report.html when it is done
        quiet: no progress; what the run came to is printed all the same
        json_: print one JSON object instead of a table

    Returns:
        exit status
    """
    if help_settings:
        numbers = evolution.Settings() if task is None else evolution.load_task(task).for_rig(rig).settings
        Console(file=sys.stdout).print(_settings(evolution.apply_overrides(numbers, set_ or [])))
        return 0
    if threads is not None:
        _check("--threads", threads, 1, _THREADS_MAX)
    given: dict[str, object] = {
        "TASK": task,
        "--rig": rig,
        "--engine": engine,
        "--out": out,
        "--seed": seed,
        "--population": population,
    }
    given |= {"--generations": generations, "--set": set_ or None}
    if resume is not None:
        _refuse_with_resume([name for name, value in given.items() if value is not None])
        result = _resumed(resume, threads, any_version, quiet, quiet or json_)
    elif task is None:
        raise InputError("evolve needs a task; give lamp-robust, another task's name or file, or --resume RUN")
    else:
        if any_version:
            raise InputError("--any-version goes with --resume alone; leave it out")
        overrides = _overrides(set_ or [], {"population": population, "generations": generations})
        config = _config(task, rig, engine, out, 1 if seed is None else seed, threads, overrides)
        with _reporter(quiet, config.out) as progress:
            result = evolution.evolve(config, progress, None if quiet or json_ else _tell_beginning)
    if report and not (result.folder / REPORT).is_file():
        _write_report(result.folder)
    if json_:
        print(json.dumps(_summary(result)))
    else:
        Console(file=sys.stdout).print(_table(result))
    return 0


def _overrides(set_: list[str], options: dict[str, int | None]) -> list[str]:
    """Return the settings that were given in either way, each in one of them."""
    for name in {override.partition("=")[0] for override in set_} & {n for n, v in options.items() if v is not None}:
        raise InputError(f"--{name} and --set {name} say the same thing twice; leave one of them out")
    return [*set_, *(f"{name}={value}" for name, value in options.items() if value is not None)]


def _config(
    task: str,
    rig: str | None,
    engine: Literal["gp", "gep"] | None,
    out: Path | None,
    seed: int,
    threads: int | None,
    overrides: list[str],
) -> evolution.RunConfig:
    """Return what a new run is to be."""
    _check("--seed", seed, 0, _SEED_MAX)
    loaded = evolution.load_task(task).for_rig(rig)
    settings = evolution.apply_overrides(loaded.settings, overrides)
    folder = out if out is not None else free_folder(RUNS, f"{loaded.name}-{seed}")
    text = None if task in BUILT_IN else Path(task).read_bytes()
    return evolution.RunConfig(loaded, folder, seed, settings, rig, threads, engine, task_text=text)


def _tell_beginning(plan: Plan, done: int) -> None:
    """Say what has begun, or goes on, and where it goes: the first generation may take a while."""
    settings = plan.settings
    doing = "going on with" if done else "evolving"
    print(
        f"{plan.folder}: {doing} {plan.task.name} on {plan.rig.name}, seed {plan.seed}, {settings.population}"
        f" individuals for {settings.generations} generations{f', {done} of them done' if done else ''}",
        file=sys.stderr,
        flush=True,
    )


def _refuse_with_resume(given: list[str]) -> None:
    """Refuse what would make another run of the one that is resumed."""
    if not given:
        return
    why = " (a longer run weighs style points otherwise from its start)" if "--generations" in given else ""
    raise InputError(
        f"--resume goes on with a run as it began; leave out {', '.join(given)}{why}, or start a new run without it"
    )


def _resumed(folder: Path, threads: int | None, any_version: bool, quiet: bool, silent: bool) -> evolution.RunResult:
    """Go on with a run, or say that there is nothing left to do."""
    read_run_file(folder)
    if is_finished(folder):
        print(f"{folder}: this run is finished; nothing is left to do", file=sys.stderr)
    with _reporter(quiet, folder) as progress:
        begun = None if silent else _tell_beginning
        return evolution.resume(folder, threads, progress, begun, any_version=any_version)


def _write_report(folder: Path) -> None:
    """Write a run's report; what it needs and this machine lacks is said, and costs the run nothing."""
    remedy = f"write it later with servolve show {folder} --report {folder / REPORT}"
    try:
        from servolve.run_report import write_run_report

        lacking = write_run_report(folder, folder / REPORT)
    except ModuleNotFoundError as error:
        package = (error.name or "a package").partition(".")[0]
        lacking = f"no report: {package} is not installed (pip install 'servolve[report]'); {remedy}"
    except (InputError, RunError) as error:
        lacking = f"no report: {error}; {remedy}"
    if lacking:
        print(f"servolve: {lacking}", file=sys.stderr)


def _check(name: str, value: int, low: int, high: int) -> None:
    if not low <= value <= high:
        raise InputError(f"{name} {value}: not from {low} to {high}; give a number in this range")


@contextmanager
def _reporter(quiet: bool, folder: Path) -> Iterator[Callable[[evolution.Progress], None]]:
    """Yield what is called after each generation; say how to go on if the keyboard interrupts."""
    try:
        with _display(quiet) as display:
            yield display
    except KeyboardInterrupt:
        raise RunError(f"interrupted from the keyboard; go on with servolve evolve --resume {folder}") from None


@contextmanager
def _display(quiet: bool) -> Iterator[Callable[[evolution.Progress], None]]:
    """Yield a live display on a terminal, now and then a line elsewhere."""
    console = Console(stderr=True)
    if quiet:
        yield lambda progress: None
    elif console.is_terminal:
        bar = ProgressBar(
            TextColumn("generations"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), console=console
        )
        work = bar.add_task("generations", total=None)
        with Live(bar, console=console, refresh_per_second=4) as live:

            def show(progress: evolution.Progress) -> None:
                bar.update(work, completed=progress.generation + 1, total=progress.generations)
                live.update(_live(bar, progress))

            yield show
    else:
        told_s = -math.inf

        def tell(progress: evolution.Progress) -> None:
            nonlocal told_s
            last = progress.generation + 1 == progress.generations
            if last or progress.seconds - told_s >= _LOG_EVERY_S:
                told_s = progress.seconds
                print(_line(progress), file=sys.stderr, flush=True)

        yield tell


def _live(bar: ProgressBar, progress: evolution.Progress) -> Table:
    """Return the bar with the latest generation's figures under it."""
    grid = Table.grid()
    grid.add_row(bar)
    grid.add_row(_line(progress))
    return grid


def _line(progress: evolution.Progress) -> str:
    """Say how a generation did."""
    rate = progress.simulations / max(progress.seconds, 1e-9)
    return (
        f"generation {progress.generation} ({progress.generation + 1} of {progress.generations}):"
        f" best {progress.best:.4f} (main {progress.main:.4f}), mean {progress.mean:.3f},"
        f" hits {progress.hits}/{progress.conditions}, {progress.nodes} nodes, {rate:.0f} rollouts/s"
    )


def _settings(settings: evolution.Settings) -> Table:
    """Return what each setting is, for people."""
    table = Table("setting", "value", "from, to", "meaning", box=None)
    for one in describe(settings):
        table.add_row(one.name, one.value, one.allowed, one.meaning)
    return table


def _summary(result: evolution.RunResult) -> dict[str, Any]:
    """Return what `--json` prints."""
    held_out, stated = (
        None if one is None else finite(dataclasses.asdict(one)) for one in (result.validation, result.stated)
    )
    return {
        "run": str(result.folder),
        "controller": str(result.folder / "best.controller.toml"),
        "generation": result.candidate.generation,
        "program_hash": result.candidate.program,
        "nodes": result.candidate.nodes,
        "held_out": held_out,
        "stated": stated,
        "simulations": result.simulations,
        "search_s": round(result.search_s, 3),
        "seconds": round(result.seconds, 3),
    }


def _table(result: evolution.RunResult) -> Table:
    """Return what a run came to, for people."""
    table = Table("best.controller.toml", str(result.folder / "best.controller.toml"), title_justify="left")
    table.add_row("found in", f"generation {result.candidate.generation}, {result.candidate.nodes} nodes")
    if result.validation is not None:
        _add_validation(table, result.validation)
    if result.stated is not None:
        s = result.stated
        touched = f"; its head touches in {s.head_touched:.0%}" if s.head_touched else ""
        table.add_row("as stated", f"{s.hits:.0%} of {s.conditions} unseen goals hit on the rig's own numbers{touched}")
    # of a run that was finished before, the decision's time is not known
    in_all = f"; {result.seconds:.0f} s in all" if result.seconds > result.search_s else ""
    table.add_row("search", f"{result.simulations} rollouts in {result.search_s:.0f} s{in_all}")
    return table


def _add_validation(table: Table, v: Validation) -> None:
    """Add how the best did under unseen conditions."""
    table.add_row("judged by", f"{v.conditions} unseen goals and rigs, free base, full physics")
    table.add_row("error at the end", f"mean {v.mean_error_m * 100:.2f} cm, median {v.median_error_m * 100:.2f} cm")
    table.add_row("hits", f"{v.hits:.0%} (within 1.5 cm, at rest, upright); {v.passed:.0%} passed within 1.5 cm")
    table.add_row("near", f"{v.within_50_mm:.0%} within 5 cm, upright; {v.falls:.0%} fell")
    table.add_row("hops", f"mean {v.hops_mean:.1f}, fewest {v.hops_min}, {v.clearance_m * 1000:.0f} mm clearance")
