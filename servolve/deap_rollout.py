"""The closed loop as one writes it around MuJoCo's Python bindings: the rollouts of `servolve.deap_baseline`.

Written to be as fast as it gets in Python: one model a condition, prepared once a generation; views and numbers in
local names; as few calls of `mj_step` as the latency and the sensor's sampling allow; statistics in numpy when the
rollout is over. It stands beside the native rollouts as an implementation of its own, for the planar lamp's task only.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
import numpy.typing as npt

from controller.controller import Controller
from controller.cycle import CycleSpec, resolve_cycle
from controller.errors import InputError
from controller.rig import Rig
from evolve.conditions import Conditions
from sim_models.body import Layout, body_layout, build_model, settled_data, substeps
from sim_models.raw_channels import samples_at_instants
from sim_models.rollouts import END_WINDOW_S, StopConditions
from sim_models.servo import servo_parameters, set_servo
from sim_models.statistics import HIT_M, STATISTICS, count_hops

TERMINALS: Final = ("t", "a0", "a1", "a2", "px", "goal_met", "goal_dist")
"""Inputs of the programs that this loop runs, in order."""

_UPRIGHT_RAD: Final = 0.35
_IDLE_M_S: Final = 0.02
_FALL_TILT, _FALL_HEAD, _FALL_FLIGHT = 1, 2, 3
_NOISE_CHANNELS: Final = 32  # places that the noise keeps for the channels of one substep

FloatArray = npt.NDArray[np.float64]
Program = Callable[[float, float, float, float, float, float, float], float]


@dataclass(frozen=True, eq=False)
class Loop:
    """Hold what all rollouts share.

    Args:
        rig: the rig
        model: its planar body as `build_model` gives it
        data: one for all rollouts
        layout: where the model keeps the rig's joints
        settled: where rollouts start, qpos, (nq,)
        cycle: the control cycle's numbers
        nstep: control periods of a rollout
        nsub: substeps of a period
        sampled: substep of a period whose state the next period's px shows
        stop: when a rollout is over before its time
        stop_early: whether physics ends there, too; the statistics do in any case
        base_geoms: ids of the base's geoms
    """

    rig: Rig
    model: mujoco.MjModel
    data: mujoco.MjData
    layout: Layout
    settled: FloatArray
    cycle: CycleSpec
    nstep: int
    nsub: int
    sampled: int
    stop: StopConditions
    stop_early: bool
    base_geoms: frozenset[int]


@dataclass(frozen=True, eq=False)
class Case:
    """Hold one condition, ready to run.

    Args:
        model: its body
        goal_m: distance of the goal [m]
        start: qpos, (nq,)
        bias: encoder biases [rad], (njoint,)
        late_periods: whole periods of the command latency
        late_substeps: the rest of it
        noise: of x at each control instant [m], (nstep,)
    """

    model: mujoco.MjModel
    goal_m: float
    start: FloatArray
    bias: tuple[float, ...]
    late_periods: int
    late_substeps: int
    noise: tuple[float, ...]


def make_loop(
    rig: Rig, template: Controller, timestep_s: float, time_limit_s: float, stop: StopConditions, *, stop_early: bool
) -> Loop:
    """Prepare what all rollouts share.

    Args:
        rig: the rig
        template: the controller around the programs, over `TERMINALS`
        timestep_s: MuJoCo's step [s]
        time_limit_s: how long a rollout lasts [s]
        stop: when a rollout is over before its time
        stop_early: whether physics ends there, too

    Returns:
        The loop's numbers.

    Raises:
        InputError: the controller or the rig is not of the kind that this loop knows
    """
    names = tuple(terminal.name for terminal in template.inputs)
    if names != TERMINALS or len(rig.joints) != 3:
        raise InputError(f"{rig.name}: the DEAP baseline runs three joints on {' '.join(TERMINALS)}; use such a task")
    model = build_model(rig, form="planar", timestep_s=timestep_s)
    layout = body_layout(model, rig)
    nstep, nsub = round(time_limit_s / rig.period_s), substeps(rig, timestep_s)
    x = [sensor.name for sensor in rig.sensors].index("x")
    offsets = samples_at_instants(rig, timestep_s, nstep)[1:, x] - np.arange(nstep - 1) * nsub
    if np.any(offsets != offsets[0]) or not 0 < offsets[0] <= nsub:
        raise InputError(f"{rig.path}: the DEAP baseline samples x once a period; use a rig with such a sensor")
    return Loop(
        rig=rig,
        model=model,
        data=mujoco.MjData(model),
        layout=layout,
        settled=settled_data(model, rig).qpos.copy(),
        cycle=resolve_cycle(template, rig),
        nstep=nstep,
        nsub=nsub,
        sampled=int(offsets[0]),
        stop=stop,
        stop_early=stop_early,
        base_geoms=frozenset(np.flatnonzero(model.geom_bodyid == layout.base).tolist()),
    )


def make_cases(loop: Loop, conditions: Conditions) -> list[Case]:
    """Prepare conditions: a model each, and the noise that does not depend on the controller.

    Args:
        loop: from `make_loop`
        conditions: goals and rigs

    Returns:
        One case for each condition.
    """
    drawn, rig, timestep_s = conditions.perturbations, loop.rig, float(loop.model.opt.timestep)
    cases = []
    for row, goal_m in enumerate(conditions.goal_m.tolist()):
        model = copy.copy(loop.model)
        model.geom_friction[:, 0] *= drawn.friction[row]
        model.body_mass *= drawn.mass[row]
        model.body_inertia *= drawn.mass[row]
        mujoco.mj_setConst(model, loop.data)
        for joint, actuator, torque in zip(rig.joints, loop.layout.actuator, drawn.torque[row], strict=True):
            voltage = rig.supply_v * drawn.voltage[row]
            gains = joint.p_gain, joint.d_gain, joint.pwm_limit
            set_servo(model, int(actuator), servo_parameters(joint.product, *gains, voltage, float(torque)))
        start = loop.settled.copy()
        start[loop.layout.qpos] += drawn.initial_rad[row]
        periods, rest = divmod(round(drawn.latency_s[row] / timestep_s), loop.nsub)
        noise = drawn.pose_noise_m[row] * _noise_of_x(loop, int(drawn.seed[row]))
        bias = tuple(drawn.encoder_bias_rad[row].tolist())
        cases.append(Case(model, goal_m, start, bias, periods, rest, tuple(noise.tolist())))
    return cases


def _noise_of_x(loop: Loop, seed: int) -> FloatArray:
    """Return the standard normal deviates that the native rollouts draw for x, (nstep,)."""
    at = samples_at_instants(loop.rig, float(loop.model.opt.timestep), loop.nstep).astype(np.uint64)
    x = [sensor.name for sensor in loop.rig.sensors].index("x")
    total = np.zeros(loop.nstep)
    with np.errstate(over="ignore"):
        for i in range(2):
            place = (at[:, x] * np.uint64(_NOISE_CHANNELS) + np.uint64(x)) * np.uint64(2) + np.uint64(i + 1)
            z = np.uint64(seed) + place * np.uint64(0x9E3779B97F4A7C15)
            z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
            z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
            z ^= z >> np.uint64(31)
            for j in range(4):
                total += ((z >> np.uint64(16 * j)) & np.uint64(0xFFFF)).astype(np.float64)
    return np.asarray((total - 262140) / 65536 * math.sqrt(1.5))


def rollout(loop: Loop, case: Case, programs: Sequence[Program]) -> npt.NDArray[np.void]:
    """Run one controller under one condition.

    Args:
        loop: from `make_loop`
        case: from `make_cases`
        programs: one function of `TERMINALS` for each joint, in the outputs' own units

    Returns:
        What it came to, dtype `STATISTICS`, a scalar; fields that the loop does not know are NaN, or 0.
    """
    poses, rates, fallen = _run(loop, case, programs)
    return _statistics(loop, case, np.array(poses), np.array(rates), fallen)


def _run(loop: Loop, case: Case, programs: Sequence[Program]) -> tuple[list[list[float]], list[list[float]], int]:
    """Return qpos and qvel at every control instant up to the stop, and which stop condition held."""
    # local names: attributes cost more than the arithmetic
    step, model, data, cycle = mujoco.mj_step, case.model, loop.data, loop.cycle
    goal_dist, noise, late, stop_early = case.goal_m, case.noise, case.late_periods, loop.stop_early
    period, tick, share, slew = loop.rig.period_s, cycle.x.scale, cycle.filter, cycle.slew_step or math.inf
    scales = (abs(terminal.scale) for terminal in cycle.terminals[1:4])
    encoders = tuple(zip(loop.layout.qpos.tolist(), case.bias, scales, strict=True))
    drives = tuple((p, o.low, o.high, o.neutral, o.unit_scale) for p, o in zip(programs, cycle.outputs, strict=True))
    per_rad = [output.count_scale for output in cycle.outputs]
    plan, fall = _plan(loop, case), _fall_watch(loop)

    mujoco.mj_resetData(model, data)
    qpos, qvel, ctrl = data.qpos, data.qvel, data.ctrl
    qpos[:] = case.start
    held = [output.neutral * output.unit_scale for output in cycle.outputs]
    ctrl[:] = held
    pose, met, fallen = qpos.tolist(), 0.0, 0
    x = pose[0]
    there = round((x + noise[0]) / tick) * tick + goal_dist
    poses, rates, goals = [pose], [qvel.tolist()], []
    for k in range(loop.nstep):
        # terminals
        t, px = k * period, there - round((x + noise[k]) / tick) * tick
        if -HIT_M <= px <= HIT_M:
            met = 1.0
        a0, a1, a2 = [round((pose[i] + bias) / scale) * scale for i, bias, scale in encoders]

        # programs; clamp, filter, slew; NaN is neutral
        for j, (program, low, high, neutral, unit) in enumerate(drives):
            u = program(t, a0, a1, a2, px, met, goal_dist)
            move = share * ((low if u < low else high if u > high else u if u == u else neutral) * unit - held[j])
            held[j] += slew if move > slew else -slew if move < -slew else move
        goals.append([round(angle * counts) / counts for angle, counts in zip(held, per_rad, strict=True)])

        # physics, with a break where goals act and one where x is sampled
        for count, acts, samples in plan:
            if count:
                step(model, data, count)
            if acts and k >= late:
                ctrl[:] = goals[k - late]
            if samples:
                x = qpos.item(0)
        pose = qpos.tolist()
        if not fallen:
            poses.append(pose)
            rates.append(qvel.tolist())
            fallen = fall(pose)
            if fallen and stop_early:
                break
    return poses, rates, fallen


def _plan(loop: Loop, case: Case) -> tuple[tuple[int, bool, bool], ...]:
    """Return the pieces of a period: how many substeps, then whether goals act there, whether x is sampled."""
    breaks = sorted({case.late_substeps, loop.sampled, loop.nsub})
    return tuple(
        (at - before, at == case.late_substeps, at == loop.sampled)
        for before, at in zip((0, *breaks), breaks, strict=False)
    )


def _fall_watch(loop: Loop) -> Callable[[list[float]], int]:
    """Return what says at the end of each period, from qpos and the last contacts, which stop condition holds."""
    data, stop, base_geoms = loop.data, loop.stop, loop.base_geoms
    tilt_max, flight_max = stop.tilt_rad_max, stop.flight_s_max / loop.rig.period_s
    head = frozenset(loop.layout.head_geoms.tolist()) if stop.head_contact else frozenset()
    flight = 0

    def watch(pose: list[float]) -> int:
        nonlocal flight
        touching = data.contact.geom.ravel().tolist()
        flight = flight + 1 if base_geoms.isdisjoint(touching) else 0
        if not -tilt_max <= pose[2] <= tilt_max:
            return _FALL_TILT
        if not head.isdisjoint(touching):
            return _FALL_HEAD
        return _FALL_FLIGHT if flight >= flight_max else 0

    return watch


def _statistics(loop: Loop, case: Case, poses: FloatArray, rates: FloatArray, fallen: int) -> npt.NDArray[np.void]:
    """Return the statistics of a rollout from what was seen at control instants, (n, nq) and (n, nv)."""
    end = np.zeros((), STATISTICS)
    for name in STATISTICS.names or ():
        if STATISTICS[name].kind == "f":
            end[name] = np.nan
    end["alive_steps"], end["fallen"] = len(poses) - 1, fallen
    if not np.isfinite(poses).all():
        end["status"], end["final_error"], end["end_speed"], end["end_joint_error"] = 1, np.inf, np.inf, np.inf
        return end
    joints = poses[:, loop.layout.qpos]
    away = poses[0, 0] + case.goal_m - poses[:, 0]
    speed = np.hypot(rates[:, 0], rates[:, 1])
    clearance = _clearance(loop, poses)
    end["final_error"], end["min_error"] = abs(away[-1]), np.abs(away).min()
    end["end_tilt"], end["max_tilt"] = _tilt(poses[-1:, 2])[0], _tilt(poses[:, 2]).max()
    end["upright_end"] = not fallen and end["end_tilt"] <= _UPRIGHT_RAD
    end["end_speed"] = speed[-1 - min(round(END_WINDOW_S / loop.rig.period_s), len(speed) - 1) :].max()
    end["end_joint_error"] = np.abs(joints[-1] - [joint.neutral_rad for joint in loop.rig.joints]).mean()
    end["end_joint_speed"] = np.abs(rates[-1, loop.layout.dof]).mean()
    end["max_clearance"], end["hops"] = max(0.0, clearance.max()), count_hops(clearance)
    end["path"] = np.abs(np.diff(poses[:, 0])).sum()

    # when the goal was met, and when for good
    hits = np.flatnonzero(np.abs(away) <= HIT_M)
    misses = np.flatnonzero(np.abs(away) > HIT_M)
    end["first_hit_step"] = hits[0] if len(hits) else -1
    settled = misses[-1] + 1 if len(misses) else 0
    end["arrive_step"] = settled if settled < len(away) else -1
    end["idle_steps"] = np.count_nonzero(speed[:settled] < _IDLE_M_S)
    after = slice(hits[0], None) if len(hits) else slice(0, 0)
    end["path_after_hit"] = np.abs(np.diff(poses[after, 0])).sum()
    end["joint_path_after_hit"] = np.abs(np.diff(joints[after], axis=0)).mean(axis=1).sum()
    return end


def _tilt(pitch: FloatArray) -> FloatArray:
    """Return the angles to the vertical."""
    return np.asarray(np.abs(np.remainder(pitch + math.pi, 2 * math.pi) - math.pi))


def _clearance(loop: Loop, poses: FloatArray) -> FloatArray:
    """Return the height of the lowest foot."""
    sine, cosine = np.sin(poses[:, 2]), np.cos(poses[:, 2])
    feet = [cosine * foot[2] - sine * foot[0] for foot in loop.layout.foot_position]
    base = poses[:, 1] + float(loop.model.body_pos[loop.layout.base, 2])
    return np.asarray(base + np.min(feet, axis=0) - loop.layout.foot_radius)
