"""The compiled runtime from Python: programs and cycles as the rollouts, the host loop and the firmware run them."""

from __future__ import annotations

import ctypes
from ctypes import byref

import numpy as np
import numpy.typing as npt

from controller.controller import Controller
from controller.cycle import CycleSpec, OutputSpec, resolve_cycle
from controller.errors import InputError
from controller.library import SvCycle, SvCycleState, SvGoal, SvGuard, SvOutput, SvProgram, SvTerminal, library
from controller.program import INSTRUCTION, Program
from controller.reference import check_inputs
from controller.rig import Rig
from controller.terminals import TerminalSpec
from controller.verifier import verify

Floats = npt.NDArray[np.float32]
Counts = npt.NDArray[np.int32]


def pack_program(program: Program) -> SvProgram:
    """Lay a program out as `sv_program` and verify it.

    Args:
        program: the program

    Returns:
        the structure; it keeps its arrays alive as long as itself

    Raises:
        InputError: the program breaks a bound, or the library is not built
    """
    constants = np.ascontiguousarray(program.constants, np.float32)
    instructions = np.ascontiguousarray(program.instructions, INSTRUCTION)
    outputs = np.ascontiguousarray(program.outputs, np.uint16)
    packed = SvProgram(
        len(program.inputs),
        len(constants),
        len(instructions),
        program.nstate,
        len(outputs),
        constants.ctypes.data,
        instructions.ctypes.data,
        outputs.ctypes.data,
    )
    packed.arrays = (constants, instructions, outputs)
    if library().sv_verify(byref(packed)) != 0:
        verify(program)
        raise InputError("the program breaks a bound of the machine; lower the source again")
    return packed


class NativeProgram:
    """Run a program on the compiled virtual machine.

    Args:
        program: the program, verified here
    """

    def __init__(self, program: Program) -> None:
        self._program = program
        self._packed = pack_program(program)
        self._registers = np.empty(program.nregister, np.float32)
        self._state = np.empty(max(program.nstate, 1), np.float32)

    def run(self, dt: float, inputs: Floats) -> Floats:
        """Evaluate successive steps from the start.

        Args:
            dt: period, rounded to float32 [s]
            inputs: terminals, float32, (nstep, ninput)

        Returns:
            the program's outputs, unclamped, float32, (nstep, noutput)

        Raises:
            InputError: the shape of the inputs is wrong
        """
        rows = check_inputs(self._program, inputs)
        outputs = np.empty((len(rows), len(self._program.outputs)), np.float32)
        library().sv_run(
            byref(self._packed),
            dt,
            len(rows),
            rows.ctypes.data,
            self._registers.ctypes.data,
            self._state.ctypes.data,
            outputs.ctypes.data,
        )
        return outputs


def lay_out_cycle(spec: CycleSpec) -> SvCycle:
    """Lay a cycle out as `sv_cycle` and verify it.

    Args:
        spec: the cycle's numbers

    Returns:
        the structure; it keeps what it points to alive as long as itself

    Raises:
        InputError: they are inconsistent, or the library is not built
    """
    program = pack_program(spec.program)
    terminals = (SvTerminal * max(len(spec.terminals), 1))(*map(_terminal, spec.terminals))
    outputs = (SvOutput * len(spec.outputs))(*map(_output, spec.outputs))
    pose = (_terminal(spec.x), _terminal(spec.y), _terminal(spec.heading), _terminal(spec.facing))
    guards = (SvGuard * len(spec.outputs))(*map(_guard, spec.outputs))
    numbers = (spec.period_s, spec.filter, spec.slew_step, spec.nraw)
    packed = SvCycle(ctypes.pointer(program), terminals, outputs, guards, *numbers, *pose)
    packed.parts = (program, terminals, outputs, guards)
    return _verified(packed)


def replace_program(cycle: SvCycle, program: Program) -> SvCycle:
    """Return a copy of a cycle with another program in it, at a fraction of what laying it out costs.

    Args:
        cycle: from `lay_out_cycle`
        program: as many inputs and outputs as the cycle's own

    Returns:
        the structure; it keeps what it points to alive as long as itself

    Raises:
        InputError: the program breaks a bound
    """
    packed = SvCycle.from_buffer_copy(cycle)
    own = pack_program(program)
    packed.program = ctypes.pointer(own)
    packed.parts = (cycle, own)
    return _verified(packed)


def _verified(cycle: SvCycle) -> SvCycle:
    """Return a cycle that the runtime accepts."""
    if library().sv_cycle_verify(byref(cycle)) != 0:
        raise InputError("the controller's limits, filter, slew or period are not usable on the rig; check both files")
    return cycle


class NativeCycle:
    """Run the control cycle of one controller on one rig, from the start.

    Args:
        spec: the cycle's numbers

    Raises:
        InputError: they are inconsistent, or the library is not built
    """

    def __init__(self, spec: CycleSpec) -> None:
        self.spec = spec
        self._cycle = lay_out_cycle(spec)
        program = spec.program
        self._state = SvCycleState()
        self._registers = np.empty(program.nregister, np.float32)
        self._program_state = np.empty(max(program.nstate, 1), np.float32)
        self.reset()

    @property
    def address(self) -> int:
        """Return the address of the `sv_cycle`, valid as long as this object lives."""
        return ctypes.addressof(self._cycle)

    def reset(self) -> None:
        """Return to the start of a run."""
        library().sv_cycle_reset(
            byref(self._cycle), byref(self._state), self._registers.ctypes.data, self._program_state.ctypes.data
        )

    def step(self, goal_dist: float, goal_bearing: float, raw: Counts) -> tuple[Floats, Floats, Counts]:
        """Run one period.

        Args:
            goal_dist: distance of the goal from the base at the start [m]
            goal_bearing: its direction from the heading at the start [rad]
            raw: raw channels, (nraw,)

        Returns:
            terminals (ninput,), clamped outputs in their own units (noutput,), goal counts (noutput,)

        Raises:
            InputError: the shape of raw is wrong
        """
        counts = np.ascontiguousarray(raw, np.int32)
        if counts.shape != (self.spec.nraw,):
            raise InputError(f"raw has shape {counts.shape}; give the rig's {self.spec.nraw} channels")
        terminals = np.empty(len(self.spec.terminals), np.float32)
        outputs = np.empty(len(self.spec.outputs), np.float32)
        goals = np.empty(len(self.spec.outputs), np.int32)
        library().sv_cycle_step(
            byref(self._cycle),
            byref(SvGoal(goal_dist, goal_bearing)),
            byref(self._state),
            self._registers.ctypes.data,
            self._program_state.ctypes.data,
            counts.ctypes.data,
            terminals.ctypes.data,
            outputs.ctypes.data,
            goals.ctypes.data,
        )
        return terminals, outputs, goals


def pack_cycle(controller: Controller, rig: Rig) -> NativeCycle:
    """Build the control cycle of a controller on a rig, its terminals and outputs found by name.

    Args:
        controller: the controller
        rig: the rig

    Returns:
        the cycle, at its start

    Raises:
        InputError: the rig can not supply a terminal, or differs in joints or period
    """
    return NativeCycle(resolve_cycle(controller, rig))


def run_cycle(
    controller: Controller, rig: Rig, raw: Counts, goal: tuple[float, float]
) -> tuple[Floats, Floats, Counts]:
    """Run the control cycle over recorded raw counts, from the start.

    Args:
        controller: the controller
        rig: the rig
        raw: raw channels, (nstep, nraw)
        goal: distance [m] and bearing [rad] of the goal at the start

    Returns:
        terminals (nstep, ninput), clamped outputs in their own units (nstep, noutput), goal counts (nstep, noutput)

    Raises:
        InputError: the rig can not supply a terminal, or differs in joints or period
    """
    cycle = pack_cycle(controller, rig)
    terminals = np.empty((len(raw), len(controller.inputs)), np.float32)
    outputs = np.empty((len(raw), len(controller.outputs)), np.float32)
    counts = np.empty((len(raw), len(controller.outputs)), np.int32)
    for i, row in enumerate(raw):
        terminals[i], outputs[i], counts[i] = cycle.step(*goal, row)
    return terminals, outputs, counts


def encode(terminal: TerminalSpec, value: float) -> int:
    """Encode an SI value as counts, rounded half to even, as a sensor with this terminal's scale would.

    Args:
        terminal: a raw channel
        value: the value, rounded to float32 [SI]

    Returns:
        counts
    """
    return int(library().sv_encode(byref(_terminal(terminal)), value))


def _terminal(spec: TerminalSpec) -> SvTerminal:
    return SvTerminal(int(spec.kind), spec.channel, spec.zero, spec.scale)


def _output(spec: OutputSpec) -> SvOutput:
    return SvOutput(
        spec.low,
        spec.high,
        spec.neutral,
        spec.unit_scale,
        spec.count_scale,
        spec.zero,
        spec.count_low,
        spec.count_high,
    )


def _guard(spec: OutputSpec) -> SvGuard:
    return SvGuard(_terminal(spec.angle), spec.angle_low, spec.angle_high)
