"""Put a control period into the log's words, and take it out again bit for bit."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from controller.controller import Controller
from controller.rig import Rig
from deploy.period import Period
from deploy.rig_io import raw_channels

Floats = npt.NDArray[np.float32]
Counts = npt.NDArray[np.int32]
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class CycleStep:
    """Hold what went into one control cycle and what came out.

    Args:
        raw: counts, (nraw,)
        ages_s: their ages, infinite if never read [s], (nraw,)
        terminals: (ninput,)
        outputs: clamped, in their own units, (noutput,)
        goals: [counts], (noutput,)
    """

    raw: Counts
    ages_s: Sequence[float]
    terminals: Floats
    outputs: Floats
    goals: Counts


class CycleWords:
    """Know the names that a log of one controller on one rig uses.

    Args:
        rig: the rig
        controller: the controller
    """

    def __init__(self, rig: Rig, controller: Controller) -> None:
        self._channels = raw_channels(rig)
        self._inputs = tuple(terminal.name for terminal in controller.inputs)
        self._outputs = tuple(output.name for output in controller.outputs)

    def message(self, k: int, step: CycleStep, done: Period, origin: float) -> dict[str, Any]:
        """Return the fields of a `/cycle` message, but for its time.

        Args:
            k: number of the period
            step: its control cycle
            done: the period
            origin: start of the run on the run's clock [s]
        """
        return {
            "k": k,
            "raw": _named(self._channels, step.raw.tolist()),
            "age_s": _named(self._channels, [finite(round(age, 6)) for age in step.ages_s]),
            **self.values(step.terminals, step.outputs, step.goals),
            "missed": [servo for servo, reply in done.replies.items() if reply.status != "data"],
            "t_write": None if done.written is None else round(done.written - origin, 9),
            "late_s": round(done.late_s, 9),
            "read_s": round(done.read - done.started, 9),
            "compute_s": round(done.aimed - done.read, 9),
            "write_s": round(done.ended - done.aimed, 9),
        }

    def values(self, terminals: Floats, outputs: Floats, goals: Counts) -> dict[str, Any]:
        """Return the fields of a `/cycle` message that the control cycle computes.

        Args:
            terminals: (ninput,)
            outputs: clamped, in their own units, (noutput,)
            goals: [counts], (noutput,)
        """
        return {
            "terminals": _named(self._inputs, [finite(value) for value in terminals.tolist()]),
            "outputs": _named(self._outputs, [finite(value) for value in outputs.tolist()]),
            "goal_counts": _named(self._outputs, goals.tolist()),
            "terminal_bits": float_bits(terminals),
            "output_bits": float_bits(outputs),
        }

    def raw(self, message: Mapping[str, Any]) -> Counts:
        """Return the raw counts that a logged period's cycle was given, (nraw,).

        Args:
            message: of `/cycle`
        """
        return np.array([message["raw"][name] for name in self._channels], np.int32)


def _named(names: Sequence[str], values: Sequence[T]) -> dict[str, T]:
    return dict(zip(names, values, strict=True))


def float_bits(values: Floats) -> str:
    """Return the float32 bits of values in hexadecimal, eight digits each, with spaces between.

    Args:
        values: (nvalue,)
    """
    return " ".join(f"{bits:08x}" for bits in np.ascontiguousarray(values, np.float32).view(np.uint32).tolist())


def finite(value: float) -> float | None:
    """Return a number that JSON can hold, or None.

    Args:
        value: any float
    """
    return value if math.isfinite(value) else None
