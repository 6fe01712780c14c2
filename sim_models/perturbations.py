"""Perturbations: how simulated rigs differ from the nominal one, so that a controller cannot rely on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt

from controller.errors import InputError

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Perturbations:
    """Hold perturbed rigs, one a row.

    Args:
        friction: scale of the sliding friction of every contact, (n,)
        mass: scale of all masses and inertias, (n,)
        torque: scale of each servo's stall torque, no-load speed kept, (n, njoint)
        voltage: scale of the supply voltage, (n,)
        latency_s: time from a control instant until its goals act, rounded to whole substeps [s], (n,)
        encoder_bias_rad: added to the angles that encoders read [rad], (n, njoint)
        initial_rad: added to the settled joint angles at the start [rad], (n, njoint)
        pose_noise_m: standard deviation of the noise of each position of a pose line [m], (n,)
        angle_noise_rad: standard deviation of the noise of each angle of a pose line [rad], (n,)
        force_noise_n: standard deviation of the noise of a force line [N], (n,)
        seed: seed of the noise, (n,)
    """

    friction: FloatArray
    mass: FloatArray
    torque: FloatArray
    voltage: FloatArray
    latency_s: FloatArray
    encoder_bias_rad: FloatArray
    initial_rad: FloatArray
    pose_noise_m: FloatArray
    angle_noise_rad: FloatArray
    force_noise_n: FloatArray
    seed: npt.NDArray[np.uint64]

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.friction)


@dataclass(frozen=True)
class PerturbationRanges:
    """Say how far perturbations are drawn; the defaults are what transferred between simulations.

    Args:
        friction: largest relative change, uniform either way
        mass: largest relative change, uniform either way
        torque: largest relative change of each servo's torque, uniform either way
        voltage: largest relative drop of the supply, uniform
        latency_s: longest command latency, uniform from 0 [s]
        encoder_bias_rad: standard deviation of each encoder's bias [rad]
        initial_rad: standard deviation of the initial angles [rad]
        pose_noise_m: standard deviation of the pose's positions [m]
        angle_noise_rad: standard deviation of the pose's angles [rad]
        force_noise_n: standard deviation of the contact force [N]
    """

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


def nominal_perturbations(n: int, njoint: int) -> Perturbations:
    """Return rigs that do not differ from the nominal one.

    Args:
        n: number of rows
        njoint: joints of the rig

    Returns:
        The rows.
    """
    one, zero = np.ones(n), np.zeros(n)
    return Perturbations(
        friction=one,
        mass=one,
        torque=np.ones((n, njoint)),
        voltage=one,
        latency_s=zero,
        encoder_bias_rad=np.zeros((n, njoint)),
        initial_rad=np.zeros((n, njoint)),
        pose_noise_m=zero,
        angle_noise_rad=zero,
        force_noise_n=zero,
        seed=np.zeros(n, np.uint64),
    )


def draw_perturbations(
    rng: np.random.Generator, n: int, njoint: int, ranges: PerturbationRanges | None = None
) -> Perturbations:
    """Draw perturbed rigs.

    Args:
        rng: source of randomness
        n: number of rows
        njoint: joints of the rig
        ranges: how far; None: the defaults

    Returns:
        The rows.
    """
    ranges = check_ranges(ranges or PerturbationRanges())

    def scale(width: float, *shape: int) -> FloatArray:
        return 1.0 + rng.uniform(-width, width, shape)

    return Perturbations(
        friction=scale(ranges.friction, n),
        mass=scale(ranges.mass, n),
        torque=scale(ranges.torque, n, njoint),
        voltage=1.0 - rng.uniform(0.0, ranges.voltage, n),
        latency_s=rng.uniform(0.0, ranges.latency_s, n),
        encoder_bias_rad=rng.normal(0.0, ranges.encoder_bias_rad, (n, njoint)),
        initial_rad=rng.normal(0.0, ranges.initial_rad, (n, njoint)),
        pose_noise_m=np.full(n, ranges.pose_noise_m),
        angle_noise_rad=np.full(n, ranges.angle_noise_rad),
        force_noise_n=np.full(n, ranges.force_noise_n),
        seed=rng.integers(0, 2**63, n).astype(np.uint64),
    )


def check_ranges(ranges: PerturbationRanges) -> PerturbationRanges:
    """Refuse ranges that no rig can have.

    Args:
        ranges: to be checked

    Returns:
        The same ranges.

    Raises:
        InputError: a range is negative or not finite, or a scale could reach 0.
    """
    for name in (field.name for field in fields(ranges)):
        value = getattr(ranges, name)
        scale = name in ("friction", "mass", "torque", "voltage")
        if not (np.isfinite(value) and value >= 0.0 and (not scale or value < 1.0)):
            bounds = "0 or more and below 1" if scale else "finite and 0 or more"
            raise InputError(f"perturbation range {name}: {value} is not {bounds}; choose a smaller spread")
    return ranges


def take(perturbations: Perturbations, rows: Sequence[int] | npt.NDArray[np.integer]) -> Perturbations:
    """Return some rows of perturbations, in the order asked for.

    Args:
        perturbations: to choose from
        rows: row indices, (m,)

    Returns:
        The rows, m of them.
    """
    index = np.asarray(rows)
    return replace(perturbations, **{f.name: getattr(perturbations, f.name)[index] for f in fields(perturbations)})
