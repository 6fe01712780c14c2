"""The jumper: turn the leg to a goal in any direction, hop there and stand still."""

from __future__ import annotations

import math

import numpy as np

from evolve.task import FloatArray, Settings, Task
from evolve.tasks import jumper_paper
from sim_models.rollouts import Rollouts

_HOPS = 2  # so many are hopping
_FLOWN = 0.5  # so much of the path with all feet up is hopping: landing slides a little
_PATH_MIN_M = 1e-6


def fitness(rollouts: Rollouts, goal_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how little of the way was made, by hopping rather than sliding, and how slowly and restlessly.

    Whoever stands still comes to 1, who slides to the goal to 0.8, who hops there to 0. A hop on the spot earns
    nothing, and moving away costs nothing, so that who hops along one line passes on its hops before it can steer.

    Args:
        rollouts: finished rollouts
        goal_m: goal distance of each [m], (nsim,)

    Returns:
        main goal and style points of each, (nsim,) each
    """
    end = rollouts.statistics
    way = np.clip(1 - end["final_error"] / goal_m, 0, 1)
    flown = np.clip(1 - end["ground_path"] / np.maximum(end["path"], _PATH_MIN_M), 0, 1)
    hopping = (np.minimum(end["hops"] / _HOPS, 1) + np.minimum(flown / _FLOWN, 1)) / 2
    fell = end["upright_end"] == 0
    main = 1 - way * (0.2 + 0.8 * hopping) + 0.3 * fell + 0.2 * np.minimum(end["end_speed"], 1)
    late = np.where(end["arrive_step"] < 0, 1, end["arrive_step"] / rollouts.nstep)
    return main, 0.1 * late + 0.03 * np.minimum(end["end_joint_speed"], 1)


TASK = Task(
    name="jumper",
    rig="jumper-xc330",
    terminals=("t", "a0", "a1", "a2", "a3", "px", "heading_error", "goal_met", "goal_dist"),
    fitness=fitness,
    settings=Settings(
        population=400,
        generations=18,
        constant_max=15.0,
        elites=8,
        goals=4,
        nominal_goals=2,
        race_goals=2,
        race_share=0.25,
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
        stated_share=0.75,
        decision_goals=16,
    ),
    on={"paper-jumper": jumper_paper.TASK},
)
