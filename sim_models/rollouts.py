"""Rollouts: many controllers on many perturbed rigs, closed-loop, in native code on MuJoCo's batch."""

from __future__ import annotations

import ctypes
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

import mujoco
import numpy as np
import numpy.typing as npt

from controller.controller import Controller
from controller.cycle import resolve_cycle
from controller.errors import InputError, RunError
from controller.library import SvCycle
from controller.native import lay_out_cycle, replace_program
from controller.rig import Rig
from sim_models import native_rollouts as native
from sim_models.body import Form, Layout, Scene, body_layout, build_model, settled_data, substeps
from sim_models.perturbations import Perturbations
from sim_models.raw_channels import (
    full_load_torque,
    load_per_speed,
    raw_encoders,
    sampled_substeps,
    samples_at_instants,
)
from sim_models.servo import joint_parameters
from sim_models.simulated_models import SimulatedModels
from sim_models.statistics import STATISTICS, STATUS_ERROR

END_WINDOW_S = 0.2
"""How far `end_speed` looks back [s]."""

_BATCH_MAX = 2048  # simulations handed to MuJoCo at a time; more only cost memory


@dataclass(frozen=True)
class StopConditions:
    """Say when a rollout is over before its time.

    Args:
        tilt_rad_max: largest tilt of the base [rad]; infinite: any
        head_contact: whether a touch of the head ends it
        flight_s_max: longest time that the base touches nothing [s]; infinite: any
    """

    tilt_rad_max: float = 1.0
    head_contact: bool = True
    flight_s_max: float = 0.5


@dataclass(frozen=True, eq=False)
class Cases:
    """Hold the simulations to run, one a row.

    Args:
        controller: index of its controller, (nsim,)
        goal_dist: distance of the goal from the base at the start [m], (nsim,)
        goal_bearing: direction of the goal from the base's heading at the start [rad], (nsim,)
        perturbation: row of its rig in the perturbations, (nsim,)
    """

    controller: npt.NDArray[np.int32]
    goal_dist: npt.NDArray[np.float32]
    goal_bearing: npt.NDArray[np.float32]
    perturbation: npt.NDArray[np.int32]

    def __len__(self) -> int:
        """Return the number of simulations."""
        return len(self.controller)


@dataclass(frozen=True, eq=False)
class Rollouts:
    """Hold what simulations came to; rows of traces after a stop are NaN, and 0 in integer records.

    Args:
        statistics: dtype `sim_models.statistics.STATISTICS`, (nsim,)
        channels: names of the trace channels, (nchannel,)
        traces: state at each control instant and goals set there, float32, (nsim, nstep, nchannel), or None
        raw: raw counts that the cycle read, int32, (nsim, nstep, nraw), or None
        outputs: clamped outputs in their own units, by rig joint, float32, (nsim, nstep, njoint), or None
        goal_counts: goal counts, by rig joint, int32, (nsim, nstep, njoint), or None
        nstep: control periods of a full rollout
        period_s: control period [s]
    """

    statistics: npt.NDArray[np.void]
    channels: tuple[str, ...]
    traces: npt.NDArray[np.float32] | None
    raw: npt.NDArray[np.int32] | None
    outputs: npt.NDArray[np.float32] | None
    goal_counts: npt.NDArray[np.int32] | None
    nstep: int
    period_s: float

    def __len__(self) -> int:
        """Return the number of simulations."""
        return len(self.statistics)

    def trace(self, sim: int, channel: str) -> npt.NDArray[np.float32]:
        """Return one channel of one simulation.

        Args:
            sim: which simulation
            channel: name of the channel

        Returns:
            the values, (nstep,)
        """
        if self.traces is None:
            raise ValueError("these rollouts were run without traces")
        return self.traces[sim, :, self.channels.index(channel)]


def make_cases(
    controller: npt.ArrayLike,
    goal_dist: npt.ArrayLike,
    goal_bearing: npt.ArrayLike = 0.0,
    perturbation: npt.ArrayLike = 0,
) -> Cases:
    """Build cases from arrays that broadcast against each other.

    Args:
        controller: controller indices
        goal_dist: goal distances [m]
        goal_bearing: goal bearings [rad]
        perturbation: perturbation rows

    Returns:
        The cases, flattened in C order.
    """
    rows = [row.ravel() for row in np.broadcast_arrays(controller, goal_dist, goal_bearing, perturbation)]
    return Cases(
        controller=np.ascontiguousarray(rows[0], np.int32),
        goal_dist=np.ascontiguousarray(rows[1], np.float32),
        goal_bearing=np.ascontiguousarray(rows[2], np.float32),
        perturbation=np.ascontiguousarray(rows[3], np.int32),
    )


def trace_channels(rig: Rig) -> tuple[str, ...]:
    """Return the names of a rig's trace channels.

    Args:
        rig: the rig

    Returns:
        Pose of the base, clearance of the lowest foot, contact force, px; then each joint's angle ``a``, rate
        ``a_vel``, load ``a_load`` (1 is its limit) and goal ``a_goal``, an angle or a rate. SI units.
    """
    names = [joint.name for joint in rig.joints]
    return (*native.TRACE_POSE, *(name + suffix for suffix in ("", "_vel", "_load", "_goal") for name in names))


class RolloutPool:
    """Run rollouts of one rig on a pool of threads; close it, or use it in a ``with`` statement.

    Args:
        rig: the rig
        form: "free" or "planar"
        timestep_s: MuJoCo's step, unless a model brings its own [s]
        time_limit_s: how long a rollout lasts [s]
        threads: threads that simulate; None: one per CPU this process may use
        stop: when a rollout is over before its time
        model: a model to run instead of the rig's nominal one, made by `build_model` for the same rig
        scene: what stands in the body's way, as `build_model` takes it
        lean: leave out what no statistic needs, such as sensors that are no terminals
        timer: keep the timer that MuJoCo's Python bindings call at every step
        stop_early: end a rollout that is over; False: simulate on to its full time, to no other end

    `lean`, `timer` and `stop_early` change what a rollout costs and nothing that it gives.

    Raises:
        InputError: the step does not divide the period, or the native library is not there
    """

    def __init__(
        self,
        rig: Rig,
        *,
        form: Form = "free",
        timestep_s: float = 0.002,
        time_limit_s: float = 4.0,
        threads: int | None = None,
        stop: StopConditions | None = None,
        model: mujoco.MjModel | None = None,
        scene: Scene | None = None,
        lean: bool = True,
        timer: bool = False,
        stop_early: bool = True,
    ) -> None:
        self.rig = rig
        self.nstep = round(time_limit_s / rig.period_s)
        if self.nstep < 1:
            raise InputError(f"time limit {time_limit_s:g} s: shorter than one period of {rig.period_s:g} s; extend it")
        self._lib = native.rollout_library()
        if model is None:
            model = build_model(rig, form=form, timestep_s=timestep_s, lean=lean, scene=scene)
            # islands cost time and may change the last bits: the same with and without `lean`
            model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
        self._model = model
        self._timestep_s = float(self._model.opt.timestep)
        self._threads = len(os.sched_getaffinity(0)) if threads is None else threads
        if self._threads < 1:
            raise InputError(f"threads {threads}: at least one must simulate; give 1 or more")
        self._keep: list[Any] = []
        self._setup = self._make_setup(stop or StopConditions())
        self._setup.stop_early = int(stop_early)
        self._setup.timer = int(timer)
        self._models: SimulatedModels | None = None
        self._cycles: dict[tuple[object, ...], SvCycle] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Free the threads and the batch."""
        if self._models is not None:
            self._models.close()
            self._models = None

    def run(
        self,
        controllers: Sequence[Controller],
        cases: Cases,
        perturbations: Perturbations,
        *,
        traces: bool = False,
        record: bool = False,
    ) -> Rollouts:
        """Simulate.

        Args:
            controllers: the controllers that the cases name
            cases: the simulations, (nsim,)
            perturbations: the rigs that the cases name
            traces: whether to keep the state at every control instant
            record: whether to keep raw counts, outputs and goal counts

        Returns:
            The results, which the number of threads does not change.

        Raises:
            InputError: a controller does not fit the rig, or a case names what is not there
            RunError: MuJoCo raised an error in a simulation
        """
        self._check(controllers, cases, perturbations)
        rollouts = self._allocate(len(cases), traces, record)
        cycles = [self._pack_cycle(controller) for controller in controllers]
        native_cases = self._pack_cases(cycles, cases, perturbations)
        for first in range(0, len(cases), _BATCH_MAX):
            self._run_slice(
                slice(first, min(first + _BATCH_MAX, len(cases))), native_cases, cases, perturbations, rollouts
            )
        return rollouts

    def _run_slice(
        self,
        part: slice,
        native_cases: npt.NDArray[np.void],
        cases: Cases,
        perturbations: Perturbations,
        rollouts: Rollouts,
    ) -> None:
        """Run cases part.start to part.stop."""
        n = part.stop - part.start
        if self._models is None or self._models.capacity < n:
            self.close()
            self._models = SimulatedModels(self._model, self.rig, n, self._threads)
        self._models.perturb(perturbations, cases.perturbation[part])
        results = native.SvResults()
        for name in ("statistics", "traces", "raw", "outputs", "goal_counts"):
            array = getattr(rollouts, name)
            setattr(results, name, None if array is None else array[part].ctypes.data)
        ids = np.arange(n, dtype=np.int32)
        failed = self._lib.sv_rollout_run(
            self._models.address,
            ids.ctypes.data,
            n,
            ctypes.byref(self._setup),
            native_cases[part].ctypes.data,
            ctypes.byref(results),
        )
        # one that failed after its stop has its statistics
        lost = np.flatnonzero(rollouts.statistics["status"][part] == STATUS_ERROR)
        if failed and len(lost):
            which = int(lost[0])
            raise RunError(f"{self.rig.name}: MuJoCo failed in simulation {which}: {self._models.error(which)}")

    def _make_setup(self, stop: StopConditions) -> native.SvRolloutSetup:
        """Fill the struct that all simulations share, and keep what it points to."""
        rig, layout = self.rig, body_layout(self._model, self.rig)
        self._check_sizes(layout)
        nsub = substeps(rig, self._timestep_s)
        sample = samples_at_instants(rig, self._timestep_s, self.nstep)
        settled = settled_data(self._model, rig)
        arrays = (settled.qpos.copy(), sample, sampled_substeps(sample, self.nstep * nsub))
        encoder = raw_encoders(rig)
        self._keep = [*arrays, encoder]
        if sample.size and int((np.arange(self.nstep)[:, None] * nsub - sample).max()) >= native.SAMPLE_RING:
            raise InputError(
                f"{rig.path}: sensor: rate and latency reach back too far for steps of {self._timestep_s} s"
            )
        setup = native.SvRolloutSetup(
            nstep=self.nstep,
            nsub=nsub,
            form=0 if layout.form == "free" else 1,
            base=layout.base,
            njoint=len(rig.joints),
            nfoot=len(layout.foot_position),
            nhead=len(layout.head_geoms),
            nsensor=len(rig.sensors),
            window=min(max(1, round(END_WINDOW_S / rig.period_s)), native.GOAL_RING - 1),
            stop_head=int(stop.head_contact),
            stop_flight_substeps=_whole(stop.flight_s_max / self._timestep_s),
            stop_tilt_cos=math.cos(stop.tilt_rad_max) if stop.tilt_rad_max < math.pi else -2.0,
            base_z=float(self._model.body_pos[layout.base, 2]),
            foot_radius=layout.foot_radius,
            qpos0=arrays[0].ctypes.data,
            encoder=ctypes.addressof(encoder),
            sample=arrays[1].ctypes.data,
            sampled=arrays[2].ctypes.data,
        )
        setup.foot[: layout.foot_position.size] = layout.foot_position.ravel().tolist()
        setup.head[: len(layout.head_geoms)] = layout.head_geoms.tolist()
        for index, joint in enumerate(rig.joints):
            setup.neutral[index] = joint.neutral_rad
            setup.rest[index] = 0.0 if joint.mode == "velocity" else joint.neutral_rad
            setup.unlimited[index] = int(joint.unlimited)
            limit_nm = float(self._model.actuator_forcerange[layout.actuator[index], 1])
            setup.torque_max[index] = full_load_torque(joint, limit_nm)
            setup.load_speed[index] = load_per_speed(joint, rig.supply_v)
            setup.qpos[index] = layout.qpos[index]
            setup.dof[index] = layout.dof[index]
            setup.actuator[index] = layout.actuator[index]
        for index, sensor in enumerate(rig.sensors):
            setup.sensor[index] = native.SENSORS.index(sensor.name)
        return setup

    def _check_sizes(self, layout: Layout) -> None:
        """Refuse a rig or body that the native structs have no room for."""
        for what, count, most in (
            ("joints", len(self.rig.joints), native.JOINT_MAX),
            ("sensor channels", len(self.rig.sensors), native.SENSOR_MAX),
            ("feet", len(layout.foot_position), native.FOOT_MAX),
            ("head geoms", len(layout.head_geoms), native.HEAD_MAX),
        ):
            if count > most:
                raise InputError(f"{self.rig.path}: {count} {what} are more than the {most} of a rollout; use fewer")
        for sensor in self.rig.sensors:
            if sensor.name not in native.SENSORS:
                known = ", ".join(native.SENSORS)
                raise InputError(f"{self.rig.path}: sensor {sensor.name}: simulation cannot show it; it has {known}")

    def _check(self, controllers: Sequence[Controller], cases: Cases, perturbations: Perturbations) -> None:
        """Refuse what would run out of bounds."""
        for name, index, n in (
            ("controller", cases.controller, len(controllers)),
            ("perturbation", cases.perturbation, len(perturbations)),
        ):
            if len(index) and not (index.min() >= 0 and index.max() < n):
                raise InputError(f"rollout cases: {name} index outside 0 to {n - 1}; correct the cases")
        longest = (native.GOAL_RING - 2) * self.rig.period_s
        if len(perturbations) and not (
            0.0 <= perturbations.latency_s.min() <= perturbations.latency_s.max() <= longest
        ):
            raise InputError(f"perturbations: latency_s is not within 0 to {longest:g} s; choose a shorter one")

    def _pack_cycle(self, controller: Controller) -> SvCycle:
        """Lay a controller's cycle out; those of a population differ only in their programs, the rest is kept."""
        own = (controller.inputs, controller.outputs, controller.period_s, controller.filter, controller.slew_rad_s)
        if own not in self._cycles:
            self._cycles[own] = lay_out_cycle(resolve_cycle(controller, self.rig))
        return replace_program(self._cycles[own], controller.program)

    def _pack_cases(
        self, cycles: Sequence[SvCycle], cases: Cases, perturbations: Perturbations
    ) -> npt.NDArray[np.void]:
        """Fill one struct a simulation."""
        dtype = np.dtype(native.SvRolloutCase)
        packed = np.zeros(len(cases), dtype)
        rows = cases.perturbation
        packed["cycle"] = np.array([ctypes.addressof(cycle) for cycle in cycles], np.uint64)[cases.controller]
        packed["goal"]["goal_dist"] = cases.goal_dist
        packed["goal"]["goal_bearing"] = cases.goal_bearing
        packed["seed"] = perturbations.seed[rows]
        packed["latency"] = np.rint(perturbations.latency_s[rows] / self._timestep_s)
        packed["pose_noise"] = perturbations.pose_noise_m[rows]
        packed["angle_noise"] = perturbations.angle_noise_rad[rows]
        packed["force_noise"] = perturbations.force_noise_n[rows]
        njoint = len(self.rig.joints)
        packed["encoder_bias"][:, :njoint] = perturbations.encoder_bias_rad[rows]
        packed["initial"][:, :njoint] = perturbations.initial_rad[rows]
        packed["input_scale"][:, :njoint] = self._input_scales(perturbations)[rows]
        return packed

    def _input_scales(self, perturbations: Perturbations) -> npt.NDArray[np.float64]:
        """Return what each motor's input is over its goal, (nrow, njoint)."""
        scales = np.ones((len(perturbations), len(self.rig.joints)))
        for place, joint in enumerate(self.rig.joints):
            if joint.mode == "velocity" and not joint.ideal:
                scales[:, place] = [
                    joint_parameters(joint, self.rig.supply_v * float(voltage)).input_scale
                    for voltage in perturbations.voltage
                ]
        return scales

    def _allocate(self, n: int, traces: bool, record: bool) -> Rollouts:
        """Make the arrays that the results go to."""
        nstep, njoint = self.nstep, len(self.rig.joints)
        channels = trace_channels(self.rig)
        return Rollouts(
            statistics=np.zeros(n, STATISTICS),
            channels=channels,
            traces=np.full((n, nstep, len(channels)), np.nan, np.float32) if traces else None,
            raw=np.zeros((n, nstep, self.rig.nraw), np.int32) if record else None,
            outputs=np.full((n, nstep, njoint), np.nan, np.float32) if record else None,
            goal_counts=np.zeros((n, nstep, njoint), np.int32) if record else None,
            nstep=nstep,
            period_s=self.rig.period_s,
        )


def _whole(count: float) -> int:
    """Return a number of substeps, 0 for an infinite one."""
    return max(1, round(count)) if math.isfinite(count) else 0
