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
from controller.reference import ReferenceCommand, run_program

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


@dataclass(frozen=True)
class Vectors:
    """Hold a recorded run: two sequences of steps, each from a new start.

    Args:
        inputs: bit patterns, uint32, (nstep, ninput)
        outputs: the reference's bit patterns, every NaN as `NAN_BITS`, uint32, (nstep, noutput)
        second: the step at which the second sequence starts
        values: bit patterns of outputs that try the output stage, of one sequence, uint32, (nstep, noutput)
        commands: what it makes of them, uint32, (nstep, noutput)
    """

    inputs: npt.NDArray[np.uint32]
    outputs: npt.NDArray[np.uint32]
    second: int
    values: npt.NDArray[np.uint32]
    commands: npt.NDArray[np.uint32]


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
    return Vectors(bits_of(inputs), bits_of(np.concatenate(outputs)), STEPS_USUAL, bits_of(values), bits_of(commands))


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
