"""EMOT's jumper: the ideal body, the paper's terminals, fitness and numbers.

What the paper leaves open is read so:

- The goal lies 0.5 m ahead, one body height. Coordinates and velocities of objects are those of goal and base as the
  jumper sees them, and heading_error, the direction of the goal from the leg's plane, is among them.
- Style is 1 if the head has touched anything or the jumper has fallen, and the rollout ends there. Such a jumper does
  not stand at the goal: its distance counts as the initial one if it is less. Else falling towards the goal pays.
- Idle time is the share of the time limit at which the base is slower than 0.02 m/s and has not arrived. The sum of
  angles is that of |angle| [rad], the bearing's the shorter way round.
- The sum of velocities ("stop after achieving the goal") is that of the five elements, each taken to move as fast as
  the base did at most in the last 0.2 s [m/s], and of the joints' |rate| at the end [rad/s]. Of the joints' rates alone
  a jumper that shakes makes nothing: it reverses them at the very end.
- A motor of limited power reaches the demanded velocity late: with a time constant of 45 ms (`filter`). Motors that
  answer at once let the jumper chatter along at half the rate of its program, and where such a jumper gets to depends
  on the physics step.
- The paper breeds and judges in one simulation, in steps of 10 ms; so do we, in steps of 2 ms. What is bred for one
  goal without any perturbation seldom lives in another step.
- The best of a generation passes on unchanged ("store the best solution").

Source: Kwaśnicka & Woźniak, EMOT, §5.1 and Table 2.
"""

from __future__ import annotations

import math

import numpy as np

from evolve.conditions import unperturbed
from evolve.task import FloatArray, Settings, StopConditions, Task
from sim_models.rollouts import Rollouts

_ELEMENTS = 5
_JOINTS = 4


def fitness(rollouts: Rollouts, goal_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the distance from the goal over the initial one, and the paper's style points.

    Args:
        rollouts: finished rollouts
        goal_m: goal distance of each [m], (nsim,)

    Returns:
        main goal and style points of each, (nsim,) each

    Source: Kwaśnicka & Woźniak, EMOT, pseudocode 3.
    """
    end = rollouts.statistics
    unsafe = (end["head_touched"] != 0) | (end["fallen"] != 0)
    distance = end["final_error"] / goal_m
    timing = np.clip(end["idle_steps"] / rollouts.nstep, 0, 1)
    angles = np.clip(_JOINTS * end["end_joint_error"], 0, 1)
    velocities = np.clip(_ELEMENTS * end["end_speed"] + _JOINTS * end["end_joint_speed"], 0, 1)
    style = np.where(unsafe, 1.0, 0.33 * timing + 0.33 * angles + 0.33 * velocities)
    return np.where(unsafe, np.maximum(distance, 1.0), distance), style


TASK = Task(
    name="jumper",
    rig="paper-jumper",
    terminals=("t", "k0", "k1", "k2", "k3", "px", "py", "pz", "vx", "vy", "vz", "heading_error"),
    fitness=fitness,
    stop=StopConditions(flight_s_max=math.inf),
    engine="gep",
    settings=unperturbed(
        Settings(
            population=100,
            generations=50,
            elites=1,
            constant_max=6.0,
            gep_head=10,
            goals=1,
            nominal_goals=1,
            race_goals=0,
            redraw=False,
            goal_low_m=0.5,
            goal_high_m=0.5,
            time_limit_s=20.0,
            filter=0.2,
            slew_rad_s=0.0,
            screen_form="free",
            screen_timestep_s=0.002,
            decide_timestep_s=0.002,
            verify_timestep_s=0.002,
            hall_of_fame=30,
            stated_goals=1,
            decision_goals=1,
            held_out_goals=1,
        )
    ),
)
