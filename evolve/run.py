"""A run: search, decide, and leave a folder that says all of it."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np

from controller import Controller, Rig, format_source, load_rig, program_hash, save_controller
from controller.native import run_cycle
from evolve.conditions import Conditions, draw_conditions, pick
from evolve.decide import Candidate, Validation, candidates, decide, hall_of_fame, stated_hits, who_hit_most
from evolve.engines import make_engine
from evolve.evaluate import Cache, evaluate
from evolve.history import EvaluationRow, GenerationRow, History
from evolve.run_folder import BEST, HISTORY, RUN, VALIDATION, make_folder, run_text, validation_text, write_whole
from evolve.search import Generation, ask, tell
from evolve.settings import Settings, check
from evolve.streams import RNG_NAME, Stream, generator
from evolve.task import Task
from evolve.template import controller_template
from sim_models.body import Form
from sim_models.rollouts import RolloutPool, make_cases

_GOLDEN_STEPS: Final = 50
_HALL_OF_A_GENERATION: Final = 3


@dataclass(frozen=True)
class RunConfig:
    """Say what to run.

    Args:
        task: the task
        out: folder of the run, new or empty
        seed: of all chance
        settings: numbers; None: the task's own
        rig: name or path of the rig; None: the task's own
        threads: threads that simulate, which change nothing but the time; None: one per CPU
        engine: name of the method; None: the task's own
    """

    task: Task
    out: Path
    seed: int = 1
    settings: Settings | None = None
    rig: str | None = None
    threads: int | None = None
    engine: str | None = None


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
        controller: the best
        candidate: where it came from
        validation: how it did under conditions that did not choose it
        simulations: rollouts of the search
        seconds: wall time [s]
    """

    folder: Path
    controller: Controller
    candidate: Candidate
    validation: Validation
    simulations: int
    seconds: float


def evolve(config: RunConfig, progress: Callable[[Progress], None]) -> RunResult:
    """Evolve a controller.

    Args:
        config: what to run
        progress: called after each generation

    Returns:
        the best controller and how good it is; the same for the same task, settings and seed at any thread count

    Raises:
        InputError: task, rig, settings or folder are wrong
    """
    started = time.monotonic()
    task = config.task
    settings = check(config.settings or task.settings, task.name)
    rig = load_rig(config.rig or task.rig)
    template = controller_template(task, rig, settings)
    for timestep_s in (settings.verify_timestep_s, settings.decide_timestep_s):
        # a step that does not fit the rig's period is told before the search, not after
        _pool(task, rig, settings, config.threads, settings.decide_form, timestep_s).close()
    with _pool(task, rig, settings, config.threads, settings.screen_form, settings.screen_timestep_s) as pool:
        _rehearse(task, pool, template, settings, config.seed)
        make_folder(config.out)
        write_whole(config.out / RUN, run_text(_head(config, rig), settings, _versions()))
        hall, simulations = _search(config, settings, template, pool, progress, started)
    hall = hall_of_fame(hall, settings)
    with _pool(task, rig, settings, config.threads, settings.decide_form, settings.verify_timestep_s) as pool:
        verified = stated_hits(task, pool, rig, settings, config.seed, hall)
    with _pool(task, rig, settings, config.threads, settings.decide_form, settings.decide_timestep_s) as pool:
        hall = who_hit_most(hall, verified + stated_hits(task, pool, rig, settings, config.seed, hall))
        best, validation, held_out = decide(task, pool, rig, settings, config.seed, hall)
        golden = golden_trace(pool, best.controller, held_out)
    provenance = _provenance(config, rig, settings, best, validation)
    controller = dataclasses.replace(best.controller, provenance=provenance, golden=golden)
    origin = {"generation": best.generation, "individual": best.individual, "program": best.program}
    text = validation_text(origin, validation, held_out.goal_m.tolist())
    write_whole(config.out / VALIDATION, text)
    save_controller(controller, config.out / BEST)
    return RunResult(config.out, controller, best, validation, simulations, time.monotonic() - started)


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


def _rehearse(task: Task, pool: RolloutPool, template: Controller, settings: Settings, seed: int) -> None:
    """Let a controller that holds still meet the first conditions: a task's mistakes show before a folder is made."""
    njoint = len(template.outputs)
    conditions = draw_conditions(generator(seed, Stream.CONDITIONS), settings, settings.goals, njoint)
    evaluate(task, pool, [template], [program_hash(template.program)], conditions, Cache())


def _search(
    config: RunConfig,
    settings: Settings,
    template: Controller,
    pool: RolloutPool,
    progress: Callable[[Progress], None],
    started: float,
) -> tuple[list[Candidate], int]:
    """Run all generations; return the best of each and the number of simulations."""
    engine = make_engine(config.engine or config.task.engine, config.task.terminals, len(template.outputs), settings)
    cache = Cache()
    hall: list[Candidate] = []
    generation: Generation | None = None
    with History(config.out / HISTORY) as history:
        for number in range(settings.generations):
            before, simulations = time.monotonic(), cache.simulations
            population = ask(engine, settings, config.seed, generation)
            generation = tell(config.task, engine, settings, template, pool, cache, config.seed, number, population)
            seconds = time.monotonic() - before
            row = _generation_row(generation, cache.simulations - simulations, seconds)
            history.record(row, _evaluation_rows(generation))
            hall += candidates(generation, _HALL_OF_A_GENERATION)
            progress(_progress(generation, row, settings, cache, time.monotonic() - started))
    return hall, cache.simulations


def _pool(task: Task, rig: Rig, settings: Settings, threads: int | None, form: Form, timestep_s: float) -> RolloutPool:
    """Open rollouts in one physics."""
    return RolloutPool(
        rig, form=form, timestep_s=timestep_s, time_limit_s=settings.time_limit_s, threads=threads, stop=task.stop
    )


def _evaluation_rows(generation: Generation) -> list[EvaluationRow]:
    """Return what is recorded of each individual."""
    evaluation = generation.evaluation
    return [
        EvaluationRow(
            program,
            int(generation.nodes[index]),
            format_source(controller.source),
            individual.operator,
            individual.parents,
            int(evaluation.met[index]),
            float(evaluation.main[index]),
            float(evaluation.style[index]),
        )
        for index, (individual, controller, program) in enumerate(
            zip(generation.population, generation.controllers, generation.programs, strict=True)
        )
    ]


def _generation_row(generation: Generation, simulations: int, seconds: float) -> GenerationRow:
    """Return what is recorded of a generation."""
    evaluation, conditions = generation.evaluation, generation.conditions
    complete = evaluation.met == len(conditions)
    fitness = evaluation.fitness(generation.phase)[complete]
    finite = fitness[np.isfinite(fitness)]
    return GenerationRow(
        generation.number,
        conditions.draw,
        tuple(conditions.goal_m.tolist()),
        generation.phase,
        float(fitness.min()),
        float(finite.mean()) if len(finite) else float("inf"),
        int(np.sum(complete & (evaluation.hits == len(conditions)))),
        simulations,
        seconds,
    )


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


def _head(config: RunConfig, rig: Rig) -> dict[str, str | int | float | bool]:
    """Return what a run is, apart from its numbers."""
    return {
        "task": config.task.name,
        "rig": rig.name,
        "engine": config.engine or config.task.engine,
        "seed": config.seed,
        "rng": RNG_NAME,
    }


def _versions() -> dict[str, str]:
    """Return the versions of what computes, as results differ between them in the last digits."""
    return {"servolve": version("servolve"), "mujoco": mujoco.__version__, "numpy": np.__version__}


def _provenance(
    config: RunConfig, rig: Rig, settings: Settings, best: Candidate, validation: Validation
) -> Mapping[str, Any]:
    """Return how the best came to be and how good it is."""
    return {
        **_head(config, rig),
        **{f"{name}_version": text for name, text in _versions().items()},
        "time_limit_s": settings.time_limit_s,
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
