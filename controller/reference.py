"""The slow reference: programs and the control cycle in plain Python on numpy.float32, the judge of all back ends."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from controller import float_math
from controller.controller import Controller, Output
from controller.cycle import COUNT_MAX, OutputSpec, resolve_cycle, slew_step, unit_scale
from controller.errors import InputError
from controller.operations import BY_OPCODE
from controller.program import Program
from controller.rig import Rig
from controller.terminals import TerminalKind, TerminalSpec
from controller.verifier import verify

F = np.float32
Floats = npt.NDArray[np.float32]
Counts = npt.NDArray[np.int32]

_GOAL_RADIUS: Final = F(0.015)
_PI: Final = F(3.14159274)
_HALF_PI: Final = F(1.57079637)
_ZERO: Final = F(0)


class ReferenceProgram:
    """Run a program step by step.

    Args:
        program: the program, verified here
        dt: period [s]
    """

    def __init__(self, program: Program, dt: float) -> None:
        verify(program)
        self._program = program
        self._dt = np.float32(dt)
        self._state = np.zeros(program.nstate, np.float32)
        self._constants: list[np.float32] = list(program.constants)
        self._outputs: list[int] = program.outputs.tolist()
        self._steps: list[tuple[Callable[..., Any], list[int], Floats | None]] = []
        for row in program.instructions.tolist():
            operation = BY_OPCODE[row[0]]
            operands = row[1 : 1 + operation.arity]
            state = None
            if operation.nstate:
                first = row[1 + operation.arity]
                state = self._state[first : first + operation.nstate]
            self._steps.append((operation.reference, list(operands), state))

    def reset(self) -> None:
        """Return to the start: all state 0."""
        self._state[:] = 0

    def step(self, inputs: list[np.float32]) -> list[np.float32]:
        """Evaluate one step.

        Args:
            inputs: terminals, (ninput,)

        Returns:
            outputs, (noutput,)
        """
        registers = inputs + self._constants
        dt = self._dt
        for reference, operands, state in self._steps:
            values = [registers[i] for i in operands]
            registers.append(reference(*values) if state is None else reference(state, dt, *values))
        return [registers[i] for i in self._outputs]


def run_program(program: Program, dt: float, inputs: Floats) -> Floats:
    """Evaluate successive steps from the start.

    Args:
        program: the program
        dt: period, rounded to float32 [s]
        inputs: terminals, float32, (nstep, ninput)

    Returns:
        the program's outputs, unclamped, float32, (nstep, noutput)

    Raises:
        InputError: the program is not valid or the shape of the inputs is wrong
    """
    rows = check_inputs(program, inputs)
    outputs = np.empty((len(rows), len(program.outputs)), np.float32)
    machine = ReferenceProgram(program, dt)
    with np.errstate(all="ignore"):
        for i, row in enumerate(rows):
            outputs[i] = machine.step(list(row))
    return outputs


def check_inputs(program: Program, inputs: Floats) -> Floats:
    """Return the inputs as contiguous float32 rows.

    Args:
        program: the program
        inputs: terminals, (nstep, ninput)

    Returns:
        the same, C-contiguous, (nstep, ninput)

    Raises:
        InputError: their shape is wrong
    """
    rows = np.ascontiguousarray(inputs, np.float32)
    if rows.ndim != 2 or rows.shape[1] != len(program.inputs):
        raise InputError(
            f"the inputs have shape {rows.shape}; give (steps, {len(program.inputs)}): {' '.join(program.inputs)}"
        )
    return rows


class ReferenceCommand:
    """Turn a program's outputs into commands, as the cycle does before it counts: clamp, SI, filter, slew limit.

    Args:
        controller: the controller
    """

    def __init__(self, controller: Controller) -> None:
        self._outputs = controller.outputs
        self._scales = [F(unit_scale(output)) for output in controller.outputs]
        self._filter = F(controller.filter)
        self._slew_step = F(slew_step(controller))
        self.held = [F(output.neutral) * scale for output, scale in zip(self._outputs, self._scales, strict=True)]

    def step(self, outputs: Sequence[np.float32]) -> list[np.float32]:
        """Run one period.

        Args:
            outputs: the program's own values, (noutput,)

        Returns:
            commands [SI], (noutput,)
        """
        with np.errstate(all="ignore"):
            self.held = [
                _follow(held, _clamp(output, value) * scale, self._filter, self._slew_step)
                for held, output, value, scale in zip(self.held, self._outputs, outputs, self._scales, strict=True)
            ]
        return self.held


class ReferenceCycle:
    """Run the control cycle of one controller on one rig: what `sv_cycle_step` must agree with, bit for bit.

    Args:
        controller: the controller
        rig: the rig

    Raises:
        InputError: the rig can not supply a terminal, or differs in joints or period
    """

    def __init__(self, controller: Controller, rig: Rig) -> None:
        self.spec = resolve_cycle(controller, rig)
        self._program = ReferenceProgram(controller.program, self.spec.period_s)
        self.reset()

    def reset(self) -> None:
        """Return to the start: outputs held at neutral, no goal yet."""
        self._program.reset()
        self._k = 0
        self._goal_met = False
        self._goal = (_ZERO, _ZERO)
        self._held = [F(output.neutral) * F(output.unit_scale) for output in self.spec.outputs]

    def step(self, goal_dist: float, goal_bearing: float, raw: Sequence[int] | Counts) -> tuple[Floats, Floats, Counts]:
        """Run one period.

        Args:
            goal_dist: distance of the goal from the base at the start [m]
            goal_bearing: its direction from the heading at the start [rad]
            raw: raw channels, (nraw,)

        Returns:
            terminals (ninput,), clamped outputs in their own units (noutput,), goal counts (noutput,)
        """
        with np.errstate(all="ignore"):
            px, py = self._locate_goal(F(goal_dist), F(goal_bearing), raw)
            values: dict[TerminalKind, np.float32] = {
                TerminalKind.TIME: F(self._k) * F(self.spec.period_s),
                TerminalKind.GOAL_DIST: F(goal_dist),
                TerminalKind.PX: px,
                TerminalKind.PY: py,
                TerminalKind.GOAL_MET: F(self._goal_met),
                TerminalKind.HEADING_ERROR: _direction(px, py),
            }
            terminals = [
                _decode(spec, raw) if spec.kind == TerminalKind.RAW else values[spec.kind]
                for spec in self.spec.terminals
            ]
            raw_outputs = self._program.step(terminals)
            outputs = [_clamp(spec, value) for spec, value in zip(self.spec.outputs, raw_outputs, strict=True)]
            counts = [self._count(i, value, raw) for i, value in enumerate(outputs)]
        self._k += 1
        return np.array(terminals, F), np.array(outputs, F), np.array(counts, np.int32)

    def _locate_goal(self, dist: F, bearing: F, raw: Sequence[int] | Counts) -> tuple[F, F]:
        """Return the goal along and across the direction that the rig looks in."""
        x, y, heading = (_decode(spec, raw) for spec in (self.spec.x, self.spec.y, self.spec.heading))
        if self._k == 0:
            direction = heading + bearing
            self._goal = (x + dist * float_math.cos(direction), y + dist * float_math.sin(direction))
        if self.spec.facing.channel >= 0:
            heading = heading + _decode(self.spec.facing, raw)
        dx, dy = self._goal[0] - x, self._goal[1] - y
        c, s = float_math.cos(heading), float_math.sin(heading)
        px, py = dx * c + dy * s, dy * c - dx * s
        self._goal_met = self._goal_met or bool(abs(px) <= _GOAL_RADIUS)
        return px, py

    def _count(self, index: int, value: F, raw: Sequence[int] | Counts) -> int:
        """Return the goal count of one output: converted, filtered, limited in rate, kept within the joint's travel."""
        output = self.spec.outputs[index]
        target = _follow(self._held[index], value * F(output.unit_scale), F(self.spec.filter), F(self.spec.slew_step))
        self._held[index] = target
        command = _ZERO if self._is_beyond(output, target, raw) else target
        count = output.zero + _round(command * F(output.count_scale))
        return min(max(count, output.count_low), output.count_high)

    def _is_beyond(self, output: OutputSpec, velocity: F, raw: Sequence[int] | Counts) -> bool:
        """Return whether a velocity would carry a limited joint beyond its limits within this period."""
        if output.kind != "velocity" or output.angle.channel < 0:
            return False
        angle = _decode(output.angle, raw) + velocity * F(self.spec.period_s)
        above, below = angle > F(output.angle_high), angle < F(output.angle_low)
        return bool((velocity > _ZERO and above) or (velocity < _ZERO and below))


def _decode(spec: TerminalSpec, raw: Sequence[int] | Counts) -> F:
    if spec.channel < 0:
        return _ZERO
    count = min(max(int(raw[spec.channel]), -COUNT_MAX), COUNT_MAX)
    return F(count - spec.zero) * F(spec.scale)


def _follow(held: F, target: F, part: F, limit: F) -> F:
    """Return the command after `held`: towards the target by a part of the way, and by no more than a limit above 0."""
    if part != F(1):
        target = held + part * (target - held)
    if limit > _ZERO:
        if target - held > limit:
            target = held + limit
        elif target - held < -limit:
            target = held - limit
    return target


def _clamp(output: Output | OutputSpec, value: F) -> F:
    low, high = F(output.low), F(output.high)
    if np.isnan(value):
        return F(output.neutral)
    if value < low:
        return low
    return high if value > high else value


def _round(value: F) -> int:
    """Round half to even; saturate."""
    if np.isnan(value):
        return 0
    return int(np.rint(min(max(value, F(-COUNT_MAX)), F(COUNT_MAX))))


def _direction(x: F, y: F) -> F:
    """Return the direction of (x, y) within +-pi, 0 at the origin [rad]."""
    if x > _ZERO:
        return float_math.atan(y / x)
    if x < _ZERO:
        angle = float_math.atan(y / x)
        return angle - _PI if y < _ZERO else angle + _PI
    if y > _ZERO:
        return _HALF_PI
    return -_HALF_PI if y < _ZERO else _ZERO
