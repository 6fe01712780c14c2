"""Ask firmware for a run in the words of its console."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from controller.errors import InputError
from deploy.host_loop import RunOptions

SECONDS_MAX: Final = 4000.0
"""The longest run that firmware takes [s]."""
PLACES_MAX: Final = 9
"""So many decimal places its console takes of a number."""


def commands(options: RunOptions, period_s: float) -> list[str]:
    """Return the commands that ask firmware for a run.

    Args:
        options: of the run
        period_s: control period [s]

    Returns:
        lines of the console, the start last

    Raises:
        InputError: the run is longer than firmware takes, or a number has too many decimal places
    """
    if options.seconds >= SECONDS_MAX:
        raise InputError(f"--seconds {options.seconds:g}: firmware runs for less than {SECONDS_MAX:g} s; give less")
    seconds = round(options.seconds / period_s) * period_s
    bearing = [_decimal("goal", options.goal_bearing)] if options.goal_bearing else []
    goal = " ".join([_decimal("goal", options.goal_dist), *bearing])
    asked = [f"goal {goal}", f"seconds {seconds:.5f}", f"derate {_decimal('derate', options.derate)}"]
    return [*asked, "arm" if options.arm else "disarm", "start"]


def _decimal(option: str, value: float) -> str:
    """Return the shortest decimal that is the same float32."""
    if not math.isfinite(value):
        raise InputError(f"--{option} {value}: is no number; give a decimal")
    text = np.format_float_positional(np.float32(value), trim="-")
    if len(text.partition(".")[2]) > PLACES_MAX:
        raise InputError(f"--{option} {value:g}: firmware takes at most {PLACES_MAX} decimal places; round it")
    return text
