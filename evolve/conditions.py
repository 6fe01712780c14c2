"""Conditions: the goals and the perturbed rigs that a generation's controllers meet."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from evolve.settings import Settings
from sim_models.perturbations import (
    PerturbationRanges,
    Perturbations,
    draw_perturbations,
    nominal_perturbations,
    take,
)

_SPACING = 0.5  # least distance of goals, as a share of their distance when spread evenly


@dataclass(frozen=True, eq=False)
class Conditions:
    """Hold conditions, one goal and one rig each.

    Args:
        goal_m: distance of each goal [m], (n,)
        bearing_rad: direction of each goal from the heading at the start [rad], (n,)
        perturbations: rig of each, n rows
        keys: hash of each condition's numbers, (n,)
    """

    goal_m: npt.NDArray[np.float64]
    bearing_rad: npt.NDArray[np.float64]
    perturbations: Perturbations
    keys: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.goal_m)

    @property
    def draw(self) -> str:
        """Return the hash of all conditions in order."""
        return hashlib.sha256("".join(self.keys).encode()).hexdigest()


def perturbation_ranges(settings: Settings) -> PerturbationRanges:
    """Return how far a run's perturbations are drawn."""
    names = [field.name for field in dataclasses.fields(PerturbationRanges)]
    return PerturbationRanges(**{name: getattr(settings, name) for name in names})


def unperturbed(settings: Settings) -> Settings:
    """Return a run's numbers without any perturbation: every rig is as its file states it.

    Args:
        settings: the run's numbers
    """
    nothing: dict[str, Any] = {field.name: 0.0 for field in dataclasses.fields(PerturbationRanges)}
    return dataclasses.replace(settings, **nothing)


def poisson_disk(rng: np.random.Generator, n: int, low: float, high: float) -> npt.NDArray[np.float64]:
    """Draw points of an interval that keep their distance, in random order.

    The gaps beyond the least distance are uniform: sorted uniform points of the shortened interval, spread again.

    Args:
        rng: source of chance
        n: points
        low: start of the interval
        high: end of the interval

    Returns:
        the points, (n,)

    Source: Gritz & Hahn 1997, §3.6 (goal distances as one-dimensional Poisson-disk samples).
    """
    apart = _SPACING * (high - low) / (n - 1) if n > 1 else 0.0
    points = np.sort(rng.uniform(low, high - (n - 1) * apart, n)) + apart * np.arange(n)
    return rng.permutation(points)


def stratified(rng: np.random.Generator, n: int, low: float, high: float) -> npt.NDArray[np.float64]:
    """Draw directions, one uniform in each of n equal parts of a range, in random order.

    Where the range is a whole turn the parts themselves are rotated, as no direction is the first.

    Args:
        rng: source of chance; a range of one direction needs none
        n: directions
        low: start of the range [rad]
        high: end of the range [rad]

    Returns:
        the directions [rad], (n,)

    Source: McKay, Beckman & Conover 1979 (stratified sampling).
    """
    if high <= low:
        return np.full(n, float(low))
    part = (high - low) / n
    first = rng.uniform(0, part) if np.isclose(high - low, 2 * np.pi) else 0.0
    from_low = first + part * (np.arange(n) + rng.random(n))
    return rng.permutation(low + from_low % (high - low))


def draw_conditions(
    rng: np.random.Generator, settings: Settings, n: int, njoint: int, *, nominal: int = 0
) -> Conditions:
    """Draw goals, each with a rig of its own.

    Args:
        rng: source of chance
        settings: the run's numbers
        n: conditions
        njoint: joints of the rig
        nominal: how many of them, the first ones, are the rig as its file states it

    Returns:
        the conditions; all of the nominal rig where no range is wider than 0
    """
    goal_m = poisson_disk(rng, n, settings.goal_low_m, settings.goal_high_m)
    ranges = perturbation_ranges(settings)
    stated = nominal_perturbations(n, njoint)
    drawn = draw_perturbations(rng, n, njoint, ranges) if any(dataclasses.astuple(ranges)) else stated
    columns = {
        field.name: np.concatenate((getattr(stated, field.name)[:nominal], getattr(drawn, field.name)[nominal:]))
        for field in dataclasses.fields(Perturbations)
    }
    bearing_rad = stratified(rng, n, settings.bearing_low_rad, settings.bearing_high_rad)
    return conditions(goal_m, bearing_rad, Perturbations(**columns))


def conditions(
    goal_m: npt.NDArray[np.float64], bearing_rad: npt.NDArray[np.float64], perturbations: Perturbations
) -> Conditions:
    """Return conditions with their keys.

    Args:
        goal_m: distance of each goal [m], (n,)
        bearing_rad: direction of each goal [rad], (n,)
        perturbations: rig of each, n rows

    Returns:
        the conditions
    """
    columns = [goal_m, bearing_rad]
    columns += [getattr(perturbations, field.name) for field in dataclasses.fields(perturbations)]
    keys = [
        hashlib.sha256(b"".join(np.ascontiguousarray(column[row]).tobytes() for column in columns)).hexdigest()
        for row in range(len(goal_m))
    ]
    return Conditions(goal_m, bearing_rad, perturbations, tuple(keys))


def pick(chosen: Conditions, rows: Sequence[int]) -> Conditions:
    """Return some conditions, in the order asked for.

    Args:
        chosen: to choose from
        rows: which, (m,)

    Returns:
        m conditions
    """
    index = np.asarray(rows, np.int64)
    return Conditions(
        chosen.goal_m[index],
        chosen.bearing_rad[index],
        take(chosen.perturbations, index),
        tuple(chosen.keys[row] for row in rows),
    )
