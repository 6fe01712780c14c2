"""Rates of simulation as ratios: closed-loop rollouts against the engine alone, on the same motions."""

from __future__ import annotations

import ctypes
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from typing import Final

import mujoco
import mujoco.rollout
import numpy as np
import numpy.typing as npt

from controller.controller import Controller, Input, Output
from controller.errors import RunError
from controller.lowering import lower
from controller.operations import BY_NAME
from controller.rig import Rig
from controller.source import Apply, Constant, Expression, Name, Source
from controller.terminals import joint_scale
from sim_models.body import Form, body_layout, build_model, settled_data, substeps
from sim_models.native_rollouts import BatchConfig, mujoco_library
from sim_models.perturbations import nominal_perturbations
from sim_models.rollouts import RolloutPool, make_cases
from sim_models.simulation import NEVER_STOP

INSTRUCTIONS: Final = 150
"""Size of the programs that `bench_rollout` runs."""

_OPERATIONS: Final = ("+", "-", "*", "%", "ifltz")  # the papers' function set, which tree GP evolves
_SECONDS: Final = 6.0
_PROGRAMS: Final = 12
_GOALS: Final = 4  # rollouts of one program, as in a generation of the robust lamp
_TIMESTEP_S: Final = 0.004

_QPOS: Final = 1  # first place of qpos in a state: after the time

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class RolloutRatio:
    """Hold how fast closed-loop rollouts were against the engine alone, in medians of interleaved runs.

    Args:
        form: "free" or "planar"
        threads: threads that simulated, on both sides
        timer: whether MuJoCo's Python bindings timed every step of the open loops, as they do unless told otherwise
        ratio: rate of the closed loop over that of the faster open loop
        ratio_to_batch: rate of the closed loop over that of ``mjb_rollout``
        ratio_to_module: rate of the closed loop over that of the Python module ``mujoco.rollout``
        repeats: runs of each
    """

    form: Form
    threads: int
    timer: bool
    ratio: float
    ratio_to_batch: float
    ratio_to_module: float
    repeats: int


def bench_rollout(
    rig: Rig, *, threads: int, repeats: int = 21, form: Form = "planar", timer: bool = False
) -> RolloutRatio:
    """Compare closed-loop rollouts of programs of 150 instructions with an open loop of the same controls.

    Both sides step the same model through the same states; that is checked. Our rollouts always do without the timer
    callback that the Python bindings install.

    Args:
        rig: the rig
        threads: threads that simulate
        repeats: runs of each side, by turns
        form: "free" or "planar"
        timer: leave the open loops their timer, as a user gets them; False: off on both sides

    Returns:
        The ratios.

    Raises:
        RunError: the two sides did not move alike
    """
    rng = np.random.default_rng(1)
    controllers = [random_controller(rng, rig, INSTRUCTIONS) for _ in range(_PROGRAMS)]
    cases = make_cases(np.arange(_PROGRAMS)[:, None], np.linspace(0.1, 0.6, _GOALS))
    nominal = nominal_perturbations(1, len(rig.joints))
    times: dict[str, list[float]] = {"closed": [], "batch": [], "module": []}
    with RolloutPool(
        rig, form=form, timestep_s=_TIMESTEP_S, time_limit_s=_SECONDS, threads=threads, stop=NEVER_STOP
    ) as pool:
        run = pool.run(controllers, cases, nominal, record=True)
        assert run.goal_counts is not None  # asked for above
        with (
            nullcontext() if timer else timer_off(),
            _OpenLoop(rig, form, _goal_angles(rig, run.goal_counts), threads) as open_loop,
        ):
            open_loop.run_batch()
            away = open_loop.distances(cases.goal_dist)
            if not np.allclose(away, run.statistics["final_error"], rtol=0.0, atol=1e-5):
                raise RunError("bench rollout: closed and open loop did not move alike; the ratio would say nothing")
            sides: dict[str, Callable[[], object]] = {
                "closed": lambda: pool.run(controllers, cases, nominal),
                "batch": open_loop.run_batch,
                "module": open_loop.run_module,
            }
            for turn in range(repeats):
                # each side comes first, second and last equally often
                for name in np.roll(list(sides), turn):
                    times[name].append(_seconds(sides[name]))
    medians = {name: statistics.median(values) for name, values in times.items()}
    # each turn's three runs met the same machine
    ratios = {
        name: statistics.median(a / b for a, b in zip(times[name], times["closed"], strict=True))
        for name in ("batch", "module")
    }
    faster = "batch" if medians["batch"] <= medians["module"] else "module"
    return RolloutRatio(form, threads, timer, ratios[faster], ratios["batch"], ratios["module"], repeats)


def random_controller(rng: np.random.Generator, rig: Rig, instructions: int) -> Controller:
    """Grow a controller of a given size that moves every joint.

    Args:
        rng: source of randomness
        rig: the rig it is for, with a pose sensor
        instructions: size of the lowered program, 10 at least

    Returns:
        The controller.
    """
    units = {"t": "s", "px": "m", "goal_dist": "m"} | {joint.name: "rad" for joint in rig.joints}
    names = tuple(units)
    outputs: list[Expression] = [Apply("*", (Constant(np.float32(20.0)), Name("t"))) for _ in rig.joints]
    program = lower(Source(tuple(outputs)), names)
    while len(program.instructions) != instructions:
        place = int(rng.integers(len(outputs)))
        grown = list(outputs)
        grown[place] = _grow(rng, outputs[place], names)
        larger = lower(Source(tuple(grown)), names)
        # folding and sharing may leave the size as it was, and the last step must not go past it
        if len(program.instructions) < len(larger.instructions) <= instructions:
            outputs, program = grown, larger
    return Controller(
        name="bench",
        period_s=rig.period_s,
        inputs=tuple(Input(name, unit, -10.0, 10.0) for name, unit in units.items()),
        outputs=tuple(
            Output(joint.name, "position", "deg", np.degrees(joint.low_rad), np.degrees(joint.high_rad), 0.0)
            for joint in rig.joints
        ),
        source=Source(tuple(outputs)),
        program=program,
    )


def _goal_angles(rig: Rig, counts: npt.NDArray[np.int32]) -> FloatArray:
    """Return goal counts as the angles that the rollouts make of them [rad]."""
    scale = np.array([1.0 / joint_scale(joint) for joint in rig.joints], np.float32).astype(np.float64)
    angles = (counts - np.array([joint.zero_tick for joint in rig.joints])) / scale
    return np.asarray(angles, np.float64)


def _grow(rng: np.random.Generator, expression: Expression, names: Sequence[str]) -> Expression:
    """Put one operation around an expression."""
    operation = str(rng.choice(_OPERATIONS))
    arity = BY_NAME[operation].arity
    operands: list[Expression] = [
        Name(str(rng.choice(names))) if rng.random() < 0.5 else Constant(np.float32(rng.uniform(-30.0, 30.0)))
        for _ in range(arity)
    ]
    operands[int(rng.integers(arity))] = expression
    return Apply(operation, tuple(operands))


class _OpenLoop:
    """Step the model under recorded controls, as fast as MuJoCo can.

    Args:
        rig: the rig
        form: "free" or "planar"
        goals: goal angles of each period [rad], (nsim, nstep, njoint)
        threads: threads that simulate
    """

    def __init__(self, rig: Rig, form: Form, goals: FloatArray, threads: int) -> None:
        self._lib = mujoco_library()
        model = build_model(rig, form=form, timestep_s=_TIMESTEP_S, lean=True)
        self._model = model
        order = np.argsort(body_layout(model, rig).actuator)
        self._control = np.ascontiguousarray(np.repeat(goals[:, :, order], substeps(rig, _TIMESTEP_S), axis=1))
        self._n, self._nstep = self._control.shape[:2]
        self._free = form == "free"
        self._start = self._start_state(rig)
        config = BatchConfig(nthread=threads, persistent=0)
        message = ctypes.create_string_buffer(1000)
        self._batch = self._lib.mjb_makeBatch(model._address, self._n, ctypes.byref(config), message, len(message))
        size = self._start.size
        rows = ctypes.cast(self._lib.mjb_state(self._batch), ctypes.POINTER(ctypes.c_double))
        self._rows = np.ctypeslib.as_array(rows, (self._n, size))
        self._module = mujoco.rollout.Rollout(nthread=threads)
        self._data = [mujoco.MjData(model) for _ in range(threads)]

    def __enter__(self) -> _OpenLoop:
        return self

    def __exit__(self, *_: object) -> None:
        self._module.close()
        self._lib.mjb_deleteBatch(self._batch)

    def run_batch(self) -> None:
        """Step all simulations with MuJoCo's batch, recording nothing."""
        self._rows[:] = self._start
        kind = int(mujoco.mjtState.mjSTATE_CTRL)
        self._lib.mjb_rollout(self._batch, None, 0, self._nstep, self._control.ctypes.data, kind, None, 0)

    def run_module(self) -> None:
        """Step all simulations with the Python module, which records every state."""
        self._module.rollout([self._model] * self._n, self._data, self._physics, self._control)

    def distances(self, goal_dist: npt.NDArray[np.float32]) -> FloatArray:
        """Return how far the bases are after `run_batch` from goals ahead of the start [m], (nsim,)."""
        ahead = self._start[_QPOS] + goal_dist - self._rows[:, _QPOS]
        across = self._rows[:, _QPOS + 1] - self._start[_QPOS + 1] if self._free else 0.0
        return np.asarray(np.hypot(ahead, across), np.float64)

    def _start_state(self, rig: Rig) -> FloatArray:
        """Return the state that rollouts start from."""
        model, data = self._model, mujoco.MjData(self._model)
        data.qpos[:] = settled_data(model, rig).qpos
        layout = body_layout(model, rig)
        data.ctrl[layout.actuator] = [joint.neutral_rad for joint in rig.joints]
        mujoco.mj_forward(model, data)
        self._physics = self._state(data, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        return self._state(data, mujoco.mjtState.mjSTATE_INTEGRATION)

    def _state(self, data: mujoco.MjData, kind: mujoco.mjtState) -> FloatArray:
        state = np.empty(mujoco.mj_stateSize(self._model, kind))
        mujoco.mj_getState(self._model, data, state, kind)
        return state


@contextmanager
def timer_off() -> Iterator[None]:
    """Take the timer callback of the Python bindings away for a while: it costs a tenth of the time."""
    timer = ctypes.c_void_p.in_dll(mujoco_library(), "mjcb_time")
    saved, timer.value = timer.value, None
    try:
        yield
    finally:
        timer.value = saved


def _seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start
