"""The lamps as the papers evolved them: the ideal lamp, all its senses, no perturbation."""

from __future__ import annotations

import dataclasses

import numpy as np

from evolve.conditions import unperturbed
from evolve.settings import Settings
from evolve.task import FloatArray, Task
from sim_models.rollouts import Rollouts

RIG = "paper-lamp"
TERMINALS = ("t", "a0", "a1", "a2", "s0", "px", "py", "pz", "vx", "vy", "vz", "goal_met", "goal_dist")
"""Source: Gritz & Hahn 1997, §3.6."""

SETTINGS = unperturbed(
    Settings(
        population=250,
        generations=30,
        tournament=6,
        crossover=0.8,
        goals=6,
        redraw=False,
        race_goals=2,
        race_share=0.4,
        goal_low_m=0.1,
        goal_high_m=0.6,
        time_limit_s=4.0,
        filter=1.0,
        slew_rad_s=0.0,
    )
)
"""Source: Gritz & Hahn 1997, §4 (what did as well at half the cost)."""


def fitness(rollouts: Rollouts, goal_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the distance from the goal at the end, and the papers' style points.

    Style: finish early, stand still once there, neither fall nor hit the head, end with joints at their neutral angles.

    Args:
        rollouts: finished rollouts
        goal_m: goal distance of each [m], (nsim,)

    Returns:
        main goal [m] and style points of each, (nsim,) each

    Source: Gritz & Hahn 1997, §3.5.
    """
    end = rollouts.statistics
    main = end["final_error"] + 0.5 * (end["upright_end"] == 0) + 0.05 * np.minimum(end["end_speed"], 1)
    late = np.where(end["arrive_step"] < 0, 1, end["arrive_step"] / rollouts.nstep)
    restless = np.minimum(end["path_after_hit"], 1) + 0.1 * np.minimum(end["joint_path_after_hit"], 10)
    style = 0.05 * late + 0.05 * restless + 0.02 * end["end_joint_error"]
    return main, style


ROBUST = Task(name="lamp-robust", rig=RIG, terminals=TERMINALS, fitness=fitness, settings=SETTINGS)

LAMP = Task(
    name="lamp",
    rig=RIG,
    terminals=TERMINALS,
    fitness=fitness,
    settings=dataclasses.replace(
        SETTINGS,
        generations=50,
        crossover=0.9,
        goals=1,
        race_goals=0,
        goal_low_m=0.4,
        goal_high_m=0.4,
        stated_goals=1,
        decision_goals=1,
        held_out_goals=1,
    ),
)
"""Source: Gritz & Hahn 1995, §5."""
