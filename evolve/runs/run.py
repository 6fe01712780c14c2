"""A run: search, decide, and leave a folder that says all of it."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from controller import Controller, Rig, load_controller, load_rig, program_hash
from controller.controller_file import controller_text
from controller.errors import InputError
from controller.native import run_cycle
from evolve.conditions import Conditions, draw_conditions, pick
from evolve.decide import (
    Candidate,
    Validation,
    candidates,
    candidates_of,
    decide,
    hall_of_fame,
    pareto,
    stated_conditions,
    stated_hits,
    validate,
    who_hit_most,
)
from evolve.engine import Individual
from evolve.evaluate import Cache, evaluate
from evolve.held_out import condition_rows
from evolve.runs.checkpoint import Checkpoint, evaluation_rows, generation_row, outcome_rows, read_checkpoint
from evolve.runs.history import GenerationRow, History, open_history
from evolve.runs.run_file import begin_run_file, check_versions, load_again, read_run_file, versions
from evolve.runs.run_folder import (
    BEST,
    HISTORY,
    PARETO,
    RUN,
    VALIDATION,
    locked,
    make_folder,
    pareto_text,
    read_validation,
    validation_text,
    write_whole,
)
from evolve.runs.run_plan import Plan, RunConfig, make_plan, open_pool, open_screen
from evolve.search import Generation, ask, tell
from evolve.settings import Settings
from evolve.streams import Stream, generator
from evolve.task import Task, place_of
from sim_models.rollouts import RolloutPool, make_cases

__all__ = ["Progress", "RunConfig", "RunResult", "evolve", "golden_trace", "is_finished", "resume"]

_GOLDEN_STEPS: Final = 50


@dataclass(frozen=True)
class Progress:
    """Hold what is worth telling after a generation.

    Args:
        generation: from 0
        generations: how many there are
        best: lowest fitness of those that met all conditions
        mean: mean fitness of the same
        main: main goal of the best
        hits: conditions that the best hit
        conditions: conditions of the generation
        nodes: nodes of the best
        simulations: rollouts run so far
        seconds: wall time so far [s]
    """

    generation: int
    generations: int
    best: float
    mean: float
    main: float
    hits: int
    conditions: int
    nodes: int
    simulations: int
    seconds: float


@dataclass(frozen=True, eq=False)
class RunResult:
    """Hold what a run came to.

    Args:
        folder: the run's folder
        controller: the best; of a search alone the best of its last generation
        candidate: where it came from
        validation: how it did under conditions that did not choose it; None: a search alone
        stated: how it did at the unseen goals on the rig as its file states it; None: a search alone, or an older run
        simulations: rollouts of the search
        search_s: wall time of the generations [s]
        seconds: wall time in all; of a run that was finished before, of its generations [s]
    """

    folder: Path
    controller: Controller
    candidate: Candidate
    validation: Validation | None
    stated: Validation | None
    simulations: int
    search_s: float
    seconds: float


def evolve(
    config: RunConfig, progress: Callable[[Progress], None], begun: Callable[[Plan, int], None] | None = None
) -> RunResult:
    """Evolve a controller.

    Args:
        config: what to run
        progress: called after each generation
        begun: called before the first generation, when all is checked and the folder is there; with no generations

    Returns:
        the best controller and how good it is; the same for the same task, settings and seed at any thread count

    Raises:
        InputError: task, rig, settings or folder are wrong
    """
    started = time.monotonic()
    plan = make_plan(config, load_rig(config.rig) if config.rig else _own_rig(config.task))
    with open_screen(plan) as pool:
        _rehearse(plan, pool)
        make_folder(config.out)
        with locked(config.out):
            begin_run_file(
                *(config.out, plan.task, config.task_text, plan.rig, plan.settings),
                engine=plan.engine.name,
                seed=plan.seed,
                decide=config.decide,
            )
            return _finish(plan, *_search(plan, pool, progress, begun, started), started)


def resume(
    folder: Path,
    threads: int | None,
    progress: Callable[[Progress], None],
    begun: Callable[[Plan, int], None] | None = None,
    *,
    any_version: bool = False,
    task: Task | None = None,
) -> RunResult:
    """Go on with a run that was interrupted, wherever that was.

    Args:
        folder: the run's
        threads: threads that simulate; None: one per CPU
        progress: called after each generation that is still missing
        begun: called before the first of them, when all is checked, with the generations that are there
        any_version: go on although other versions of servolve, MuJoCo or numpy began it
        task: the run's task, if it is neither built in nor kept in the folder

    Returns:
        what the run would have come to without the interruption; of a finished run, what it came to

    Raises:
        InputError: there is no run, another process works on it, or it has been changed
    """
    started = time.monotonic()
    found = read_run_file(folder)
    if is_finished(folder):
        return _result_of(folder)
    with locked(folder):
        task, rig = load_again(folder, found, task)
        config = RunConfig(
            *(task, folder, found.seed, found.settings, found.rig, threads, found.engine), decide=found.decide
        )
        if not any_version:
            check_versions(folder, found)
        plan = make_plan(config, rig)
        with open_screen(plan) as pool:
            return _finish(plan, *_search(plan, pool, progress, begun, started), started)


def is_finished(folder: Path) -> bool:
    """Tell whether a run has chosen its best: the last file that it writes.

    Args:
        folder: the run's
    """
    return (folder / RUN).is_file() and (folder / BEST).is_file()


def _finish(
    plan: Plan, halls: list[Candidate], simulations: int, search_s: float, earlier_s: float, started: float
) -> RunResult:
    """Choose and judge the best, and leave its files, the controller last."""
    if not plan.decide:
        best = halls[-1]
        seconds = earlier_s + time.monotonic() - started
        return RunResult(plan.folder, best.controller, best, None, None, simulations, search_s, seconds)
    task, rig, settings, seed = plan.task, plan.rig, plan.settings, plan.seed
    hall = hall_of_fame(halls, settings)
    with open_pool(plan, settings.decide_form, settings.verify_timestep_s) as pool:
        verified = stated_hits(task, pool, rig, settings, seed, hall)
    with open_pool(plan, settings.decide_form, settings.decide_timestep_s) as pool:
        verified += stated_hits(task, pool, rig, settings, seed, hall)
        hall = who_hit_most(hall, verified, settings.stated_share)
        best, validation, held_out = decide(task, pool, rig, settings, seed, hall)
        stated = validate(task, pool, best.controller, stated_conditions(settings, seed, len(rig.joints)))
        golden = golden_trace(pool, best.controller, held_out)
        conditions = condition_rows(pool, best.controller, held_out)
        found = pareto(task, pool, rig, settings, seed, halls)
    if found:
        write_whole(plan.folder / PARETO, pareto_text(found).encode())
    controller = dataclasses.replace(best.controller, provenance=_provenance(plan, best, validation), golden=golden)
    origin = {"generation": best.generation, "individual": best.individual, "program": best.program}
    text = validation_text(origin, validation, stated, conditions)
    write_whole(plan.folder / VALIDATION, text.encode())
    write_whole(plan.folder / BEST, controller_text(controller).encode())
    seconds = earlier_s + time.monotonic() - started
    return RunResult(plan.folder, controller, best, validation, stated, simulations, search_s, seconds)


def _result_of(folder: Path) -> RunResult:
    """Return what a finished run came to."""
    controller = load_controller(folder)
    path = folder / VALIDATION
    content = read_validation(path)
    try:
        origin, validation = content["best"], Validation(**content["held_out"])
        stated = Validation(**content["stated"]) if "stated" in content else None
        nodes = int(controller.provenance["nodes"])
        best = Candidate(origin["generation"], origin["individual"], origin["program"], nodes, controller)
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: not as the run wrote it ({error}); put back the file that it wrote") from None
    with open_history(folder / HISTORY) as history:
        query = "select total(simulations), total(seconds) from generation"
        simulations, seconds = history.execute(query).fetchone()
    return RunResult(folder, controller, best, validation, stated, int(simulations), seconds, seconds)


def golden_trace(pool: RolloutPool, controller: Controller, conditions: Conditions) -> dict[str, list[list[str]]]:
    """Record what a controller's program meets and answers at the start of a rollout.

    Args:
        pool: where it runs
        controller: the controller
        conditions: of which the first is met

    Returns:
        "inputs" and "outputs", float32 bit patterns in hex, a row a step; outputs are clamped, in their own units
    """
    first = pick(conditions, [0])
    goal = float(first.goal_m[0]), float(first.bearing_rad[0])
    rollouts = pool.run([controller], make_cases(0, *goal), first.perturbations, record=True)
    assert rollouts.raw is not None
    steps = min(_GOLDEN_STEPS, int(rollouts.statistics["alive_steps"][0]))
    terminals, outputs, _ = run_cycle(controller, pool.rig, rollouts.raw[0, :steps], goal)
    return {"inputs": _bits(terminals), "outputs": _bits(outputs)}


def _own_rig(task: Task) -> Rig:
    """Load the rig that a task names; if there is none, say where the task names it."""
    try:
        return load_rig(task.rig)
    except InputError as error:
        place = place_of(task, task.rig)
        if place == task.name:
            raise
        raise InputError(f"{place}: {error}") from None


def _rehearse(plan: Plan, pool: RolloutPool) -> None:
    """Let a controller that holds still meet the first conditions: a task's mistakes show before a folder is made."""
    template, settings = plan.template, plan.settings
    rng = generator(plan.seed, Stream.CONDITIONS)
    conditions = draw_conditions(rng, settings, settings.goals, len(template.outputs))
    cache = Cache()
    evaluate(plan.task, pool, [template], [program_hash(template.program)], conditions, cache)
    if not any(math.isfinite(outcome.main) for outcome in cache.outcomes.values()):
        raise InputError(
            f"{place_of(plan.task)}: a controller that holds still has no finite fitness in any of the first"
            f" {len(conditions)} conditions, so that none would stand out; let fitness return finite numbers, large"
            " ones for what is bad"
        )


def _search(
    plan: Plan,
    pool: RolloutPool,
    progress: Callable[[Progress], None],
    begun: Callable[[Plan, int], None] | None,
    started: float,
) -> tuple[list[Candidate], int, float, float]:
    """Run the generations that are missing; return each one's best, simulations, their and earlier time [s]."""
    path = plan.folder / HISTORY
    checkpoint = read_checkpoint(path, plan.engine, plan.template, plan.settings)
    if begun is not None:
        begun(plan, checkpoint.generations)
    cache = Cache(dict(checkpoint.outcomes))
    hall, search_s = list(checkpoint.hall), checkpoint.seconds
    settings = plan.settings
    with History(path) as history:
        generation = _last_generation(plan, pool, cache, checkpoint)
        cache.simulations = checkpoint.simulations
        for number in range(checkpoint.generations, settings.generations):
            before, simulations = time.monotonic(), cache.simulations
            population = ask(plan.engine, settings, plan.seed, generation)
            generation = _tell(plan, pool, cache, number, population)
            chosen = candidates(generation, candidates_of(settings, number))
            row = generation_row(generation, cache.simulations - simulations, time.monotonic() - before)
            history.record(
                row,
                evaluation_rows(generation, plan.engine),
                [candidate.individual for candidate in chosen],
                outcome_rows(cache, settings.cache),
            )
            hall += chosen
            search_s += row.seconds
            progress(_progress(generation, row, settings, cache, checkpoint.seconds + time.monotonic() - started))
    return hall, cache.simulations, search_s, checkpoint.seconds


def _last_generation(plan: Plan, pool: RolloutPool, cache: Cache, checkpoint: Checkpoint) -> Generation | None:
    """Return the last generation of a checkpoint as its run knew it: told again, its outcomes are in the cache."""
    if checkpoint.generations in (0, plan.settings.generations):
        return None
    return _tell(plan, pool, cache, checkpoint.generations - 1, checkpoint.population)


def _tell(plan: Plan, pool: RolloutPool, cache: Cache, number: int, population: Sequence[Individual]) -> Generation:
    """Let a population meet the conditions of its generation."""
    return tell(*(plan.task, plan.engine, plan.settings, plan.template, pool, cache, plan.seed), number, population)


def _progress(generation: Generation, row: GenerationRow, settings: Settings, cache: Cache, seconds: float) -> Progress:
    """Return what is worth telling of a generation."""
    best = generation.best(1)[0]
    return Progress(
        generation=generation.number,
        generations=settings.generations,
        best=row.best,
        mean=row.mean,
        main=float(generation.evaluation.main[best]),
        hits=int(generation.evaluation.hits[best]),
        conditions=len(generation.conditions),
        nodes=int(generation.nodes[best]),
        simulations=cache.simulations,
        seconds=seconds,
    )


def _provenance(plan: Plan, best: Candidate, validation: Validation) -> Mapping[str, Any]:
    """Return how the best came to be and how good it is."""
    return {
        **plan.head(),
        **{f"{name}_version": text for name, text in versions().items()},
        "time_limit_s": plan.settings.time_limit_s,
        "generation": best.generation,
        "individual": best.individual,
        "program_hash": best.program,
        "nodes": best.nodes,
        "held_out_conditions": validation.conditions,
        "held_out_error_m": validation.mean_error_m,
        "held_out_hits": validation.hits,
        "held_out_within_50_mm": validation.within_50_mm,
        "held_out_falls": validation.falls,
        "held_out_hops": validation.hops_mean,
        "held_out_clearance_m": validation.clearance_m,
    }


def _bits(rows: np.ndarray[Any, np.dtype[np.float32]]) -> list[list[str]]:
    """Write float32 rows as their bit patterns in hex."""
    return [[f"0x{bits:08x}" for bits in row] for row in np.ascontiguousarray(rows).view(np.uint32).tolist()]
