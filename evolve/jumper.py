"""The jumper: turn the leg to a goal in any direction, hop there and stand still."""

from __future__ import annotations

import math

import numpy as np

from evolve import jumper_paper
from evolve.task import FloatArray, Settings, Task
from sim_models.rollouts import Rollouts
from sim_models.statistics import HOP_CLEARANCE_M


def fitness(rollouts: Rollouts, goal_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the distance from the goal over the initial one, and how unlike good hopping the way there was.

    Whoever stands still comes to 1.2, so a fall in one direction costs less than reaching the goal in another gains. A
    jumper on velocity motors shuffles more readily than it hops: sliding and feet that stay low cost from the start
    on.

    Args:
        rollouts: finished rollouts
        goal_m: goal distance of each [m], (nsim,)

    Returns:
        main goal and style points of each, (nsim,) each
    """
    end = rollouts.statistics
    few_hops = np.clip(1 - end["hops"] / 3, 0, 1)
    slid = np.minimum(end["ground_path"] / goal_m, 1)
    late = np.where(end["arrive_step"] < 0, 1, end["arrive_step"] / rollouts.nstep)
    low = 1 - np.clip(end["max_clearance"] / (2 * HOP_CLEARANCE_M), 0, 1)
    main = end["final_error"] / goal_m + 0.5 * (end["upright_end"] == 0) + 0.2 * np.minimum(end["end_speed"], 1)
    style = 0.2 * few_hops + 0.1 * late + 0.03 * np.minimum(end["end_joint_speed"], 1)
    return main + 0.3 * slid + 0.2 * low, style


TASK = Task(
    name="jumper",
    rig="jumper-xc330",
    terminals=("t", "a0", "a1", "a2", "a3", "px", "heading_error", "goal_met", "goal_dist"),
    fitness=fitness,
    settings=Settings(
        population=250,
        generations=22,
        constant_max=15.0,
        elites=8,
        goals=4,
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
        hall_of_fame=12,
        decision_goals=16,
    ),
    on={"paper-jumper": jumper_paper.TASK},
)
