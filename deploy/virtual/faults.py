"""Faults of the virtual rig: what goes wrong, how often, when. They are configuration, and seeded.

A fault is written ``KIND=VALUE``, ``KIND=VALUE@START`` or ``KIND=VALUE@START-END``, times in seconds of the rig:
``drop=0.01`` loses one reply in a hundred, ``dead=2@3.0`` takes servo 2 off the bus after three seconds. What has no
value goes without: ``estop@5``.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

from controller.errors import InputError
from controller.rig import Rig

Meaning = Literal["probability", "id", "letter", "volts", "nothing"]

KINDS: Final[Mapping[str, tuple[Meaning, str]]] = {
    "drop": ("probability", "a status packet does not reach the master"),
    "corrupt": ("probability", "one bit of a status packet is wrong"),
    "deaf": ("probability", "no servo hears a packet of the master"),
    "dead": ("id", "the servo has no power: silent and limp; at END it boots"),
    "mute": ("id", "the servo's line is cut: silent, and it drives on"),
    "overload": ("id", "the servo reports an overload"),
    "overheat": ("id", "the servo reports overheating"),
    "supply": ("volts", "the supply has this voltage"),
    "sensor-drop": ("probability", "a sensor line does not arrive"),
    "sensor-corrupt": ("probability", "one bit of a sensor line is wrong"),
    "sensor-dead": ("letter", "the sensor node sends no lines of this letter"),
    "estop": ("nothing", "the sensor node sends its emergency stop line, once"),
}
"""Kind => what its value is, and what happens."""

_SPEC: Final = re.compile(r"(?P<kind>[a-z-]+)(=(?P<value>[^@]+))?(@(?P<start>[0-9.]+)(-(?P<end>[0-9.]+))?)?", re.ASCII)


@dataclass(frozen=True)
class Fault:
    """Describe one fault.

    Args:
        kind: one of `KINDS`
        value: a probability, an id or a voltage; 0 where the value is a letter or nothing
        letter: message letter, or ""
        start_s: rig time at which it begins [s]
        end_s: rig time at which it ends, infinite: never [s]
    """

    kind: str
    value: float
    letter: str = ""
    start_s: float = 0.0
    end_s: float = math.inf

    def active(self, t_s: float) -> bool:
        """Return whether it acts at a time.

        Args:
            t_s: rig time [s]
        """
        return self.start_s <= t_s + 1e-12 < self.end_s


def parse_fault(spec: str) -> Fault:
    """Read a fault as the command line has it.

    Args:
        spec: ``KIND=VALUE[@START[-END]]``

    Returns:
        the fault

    Raises:
        InputError: it is none
    """
    match = _SPEC.fullmatch(spec)
    if not match:
        raise InputError(f"fault '{spec}': is not KIND=VALUE, KIND=VALUE@START or KIND=VALUE@START-END; as dead=2@3.0")
    kind, text = match["kind"], match["value"]
    if kind not in KINDS:
        close = difflib.get_close_matches(kind, KINDS, n=1)
        hint = f"did you mean '{close[0]}'?" if close else f"known: {', '.join(KINDS)}"
        raise InputError(f"fault '{spec}': kind '{kind}' is not known; {hint}")
    start_s = _time(spec, match["start"], 0.0)
    end_s = _time(spec, match["end"], math.inf)
    if start_s >= end_s:
        raise InputError(f"fault '{spec}': it ends before it begins; write the earlier time first")
    if (text is None) != (KINDS[kind][0] == "nothing"):
        raise InputError(f"fault '{spec}': {kind} {'takes no' if text else 'needs a'} value; write as {_example(kind)}")
    value, letter = _value(spec, KINDS[kind][0], text or "")
    return Fault(kind, value, letter, start_s, end_s)


def check_faults(faults: Sequence[Fault], rig: Rig) -> None:
    """Check that what faults name is there.

    Args:
        faults: the faults
        rig: the rig that they shall happen to

    Raises:
        InputError: the rig has no such servo or message
    """
    ids = [joint.id for joint in rig.joints]
    letters = sorted({sensor.message for sensor in rig.sensors})
    for fault in faults:
        meaning = KINDS[fault.kind][0]
        if meaning == "id" and fault.value not in ids:
            known = ", ".join(str(identity) for identity in ids)
            raise InputError(f"fault {fault.kind}={fault.value:g}: {rig.name} has no such servo; its ids are {known}")
        if meaning == "letter" and fault.letter not in letters:
            known = ", ".join(letters) or "none"
            raise InputError(f"fault {fault.kind}={fault.letter}: {rig.name} has no such message; it has {known}")


def _example(kind: str) -> str:
    values = {"probability": "=0.01", "id": "=2@3.0", "letter": "=F@3.0", "volts": "=4.5@3.0", "nothing": "@3.0"}
    return kind + values[KINDS[kind][0]]


def _value(spec: str, meaning: Meaning, text: str) -> tuple[float, str]:
    if meaning == "nothing":
        return 0.0, ""
    if meaning == "letter":
        if not re.fullmatch("[A-Z]", text):
            raise InputError(f"fault '{spec}': '{text}' is not a message letter; write one such as F")
        return 0.0, text
    if meaning == "id":
        if not re.fullmatch("[0-9]{1,3}", text) or int(text) > 252:
            raise InputError(f"fault '{spec}': '{text}' is not a servo id; write a whole number from 0 to 252")
        return float(int(text)), ""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if meaning == "probability" and not 0.0 <= value <= 1.0:
        raise InputError(f"fault '{spec}': '{text}' is not a probability; write a number from 0 to 1")
    if meaning == "volts" and not 0.0 <= value <= 100.0:
        raise InputError(f"fault '{spec}': '{text}' is not a supply voltage; write a number of volts")
    return value, ""


def _time(spec: str, text: str | None, default: float) -> float:
    if text is None:
        return default
    try:
        return float(text)
    except ValueError:
        raise InputError(f"fault '{spec}': '{text}' is not a time; write seconds, as @3.0 or @3.0-4.5") from None
