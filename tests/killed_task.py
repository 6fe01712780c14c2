"""The task of the runs that are killed: a copy of its own, which no change to the built-in ones disturbs."""

from __future__ import annotations

import numpy as np

from evolve.task import Settings, Task


def fitness(rollouts, goal_m):
    end = rollouts.statistics
    main = end["final_error"] + 0.5 * (end["upright_end"] == 0)
    return main, 0.05 * end["end_joint_error"] + 0.02 * np.minimum(end["end_speed"], 1)


TASK = Task(
    name="killed",
    rig="lamp-xc330",
    terminals=("t", "a0", "a1", "a2", "px", "goal_met"),
    fitness=fitness,
    settings=Settings(
        population=20,
        generations=5,
        goals=3,
        race_goals=1,
        race_share=0.5,
        time_limit_s=1,
        decision_goals=4,
        held_out_goals=4,
        stated_goals=2,
        hall_of_fame=6,
        elites=2,
    ),
)
