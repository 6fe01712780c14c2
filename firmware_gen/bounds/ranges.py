"""What a program can give while its inputs keep to their ranges: intervals of all values, at all times.

State starts at 0. What a step can make of it is joined to what it can be, until nothing grows; bounds that go on
growing jump to the next power of 2^8, at last to infinity. So the result holds for any number of steps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np

from controller import Controller
from controller.operations import BY_OPCODE, Operation
from firmware_gen.bounds.intervals import (
    INFINITE,
    PHASE,
    STATELESS,
    UNIT,
    ZERO,
    Interval,
    add,
    approach,
    divide,
    fraction,
    if_positive,
    multiply,
    subtract,
)

PATIENCE: Final = 12
"""Steps before growing bounds jump, and between jumps."""

NARROWINGS: Final = 4

_THRESHOLDS: Final = (0.0, 1.0, *(2.0**k for k in range(8, 128, 8)), float(np.finfo(np.float32).max), INFINITE)


@dataclass(frozen=True)
class Source:
    """Name an operation that may give infinity or NaN out of finite numbers.

    Args:
        instruction: its place in the program
        infinite: it may overflow, or divide by nearly nothing
        nan: it may give NaN out of operands that are numbers
    """

    instruction: int
    infinite: bool
    nan: bool


@dataclass(frozen=True)
class Ranges:
    """Hold what a program can give.

    Args:
        outputs: of the program, unclamped, (noutput,)
        sources: operations that infinities or NaNs come from
        states: of the program's memory, at any time, (nstate,)
    """

    outputs: tuple[Interval, ...]
    sources: tuple[Source, ...]
    states: tuple[Interval, ...]


def program_ranges(controller: Controller) -> Ranges:
    """Bound what a controller's program gives.

    Args:
        controller: a verified controller

    Returns:
        intervals that hold for ever while the inputs keep to their ranges
    """
    program = controller.program
    states = [ZERO] * program.nstate
    with np.errstate(all="ignore"):
        for k in range(PATIENCE * (len(_THRESHOLDS) + 1) * 2 + 1):
            _, after = _step(controller, states)
            grown = [old.join(new) for old, new in zip(states, after, strict=True)]
            if grown == states:
                break
            if k % PATIENCE == PATIENCE - 1:
                grown = [_jump(old, new) for old, new in zip(states, grown, strict=True)]
            states = grown
        else:
            states = [Interval(-INFINITE, INFINITE, True)] * program.nstate
        for _ in range(NARROWINGS):
            _, after = _step(controller, states)
            states = [ZERO.join(new) for new in after]
        registers, _ = _step(controller, states)
    return Ranges(
        outputs=tuple(registers[i] for i in program.outputs.tolist()),
        sources=tuple(_sources(controller, registers, states)),
        states=tuple(states),
    )


def _jump(old: Interval, new: Interval) -> Interval:
    """Return an interval whose growing ends are beyond where they have come to."""
    high = min(t for t in _THRESHOLDS if t >= new.high) if new.high > old.high else new.high
    low = -min(t for t in _THRESHOLDS if t >= -new.low) if new.low < old.low else new.low
    return Interval(low, high, new.nan)


def _step(controller: Controller, states: list[Interval]) -> tuple[list[Interval], list[Interval]]:
    """Return all registers of a step and the state behind it."""
    program, dt = controller.program, float(np.float32(controller.period_s))
    registers = [_input(terminal.low, terminal.high) for terminal in controller.inputs]
    registers += [Interval(float(value), float(value)) for value in program.constants]
    current = list(states)
    for row in program.instructions.tolist():
        operation = BY_OPCODE[row[0]]
        operands = [registers[i] for i in row[1 : 1 + operation.arity]]
        if operation.nstate == 0:
            registers.append(STATELESS[operation.name](*operands))
            continue
        first = row[1 + operation.arity]
        result, after = _STATEFUL[operation.name](current[first], Interval(dt, dt), *operands)
        registers.append(result)
        current[first] = after
    return registers, current


def _input(low: float, high: float) -> Interval:
    return Interval(float(np.float32(low)), float(np.float32(high)))


def _delay(s: Interval, _dt: Interval, a: Interval) -> tuple[Interval, Interval]:
    return s, a


def _integrate(s: Interval, dt: Interval, a: Interval) -> tuple[Interval, Interval]:
    total = add(s, multiply(dt, a))
    return total, total


def _differentiate(s: Interval, dt: Interval, a: Interval) -> tuple[Interval, Interval]:
    return ZERO.join(divide(subtract(a, s), dt)), a


def _smooth(s: Interval, _dt: Interval, a: Interval, r: Interval) -> tuple[Interval, Interval]:
    result = approach(s, a, r)
    return result, result


def _memory(s: Interval, _dt: Interval, a: Interval, w: Interval) -> tuple[Interval, Interval]:
    result = if_positive(w, a, s)
    return result, result


def _oscillate(wave: Interval) -> Callable[..., tuple[Interval, Interval]]:
    def step(s: Interval, dt: Interval, f: Interval, p: Interval) -> tuple[Interval, Interval]:
        phase = fraction(add(s, multiply(dt, f)))
        return Interval(wave.low, wave.high, fraction(add(phase, p)).nan), phase

    return step


def _load(s: Interval, _dt: Interval) -> tuple[Interval, Interval]:
    return s, s


def _store(_s: Interval, _dt: Interval, a: Interval) -> tuple[Interval, Interval]:
    return a, a


_STATEFUL: Final = MappingProxyType[str, Callable[..., tuple[Interval, Interval]]](
    {
        "delay": _delay,
        "integrate": _integrate,
        "differentiate": _differentiate,
        "smooth": _smooth,
        "memory": _memory,
        "osc-wave": _oscillate(UNIT),
        "osc-saw": _oscillate(Interval(-1.0, 2.0 * PHASE.high - 1.0)),
        "osc-tri": _oscillate(UNIT),
        "load": _load,
        "store": _store,
    }
)


def _sources(controller: Controller, registers: list[Interval], states: list[Interval]) -> list[Source]:
    program = controller.program
    first_result = program.nregister - len(program.instructions)
    found = []
    for i, row in enumerate(program.instructions.tolist()):
        operation: Operation = BY_OPCODE[row[0]]
        result = registers[first_result + i]
        taken = [registers[k] for k in row[1 : 1 + operation.arity]]
        if operation.nstate and operation.name not in ("integrate", "smooth"):
            taken.append(states[row[1 + operation.arity]])
        infinite = result.infinite and not any(value.infinite for value in taken)
        nan = result.nan and not any(value.nan for value in taken)
        if infinite or nan:
            found.append(Source(i, infinite, nan))
    return found
