"""Tell the time and wait for it: the machine's monotonic clock, or the rig's own in lock step."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from deploy.virtual.lockstep import LockstepBench


class Clock(Protocol):
    """Give one time line to everything that a run does."""

    def now(self) -> float:
        """Return the time [s]."""
        ...

    def sleep_until(self, t: float) -> None:
        """Wait until a time; return at once if it has passed.

        Args:
            t: absolute, so that delays do not add up [s]
        """
        ...


class RealClock:
    """The machine's monotonic clock; steps of the wall clock do not reach it."""

    def now(self) -> float:
        """Return the time [s]."""
        return time.monotonic()

    def sleep_until(self, t: float) -> None:
        """Wait until a time.

        Args:
            t: absolute [s]
        """
        # sleep() waits for an absolute time of the same clock, and goes on waiting after a signal's handler returns
        remaining = t - time.monotonic()
        if remaining > 0.0:
            time.sleep(remaining)


class LockstepClock:
    """The virtual rig's own time: waiting moves the rig.

    Args:
        bench: the rig and its ports
    """

    def __init__(self, bench: LockstepBench) -> None:
        self._bench = bench

    def now(self) -> float:
        """Return the rig's time [s]."""
        return float(self._bench.now)

    def sleep_until(self, t: float) -> None:
        """Move the rig to a time.

        Args:
            t: absolute [s]
        """
        if t > self._bench.now:
            self._bench.pump(t)
