"""The robust lamp: hop to a goal anywhere in 10 to 60 cm and stand there, on floors and servos that vary."""

from __future__ import annotations

import numpy as np

from evolve.task import FloatArray, Settings, Task
from evolve.tasks import lamp_paper
from sim_models.rollouts import Rollouts


def fitness(rollouts: Rollouts, goal_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the distance from the goal at the end, and how unlike good hopping the way there was.

    Args:
        rollouts: finished rollouts
        goal_m: goal distance of each [m], (nsim,)

    Returns:
        main goal [m] and style points of each, (nsim,) each

    Source: Gritz & Hahn 1997, §3.5.
    """
    end = rollouts.statistics
    main = end["final_error"] + 0.5 * (end["upright_end"] == 0) + 0.05 * np.minimum(end["end_speed"], 1)
    few_hops = np.clip(1 - end["hops"] / 3, 0, 1)
    late = np.where(end["arrive_step"] < 0, 1, end["arrive_step"] / rollouts.nstep)
    style = 0.1 * few_hops + 0.03 * late + 0.01 * end["end_joint_error"] + 0.02 * end["joint_path_after_hit"]
    return main, style


TASK = Task(
    name="lamp-robust",
    rig="lamp-xc330",
    terminals=("t", "a0", "a1", "a2", "px", "goal_met", "goal_dist"),
    fitness=fitness,
    settings=Settings(
        population=500,
        generations=18,
        goals=6,
        race_goals=2,
        race_share=0.3,
        goal_low_m=0.1,
        goal_high_m=0.6,
        time_limit_s=6.0,
        screen_timestep_s=0.005,
        hall_of_fame=45,
        stated_share=0.75,
        decision_goals=48,
    ),
    on={lamp_paper.RIG: lamp_paper.ROBUST},
)
