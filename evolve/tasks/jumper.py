"""The jumper: turn the leg to a goal in any direction, hop there and stand still.

`goal_met` is no terminal here: it latches when the leg's plane sweeps past a goal that lies to the side.
"""

from __future__ import annotations

import math

import numpy as np

from evolve.task import FloatArray, Settings, Task
from evolve.tasks import jumper_paper
from sim_models.rollouts import Rollouts

_HOPS = 2  # so many are hopping
_HOP_M = 0.012  # and so high
_NEAR_M = 0.05
_FAST_M_S = 0.2
_WAY = 0.7  # share of the way; the rest is for coming near
_CLEARANCE = 0.3  # share of clearance; the rest is for whole hops
_SLIDING = 0.05  # what sliding earns of it
_UNREST = 0.7  # the most that unrest costs


def fitness(rollouts: Rollouts, goal_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how little of the way was made, by hopping rather than sliding, and how far from rest at the goal it ends.

    Whoever stands still comes to 1, who slides to the goal to 0.95, who gets there with two hops on the way to 0. A hop
    on the spot earns nothing, and moving away costs nothing, so that who hops along one line passes on its hops before
    it can steer. Rest and the last centimetres are style, phased in, and only for who hops there: sliders find them
    first, and would leave the hoppers no room.

    Args:
        rollouts: finished rollouts
        goal_m: goal distance of each [m], (nsim,)

    Returns:
        main goal and style points of each, (nsim,) each
    """
    end = rollouts.statistics
    way = np.clip(1 - end["final_error"] / goal_m, 0, 1)
    near = np.exp(-np.minimum(end["final_error"], 1e3) / _NEAR_M)
    high = np.minimum(end["max_clearance"] / _HOP_M, 1)
    hopping = _CLEARANCE * high + (1 - _CLEARANCE) * np.minimum(end["hops"] / _HOPS, 1)
    got = _WAY * way + (1 - _WAY) * near
    fell = end["upright_end"] == 0
    main = 1 - got * (_SLIDING + (1 - _SLIDING) * hopping) + 0.3 * fell + 0.1 * np.minimum(end["end_speed"], 1)
    late = np.where(end["arrive_step"] < 0, 1, end["arrive_step"] / rollouts.nstep)
    unrest = 0.2 * late + 0.3 * np.minimum(end["end_speed"] / _FAST_M_S, 1) + 0.2 * (1 - near)
    style = _UNREST - got * hopping * (_UNREST - unrest) + 0.3 * fell
    return main, style + 0.03 * np.minimum(end["end_joint_speed"], 1)


TASK = Task(
    name="jumper",
    rig="jumper-xc330",
    terminals=("t", "a0", "a1", "a2", "a3", "px", "py", "heading_error", "goal_dist"),
    fitness=fitness,
    settings=Settings(
        population=400,
        generations=80,
        constant_max=15.0,
        elites=8,
        crossover=0.7,
        mutate_subtree=0.1,
        mutate_constant=0.15,
        goals=6,
        nominal_goals=3,
        race_goals=2,
        race_share=0.25,
        goal_low_m=0.15,
        goal_high_m=0.4,
        bearing_low_rad=-math.pi,
        bearing_high_rad=math.pi,
        time_limit_s=10.0,
        filter=1.0,
        slew_rad_s=0.0,
        friction=0.2,
        torque=0.1,
        latency_s=0.02,
        screen_form="free",
        screen_timestep_s=0.005,
        hall_of_fame=40,
        stated_share=0.75,
        stated_goals=16,
        decision_goals=32,
    ),
    on={"paper-jumper": jumper_paper.TASK},
)
