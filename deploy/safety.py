"""Decide when a run must stop: isolated glitches ride through, persistent ones stop.

Each ``judge_…`` function looks at one thing for one period, keeps its count in `Watch`, and returns None or the
sentence that ends the run.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from controller.registers import registers
from controller.rig import Joint, Rig
from deploy.buses.servo_bus import Reply
from deploy.joint_counts import joint_speed

PERSISTENT: Final = 3
"""A heat, voltage or tilt reading must come this often in a row before it counts."""

_LATE_REMEDY: Final = "set the adapter's latency timer to 1 ms, or look for what else holds bytes back"

_POOR_MAX: Final = 10
"""So many more periods without a reply than with one, beyond those that may be missed in a row, are too many: an
estimate."""

_VOLTAGE_BIT: Final = 0x01
"""Of the error byte of protocol 1 servos, which comes and goes with the supply."""

_JUMP_RAD: Final = 0.2
_JUMP_SPEED: Final = 1.2
"""How far an encoder may be from its last reading, beside what the servo does at so many times its no-load speed:
estimates."""

_SPEED_SHARE: Final = 0.2
"""Below this part of the speed asked for a joint counts as blocked, unless it is asked for less than this part of its
fastest: an estimate."""


@dataclass
class Watch:
    """Count what has lasted.

    Args:
        missed: servo id => periods in a row without a valid reply
        poor: servo id => how many more periods lately were without one than with one
        stale: sensor => periods in a row with an old value
        alerted: servo id => replies in a row that reported a hardware error
        believed: joint => when and where it was last seen that it can have been [s, rad]
        jumped: joint => angles in a row that it can not have
        off_track_since: joint => since when it has not done what its goals say [s]
        hot: servo id => readings in a row above the limit
        low: servo id => readings in a row below the limit
        tilted: periods in a row with too much tilt
        overruns: periods in a row that were not done in time
    """

    missed: dict[int, int] = field(default_factory=dict)
    poor: dict[int, int] = field(default_factory=dict)
    stale: dict[str, int] = field(default_factory=dict)
    alerted: dict[int, int] = field(default_factory=dict)
    believed: dict[str, tuple[float, float]] = field(default_factory=dict)
    jumped: dict[str, int] = field(default_factory=dict)
    off_track_since: dict[str, float] = field(default_factory=dict)
    hot: dict[int, int] = field(default_factory=dict)
    low: dict[int, int] = field(default_factory=dict)
    tilted: int = 0
    overruns: int = 0


def judge_replies(rig: Rig, watch: Watch, replies: Mapping[int, Reply]) -> str | None:
    """Stop when one servo has been silent for too many periods, or in most of them.

    Args:
        rig: the rig
        watch: counts
        replies: servo id => its reply of this period
    """
    most = rig.safety.missed_cycles_max
    for joint in rig.joints:
        answered = replies[joint.id].status == "data"
        watch.missed[joint.id] = 0 if answered else watch.missed.get(joint.id, 0) + 1
        watch.poor[joint.id] = max(0, watch.poor.get(joint.id, 0) + (-1 if answered else 1))
    for joint in rig.joints:
        missed = watch.missed[joint.id]
        lasting = f"for {missed} periods" if missed > most else "in most periods"
        if missed <= most and (missed == 0 or watch.poor[joint.id] <= most + _POOR_MAX):
            continue
        everyone = len(rig.joints) > 1 and min(watch.missed.values()) > most
        if any(reply.late for reply in replies.values()):
            who = "every servo" if everyone else _named(joint)
            return f"{who} has answered too late {lasting}; {_LATE_REMEDY}"
        if everyone:
            return f"no servo has answered {lasting}; check the bus cable and the power supply"
        reply = replies[joint.id]
        said = {
            "missing": f"gave no reply {lasting}; check its cable and its power",
            "corrupt": f"gave only corrupt replies {lasting}; check its cable, and that no other servo has its id",
            "refused": f"refused to be read ({reply.refusal}) {lasting}; check that it is the right product",
            "data": "",
        }[reply.status]
        return f"{_named(joint)} {said}"
    return None


def judge_alert(watch: Watch, joint: Joint, reply: Reply) -> bool:
    """Return whether to look into what a servo reports: at once, but for a voltage that may be back in a moment.

    Args:
        watch: counts
        joint: the joint
        reply: its reply of this period
    """
    if reply.status != "data":
        return False
    watch.alerted[joint.id] = watch.alerted.get(joint.id, 0) + 1 if reply.alert else 0
    passing = joint.family.protocol != "dynamixel-2.0" and reply.error == _VOLTAGE_BIT
    return watch.alerted[joint.id] >= (PERSISTENT if passing else 1)


def judge_hardware_error(joint: Joint, status: int, shutdown: int | None) -> str | None:
    """Stop when a servo reports a hardware error; its shutdown register says whether it has switched its torque off.

    Args:
        joint: the joint
        status: its hardware error status, or the error byte of a servo that has none
        shutdown: its shutdown register, or None if that could not be read
    """
    family = joint.family
    if family.hardware_error is None:
        status &= sum(1 << bit for bit in family.error_bits)  # the others are about the question
    if not status:
        return None
    names = family.errors(status) or [f"bits 0x{status:02x}"]
    done = "" if shutdown is None else " and has switched its torque off"
    if shutdown is not None and not status & shutdown:
        address = registers(joint.product)[family.shutdown].address
        done = f", for which its {family.shutdown} register ({address}) of {shutdown} does not switch its torque off"
    remedy = "reboot the servo or switch it off and on"
    if family.protocol != "dynamixel-2.0":
        remedy = "switch the servo off and on"
    return f"{_named(joint)} reports a hardware error ({', '.join(names)}){done}; remove the cause, then {remedy}"


def judge_torque(joint: Joint, torque: int) -> str | None:
    """Stop when a servo that should move has no torque: it has restarted, or something else has switched it off.

    Args:
        joint: the joint
        torque: its torque enable register
    """
    if torque:
        return None
    return (
        f"{_named(joint)} has no torque; it has restarted, or another program switched it off: check its power cable "
        "and connectors"
    )


def judge_sensors(rig: Rig, watch: Watch, needed: frozenset[int], ages_s: Sequence[float]) -> str | None:
    """Stop when a sensor that is needed has been old for too many periods.

    Args:
        rig: the rig
        watch: counts
        needed: numbers of the sensors that matter
        ages_s: age of each sensor's value [s], (nsensor,)
    """
    for number in sorted(needed):
        sensor = rig.sensors[number]
        fresh = ages_s[number] <= sensor.age_s_max
        watch.stale[sensor.name] = 0 if fresh else watch.stale.get(sensor.name, 0) + 1
        if watch.stale[sensor.name] > rig.safety.missed_cycles_max:
            return (
                f"sensor {sensor.name} (lines ${sensor.message}) has given nothing new for {ages_s[number]:.2f} s, "
                f"{sensor.age_s_max:g} s are allowed; check the sensor node and its cable"
            )
    return None


def judge_encoders(
    rig: Rig, watch: Watch, asked: float, now: float, replies: Mapping[int, Reply], angles_rad: Sequence[float]
) -> str | None:
    """Stop when an angle has jumped farther than its servo can turn: the encoder has wrapped around or lost its count.

    Args:
        rig: the rig
        watch: counts
        asked: when the servos were asked, or earlier [s]
        now: time, at which they had answered [s]
        replies: servo id => its reply of this period
        angles_rad: angles, (njoint,)
    """
    for joint, angle in zip(rig.joints, angles_rad, strict=True):
        if joint.mode != "position" or replies[joint.id].status != "data":
            continue
        since, before = watch.believed.setdefault(joint.name, (asked, angle))
        reach = _JUMP_RAD + _JUMP_SPEED * joint.product.no_load_speed_rad_s * (now - since)
        if abs(angle - before) <= reach:
            watch.believed[joint.name] = (asked, angle)  # an answer that was held up is as old as its question
            watch.jumped[joint.name] = 0
            continue
        watch.jumped[joint.name] = watch.jumped.get(joint.name, 0) + 1
        # a sum of bytes does not always tell that a packet is damaged, a CRC does
        if watch.jumped[joint.name] > (0 if joint.family.protocol == "dynamixel-2.0" else 1):
            return (
                f"{_named(joint)} has jumped by {abs(angle - before):.2f} rad in {now - since:.2f} s, which no servo "
                "can: its encoder has wrapped around or lost its count; switch it off and on, then check zero_tick"
            )
    return None


def judge_tracking(
    rig: Rig, watch: Watch, now: float, goals_rad: Sequence[float], angles_rad: Sequence[float]
) -> str | None:
    """Stop when a joint has been far from its goal for too long.

    Args:
        rig: the rig
        watch: counts
        now: time [s]
        goals_rad: goals in force, (njoint,)
        angles_rad: angles, (njoint,)
    """
    for joint, goal, angle in zip(rig.joints, goals_rad, angles_rad, strict=True):
        if abs(goal - angle) <= rig.safety.tracking_rad_max:
            watch.off_track_since.pop(joint.name, None)
            continue
        since = watch.off_track_since.setdefault(joint.name, now)
        if now - since > rig.safety.tracking_s_max:
            return (
                f"{_named(joint)} has been {abs(goal - angle):.2f} rad from its goal for {now - since:.2f} s; "
                "look for something that blocks it"
            )
    return None


def judge_speeds(
    rig: Rig, watch: Watch, now: float, goals: Sequence[int], speeds: Sequence[int], angles_rad: Sequence[float]
) -> str | None:
    """Stop when a joint that is driven by its speed hardly moves, or runs the other way, or is beyond its limits.

    How fast it is lags and sags with the load, so only what no healthy joint does for long counts.

    Args:
        rig: the rig
        watch: counts
        now: time [s]
        goals: goals in force [velocity counts], (njoint,)
        speeds: velocities [counts], (njoint,)
        angles_rad: angles, (njoint,)
    """
    for joint, goal, speed, angle in zip(rig.joints, goals, speeds, angles_rad, strict=True):
        slack = rig.safety.tracking_rad_max
        if not joint.low_rad - slack <= angle <= joint.high_rad + slack:
            return (
                f"{_named(joint)} is at {angle:.2f} rad, outside its limits {joint.low_rad:g} to {joint.high_rad:g} "
                "rad; move it inside by hand, or, if it stands inside, switch it off and on: its encoder has wrapped "
                "around"
            )
        asked, done = joint_speed(joint, goal), joint_speed(joint, speed)
        stuck = abs(asked) > _SPEED_SHARE * joint.speed_rad_s_max and done * asked < _SPEED_SHARE * asked * asked
        if not stuck:
            watch.off_track_since.pop(joint.name, None)
            continue
        since = watch.off_track_since.setdefault(joint.name, now)
        if now - since > rig.safety.tracking_s_max:
            return (
                f"{_named(joint)} turns at {done:.2f} rad/s where {asked:.2f} are asked for, for {now - since:.2f} s; "
                "look for something that blocks it"
            )
    return None


def judge_tilt(rig: Rig, watch: Watch, roll: float, pitch: float) -> str | None:
    """Stop when the base has fallen over.

    Args:
        rig: the rig
        watch: counts
        roll: of the base [rad]
        pitch: of the base [rad]
    """
    tilt = math.acos(math.cos(roll) * math.cos(pitch))
    watch.tilted = watch.tilted + 1 if 0.0 < rig.safety.tilt_rad_max < tilt else 0
    if watch.tilted >= PERSISTENT:
        return f"the base has fallen: it tilts {tilt:.2f} rad, {rig.safety.tilt_rad_max:g} are allowed; set it upright"
    return None


def judge_health(rig: Rig, watch: Watch, joint: Joint, voltage_v: float, temperature_c: float) -> str | None:
    """Stop when a servo is too hot or its supply too low.

    Args:
        rig: the rig
        watch: counts
        joint: the joint
        voltage_v: input voltage [V]
        temperature_c: [degrees Celsius]
    """
    safety = rig.safety
    watch.hot[joint.id] = watch.hot.get(joint.id, 0) + 1 if temperature_c > safety.temperature_c_max else 0
    watch.low[joint.id] = watch.low.get(joint.id, 0) + 1 if voltage_v < safety.voltage_low_v else 0
    if watch.hot[joint.id] >= PERSISTENT:
        return (
            f"{_named(joint)} is at {temperature_c:g} degrees Celsius, {safety.temperature_c_max:g} are allowed; "
            "let it cool, and lower gains or torque ceiling"
        )
    if watch.low[joint.id] >= PERSISTENT:
        return (
            f"{_named(joint)} gets {voltage_v:g} V, {safety.voltage_low_v:g} V are needed; charge the battery, or use "
            "shorter or thicker wires"
        )
    return None


def judge_timing(rig: Rig, watch: Watch, overran: bool) -> str | None:
    """Stop when too many periods in a row were not done in time.

    Args:
        rig: the rig
        watch: counts
        overran: whether this one was not
    """
    watch.overruns = watch.overruns + 1 if overran else 0
    if watch.overruns > rig.safety.overrun_cycles_max:
        return (
            f"{watch.overruns} periods in a row took longer than {rig.period_s:g} s; set the adapter's latency timer "
            "to 1 ms, free the processor, or use --realtime"
        )
    return None


def _named(joint: Joint) -> str:
    return f"joint {joint.name} (servo {joint.id})"
