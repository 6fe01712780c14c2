"""The lamp: hop to one goal and stand there."""

from __future__ import annotations

from evolve.lamp_robust import TASK as ROBUST
from evolve.task import Settings, Task

TASK = Task(
    name="lamp",
    rig=ROBUST.rig,
    terminals=ROBUST.terminals,
    fitness=ROBUST.fitness,
    settings=Settings(
        population=250,
        generations=20,
        goals=6,
        race_goals=2,
        race_share=0.3,
        goal_low_m=0.3,
        goal_high_m=0.3,
        time_limit_s=4.0,
    ),
)
