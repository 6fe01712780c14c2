"""Faults of the virtual rig: what goes wrong, how often, when. They are configuration, and seeded.

A fault is written ``KIND=VALUE``, ``KIND=VALUE@START`` or ``KIND=VALUE@START-END``, times in seconds of the rig:
``drop=0.01`` loses one reply in a hundred, ``drop=#3`` exactly the next three, ``dead=2@3.0`` takes servo 2 off the bus
after three seconds. What has no value goes without: ``estop@5``. A file of faults is a list of them.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Final, Literal

from controller.errors import InputError
from controller.rig import Rig
from controller.toml_table import read_toml

Meaning = Literal["chance", "late", "id", "slip", "letter", "volts", "time", "nothing"]

KINDS: Final[Mapping[str, tuple[Meaning, str]]] = {
    "drop": ("chance", "a status packet does not reach the master"),
    "corrupt": ("chance", "one bit of a status packet is wrong"),
    "truncate": ("chance", "a status packet loses its end"),
    "late": ("late", "a status packet reaches the master so many milliseconds late, 20 unless said"),
    "duplicate": ("chance", "a status packet reaches the master twice"),
    "unsolicited": ("chance", "an old status packet follows an answer, though nobody asked for it"),
    "deaf": ("chance", "no servo hears a packet of the master"),
    "latency-timer": ("time", "the USB adapter hands bytes over only so often, in milliseconds"),
    "unplug": ("nothing", "the adapter is unplugged: its port dies; at END it returns"),
    "dead": ("id", "the servo has no power: silent and limp; at END it boots"),
    "mute": ("id", "the servo's line is cut: silent, and it drives on"),
    "duplicate-id": ("id", "the servo after it on the line answers to its id as well"),
    "brownout": ("nothing", "no servo has enough power: all are silent and limp; at END they boot"),
    "supply": ("volts", "the supply has this voltage"),
    "overload": ("id", "the servo reports an overload"),
    "overheat": ("id", "the servo reports overheating"),
    "wrap": ("slip", "the servo's encoder counts on from elsewhere: a turn further, or so many counts"),
    "stuck": ("id", "the servo's horn is stuck: the joint does not move"),
    "sensor-drop": ("chance", "a sensor line does not arrive"),
    "sensor-corrupt": ("chance", "one bit of a sensor line is wrong"),
    "sensor-dead": ("letter", "the sensor node sends no lines of this letter"),
    "sensor-silent": ("nothing", "the sensor node sends nothing"),
    "sensor-babble": ("nothing", "the sensor node sends garbage between its lines"),
    "estop": ("nothing", "the sensor node sends its emergency stop line, once"),
}
"""Kind => what its value is, and what happens."""

LATE_MS: Final = 20.0
_IDS: Final = ("id", "slip")
_EXAMPLES: Final[Mapping[Meaning, str]] = {
    "chance": "=0.01 or =#3",
    "late": "=0.01, =0.01:20 or =#3:20",
    "id": "=2@3.0",
    "slip": "=2@3.0 or =2:4096@3.0",
    "letter": "=F@3.0",
    "volts": "=4.5@3.0",
    "time": "=16",
    "nothing": "@3.0-4.0",
}
_SPEC: Final = re.compile(
    r"(?P<kind>[a-z-]+)(=(?P<value>[^@:]+)(:(?P<more>[^@:]+))?)?(@(?P<start>[0-9.]+)(-(?P<end>[0-9.]+))?)?", re.ASCII
)


@dataclass(frozen=True)
class Fault:
    """Describe one fault.

    Args:
        kind: one of `KINDS`
        value: a probability, an id, a voltage or a time [ms]; 0 where the value is a count, a letter or nothing
        letter: message letter, or ""
        start_s: rig time at which it begins [s]
        end_s: rig time at which it ends, infinite: never [s]
        count: how often it happens in all; 0: the value says how probable it is
        more: how late [ms], or how many counts the encoder slips, 0: a turn
    """

    kind: str
    value: float
    letter: str = ""
    start_s: float = 0.0
    end_s: float = math.inf
    count: int = 0
    more: float = 0.0

    def active(self, t_s: float) -> bool:
        """Return whether it acts at a time.

        Args:
            t_s: rig time [s]
        """
        return self.start_s <= t_s + 1e-12 < self.end_s

    @property
    def spec(self) -> str:
        """Return how it is written."""
        meaning = KINDS[self.kind][0]
        value = self.letter or (f"#{self.count}" if self.count else _written(self.value))
        value = "" if meaning == "nothing" else f"={value}"
        more = f":{_written(self.more)}" if self.more and meaning in ("late", "slip") else ""
        end = f"-{_written(self.end_s)}" if self.end_s < math.inf else ""
        times = f"@{_written(self.start_s)}{end}" if self.start_s or end else ""
        return f"{self.kind}{value}{more}{times}"


def _written(value: float) -> str:
    """Return a number's digits, all that it needs and no exponent."""
    return format(Decimal(repr(value)), "f").removesuffix(".0")


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
        raise InputError(f"fault {spec!r}: is not KIND=VALUE, KIND=VALUE@START or KIND=VALUE@START-END; as dead=2@3.0")
    kind, text, more = match["kind"], match["value"], match["more"]
    if kind not in KINDS:
        close = difflib.get_close_matches(kind, KINDS, n=1)
        hint = f"did you mean '{close[0]}'?" if close else f"known: {', '.join(KINDS)}"
        raise InputError(f"fault {spec!r}: kind '{kind}' is not known; {hint}")
    start_s = _time(spec, match["start"], 0.0)
    end_s = _time(spec, match["end"], math.inf)
    if start_s >= end_s:
        raise InputError(f"fault {spec!r}: it ends before it begins; write the earlier time first")
    meaning = KINDS[kind][0]
    if (text is None) != (meaning == "nothing"):
        example = kind + _EXAMPLES[meaning]
        raise InputError(f"fault {spec!r}: {kind} {'takes no' if text else 'needs a'} value; write as {example}")
    if more is not None and meaning not in ("late", "slip"):
        raise InputError(f"fault {spec!r}: {kind} takes no second value; write as {kind}{_EXAMPLES[meaning]}")
    if meaning == "letter" and not re.fullmatch("[A-Z]", text):
        raise InputError(f"fault {spec!r}: {text!r} is not a message letter; write one such as F")
    count = _count(spec, text) if meaning in ("chance", "late") and text.startswith("#") else 0
    value = 0.0 if count else _value(spec, meaning, text or "")
    extra = _more(spec, meaning, more)
    return Fault(kind, value, text if meaning == "letter" else "", start_s, end_s, count, extra)


def read_faults(specs: Sequence[str]) -> tuple[Fault, ...]:
    """Read faults as the command line has them, or the files that it names.

    Args:
        specs: each a fault, or the path of a file that ends in .toml

    Returns:
        all of them

    Raises:
        InputError: one is wrong
    """
    return tuple(parse_fault(spec) for spec in fault_specs(specs))


def fault_specs(specs: Sequence[str]) -> tuple[str, ...]:
    """Put faults where files of them are named.

    Args:
        specs: each a fault, or the path of a file that ends in .toml

    Returns:
        each a fault

    Raises:
        InputError: a file can not be read, or something in it is wrong
    """
    told: list[str] = []
    for spec in specs:
        told += _listed(Path(spec)) if spec.endswith(".toml") else [spec]
    return tuple(told)


def _listed(path: Path) -> list[str]:
    top = read_toml(path, "fault file")
    top.refuse_unknown(("format", "faults"))
    listed = top.values.get("faults")
    if not isinstance(listed, list) or not all(isinstance(each, str) for each in listed):
        top.fail("faults", 'faults is not a list of texts; write faults = ["drop=0.01", "dead=2@3.0"]')
    for each in listed:
        try:
            parse_fault(each)
        except InputError as error:
            top.fail("faults", str(error))
    return listed


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
        if meaning in _IDS and fault.value not in ids:
            known = ", ".join(str(identity) for identity in ids)
            raise InputError(f"fault {fault.kind}={fault.value:g}: {rig.name} has no such servo; its ids are {known}")
        if meaning == "letter" and fault.letter not in letters:
            known = ", ".join(letters) or "none"
            raise InputError(f"fault {fault.kind}={fault.letter}: {rig.name} has no such message; it has {known}")


def _count(spec: str, text: str) -> int:
    if not re.fullmatch("#[0-9]{1,6}", text) or int(text[1:]) == 0:
        raise InputError(f"fault {spec!r}: {text!r} is not a count; write one such as #3")
    return int(text[1:])


def _value(spec: str, meaning: Meaning, text: str) -> float:
    if meaning in ("nothing", "letter"):
        return 0.0
    if meaning in _IDS:
        if not re.fullmatch("[0-9]{1,3}", text) or int(text) > 253:
            raise InputError(f"fault {spec!r}: {text!r} is not a servo id; write a whole number from 0 to 253")
        return float(int(text))
    value = _number(text)
    if meaning in ("chance", "late") and not 0.0 <= value <= 1.0:
        raise InputError(f"fault {spec!r}: {text!r} is not a probability; write a number from 0 to 1, or a count as #3")
    if meaning == "volts" and not 0.0 <= value <= 100.0:
        raise InputError(f"fault {spec!r}: {text!r} is not a supply voltage; write a number of volts")
    if meaning == "time" and not 0.0 < value <= 255.0:
        raise InputError(f"fault {spec!r}: {text!r} is not a latency; write milliseconds from 1 to 255")
    return value


def _more(spec: str, meaning: Meaning, text: str | None) -> float:
    if text is None:
        return LATE_MS if meaning == "late" else 0.0
    value = _number(text)
    if meaning == "late" and not 0.0 < value <= 10000.0:
        raise InputError(f"fault {spec!r}: {text!r} is no time to be late by; write milliseconds up to 10000")
    if meaning == "slip" and (not abs(value) <= 1e6 or value != round(value)):
        raise InputError(f"fault {spec!r}: {text!r} is not a number of counts; write a whole number such as 4096")
    return value


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _time(spec: str, text: str | None, default: float) -> float:
    if text is None:
        return default
    try:
        return float(text)
    except ValueError:
        raise InputError(f"fault {spec!r}: {text!r} is not a time; write seconds, as @3.0 or @3.0-4.5") from None
