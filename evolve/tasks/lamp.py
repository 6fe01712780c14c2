"""The lamp: hop to one goal and stand there."""

from __future__ import annotations

from evolve.task import Settings, Task
from evolve.tasks import lamp_paper
from evolve.tasks.lamp_robust import TASK as ROBUST

TASK = Task(
    name="lamp",
    rig=ROBUST.rig,
    terminals=ROBUST.terminals,
    fitness=ROBUST.fitness,
    settings=Settings(
        population=250,
        generations=28,
        goals=6,
        nominal_goals=2,
        race_goals=2,
        race_share=0.3,
        goal_low_m=0.3,
        goal_high_m=0.3,
        time_limit_s=4.0,
        friction=0.2,
        torque=0.1,
        latency_s=0.02,
        hall_of_fame=45,
    ),
    on={lamp_paper.RIG: lamp_paper.LAMP},
)
