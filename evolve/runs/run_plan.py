"""What a run is to be, checked, and the physics that it runs in."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from controller import Controller, Rig
from evolve.engine import Engine
from evolve.engines import make_engine
from evolve.settings import Settings, check
from evolve.streams import RNG_NAME
from evolve.task import Task
from evolve.template import controller_template
from sim_models.body import Form, substeps
from sim_models.rollouts import RolloutPool


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
        decide: choose the best in full physics and judge it; False: the search alone
        task_text: content of the task's file, of which the folder keeps a copy; None: the task is built in
    """

    task: Task
    out: Path
    seed: int = 1
    settings: Settings | None = None
    rig: str | None = None
    threads: int | None = None
    engine: str | None = None
    decide: bool = True
    task_text: bytes | None = None


@dataclass(frozen=True, eq=False)
class Plan:
    """Hold all that a run's steps share.

    Args:
        task: the task
        folder: the run's
        seed: of all chance
        settings: the run's numbers, checked
        rig: the rig
        threads: threads that simulate; None: one per CPU
        engine: the method
        template: the controller around the programs
        decide: whether the best is chosen and judged after the search
    """

    task: Task
    folder: Path
    seed: int
    settings: Settings
    rig: Rig
    threads: int | None
    engine: Engine
    template: Controller
    decide: bool

    def head(self) -> dict[str, str | int | float | bool]:
        """Return what the run is, apart from its numbers."""
        return {
            "task": self.task.name,
            "rig": self.rig.name,
            "engine": self.engine.name,
            "seed": self.seed,
            "rng": RNG_NAME,
        }


def make_plan(config: RunConfig, rig: Rig) -> Plan:
    """Check what a run is to be.

    Args:
        config: what to run
        rig: its rig, loaded

    Raises:
        InputError: task, rig, engine and settings do not go together
    """
    task = config.task
    settings = check(config.settings or task.settings, task.name)
    template = controller_template(task, rig, settings)
    engine = make_engine(config.engine or task.engine, task.terminals, len(template.outputs), settings)
    return Plan(*(task, config.out, config.seed, settings, rig, config.threads, engine, template), decide=config.decide)


def open_screen(plan: Plan) -> RolloutPool:
    """Open the search's rollouts; a step that does not fit the rig's period is told before the search, not after.

    Args:
        plan: the run's

    Raises:
        InputError: a physics step does not divide the rig's period, or the body cannot be compiled
    """
    settings = plan.settings
    for name in ("screen_timestep_s", "verify_timestep_s", "decide_timestep_s"):
        substeps(plan.rig, getattr(settings, name), f"{plan.task.name}: {name}")
    for timestep_s in (settings.verify_timestep_s, settings.decide_timestep_s):
        open_pool(plan, settings.decide_form, timestep_s).close()
    return open_pool(plan, settings.screen_form, settings.screen_timestep_s)


def open_pool(plan: Plan, form: Form, timestep_s: float) -> RolloutPool:
    """Open rollouts in one physics.

    Args:
        plan: the run's
        form: "free" or "planar"
        timestep_s: MuJoCo's step [s]
    """
    settings = plan.settings
    return RolloutPool(
        plan.rig,
        form=form,
        timestep_s=timestep_s,
        time_limit_s=settings.time_limit_s,
        threads=plan.threads,
        stop=plan.task.stop,
        scene=plan.task.scene_with(settings),
        lean=settings.lean,
        timer=settings.timer,
        stop_early=settings.stop_early,
    )
