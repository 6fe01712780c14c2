"""Compare a run on a rig with its simulation: the logged goals, at the times at which they reached the servos.

What is compared with what: a servo's encoder was sampled when the question of its sync read had ended on the wire, a
goal acts from the end of its packet, a sensor's value is as old as the log says. The simulation is asked at those very
instants. It starts where the rig stood before the first cycle and sees nothing else of it: errors are the model's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from controller.errors import InputError
from controller.rig import Rig
from controller.rig_file import load_rig, rig_names
from deploy.joint_counts import joint_angle, joint_count
from deploy.logs.comparison import (
    Array,
    Comparison,
    LoopTiming,
    Outcome,
    Track,
    count_hops,
    joint_errors,
)
from deploy.logs.goal_replay import GoalWrites, SampleTimes, Start, replay_goals, tilt, to_start_frame
from deploy.logs.log import Log, log_rig, log_text, read_log

_BITS_PER_BYTE: Final = 10
_SYNC_READ, _SYNC_WRITE = 0x82, 0x83
_INSTRUCTION: Final = 7
"""Where a Dynamixel 2.0 packet names its instruction."""


def compare(log_path: str | Path) -> Comparison:
    """Replay a log's goals in simulation and measure how far rig and simulation differ.

    Args:
        log_path: a log of `servolve deploy`

    Returns:
        both sides, their differences, and the loop's timing

    Raises:
        InputError: it is not such a log, or it ends before the controller's second period
    """
    log = read_log(log_path)
    if len(log.cycles) < 2:
        raise InputError(
            f"{log_path}: holds fewer than two periods of a controller (/cycle), which a comparison needs; "
            "give the log of a run that came to run"
        )
    try:
        return _compare(log, _rig_as_run(log))
    except InputError:
        raise
    except (KeyError, IndexError, TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"{log_path}: a message lacks what docs/log.md promises ({type(error).__name__}: {error}); "
            "record the run again"
        ) from error


def _compare(log: Log, rig: Rig) -> Comparison:
    cycles = log.cycles
    asked = _wire_ends(log, _SYNC_READ, rig)
    wrote = _wire_ends(log, _SYNC_WRITE, rig)
    real_rad = _encoder_angles(log, rig)

    sent = [i for i, cycle in enumerate(cycles) if cycle["t_write"] is not None]
    counts = [[cycles[i]["goal_counts"].get(joint.name) for joint in rig.joints] for i in sent]
    neutral = np.array([joint_angle(joint, joint_count(joint, joint.neutral_rad)) for joint in rig.joints])
    goals = GoalWrites(wrote[sent], _goal_angles(rig, counts, neutral))
    pose_source, pose_time, position, tilts, clearance = _poses(log, rig)
    force_time, force = _sensor(log, rig, "force")
    samples = SampleTimes(asked, pose_time, force_time)
    sim = replay_goals(rig, _start(log, rig, real_rad, neutral), goals, samples)
    real = Track(real_rad, position, tilts, clearance, force)

    goal = (float(log.meta["goal_dist"]), float(log.meta["goal_bearing"]))
    origin = float(cycles[0]["t"])
    apart = np.linalg.norm(position - sim.position_m, axis=1)
    return Comparison(
        log=log.path,
        complete=log.complete,
        rig=rig,
        controller_text=log_text(log, "controller_text"),
        meta=log.meta,
        events=tuple((float(event["t"]) - origin, str(event["text"])) for event in log.events),
        goal_m=goal,
        time_s=asked - origin,
        goal_time_s=goals.time_s - origin,
        goal_rad=goals.angle_rad,
        pose_time_s=pose_time - origin,
        force_time_s=force_time - origin,
        real=real,
        sim=sim,
        joints=joint_errors(tuple(joint.name for joint in rig.joints), asked - origin, real.joint_rad, sim.joint_rad),
        base_rms_m=float(np.sqrt(np.mean(apart**2))) if len(apart) else None,
        pose_source=pose_source,
        real_outcome=_outcome(real, goal),
        sim_outcome=_outcome(sim, goal),
        timing=_timing(log, rig, origin),
    )


def _rig_as_run(log: Log) -> Rig:
    """Return the embedded rig with the torque ceiling that the run was allowed."""
    name = log.meta.get("rig")
    rig = log_rig(log, load_rig(name).path.parent if name in rig_names() else None)
    derate = float(log.meta.get("derate", 1.0))
    joints = tuple(replace(joint, ceiling=round(joint.ceiling * derate)) for joint in rig.joints)
    return replace(rig, joints=joints)


def _start(log: Log, rig: Rig, real_rad: Array, neutral: Array) -> Start:
    """Return the state before the first cycle: as the virtual rig's judge saw it, or by the encoders."""
    first = float(log.cycles[0]["t"])
    seen = [message for message in log.messages.get("/truth", ()) if float(message["t"]) <= first]
    if seen:
        state = seen[-1]
        angles, rates = (
            np.array([float(state[name][joint.name]) for joint in rig.joints]) for name in ("joint_rad", "joint_vel")
        )
        return Start(
            float(state["t"]), angles, rates, neutral, np.array([*state["base_pos"], *state["base_rpy"]], float)
        )
    if not np.isfinite(real_rad[0]).all():
        raise InputError(
            f"{log.path}: /cycle 0: a servo had not answered, so the start of the run is not known; record it again"
        )
    return Start(first, real_rad[0], None, neutral, None)


def _wire_ends(log: Log, instruction: int, rig: Rig) -> Array:
    """Return when the packet with an instruction had ended on the wire in each cycle [s], (ncycle,).

    Where the bus was not logged, the cycle's own times stand in, when it began and when it handed its goals over, and
    the length that such a packet has.
    """
    nservo = len(rig.joints)
    stand_in, usual_nbyte = ("t", 14 + nservo) if instruction == _SYNC_READ else ("t_write", 14 + 5 * nservo)
    byte_s = _BITS_PER_BYTE / rig.bus.baud
    sent = [
        (float(frame["t"]), len(frame["hex"]) // 2)
        for frame in log.messages.get("/bus", ())
        if frame["direction"] == "tx"
        and int(frame["hex"][2 * _INSTRUCTION : 2 * _INSTRUCTION + 2] or "0", 16) == instruction
    ]
    starts = [float(cycle["t"]) for cycle in log.cycles] + [math.inf]
    ends, index = [], 0
    for cycle, start, end in zip(log.cycles, starts, starts[1:], strict=False):
        while index < len(sent) and sent[index][0] < start - 1e-6:
            index += 1
        if index < len(sent) and sent[index][0] < end - 1e-6:
            t, nbyte = sent[index]
            ends.append(t + nbyte * byte_s)
        else:
            ends.append(math.nan if cycle[stand_in] is None else float(cycle[stand_in]) + usual_nbyte * byte_s)
    return np.array(ends)


def _encoder_angles(log: Log, rig: Rig) -> Array:
    """Return the joints' angles in each cycle, NaN where a servo did not answer [rad], (ncycle, njoint)."""
    return np.array(
        [
            [
                math.nan if joint.id in cycle["missed"] else joint_angle(joint, int(cycle["raw"][joint.name]))
                for joint in rig.joints
            ]
            for cycle in log.cycles
        ]
    )


def _goal_angles(rig: Rig, counts: Sequence[Sequence[int | None]], neutral: Array) -> Array:
    """Return goals as angles [rad], (ngoal, njoint); a joint without a goal stays in neutral."""
    return np.array(
        [
            [
                still if count is None else joint_angle(joint, count)
                for joint, count, still in zip(rig.joints, row, neutral, strict=True)
            ]
            for row in counts
        ]
    ).reshape(-1, len(rig.joints))


def _poses(log: Log, rig: Rig) -> tuple[str, Array, Array, Array, Array]:
    """Return where the rig's base poses come from, their times, positions, tilts and foot clearances."""
    truth = log.messages.get("/truth", ())
    if truth:
        times = np.array([float(m["t"]) for m in truth])
        xyz = np.array([m["base_pos"] for m in truth], float)
        rpy = np.array([m["base_rpy"] for m in truth], float)
        clearance = np.array([float(m["feet_clearance_m"]) for m in truth])
        return ("truth", times, *_in_start_frame(xyz, rpy), clearance)
    names = {sensor.name for sensor in rig.sensors}
    if not {"x", "y", "z", "heading"} <= names:
        none = np.empty(0)
        return "none", none, np.empty((0, 3)), none, none
    series = {name: _sensor(log, rig, name) for name in ("x", "y", "z", "heading", "roll", "pitch") if name in names}
    times = series["x"][0]
    still = np.zeros(len(times))
    xyz = np.stack([series[name][1] for name in ("x", "y", "z")], axis=1)
    rpy = np.stack([series.get(name, (times, still))[1] for name in ("roll", "pitch", "heading")], axis=1)
    return ("sensors", times, *_in_start_frame(xyz, rpy), np.full(len(times), math.nan))


def _in_start_frame(xyz: Array, rpy: Array) -> tuple[Array, Array]:
    """Return positions in the frame of the first [m], (n, 3), and tilts [rad], (n,)."""
    if len(xyz) == 0:
        return xyz, np.empty(0)
    x, y = to_start_frame(xyz[:, 0], xyz[:, 1], (float(xyz[0, 0]), float(xyz[0, 1]), float(rpy[0, 2])))
    return np.stack([x, y, xyz[:, 2]], axis=1), np.array([tilt(float(roll), float(pitch)) for roll, pitch, _ in rpy])


def _sensor(log: Log, rig: Rig, name: str) -> tuple[Array, Array]:
    """Return when a sensor's values were sampled [s], and the values in SI; each sample once."""
    sensor = next((sensor for sensor in rig.sensors if sensor.name == name), None)
    times: list[float] = []
    values: list[float] = []
    for cycle in log.cycles if sensor is not None else ():
        age = cycle["age_s"].get(name)
        if sensor is None or age is None:
            continue
        t = float(cycle["t"]) + float(cycle["read_s"]) - float(age)
        if not times or t > times[-1] + 1e-4:
            times.append(t)
            values.append((int(cycle["raw"][name]) - sensor.zero) * sensor.scale)
    return np.array(times), np.array(values)


def _outcome(track: Track, goal: tuple[float, float]) -> Outcome:
    if len(track.position_m) == 0:
        return Outcome(None, None, None, None, None)
    end = track.position_m[-1, :2]
    at = goal[0] * np.array([math.cos(goal[1]), math.sin(goal[1])])
    seen = track.clearance_m[np.isfinite(track.clearance_m)]
    return Outcome(
        distance_m=float(np.hypot(*(end - at))),
        hops=count_hops(seen) if len(seen) else None,
        clearance_m=float(seen.max()) if len(seen) else None,
        tilt_rad=float(track.tilt_rad[-1]),
        travel_m=float(np.hypot(*(end - track.position_m[0, :2]))),
    )


def _timing(log: Log, rig: Rig, origin: float) -> LoopTiming:
    cycles = log.cycles

    def column(name: str) -> Array:
        return np.array([math.nan if cycle[name] is None else float(cycle[name]) for cycle in cycles])

    ages: Mapping[str, list[Any]] = {
        line: [cycle["age_s"].get(name) for cycle in cycles] for line, name in _line_names(rig).items()
    }
    start, late = column("t") - origin, column("late_s")
    done = late + column("read_s") + column("compute_s") + column("write_s")
    return LoopTiming(
        period_s=rig.period_s,
        start_s=start,
        read_s=column("read_s"),
        compute_s=column("compute_s"),
        write_s=column("write_s"),
        overruns=int(np.sum(done > rig.period_s)),
        missed_replies=sum(len(cycle["missed"]) for cycle in cycles),
        ages_s={name: np.array([math.nan if age is None else float(age) for age in of]) for name, of in ages.items()},
    )


def _line_names(rig: Rig) -> dict[str, str]:
    """Return one channel of each sensor line, by what the line carries: its channels age together."""
    first: dict[str, str] = {}
    for sensor in rig.sensors:
        first.setdefault(sensor.message, sensor.name)
    return {"pose" if name in ("x", "y", "z", "heading", "roll", "pitch") else name: name for name in first.values()}
