"""Record a run without ever standing in its way: what is held back waits in memory, what fails is kept for later."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from deploy.logs.log import RunLog
from deploy.states import State


class RunRecord:
    """Pass a run's messages on to its log, and its states to whoever announces them.

    A log may be full and a terminal may be stopped. Neither may keep the servos from being talked to: nothing is raised
    here, and between `hold_back` and `let_go` nothing is written or announced.

    Args:
        log: where messages go
        announce: told each state that is entered, or None
    """

    def __init__(self, log: RunLog, announce: Callable[[State], None] | None = None) -> None:
        self.error: Exception | None = None
        self._log = log
        self._announce = announce
        self._held: list[Callable[[], None]] | None = None

    def write(self, topic: str, t: float, message: Mapping[str, Any]) -> None:
        """Write one message; keep the error if it can not be written.

        Args:
            topic: of the log
            t: since the start of the run [s]
            message: its other fields
        """
        self._pass_on(partial(self._log.write, topic, t, message))

    def announce(self, state: State) -> None:
        """Announce a state.

        Args:
            state: that was entered
        """
        if self._announce is not None:
            self._pass_on(partial(self._announce, state))

    def hold_back(self) -> None:
        """Keep everything in memory from now on."""
        if self._held is None:
            self._held = []

    def let_go(self) -> None:
        """Pass on what was held back, in its order."""
        held, self._held = self._held or [], None
        for action in held:
            self._pass_on(action)

    def _pass_on(self, action: Callable[[], None]) -> None:
        if self._held is not None:
            self._held.append(action)
            return
        try:
            action()
        except Exception as error:  # whatever it is, it is heeded where it can do no harm
            self.error = self.error or error
