"""Which faults act now, which begin and end, and which of those that come by chance happen."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from deploy.virtual.faults import Fault


class ActiveFaults:
    """Keep account of faults while time passes."""

    def __init__(self) -> None:
        self.all: tuple[Fault, ...] = ()
        self._acting: list[Fault] = []
        self._left: dict[Fault, int] = {}

    def replace(self, faults: Sequence[Fault]) -> list[Fault]:
        """Replace all faults, and begin to count anew; return those that end by it.

        Args:
            faults: all faults; those that are over or to come included
        """
        ended = [fault for fault in self._acting if fault not in faults]
        self._acting = [fault for fault in self._acting if fault in faults]
        self.all = tuple(dict.fromkeys(faults))
        self._left = {fault: fault.count for fault in self.all if fault.count}
        return ended

    def turn(self, t_s: float) -> tuple[list[Fault], list[Fault]]:
        """Return the faults that begin, and those that end, at a time.

        Args:
            t_s: rig time [s]
        """
        begun = [fault for fault in self.all if fault.active(t_s) and fault not in self._acting]
        ended = [fault for fault in self._acting if not fault.active(t_s)]
        if begun or ended:
            self._acting = [fault for fault in self.all if fault.active(t_s)]
        return begun, ended

    def times_s(self) -> Iterator[float]:
        """Yield when faults begin or end next [s]."""
        for fault in self.all:
            yield fault.end_s if fault in self._acting else fault.start_s

    def acts(self, kind: str, value: float | None = None) -> bool:
        """Return whether a fault acts.

        Args:
            kind: which
            value: its id; None: of any
        """
        return any(fault.kind == kind and value in (None, fault.value) for fault in self._acting)

    def acting(self, kind: str) -> Iterator[Fault]:
        """Yield the faults of a kind that act.

        Args:
            kind: which
        """
        return (fault for fault in self._acting if fault.kind == kind)

    def happens(self, rng: np.random.Generator, kind: str, t_s: float) -> Fault | None:
        """Draw whether a fault that comes by chance happens now, and return it; draw only where one is configured.

        Args:
            rng: to draw from
            kind: which
            t_s: rig time [s]
        """
        for fault in self.all:
            if fault.kind != kind or not fault.active(t_s):
                continue
            if fault.count:
                if self._left[fault] > 0:
                    self._left[fault] -= 1
                    return fault
            elif rng.random() < fault.value:
                return fault
        return None
