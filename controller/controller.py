"""A controller: the program with the meaning of its inputs and outputs (see `controller_file` for its TOML form)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from controller.program import Program
from controller.source import Source


@dataclass(frozen=True)
class Input:
    """Describe one terminal.

    Args:
        name: as the program names it
        unit: "rad", "rad/s", "N", "m", "m/s", "s" or "1"
        low: smallest value expected [unit]
        high: largest value expected [unit]
    """

    name: str
    unit: str
    low: float
    high: float


@dataclass(frozen=True)
class Output:
    """Describe one output, in its own unit: a program's value is made `neutral` if NaN, then clamped to the limits.

    Args:
        name: the joint's name in the rig
        kind: what is commanded
        unit: "deg" or "rad" ("deg/s" or "rad/s" for a velocity)
        low: lower clamp [unit]
        high: upper clamp [unit]
        neutral: value at rest, low <= neutral <= high [unit]
    """

    name: str
    kind: Literal["position", "velocity"]
    unit: Literal["deg", "rad", "deg/s", "rad/s"]
    low: float
    high: float
    neutral: float


@dataclass(frozen=True)
class Controller:
    """Hold everything a deployment needs to know of a controller, apart from the rig.

    Args:
        name: a C identifier's worth of name, ``[A-Za-z_][A-Za-z0-9_.-]{0,63}``
        period_s: control period [s]
        inputs: terminals, in program order, (ninput,)
        outputs: outputs, in list order, (noutput,)
        source: the program as written
        program: the program as lowered and verified
        filter: first-order command filter ``y += filter * (u - y)`` a period, in (0, 1]; 1: none
        slew_rad_s: largest rate of a commanded joint angle [rad/s]; 0: no limit
        task: name of the task that it was evolved for, or None
        provenance: how it came to be (seed, generation, engine version…), TOML scalars
        golden: a recorded trace ``{"inputs": [[…]], "outputs": [[…]]}`` of float32 bit patterns in hex, or empty
    """

    name: str
    period_s: float
    inputs: tuple[Input, ...]
    outputs: tuple[Output, ...]
    source: Source
    program: Program
    filter: float = 1.0
    slew_rad_s: float = 0.0
    task: str | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)
    golden: Mapping[str, Any] = field(default_factory=dict)
