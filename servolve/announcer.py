"""Print a run's states from a thread of its own: a terminal that is stopped (Ctrl-S) must not stop a control loop."""

from __future__ import annotations

import threading
from queue import SimpleQueue
from typing import Final

from rich.console import Console

from deploy.states import State

_FAREWELL_S: Final = 2.0


class Announcer:
    """Take states without ever waiting, and print them in their order until closed.

    Args:
        console: where to
        name: whose states they are
    """

    def __init__(self, console: Console, name: str) -> None:
        self._console = console
        self._name = name
        self._states: SimpleQueue[State | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._print, name="announcer", daemon=True)

    def __call__(self, state: State) -> None:
        """Take a state.

        Args:
            state: that was entered
        """
        self._states.put(state)

    def __enter__(self) -> Announcer:
        """Start to print."""
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Print what is left, unless the terminal stands still."""
        self._states.put(None)
        self._thread.join(_FAREWELL_S)

    def _print(self) -> None:
        while (state := self._states.get()) is not None:
            try:
                self._console.print(f"{self._name}: {state.value}", highlight=False)
            except OSError:
                return  # nobody reads any more
