"""Say in the host loop's sentences why firmware has entered a state: the numbers of sv_reason.h, with joint names.

A fault's sentence comes from the very function that says it in the host loop, which is shown what the firmware saw.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from types import MappingProxyType
from typing import Final, Literal

from controller.registers import registers
from controller.rig import Joint, Rig
from controller.terminals import joint_scale
from deploy.buses.dynamixel_bus import ERROR_NUMBERS
from deploy.buses.servo_bus import Reply
from deploy.joint_counts import joint_angle
from deploy.safety import (
    Watch,
    judge_encoders,
    judge_hardware_error,
    judge_health,
    judge_replies,
    judge_sensors,
    judge_speeds,
    judge_tilt,
    judge_timing,
    judge_torque,
    judge_tracking,
)
from deploy.torque import unsure_sentence

NOBODY: Final = 255
"""Number of no joint."""

_LASTING: Final = 10**6
"""So many periods are too many, whatever the rig allows."""
_ALERT: Final = 0x80
_STATUSES: Final[Mapping[int, Literal["refused", "missing", "corrupt"]]] = MappingProxyType(
    {1: "refused", 2: "missing", 3: "corrupt"}
)


class Reason(IntEnum):
    """Name the numbers of `sv_reason`."""

    NONE = 0
    WELL = 1
    WRITTEN = 2
    TORQUE_ON = 3
    RESTED = 4
    TIME = 5
    DRY_RUN = 6
    RELEASED = 7
    STOP_COMMAND = 16
    STOP_INPUT = 17
    STOP_LINE = 18
    FINDING = 32
    SILENT = 33
    LATE = 34
    CORRUPT = 35
    REFUSED = 36
    HARDWARE = 37
    NO_TORQUE = 38
    STALE = 39
    JUMP = 40
    TRACKING = 41
    OUTSIDE = 42
    BLOCKED = 43
    TILT = 44
    HOT = 45
    LOW = 46
    OVERRUN = 47
    WATCHDOG = 48
    NO_REST = 49
    LIMIT = 50
    RATE = 51
    SETTING = 52
    TORQUE_UNSURE = 53
    SELFTEST = 54
    RESET = 55


PLAIN: Final[Mapping[int, str]] = MappingProxyType(
    {
        Reason.NONE: "",
        Reason.WELL: "every servo is there, is the right one, and is well",
        Reason.WRITTEN: "settings are written and read back, goals are where the joints stand",
        Reason.TORQUE_ON: "torque is on",
        Reason.RESTED: "at rest in neutral, sensors are fresh",
        Reason.TIME: "the time is over",
        Reason.DRY_RUN: "every check passed; nothing was written: give --arm (on the console: arm)",
        Reason.RELEASED: "torque is off on every servo, as read back",
        Reason.STOP_COMMAND: "stopped: the console was told to stop",
        Reason.STOP_INPUT: "stopped: the stop input is active",
        Reason.STOP_LINE: "stopped: the sensor node sent an emergency stop",
        Reason.NO_REST: "the rig did not come to rest in neutral within 10 s; look for what moves or blocks it",
    }
)
"""What needs no number; the host loop's words where it has them."""

_DEFECT: Final = "report this as a defect"
_RESETS: Final = (
    ("power", _DEFECT),
    ("the watchdog, for the main loop hung", _DEFECT),
    ("a fault handler", _DEFECT),
    ("its falling supply", "feed it from another supply than the servos"),
    ("the loss of its crystal's clock", "look at the crystal, or change the board"),
)
"""What has reset the board and what to do about it, by `sv_reset_cause`."""


@dataclass(frozen=True)
class Why:
    """Hold why a state was entered.

    Args:
        reason: `sv_reason`
        joint: number of the joint, or of the sensor, 255: none
        a: see sv_reason.h
        b: likewise
    """

    reason: int
    joint: int
    a: int
    b: int

    @property
    def faulty(self) -> bool:
        """Return whether it is a fault."""
        return self.reason >= Reason.FINDING

    @property
    def stopped(self) -> bool:
        """Return whether a person wanted it."""
        return Reason.STOP_COMMAND <= self.reason < Reason.FINDING


def sentence(why: Why, rig: Rig, label: str, first_finding: str = "") -> str:
    """Return the sentence of a reason.

    Args:
        why: what the firmware says
        rig: the rig
        label: what the bus is called
        first_finding: sentence of the first error that the check has found

    Returns:
        one sentence; of a number that this servolve does not know, the numbers
    """
    if why.reason in PLAIN:
        return PLAIN[why.reason]
    if why.reason == Reason.FINDING and first_finding:
        return first_finding + (f" (and {why.a} more findings)" if why.a else "")
    said = None
    try:
        tell = _FAULTS.get(Reason(why.reason))
        said = tell(why, rig, label) if tell else None
    except (ValueError, IndexError):
        pass  # a newer firmware's number, or one that this rig does not have
    return said or f"reason {why.reason} of joint {why.joint}: {why.a}, {why.b}; see sv_reason.h of the firmware"


def unsure_joints(rig: Rig, bits: int) -> list[Joint]:
    """Return the joints of a mask.

    Args:
        rig: the rig
        bits: a bit each
    """
    return [joint for number, joint in enumerate(rig.joints) if bits >> number & 1]


# each of these shows a function of the host loop what the firmware saw


def _replies(why: Why, rig: Rig, _: str) -> str | None:
    status: Literal["refused", "missing", "corrupt"] = "missing"
    if why.reason in (Reason.CORRUPT, Reason.REFUSED):
        status = "corrupt" if why.reason == Reason.CORRUPT else "refused"
    error = why.b >> 8 & 0xFF
    watch, replies = Watch(), {}
    for number, joint in enumerate(rig.joints):
        replies[joint.id] = Reply(joint.id, "data", b"", 0, 0.0)
        if why.joint not in (NOBODY, number):
            continue
        replies[joint.id] = Reply(
            joint.id, status, b"", error, 0.0, refusal=_refusal(joint, error), late=why.reason == Reason.LATE
        )
        watch.missed[joint.id] = why.a - 1
        watch.poor[joint.id] = _LASTING if why.b & 1 else 0
    return judge_replies(rig, watch, replies)


def _refusal(joint: Joint, error: int) -> str:
    number = error & ~_ALERT
    if joint.family.protocol != "dynamixel-2.0" or not number:
        return ""
    return ERROR_NUMBERS[number] if number < len(ERROR_NUMBERS) else f"error {number}"


def _stale(why: Why, rig: Rig, _: str) -> str | None:
    watch = Watch(stale={rig.sensors[why.joint].name: _LASTING})
    ages = [0.0] * len(rig.sensors)
    ages[why.joint] = math.inf if why.a < 0 else 1e-6 * why.a
    return judge_sensors(rig, watch, frozenset({why.joint}), ages)


def _jumped(why: Why, rig: Rig, _: str) -> str | None:
    joint = rig.joints[why.joint]
    watch = Watch(believed={joint.name: (0.0, 0.0)}, jumped={joint.name: _LASTING})
    replies = {other.id: Reply(other.id, "data" if other is joint else "missing", b"", 0, 0.0) for other in rig.joints}
    angles = [abs(joint_scale(joint)) * why.a] * len(rig.joints)
    return judge_encoders(rig, watch, 0.0, 1e-6 * why.b, replies, angles)


def _off_track(why: Why, rig: Rig, _: str) -> str | None:
    goals = [0.0] * len(rig.joints)
    goals[why.joint] = joint_scale(rig.joints[why.joint]) * why.a
    watch = Watch(off_track_since={rig.joints[why.joint].name: 0.0})
    return judge_tracking(rig, watch, 1e-6 * why.b, goals, [0.0] * len(rig.joints))


def _speeds(why: Why, rig: Rig, _: str) -> str | None:
    angles = [joint.neutral_rad for joint in rig.joints]
    speeds, goals = [0] * len(rig.joints), [0] * len(rig.joints)
    joint = rig.joints[why.joint]
    since_s = rig.safety.tracking_s_max + rig.period_s  # it is told as soon as it has lasted for too long
    if why.reason == Reason.OUTSIDE:
        angles[why.joint] = joint_angle(joint, why.a)
    else:
        speeds[why.joint], goals[why.joint] = why.a, why.b
    watch = Watch(off_track_since={joint.name: 0.0})
    return judge_speeds(rig, watch, since_s, goals, speeds, angles)


def _tilted(why: Why, rig: Rig, _: str) -> str | None:
    sensors = {sensor.name: sensor for sensor in rig.sensors}
    if not {"roll", "pitch"} <= sensors.keys():
        return None
    roll, pitch = sensors["roll"], sensors["pitch"]
    angles = ((why.a - roll.zero) * roll.scale, (why.b - pitch.zero) * pitch.scale)
    return judge_tilt(rig, Watch(tilted=_LASTING), *angles)


def _low(why: Why, rig: Rig, _: str) -> str | None:
    joint = rig.joints[why.joint]
    volts = round(why.a * registers(joint.product)[joint.family.voltage].scale, 6)
    return judge_health(rig, Watch(low={joint.id: _LASTING}), joint, volts, -math.inf)


def _setting(why: Why, rig: Rig, label: str) -> str:
    joint = rig.joints[why.joint]
    name = next(
        (name for name, register in registers(joint.product).items() if register.address == why.a), f"register {why.a}"
    )
    status = _STATUSES.get(why.b >> 16)
    where = f"servo {joint.id} on {label}"
    if status == "missing":
        return f"{where}: reading {name}, it did not answer; check its power, cable and id"
    if status == "corrupt":
        said = "it answered with corrupt packets only; check cables, ground and other masters on the bus"
        return f"{where}: reading {name}, {said}"
    if status == "refused":
        return f"{where}: writing {name}, it refused: {_refusal(joint, why.b & 0xFF)}"
    return f"{where}: {name} reads {why.b} after another count was written; switch the servo off and on and try again"


def _last_look(why: Why, rig: Rig, _: str) -> str:
    named = f"joint {rig.joints[why.joint].name}"
    if why.reason == Reason.LIMIT:
        return f"{named}: goal {why.a} is outside its limits; report this as a defect"
    return f"{named}: goal {why.a} is farther from the last one, {why.b}, than is allowed; report this as a defect"


def _watchdog(why: Why, rig: Rig, _: str) -> str:
    return (
        f"the firmware was silent for {1e-6 * why.a:.2f} s, so the servos' bus watchdogs ({rig.safety.watchdog_s:g} s) "
        "have stopped them; look for what holds it up"
    )


def _reset(why: Why, *_: object) -> str:
    by, remedy = _RESETS[why.a] if 0 <= why.a < len(_RESETS) else (f"cause {why.a}", _DEFECT)
    return f"the board was reset by {by}; torque was switched off: {remedy}"


_FAULTS: Final[Mapping[Reason, Callable[[Why, Rig, str], str | None]]] = MappingProxyType(
    {
        Reason.FINDING: lambda why, *_: f"the check found {why.a + 1} errors; see the findings",
        Reason.SILENT: _replies,
        Reason.LATE: _replies,
        Reason.CORRUPT: _replies,
        Reason.REFUSED: _replies,
        Reason.HARDWARE: lambda why, rig, _: judge_hardware_error(
            rig.joints[why.joint], why.a, None if why.b < 0 else why.b
        ),
        Reason.NO_TORQUE: lambda why, rig, _: judge_torque(rig.joints[why.joint], 0),
        Reason.STALE: _stale,
        Reason.JUMP: _jumped,
        Reason.TRACKING: _off_track,
        Reason.OUTSIDE: _speeds,
        Reason.BLOCKED: _speeds,
        Reason.TILT: _tilted,
        Reason.HOT: lambda why, rig, _: judge_health(
            rig, Watch(hot={rig.joints[why.joint].id: _LASTING}), rig.joints[why.joint], math.inf, why.a
        ),
        Reason.LOW: _low,
        Reason.OVERRUN: lambda why, rig, _: judge_timing(rig, Watch(overruns=why.a - 1), True),
        Reason.WATCHDOG: _watchdog,
        Reason.LIMIT: _last_look,
        Reason.RATE: _last_look,
        Reason.SETTING: _setting,
        Reason.TORQUE_UNSURE: lambda why, rig, _: unsure_sentence(unsure_joints(rig, why.a)),
        Reason.SELFTEST: lambda why, *_: (
            f"the controller's selftest returned {why.a}: this build or this machine does not compute the reference's "
            "bits; build it with the project's own flags"
        ),
        Reason.RESET: _reset,
    }
)
