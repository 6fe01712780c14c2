"""Put a log's raw counts through its embedded controller again: every bit must come out as it did."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from controller import Controller, Rig, parse_controller
from controller.errors import InputError
from controller.native import pack_cycle
from deploy.logs.cycle_message import CycleWords
from deploy.logs.log import Log, log_rig, log_text, read_log


@dataclass(frozen=True)
class Replay:
    """Say what a replay found.

    Args:
        log: the log
        controller: the embedded controller
        rig: the embedded rig
        cycles: control periods that were put through
        difference: the first thing that came out otherwise, one sentence, or None
    """

    log: Log
    controller: Controller
    rig: Rig
    cycles: int
    difference: str | None


def replay(path: str | Path) -> Replay:
    """Replay a log: raw counts => terminals, outputs, goal counts, compared bit for bit with what was logged.

    Args:
        path: a log of `servolve deploy`

    Returns:
        what was found

    Raises:
        InputError: if it is not such a log, or holds no control period
    """
    log = read_log(path)
    rig = log_rig(log)
    controller = parse_controller(log_text(log, "controller_text"), f"{path}: /meta controller_text")
    if not log.cycles:
        raise InputError(f"{path}: holds no control period (/cycle); give the log of a run that came to run")
    try:
        difference = _first_difference(log, rig, controller)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"{path}: a message lacks what docs/log.md promises ({type(error).__name__}: {error}); record the run again"
        ) from None
    return Replay(log, controller, rig, len(log.cycles), difference)


def _first_difference(log: Log, rig: Rig, controller: Controller) -> str | None:
    cycle = pack_cycle(controller, rig)
    words = CycleWords(rig, controller)
    goal = (float(log.meta["goal_dist"]), float(log.meta["goal_bearing"]))
    for number, message in enumerate(log.cycles):
        if message["k"] != number:
            return f"/cycle {number}: k is {message['k']}, a period is missing before it"
        terminals, outputs, goals = cycle.step(*goal, words.raw(message))
        came = words.values(terminals, outputs, goals)
        for field, value in came.items():
            if message[field] != value:
                return f"/cycle {number}: {field} {_apart(message[field], value)}"
    return None


def _apart(logged: object, came: object) -> str:
    """Say where two values differ: by name where they have names, by place in words of bits."""
    if isinstance(logged, Mapping) and isinstance(came, Mapping):
        name = next(name for name in [*came, *logged] if logged.get(name) != came.get(name))
        return f"of {name} was {logged.get(name)} and is now {came.get(name)}"
    return f"were '{logged}' and are now '{came}'"
