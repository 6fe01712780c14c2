"""One rollout with everything on record: what `servolve simulate` shows and comparisons start from."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from controller.controller import Controller
from controller.native import run_cycle
from controller.rig import Rig
from sim_models.body import Form, Scene
from sim_models.perturbations import Perturbations, nominal_perturbations
from sim_models.rollouts import RolloutPool, StopConditions, make_cases

NEVER_STOP = StopConditions(tilt_rad_max=float("inf"), head_contact=False, flight_s_max=float("inf"))
"""Go on whatever happens."""


@dataclass(frozen=True, eq=False)
class Simulation:
    """Hold one rollout; every array has one row a control period that began.

    Args:
        rig: the rig
        controller: the controller
        goal_dist: distance of the goal at the start [m]
        goal_bearing: its direction from the heading at the start [rad]
        statistics: one record of dtype `sim_models.statistics.STATISTICS`
        time_s: control instants [s], (nstep,)
        channels: names of the trace channels, (nchannel,)
        trace: state at each control instant and goals set there, float32, (nstep, nchannel)
        raw: raw counts that the cycle read, int32, (nstep, nraw)
        terminals: what the program read, float32, (nstep, ninput)
        outputs: clamped outputs in their own units, float32, (nstep, noutput)
        goal_counts: goal counts, int32, (nstep, noutput)
        scene: what stood in the body's way, as `build_model` takes it
    """

    rig: Rig
    controller: Controller
    goal_dist: float
    goal_bearing: float
    statistics: np.void
    time_s: npt.NDArray[np.float64]
    channels: tuple[str, ...]
    trace: npt.NDArray[np.float32]
    raw: npt.NDArray[np.int32]
    terminals: npt.NDArray[np.float32]
    outputs: npt.NDArray[np.float32]
    goal_counts: npt.NDArray[np.int32]
    scene: Scene | None = None

    def channel(self, name: str) -> npt.NDArray[np.float32]:
        """Return one channel of the trace.

        Args:
            name: name of the channel

        Returns:
            The values, (nstep,).
        """
        return self.trace[:, self.channels.index(name)]


def simulate(
    controller: Controller,
    rig: Rig,
    *,
    goal_dist: float,
    goal_bearing: float = 0.0,
    form: Form = "free",
    timestep_s: float = 0.001,
    time_limit_s: float = 4.0,
    stop: StopConditions | None = None,
    perturbations: Perturbations | None = None,
    model: mujoco.MjModel | None = None,
    scene: Scene | None = None,
) -> Simulation:
    """Simulate one controller once.

    Args:
        controller: the controller
        rig: the rig
        goal_dist: distance of the goal at the start [m]
        goal_bearing: its direction from the heading at the start [rad]
        form: "free" or "planar"
        timestep_s: MuJoCo's step [s]
        time_limit_s: how long [s]
        stop: when it is over before its time; None: never
        perturbations: one row; None: the nominal rig
        model: a model to run instead of the rig's nominal one, made by `build_model` with the same step
        scene: what stands in the body's way, as `build_model` takes it; a model of one's own holds it already

    Returns:
        The rollout.

    Raises:
        InputError: the controller does not fit the rig, or the step does not divide its period
        RunError: MuJoCo raised an error
    """
    chosen = nominal_perturbations(1, len(rig.joints)) if perturbations is None else perturbations
    with RolloutPool(
        rig,
        form=form,
        timestep_s=timestep_s,
        time_limit_s=time_limit_s,
        threads=1,
        stop=stop or NEVER_STOP,
        model=model,
        scene=scene,
    ) as pool:
        rollouts = pool.run([controller], make_cases(0, goal_dist, goal_bearing), chosen, traces=True, record=True)
    assert rollouts.traces is not None and rollouts.raw is not None  # asked for above
    assert rollouts.outputs is not None and rollouts.goal_counts is not None
    begun = ~np.isnan(rollouts.traces[0, :, 0])
    raw = rollouts.raw[0, begun]
    goal = (float(np.float32(goal_dist)), float(np.float32(goal_bearing)))
    terminals, _, _ = run_cycle(controller, rig, raw, goal)
    return Simulation(
        rig=rig,
        controller=controller,
        goal_dist=goal_dist,
        goal_bearing=goal_bearing,
        statistics=rollouts.statistics[0],
        time_s=np.arange(len(raw), dtype=np.float64) * np.float64(rig.period_s),
        channels=rollouts.channels,
        trace=rollouts.traces[0, begun],
        raw=raw,
        terminals=terminals,
        outputs=rollouts.outputs[0, begun],
        goal_counts=rollouts.goal_counts[0, begun],
        scene=scene,
    )
