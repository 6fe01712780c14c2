"""Hear that a person wants the run to stop: a signal, or a key. It never interrupts; the loop asks every period."""

from __future__ import annotations

import os
import select
import signal
import sys
import termios
import tty
from types import FrameType
from typing import Any, Final

_KEYS: Final = b"qQ "
_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)


class StopRequest:
    """Listen for SIGINT, SIGTERM, SIGHUP, SIGQUIT and, at a terminal, for the keys ``q`` and space, until closed.

    A signal is noted and nothing else, so that no transaction on the bus is cut in two and the way out is always the
    same one; a second signal changes nothing.
    """

    def __init__(self) -> None:
        self._reason: str | None = None
        self._handlers: dict[signal.Signals, Any] = {}
        self._terminal: list[Any] | None = None

    def reason(self) -> str | None:
        """Return why the run is to stop, or None."""
        if self._reason is None and self._terminal is not None:
            descriptor = sys.stdin.fileno()
            while select.select([descriptor], [], [], 0)[0]:
                key = os.read(descriptor, 1)
                if not key:
                    break
                if key in _KEYS:
                    self._reason = "a key was pressed"
        return self._reason

    def __enter__(self) -> StopRequest:
        """Start to listen."""
        for number in _SIGNALS:
            self._handlers[number] = signal.signal(number, self._note)
        if sys.stdin is not None and sys.stdin.isatty() and not _in_background():
            self._terminal = termios.tcgetattr(sys.stdin.fileno())
            tty.setcbreak(sys.stdin.fileno())
        return self

    def __exit__(self, *_: object) -> None:
        """Give signals and terminal back."""
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        if self._terminal is not None:
            termios.tcsetattr(sys.stdin.fileno(), termios.TCSADRAIN, self._terminal)
            self._terminal = None

    def _note(self, number: int, _: FrameType | None) -> None:
        if self._reason is None:
            self._reason = f"{signal.Signals(number).name} was received"


def _in_background() -> bool:
    """Return whether the terminal belongs to other processes for now."""
    try:
        return os.tcgetpgrp(sys.stdin.fileno()) != os.getpgrp()
    except OSError:
        return False  # it controls nobody
