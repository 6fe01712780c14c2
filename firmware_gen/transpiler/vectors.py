"""Inputs that try a controller hard, and what the reference answers."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from controller import Controller, Input, program_hash
from controller.cycle import slew_step, unit_scale
from controller.reference import ReferenceCommand, ReferenceProgram, run_program

Floats = npt.NDArray[np.float32]

SPECIAL_BITS: Final = (
    0x00000000,  # 0
    0x80000000,  # -0
    0x7FC00000,  # NaN
    0x7F800000,  # infinity
    0xFF800000,  # -infinity
    0x00000001,  # smallest subnormal
    0x80000001,
    0x007FFFFF,  # largest subnormal
    0x807FFFFF,
    0x00800000,  # smallest normal
    0x80800000,
    0x7F7FFFFF,  # largest finite
    0xFF7FFFFF,
    0x3F800000,  # 1
    0xBF800000,  # -1
    0x3F7FFFFF,  # below 1
    0x4B000000,  # 2^23
    0xCB800001,  # -(2^24 + 2)
    0x46000000,  # 8192
    0xC6000001,  # beyond -8192
)
"""Bit patterns that arithmetic goes wrong on."""

NAN_BITS: Final = 0x7FC00000

STEPS_USUAL: Final = 12
"""Steps of the selftest's first sequence: inputs within their ranges."""

STEPS_HARD: Final = 12
"""Steps of its second sequence, from a new start: special values among them."""


STEPS_LOOP: Final = 32
"""Steps of its closed loop: every input follows a command."""

LOOP_PART: Final = np.float32(0.25)
"""The part of the way to its command that an input goes in a step of the closed loop."""


@dataclass(frozen=True)
class Vectors:
    """Hold a recorded run: two sequences of steps, each from a new start, the output stage, and a closed loop.

    Args:
        inputs: bit patterns, uint32, (nstep, ninput)
        outputs: the reference's bit patterns, every NaN as `NAN_BITS`, uint32, (nstep, noutput)
        second: the step at which the second sequence starts
        values: bit patterns of outputs that try the output stage, of one sequence, uint32, (nstep, noutput)
        commands: what it makes of them, uint32, (nstep, noutput)
        loop: outputs where every input follows a command, from the first inputs and a new start, uint32, (nstep,
            noutput)
    """

    inputs: npt.NDArray[np.uint32]
    outputs: npt.NDArray[np.uint32]
    second: int
    values: npt.NDArray[np.uint32]
    commands: npt.NDArray[np.uint32]
    loop: npt.NDArray[np.uint32]


def bits_of(values: Floats) -> npt.NDArray[np.uint32]:
    """Return bit patterns, one pattern for all NaNs.

    Args:
        values: float32, any shape

    Returns:
        uint32, the same shape
    """
    bits = np.ascontiguousarray(values).view(np.uint32)
    return np.where(np.isnan(values), np.uint32(NAN_BITS), bits)


def draw_inputs(words: npt.NDArray[np.uint32], inputs: Sequence[Input]) -> Floats:
    """Make inputs out of random words: most within their ranges, the rest special values or any bit pattern.

    Args:
        words: random, uniform, uint32, (nstep, ninput, 2)
        inputs: the terminals, (ninput,)

    Returns:
        (nstep, ninput)
    """
    low = np.array([terminal.low for terminal in inputs])
    high = np.array([terminal.high for terminal in inputs])
    usual = (low + (high - low) * (words[..., 0] / 2.0**32)).astype(np.float32)
    special = np.array(SPECIAL_BITS, np.uint32)[words[..., 0] % len(SPECIAL_BITS)].view(np.float32)
    wild = np.ascontiguousarray(words[..., 0]).view(np.float32)
    whole = (words[..., 0] % 7).astype(np.float32) - np.float32(3)
    choice = words[..., 1] % 8
    drawn: Floats = np.select([choice < 4, choice < 5, choice < 6], [usual, whole, special], wild)
    return drawn


def selftest_vectors(controller: Controller) -> Vectors:
    """Run the reference on inputs that the program's hash chooses, for ever the same ones.

    Args:
        controller: the controller

    Returns:
        the inputs and the outputs
    """
    shape = (STEPS_USUAL + STEPS_HARD, len(controller.inputs), 2)
    stream = hashlib.shake_256(program_hash(controller.program).encode()).digest(4 * int(np.prod(shape)))
    words = np.frombuffer(stream, "<u4").astype(np.uint32).reshape(shape)
    words[:STEPS_USUAL, :, 1] = 0
    inputs = draw_inputs(words, controller.inputs)
    outputs = [
        run_program(controller.program, controller.period_s, rows)
        for rows in (inputs[:STEPS_USUAL], inputs[STEPS_USUAL:])
    ]
    values, commands = _command_vectors(controller)
    return Vectors(
        inputs=bits_of(inputs),
        outputs=bits_of(np.concatenate(outputs)),
        second=STEPS_USUAL,
        values=bits_of(values),
        commands=bits_of(commands),
        loop=bits_of(closed_loop(controller, inputs[0])),
    )


def closed_loop(controller: Controller, first: Floats) -> Floats:
    """Run the reference on its own commands: input i goes a quarter of the way to command i mod noutput each step.

    Inputs keep to their ranges; program and output stage carry their state from step to step.

    Args:
        controller: the controller
        first: inputs of the first step, within their ranges, (ninput,)

    Returns:
        the program's outputs, (nstep, noutput)
    """
    program = ReferenceProgram(controller.program, controller.period_s)
    stage = ReferenceCommand(controller)
    limits = [(np.float32(terminal.low), np.float32(terminal.high)) for terminal in controller.inputs]
    inputs = list(first)
    outputs = np.empty((STEPS_LOOP, len(controller.outputs)), np.float32)
    with np.errstate(all="ignore"):
        for k in range(STEPS_LOOP):
            values = program.step(list(inputs))
            commands = stage.step(values)
            outputs[k] = values
            for i, (low, high) in enumerate(limits):
                moved = inputs[i] + LOOP_PART * (commands[i % len(commands)] - inputs[i])
                inputs[i] = low if moved < low else high if moved > high else moved
    return outputs


def _command_vectors(controller: Controller) -> tuple[Floats, Floats]:
    """Return outputs that pass and miss every limit of the output stage, and the commands; (nstep, noutput) each."""
    shape = (STEPS_USUAL + STEPS_HARD, len(controller.outputs), 2)
    stream = hashlib.shake_256(b"command " + program_hash(controller.program).encode())
    words = np.frombuffer(stream.digest(4 * int(np.prod(shape))), "<u4").astype(np.uint32).reshape(shape)
    ranges = [Input(output.name, output.unit, output.low, output.high) for output in controller.outputs]
    values = draw_inputs(words, ranges)
    # every other period close to the command before, so that the slew limit does not hide the filter
    near = (slew_step(controller) or 0.1) / controller.filter * (words[..., 0] / 2.0**31 - 1.0)
    reference = ReferenceCommand(controller)
    commands = np.empty_like(values)
    scales = np.array([unit_scale(output) for output in controller.outputs])
    for k in range(len(values)):
        if k % 2:
            values[k] = (np.array(reference.held, np.float64) + near[k]) / scales
        commands[k] = reference.step(list(values[k]))
    return values, commands
