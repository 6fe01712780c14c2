"""Signals during a session on a rig: the first one ends it with its fixtures, none cuts a release in two."""

from __future__ import annotations

import signal
from contextlib import contextmanager

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Interrupts:
    """Let the first signal end the session as Ctrl-C does, fixtures and all; no other one disturbs the way out."""

    def __init__(self):
        self.number = None
        self.deferred = 0

    def note(self, number, _):
        if self.number is None:
            self.number = number
            if not self.deferred:
                raise KeyboardInterrupt(f"{signal.Signals(number).name} was received")

    @contextmanager
    def deferring(self):
        """Finish what must not be cut in two, as switching torque off; then heed a signal that came meanwhile."""
        before = self.number
        self.deferred += 1
        try:
            yield
        finally:
            self.deferred -= 1
        if self.number != before and not self.deferred:
            raise KeyboardInterrupt(f"{signal.Signals(self.number).name} was received")
