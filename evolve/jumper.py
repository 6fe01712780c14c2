"""The jumper: turn the leg to a goal in any direction, hop there and stand still."""

from __future__ import annotations

import math

import numpy as np

from evolve import jumper_paper
from evolve.task import FloatArray, Settings, Task
from sim_models.rollouts import Rollouts


def fitness(rollouts: Rollouts, goal_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the distance from the goal over the initial one, and how unlike good hopping the way there was.

    Whoever stands still comes to 1, so a fall in one direction costs less than reaching the goal in another gains.

    Args:
        rollouts: finished rollouts
        goal_m: goal distance of each [m], (nsim,)

    Returns:
        main goal and style points of each, (nsim,) each
    """
    end = rollouts.statistics
    main = end["final_error"] / goal_m + 0.5 * (end["upright_end"] == 0) + 0.2 * np.minimum(end["end_speed"], 1)
    few_hops = np.clip(1 - end["hops"] / 3, 0, 1)
    late = np.where(end["arrive_step"] < 0, 1, end["arrive_step"] / rollouts.nstep)
    return main, 0.2 * few_hops + 0.1 * late + 0.03 * np.minimum(end["end_joint_speed"], 1)


TASK = Task(
    name="jumper",
    rig="jumper-xc330",
    terminals=("t", "a0", "a1", "a2", "a3", "px", "heading_error", "goal_met", "goal_dist"),
    fitness=fitness,
    settings=Settings(
        population=300,
        generations=25,
        constant_max=15.0,
        elites=8,
        goals=5,
        nominal_goals=2,
        race_goals=2,
        race_share=0.3,
        goal_low_m=0.15,
        goal_high_m=0.4,
        bearing_low_rad=-math.pi,
        bearing_high_rad=math.pi,
        time_limit_s=5.0,
        filter=1.0,
        slew_rad_s=0.0,
        friction=0.2,
        torque=0.1,
        latency_s=0.02,
        screen_form="free",
        screen_timestep_s=0.005,
        hall_of_fame=30,
        decision_goals=32,
    ),
    on={"paper-jumper": jumper_paper.TASK},
)
