"""The states of a run, and the only ways from one to the next."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import Enum
from types import MappingProxyType
from typing import Final


class State(Enum):
    """Say what the servos are being made to do."""

    OFF = "off"  # torque off, or not known yet
    CHECKED = "checked"  # every servo is there, is the right one, and is well; nothing written
    ARMED = "armed"  # gains and limits written, goals seeded, torque on
    HOMING = "homing"  # moving slowly to neutral, then waiting for rest
    RUNNING = "running"  # the controller decides
    STOPPING = "stopping"  # torque being switched off, or handed over to hold
    FAULT = "fault"  # something persistent is wrong; torque is being switched off


WAYS: Final[Mapping[State, frozenset[State]]] = MappingProxyType(
    {
        State.OFF: frozenset({State.CHECKED, State.FAULT}),
        State.CHECKED: frozenset({State.ARMED, State.OFF, State.FAULT}),
        State.ARMED: frozenset({State.HOMING, State.STOPPING, State.FAULT}),
        State.HOMING: frozenset({State.RUNNING, State.STOPPING, State.FAULT}),
        State.RUNNING: frozenset({State.STOPPING, State.FAULT}),
        State.STOPPING: frozenset({State.OFF, State.FAULT}),
        State.FAULT: frozenset(),
    }
)
"""From each state to those that may follow. A fault is left by starting again."""


class StateMachine:
    """Walk through the states; every step is reported.

    Args:
        report: called with the state left, the state entered and why
    """

    def __init__(self, report: Callable[[State, State, str], None]) -> None:
        self.state = State.OFF
        self._report = report

    def enter(self, state: State, reason: str) -> None:
        """Go to another state.

        Args:
            state: where to
            reason: why, for the log

        Raises:
            ValueError: if there is no such way
        """
        if state not in WAYS[self.state]:
            raise ValueError(f"there is no way from {self.state.value} to {state.value}")
        left, self.state = self.state, state
        self._report(left, state, reason)
