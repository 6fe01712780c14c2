"""The controller around an evolved program: what its inputs and outputs mean on a rig."""

from __future__ import annotations

import difflib
import math

import numpy as np

from controller import Controller, Input, Output, Rig
from controller.errors import InputError
from controller.lowering import lower
from controller.rig import Joint
from controller.source import Constant, Source
from controller.terminals import TerminalSpec, resolve_terminals, terminals_of
from evolve.settings import Settings
from evolve.task import Task, place_of

_MARGIN_M = 0.5  # how far beyond the goals the base is expected
_SPEED_M_S = 5.0  # of a base
_SPEED_RAD_S = 50.0  # of an ideal joint
_TRAVEL_RAD = 20.0  # of an unlimited joint, either way


def controller_template(task: Task, rig: Rig, settings: Settings) -> Controller:
    """Return a controller of a task on a rig that holds every joint at its neutral angle, or does not move it.

    Args:
        task: the task, whose terminals become the inputs
        rig: the rig, whose joints become the outputs: angles in degrees, velocities in rad/s
        settings: the run's numbers

    Returns:
        the controller, whose source and program are to be replaced

    Raises:
        InputError: the rig cannot supply one of the task's terminals
    """
    supplied = terminals_of(rig)
    for name in task.terminals:
        if name not in supplied:
            close = difflib.get_close_matches(name, supplied, n=1)
            hint = f"did you mean {close[0]}? There are" if close else "use these only:"
            raise InputError(
                f"{place_of(task, name)}: terminal {name!r} cannot be had on rig {rig.name}; {hint}"
                f" {', '.join(supplied)}"
            )
    outputs = tuple(_output(joint) for joint in rig.joints)
    source = Source(tuple(Constant(np.float32(output.neutral)) for output in outputs))
    controller = Controller(
        name=task.name.replace("-", "_"),  # as C would have it
        period_s=rig.period_s,
        inputs=tuple(_input(supplied[name], rig, settings) for name in task.terminals),
        outputs=outputs,
        source=source,
        program=lower(source, task.terminals),
        filter=settings.filter,
        slew_rad_s=settings.slew_rad_s,
        task=task.name,
    )
    resolve_terminals(controller, rig)
    return controller


def _output(joint: Joint) -> Output:
    """Return a joint as an output, limits rounded inwards to tenths.

    Constants of some tens are angles in degrees and velocities in rad/s: in other units a search saturates or creeps.
    """
    if joint.mode == "velocity":
        fastest = math.floor(joint.speed_rad_s_max * 10) / 10
        return Output(joint.name, "velocity", "rad/s", -fastest, fastest, 0.0)
    low = math.ceil(math.degrees(joint.low_rad) * 10) / 10
    high = math.floor(math.degrees(joint.high_rad) * 10) / 10
    neutral = round(math.degrees(joint.neutral_rad), 6)
    return Output(joint.name, "position", "deg", low, high, min(max(neutral, low), high))


def _input(terminal: TerminalSpec, rig: Rig, settings: Settings) -> Input:
    """Return a terminal with the values it is expected to take."""
    farthest = max(abs(settings.goal_low_m), abs(settings.goal_high_m))
    expected = {
        "t": (0.0, settings.time_limit_s),
        "goal_dist": (settings.goal_low_m, settings.goal_high_m),
        "goal_met": (0.0, 1.0),
        "heading_error": (-3.2, 3.2),
        "px": (-farthest - _MARGIN_M, farthest + _MARGIN_M),
        "py": (-farthest - _MARGIN_M, farthest + _MARGIN_M),
        "pz": (0.0, _MARGIN_M),
        "s0": (0.0, 100.0),
    }
    expected |= dict.fromkeys(("vx", "vy", "vz"), (-_SPEED_M_S, _SPEED_M_S))
    for joint in rig.joints:
        speed = round(2 * joint.product.no_load_speed_rad_s, 1) or _SPEED_RAD_S
        expected[joint.name] = (max(joint.low_rad - 0.2, -_TRAVEL_RAD), min(joint.high_rad + 0.2, _TRAVEL_RAD))
        expected[f"{joint.name}_vel"] = (-speed, speed)
        expected[f"{joint.name}_load"] = (-1.0, 1.0)
    low, high = expected.get(terminal.name, (-1000.0, 1000.0))
    return Input(terminal.name, terminal.unit, round(low, 6), round(high, 6))
