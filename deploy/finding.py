"""What a check found: a sentence for people, and for programs which register would have to hold what."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Fix:
    """Name one register whose change would settle a finding; nothing here changes it.

    Args:
        servo: id
        register: its name
        held: what it holds [counts]
        want: what it should hold [counts]
        why: one clause
    """

    servo: int
    register: str
    held: int
    want: int
    why: str

    def message(self) -> Mapping[str, int | str]:
        """Return it in the words of JSON."""
        return {
            "servo": self.servo,
            "register": self.register,
            "from": self.held,
            "to": self.want,
            "why": self.why,
        }


@dataclass(frozen=True)
class Finding:
    """Hold one thing that a check found.

    Args:
        level: "error" forbids to arm, "warning" does not
        text: one sentence that says what to change
        fix: the register to change, or None where it is not a register
    """

    level: Literal["error", "warning"]
    text: str
    fix: Fix | None = None
