"""The numbers of a run: a task sets its own, the command line overrides them."""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from controller.errors import InputError


@dataclass(frozen=True)
class Settings:
    """Hold every number that a run depends on, apart from its seed.

    Args:
        population: individuals of a generation
        generations: generations
        tournament: individuals that compete to be a parent
        elites: best individuals that pass on unchanged
        crossover: share of children by crossover
        mutate_subtree: share of children by subtree mutation
        mutate_point: share of children by point mutation
        mutate_constant: share of children by constant mutation; what the four leave is reproduction
        grow_depth_low: smallest depth of a starting tree [edges]
        grow_depth_high: largest depth of a starting tree [edges]
        depth_max: depth of a tree [edges]
        nodes_max: nodes of a tree
        constant_max: ephemeral constants lie in ±constant_max
        gep_head: symbols of a gene's head, where functions may stand
        gep_function_share: share of functions among the symbols drawn for heads
        gep_mutation: chance of each symbol to become another
        gep_is: share of children with an insertion sequence moved into a head
        gep_is_length_max: symbols of the longest insertion sequence
        gep_ris: share of children with a sequence moved to a root
        gep_ris_length_max: symbols of the longest of these
        gep_gene_transposition: share of children with a gene moved to the front
        gep_one_point: share of children by one-point recombination
        gep_two_point: share of children by two-point recombination
        gep_gene: share of children that exchange a whole gene
        gep_constant_mutation: chance of each constant to be drawn anew
        gep_constant_tuning: share of children with one constant moved a little
        goals: goal distances of a generation
        nominal_goals: how many of these are met on the rig as its file states it; the others on perturbed ones
        goal_low_m: nearest goal [m]
        goal_high_m: farthest goal [m]
        race_goals: conditions that everyone meets first; 0: no race
        race_share: share of the population that goes on to the other conditions
        cache: never simulate a program twice under the same condition
        time_limit_s: length of a rollout [s]
        filter: first-order command filter of the controllers, in (0, 1]; 1: none
        slew_rad_s: slew limit of the controllers [rad/s]; 0: none
        screen_form: body while searching
        screen_timestep_s: physics step while searching [s]
        decide_form: body when the best is chosen
        decide_timestep_s: physics step when the best is chosen [s]
        verify_timestep_s: finer physics step in which hits on the rig as its file states it must hold too [s]
        friction: floor friction varies by ± this share
        mass: masses vary by ± this share
        torque: torque of each servo varies by ± this share
        voltage: supply voltage drops by up to this share
        latency_s: commands come late by 0 to this [s]
        encoder_bias_rad: standard deviation of each encoder's bias [rad]
        initial_rad: standard deviation of the angles at the start [rad]
        pose_noise_m: standard deviation of the noise of positions [m]
        angle_noise_rad: standard deviation of the noise of the pose's angles [rad]
        force_noise_n: standard deviation of the noise of the force [N]
        hall_of_fame: candidates for the best of the run
        stated_goals: unseen goals that candidates must hit on the rig as its file states it
        decision_goals: unseen conditions that choose the best
        held_out_goals: further unseen conditions that judge the chosen
    """

    population: int = 150
    generations: int = 20
    tournament: int = 6
    elites: int = 0
    crossover: float = 0.9
    mutate_subtree: float = 0.0
    mutate_point: float = 0.0
    mutate_constant: float = 0.0
    grow_depth_low: int = 2
    grow_depth_high: int = 6
    depth_max: int = 17
    nodes_max: int = 200
    constant_max: float = 30.0
    gep_head: int = 10
    gep_function_share: float = 0.5
    gep_mutation: float = 0.01
    gep_is: float = 0.1
    gep_is_length_max: int = 4
    gep_ris: float = 0.1
    gep_ris_length_max: int = 4
    gep_gene_transposition: float = 0.05
    gep_one_point: float = 0.2
    gep_two_point: float = 0.5
    gep_gene: float = 0.1
    gep_constant_mutation: float = 0.05
    gep_constant_tuning: float = 0.9
    goals: int = 4
    nominal_goals: int = 0
    goal_low_m: float = 0.1
    goal_high_m: float = 0.6
    race_goals: int = 2
    race_share: float = 0.4
    cache: bool = True
    time_limit_s: float = 6.0
    filter: float = 0.5
    slew_rad_s: float = 10.0
    screen_form: Literal["planar", "free"] = "planar"
    screen_timestep_s: float = 0.004
    decide_form: Literal["planar", "free"] = "free"
    decide_timestep_s: float = 0.002
    verify_timestep_s: float = 0.001
    friction: float = 0.3
    mass: float = 0.1
    torque: float = 0.2
    voltage: float = 0.05
    latency_s: float = 0.04
    encoder_bias_rad: float = 0.005
    initial_rad: float = 0.01
    pose_noise_m: float = 0.0005
    angle_noise_rad: float = 0.002
    force_noise_n: float = 0.05
    hall_of_fame: int = 30
    stated_goals: int = 8
    decision_goals: int = 24
    held_out_goals: int = 24


# smallest and largest value of each number; shares that must not add up to more than 1 are checked apart
_RANGES: dict[str, tuple[float, float]] = {
    "population": (2, 100_000),
    "generations": (1, 100_000),
    "tournament": (1, 1000),
    "elites": (0, 100_000),
    "crossover": (0, 1),
    "mutate_subtree": (0, 1),
    "mutate_point": (0, 1),
    "mutate_constant": (0, 1),
    "grow_depth_low": (0, 17),
    "grow_depth_high": (0, 17),
    "depth_max": (1, 100),
    "nodes_max": (1, 2000),
    "constant_max": (1e-3, 1e6),
    "gep_head": (1, 200),
    "gep_function_share": (0, 1),
    "gep_mutation": (0, 1),
    "gep_is": (0, 1),
    "gep_is_length_max": (1, 200),
    "gep_ris": (0, 1),
    "gep_ris_length_max": (1, 200),
    "gep_gene_transposition": (0, 1),
    "gep_one_point": (0, 1),
    "gep_two_point": (0, 1),
    "gep_gene": (0, 1),
    "gep_constant_mutation": (0, 1),
    "gep_constant_tuning": (0, 1),
    "goals": (1, 1000),
    "nominal_goals": (0, 1000),
    "goal_low_m": (-100, 100),
    "goal_high_m": (-100, 100),
    "race_goals": (0, 1000),
    "race_share": (0.01, 1),
    "time_limit_s": (0.1, 600),
    "filter": (0.001, 1),
    "slew_rad_s": (0, 1000),
    "screen_timestep_s": (1e-4, 0.1),
    "decide_timestep_s": (1e-4, 0.1),
    "verify_timestep_s": (1e-4, 0.1),
    "friction": (0, 0.95),
    "mass": (0, 0.95),
    "torque": (0, 0.95),
    "voltage": (0, 0.95),
    "latency_s": (0, 0.5),
    "encoder_bias_rad": (0, 1),
    "initial_rad": (0, 1),
    "pose_noise_m": (0, 1),
    "angle_noise_rad": (0, 1),
    "force_noise_n": (0, 1000),
    "hall_of_fame": (1, 10_000),
    "stated_goals": (1, 1000),
    "decision_goals": (1, 10_000),
    "held_out_goals": (1, 10_000),
}
_CHOICES = {"screen_form": ("planar", "free"), "decide_form": ("planar", "free")}
_SHARES = ("crossover", "mutate_subtree", "mutate_point", "mutate_constant")
_SHARES_TOLERANCE = 1e-9


def apply_overrides(settings: Settings, overrides: Sequence[str]) -> Settings:
    """Return the settings with ``KEY=VALUE`` overrides applied, in order.

    Args:
        settings: where to start
        overrides: ``KEY=VALUE`` each; the value is read as the key's own type

    Returns:
        the checked settings

    Raises:
        InputError: no ``=``, no such key, a value of another type or out of range
    """
    for override in overrides:
        key, equals, text = override.partition("=")
        if not equals:
            raise InputError(f'--set {override}: no "=" in it; write --set KEY=VALUE')
        change: dict[str, Any] = {key: _typed(settings, key, text)}
        settings = dataclasses.replace(settings, **change)
    return check(settings, "--set")


def check(settings: Settings, origin: str) -> Settings:
    """Return the settings if every number is in its range.

    Args:
        settings: what to check
        origin: where they come from, for the message

    Returns:
        the same settings

    Raises:
        InputError: a number is out of its range, or two contradict each other
    """
    for key, (low, high) in _RANGES.items():
        value = getattr(settings, key)
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise InputError(f"{origin}: {key} is {value!r}; give a finite number")
        if not low <= value <= high:
            raise InputError(f"{origin}: {key} is {value:g}; give a number from {low:g} to {high:g}")
    for key, choices in _CHOICES.items():
        if getattr(settings, key) not in choices:
            raise InputError(f"{origin}: {key} is {getattr(settings, key)!r}; give one of {', '.join(choices)}")
    _check_together(settings, origin)
    return settings


def _check_together(settings: Settings, origin: str) -> None:
    """Refuse numbers that contradict each other."""
    if sum(getattr(settings, key) for key in _SHARES) > 1 + _SHARES_TOLERANCE:
        raise InputError(f"{origin}: {' + '.join(_SHARES)} is more than 1; lower one of them")
    for low, high in (("grow_depth_low", "grow_depth_high"), ("goal_low_m", "goal_high_m")):
        if getattr(settings, low) > getattr(settings, high):
            raise InputError(f"{origin}: {low} is above {high}; swap them")
    if settings.grow_depth_high > settings.depth_max:
        raise InputError(f"{origin}: grow_depth_high is above depth_max; lower it to {settings.depth_max} or less")
    if settings.elites >= settings.population:
        raise InputError(f"{origin}: elites leave no room in the population; lower elites below {settings.population}")


def _typed(settings: Settings, key: str, text: str) -> int | float | bool | str:
    """Read a value as the type of the key's present value."""
    names = [field.name for field in dataclasses.fields(settings)]
    if key not in names:
        close = difflib.get_close_matches(key, names, n=1)
        hint = f"did you mean {close[0]}?" if close else f"known are {', '.join(names)}"
        raise InputError(f"--set {key}: there is no such setting; {hint}")
    kind = type(getattr(settings, key))
    try:
        if kind is bool:
            return {"true": True, "false": False}[text.lower()]
        return kind(text)  # type: ignore[no-any-return]
    except (KeyError, ValueError):
        wanted = {bool: "true or false", int: "a whole number", float: "a number", str: "a word"}[kind]
        raise InputError(
            f"--set {key}={text}: not {wanted}; write for example {key}={_example(settings, key)}"
        ) from None


def _example(settings: Settings, key: str) -> str:
    """Return the present value as one would write it."""
    value = getattr(settings, key)
    return str(value).lower() if isinstance(value, bool) else str(value)
