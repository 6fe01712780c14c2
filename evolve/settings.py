"""The numbers of a run: a task sets its own, the command line overrides them."""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Literal, TypeVar

from controller.errors import InputError

OBJECTIVES = ("size", "instructions", "peak_torque")
"""What may be asked for beside fitness."""


_Number = TypeVar("_Number", int, float)
_Word = TypeVar("_Word", bound=str)


def _number(default: _Number, low: float, high: float, meaning: str) -> _Number:
    """Declare a number, whole if its default is."""
    return field(default=default, metadata={"low": low, "high": high, "meaning": meaning})


def _choice(default: _Word, choices: tuple[_Word, ...], meaning: str) -> _Word:
    """Declare one of some words."""
    return field(default=default, metadata={"choices": choices, "meaning": meaning})


def _switch(default: bool, meaning: str) -> bool:
    """Declare a switch."""
    return field(default=default, metadata={"meaning": meaning})


@dataclass(frozen=True)
class Settings:
    """Hold every number that a run depends on, apart from its seed: default, smallest, largest, meaning."""

    # breeding
    population: int = _number(150, 2, 100_000, "individuals of a generation")
    generations: int = _number(20, 1, 100_000, "generations")
    selection: Literal["tournament", "proportionate"] = _choice(
        "tournament", ("tournament", "proportionate"), "how parents are chosen"
    )
    tournament: int = _number(6, 1, 1000, "individuals that compete to be a parent")
    elites: int = _number(0, 0, 100_000, "best individuals that pass on unchanged")
    crossover: float = _number(0.9, 0, 1, "share of children by crossover")
    mutate_subtree: float = _number(0.0, 0, 1, "share of children by subtree mutation")
    mutate_point: float = _number(0.0, 0, 1, "share of children by point mutation")
    mutate_constant: float = _number(
        0.0, 0, 1, "share of children by constant mutation; what the four leave is reproduction"
    )
    grow_depth_low: int = _number(2, 0, 17, "smallest depth of a starting tree [edges]")
    grow_depth_high: int = _number(6, 0, 17, "largest depth of a starting tree [edges]")
    depth_max: int = _number(17, 1, 100, "depth of a tree [edges]")
    nodes_max: int = _number(200, 1, 2000, "nodes of a tree")
    constant_max: float = _number(30.0, 1e-3, 1e6, "ephemeral constants lie in ±constant_max")
    # gene expression programming
    gep_head: int = _number(10, 1, 200, "symbols of a gene's head, where functions may stand")
    gep_function_share: float = _number(0.5, 0, 1, "share of functions among the symbols drawn for heads")
    gep_mutation: float = _number(0.01, 0, 1, "chance of each symbol to become another")
    gep_is: float = _number(0.1, 0, 1, "share of children with an insertion sequence moved into a head")
    gep_is_length_max: int = _number(4, 1, 200, "symbols of the longest insertion sequence")
    gep_ris: float = _number(0.1, 0, 1, "share of children with a sequence moved to a root")
    gep_ris_length_max: int = _number(4, 1, 200, "symbols of the longest of these")
    gep_gene_transposition: float = _number(0.05, 0, 1, "share of children with a gene moved to the front")
    gep_one_point: float = _number(0.2, 0, 1, "share of children by one-point recombination")
    gep_two_point: float = _number(0.5, 0, 1, "share of children by two-point recombination")
    gep_gene: float = _number(0.1, 0, 1, "share of children that exchange a whole gene")
    gep_constant_mutation: float = _number(0.05, 0, 1, "chance of each constant to be drawn anew")
    gep_constant_tuning: float = _number(0.9, 0, 1, "share of children with one constant moved a little")
    # bloat and objectives
    parsimony: Literal["none", "lexicographic", "tarpeian", "double"] = _choice(
        "none", ("none", "lexicographic", "tarpeian", "double"), "what keeps programs small; none: ties only"
    )
    parsimony_ratio: float = _number(2.0, 1.01, 100, "lexicographic: the worst 1/ratio share one rank, and so on")
    tarpeian_share: float = _number(0.3, 0, 1, "tarpeian: chance that one larger than the average is not simulated")
    double_size: float = _number(1.4, 1, 2, "double: size of the tournament by nodes; the smaller wins half of it")
    objectives: str = field(
        default="",
        metadata={"meaning": f"objectives beside fitness, of {', '.join(OBJECTIVES)}, with commas between"},
    )
    # conditions
    goals: int = _number(4, 1, 1000, "goals of a generation")
    nominal_goals: int = _number(
        0, 0, 1000, "how many of these are met on the rig as its file states it; the others on perturbed ones"
    )
    goal_low_m: float = _number(0.1, -100, 100, "nearest goal [m]")
    goal_high_m: float = _number(0.6, -100, 100, "farthest goal [m]")
    bearing_low_rad: float = _number(0.0, -2 * math.pi, 2 * math.pi, "direction of goals, from here [rad]")
    bearing_high_rad: float = _number(0.0, -2 * math.pi, 2 * math.pi, "to here, left of the heading [rad]")
    redraw: bool = _switch(True, "draw goals and rigs anew for every generation; false: those of the first for all")
    pole_share: float = _number(0.9, 0.1, 10, "lower edge of the limbo pole, over the lamp's standing height")
    pole_at: float = _number(0.5, 0.05, 0.95, "place of the limbo pole, over the way to the goal")
    friction: float = _number(0.3, 0, 0.95, "floor friction varies by ± this share")
    mass: float = _number(0.1, 0, 0.95, "masses vary by ± this share")
    torque: float = _number(0.2, 0, 0.95, "torque of each servo varies by ± this share")
    voltage: float = _number(0.05, 0, 0.95, "supply voltage drops by up to this share")
    latency_s: float = _number(0.04, 0, 0.5, "commands come late by 0 to this [s]")
    encoder_bias_rad: float = _number(0.005, 0, 1, "standard deviation of each encoder's bias [rad]")
    initial_rad: float = _number(0.01, 0, 1, "standard deviation of the angles at the start [rad]")
    pose_noise_m: float = _number(0.0005, 0, 1, "standard deviation of the noise of positions [m]")
    angle_noise_rad: float = _number(0.002, 0, 1, "standard deviation of the noise of the pose's angles [rad]")
    force_noise_n: float = _number(0.05, 0, 1000, "standard deviation of the noise of the force [N]")
    # rollouts
    time_limit_s: float = _number(6.0, 0.1, 600, "length of a rollout [s]")
    filter: float = _number(0.5, 0.001, 1, "first-order command filter of the controllers; 1: none")
    slew_rad_s: float = _number(10.0, 0, 1000, "slew limit of the controllers [rad/s]; 0: none")
    screen_form: Literal["planar", "free"] = _choice("planar", ("planar", "free"), "body while searching")
    screen_timestep_s: float = _number(0.004, 1e-4, 0.1, "physics step while searching [s]")
    decide_form: Literal["planar", "free"] = _choice("free", ("planar", "free"), "body when the best is chosen")
    decide_timestep_s: float = _number(0.002, 1e-4, 0.1, "physics step when the best is chosen [s]")
    verify_timestep_s: float = _number(
        0.001, 1e-4, 0.1, "finer physics step in which hits on the rig as its file states it must hold too [s]"
    )
    # never pay twice: each saves time; only the race changes who is simulated how often
    race_goals: int = _number(2, 0, 1000, "conditions that everyone meets first; 0: no race")
    race_share: float = _number(0.4, 0.01, 1, "share of the programs that goes on to the other conditions")
    cache: bool = _switch(True, "never simulate a program twice under the same condition")
    stop_early: bool = _switch(True, "end a rollout once it is over; false: simulate on, to no other result")
    lean: bool = _switch(True, "leave out what no statistic needs, such as sensors that are no terminals")
    timer: bool = _switch(False, "keep the timer that MuJoCo's Python bindings call in every step")
    # the best of the run
    hall_of_fame: int = _number(30, 1, 10_000, "candidates for the best of the run")
    stated_goals: int = _number(8, 1, 1000, "unseen goals that candidates must hit on the rig as its file states it")
    stated_share: float = _number(0.9, 0, 1, "share of the most hits there that a candidate needs to stay one")
    decision_goals: int = _number(24, 1, 10_000, "unseen conditions that choose the best")
    held_out_goals: int = _number(24, 1, 10_000, "further unseen conditions that judge the chosen")


_SHARES = ("crossover", "mutate_subtree", "mutate_point", "mutate_constant")
_SHARES_TOLERANCE = 1e-9
_TURN = 2 * math.pi
_WANTED = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}


@dataclass(frozen=True)
class Described:
    """Say what a setting is.

    Args:
        name: of the setting
        value: its present value, as one would write it
        allowed: its range or choices
        meaning: what it does, with its unit
    """

    name: str
    value: str
    allowed: str
    meaning: str


def describe(settings: Settings) -> Iterator[Described]:
    """Yield what each setting is, in order.

    Args:
        settings: whose values
    """
    for one in fields(settings):
        value, about = getattr(settings, one.name), one.metadata
        if "choices" in about:
            allowed = " | ".join(about["choices"])
        elif "low" in about:
            allowed = f"{about['low']:g} to {about['high']:g}"
        else:
            allowed = "true | false" if isinstance(value, bool) else "text"
        yield Described(one.name, _written(value), allowed, about["meaning"])


def asked_objectives(settings: Settings) -> tuple[str, ...]:
    """Return the names of the objectives beside fitness.

    Args:
        settings: the run's numbers
    """
    return tuple(name.strip() for name in settings.objectives.split(",")) if settings.objectives else ()


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
    for one in fields(settings):
        _check_alone(one.name, getattr(settings, one.name), one, origin)
    _check_together(settings, origin)
    return settings


def _check_alone(key: str, value: object, declared: dataclasses.Field[Any], origin: str) -> None:
    """Refuse a value that its setting does not allow."""
    about = declared.metadata
    if "choices" in about:
        if value not in about["choices"]:
            raise InputError(f"{origin}: {key} is {value!r}; give one of {', '.join(about['choices'])}")
    elif isinstance(declared.default, bool | str):
        if type(value) is not type(declared.default):
            raise InputError(f"{origin}: {key} is {value!r}; give {_WANTED[type(declared.default)]}")
    elif isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{origin}: {key} is {value!r}; give a finite number")
    elif isinstance(declared.default, int) and not isinstance(value, int):
        raise InputError(f"{origin}: {key} is {value!r}; give a whole number")
    elif not about["low"] <= value <= about["high"]:
        raise InputError(f"{origin}: {key} is {value:g}; give a number from {about['low']:g} to {about['high']:g}")


def _check_together(settings: Settings, origin: str) -> None:
    """Refuse numbers that contradict each other."""
    if sum(getattr(settings, key) for key in _SHARES) > 1 + _SHARES_TOLERANCE:
        raise InputError(f"{origin}: {' + '.join(_SHARES)} is more than 1; lower one of them")
    pairs = (
        ("grow_depth_low", "grow_depth_high"),
        ("goal_low_m", "goal_high_m"),
        ("bearing_low_rad", "bearing_high_rad"),
    )
    for low, high in pairs:
        if getattr(settings, low) > getattr(settings, high):
            raise InputError(f"{origin}: {low} is above {high}; swap them")
    if settings.bearing_high_rad - settings.bearing_low_rad > _TURN:
        raise InputError(f"{origin}: bearing_low_rad to bearing_high_rad is more than a turn; bring them closer")
    if (settings.bearing_low_rad, settings.bearing_high_rad) != (0, 0):
        for key in ("screen_form", "decide_form"):
            if getattr(settings, key) == "planar":
                raise InputError(f"{origin}: a planar body cannot meet goals beside its heading; set {key}=free")
    if settings.grow_depth_high > settings.depth_max:
        raise InputError(f"{origin}: grow_depth_high is above depth_max; lower it to {settings.depth_max} or less")
    if settings.elites >= settings.population:
        raise InputError(f"{origin}: elites leave no room in the population; lower elites below {settings.population}")
    _check_objectives(settings, origin)


def _check_objectives(settings: Settings, origin: str) -> None:
    """Refuse objectives that do not exist, and what they leave nothing to do."""
    asked = asked_objectives(settings)
    if len(set(asked)) != len(asked) or not set(asked) <= set(OBJECTIVES):
        raise InputError(f"{origin}: objectives is {settings.objectives!r}; give some of {','.join(OBJECTIVES)}")
    if asked and (settings.parsimony, settings.selection) != ("none", "tournament"):
        raise InputError(f"{origin}: objectives rank in their own way; set parsimony=none and selection=tournament")


def _typed(settings: Settings, key: str, text: str) -> int | float | bool | str:
    """Read a value as the type of the key's present value."""
    names = [one.name for one in fields(settings)]
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
        example = _written(getattr(settings, key))
        raise InputError(f"--set {key}={text}: not {_WANTED[kind]}; write for example {key}={example}") from None


def _written(value: object) -> str:
    """Return a value as one would write it."""
    return str(value).lower() if isinstance(value, bool) else str(value)
