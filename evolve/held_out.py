"""The held-out conditions one by one, as a run's folder keeps them beside their means."""

from __future__ import annotations

from typing import Any

import numpy as np

from controller import Controller
from evolve.conditions import Conditions
from evolve.evaluate import is_hit, is_passed, simulate
from sim_models.rollouts import RolloutPool


def condition_rows(pool: RolloutPool, controller: Controller, conditions: Conditions) -> list[dict[str, Any]]:
    """Return how a controller does under each condition.

    Args:
        pool: rollouts in the physics that decides
        controller: the controller
        conditions: goals and rigs

    Returns:
        of each: its goal, and how it ended there
    """
    rows = np.arange(len(conditions), dtype=np.int32)
    rollouts = simulate(pool, [controller], conditions, np.stack((np.zeros_like(rows), rows), axis=1))
    end = rollouts.statistics
    hits, passed = is_hit(end), is_passed(end)
    return [
        {
            "goal_m": float(conditions.goal_m[row]),
            "bearing_rad": float(conditions.bearing_rad[row]),
            "final_error_m": float(end["final_error"][row]),
            "hit": bool(hits[row]),
            "passed": bool(passed[row]),
            "fell": bool(end["fallen"][row]),
            "hops": int(end["hops"][row]),
            "clearance_m": float(end["max_clearance"][row]),
        }
        for row in rows.tolist()
    ]
