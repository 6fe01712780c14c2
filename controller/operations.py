"""The one table of operations: what a controller may compute, and exactly how.

Every back end is held to this table: the Python reference calls `Operation.reference`; the virtual machine's switch
(`runtime/sv_operations.inc`) and the generated C are both written from `Operation.c`. Semantics are IEEE-754
binary32, round to nearest even, every operation rounded, subnormals kept, all NaNs equal.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from controller import float_math

F: TypeAlias = np.float32
State: TypeAlias = npt.NDArray[np.float32]

_ZERO: Final = F(0)
_ONE: Final = F(1)
_TWO: Final = F(2)
_THREE: Final = F(3)
_FOUR: Final = F(4)
_HALF: Final = F(0.5)
_TWO_PI: Final = F(6.2831855)
_BELOW_ONE: Final = F(1) - F(2.0**-24)


@dataclass(frozen=True)
class Operation:
    """Describe one operation.

    Args:
        name: as the program text names it
        opcode: its number in programs; part of every program's hash, so never given to another operation
        arity: operands
        nstate: float32 state slots, all 0 at the start
        reference: its meaning, ``(a, b, …) -> result`` on numpy.float32; a stateful operation is called as
            ``(s, dt, a, b, …)`` with its state slots (nstate,), which it updates, and the period [s]
        c: the same as one C expression over {a}, {b}, {c} (values), {dt} (the period) and {s} (pointer to the first
            state slot); its functions are in `runtime/sv_math.h` and `runtime/sv_operations.h`
        summary: what it gives, for the manual
        internal: lowered from ``(last name)``, never written in a program text
    """

    name: str
    opcode: int
    arity: int
    nstate: int
    reference: Callable[..., Any]
    c: str
    summary: str
    internal: bool = False


def _divide(a: F, b: F) -> F:
    return _ONE if b == _ZERO else a / b


def _sign(a: F) -> F:
    if a > _ZERO:
        return _ONE
    return -_ONE if a < _ZERO else _ZERO


def clamp01(w: F) -> F:
    """Return 0 if w < 0, 1 if w > 1, else w (a NaN stays one).

    Args:
        w: any value
    """
    if w < _ZERO:
        return _ZERO
    return _ONE if w > _ONE else w


def _interpolate(a: F, b: F, w: F) -> F:
    return a + (b - a) * clamp01(w)


def frac(x: F) -> F:
    """Return x - floor(x), kept in [0, 1).

    Where the difference rounds to 1 (a tiny negative x) it is the largest float below 1. From 2^23 on every float is
    an integer: 0. Infinities and NaN give NaN, as the subtraction does, and an oscillator that met one stays NaN.

    Args:
        x: any value
    """
    part = x - np.floor(x)
    return part if part < _ONE else part if part != part else _BELOW_ONE


def _delay(s: State, _dt: F, a: F) -> F:
    last: F = s[0]
    s[0] = a
    return last


def _integrate(s: State, dt: F, a: F) -> F:
    s[0] = s[0] + dt * a
    result: F = s[0]
    return result


def _differentiate(s: State, dt: F, a: F) -> F:
    # s[1] is 0 until the first step is done
    rate: F = (a - s[0]) / dt if s[1] != _ZERO else _ZERO
    s[0] = a
    s[1] = _ONE
    return rate


def _smooth(s: State, _dt: F, a: F, r: F) -> F:
    s[0] = s[0] + clamp01(r) * (a - s[0])
    result: F = s[0]
    return result


def _memory(s: State, _dt: F, a: F, w: F) -> F:
    if w > _ZERO:
        s[0] = a
    result: F = s[0]
    return result


def _phase(s: State, dt: F, f: F, p: F) -> F:
    s[0] = frac(s[0] + dt * f)
    return frac(s[0] + p)


def _osc_wave(s: State, dt: F, f: F, p: F) -> F:
    return float_math.sin(_TWO_PI * _phase(s, dt, f, p))


def _osc_saw(s: State, dt: F, f: F, p: F) -> F:
    return _TWO * _phase(s, dt, f, p) - _ONE


def _osc_tri(s: State, dt: F, f: F, p: F) -> F:
    x = _phase(s, dt, f, p)
    return _FOUR * x - _ONE if x < _HALF else _THREE - _FOUR * x


def _load(s: State, _dt: F) -> F:
    value: F = s[0]
    return value


def _store(s: State, _dt: F, a: F) -> F:
    s[0] = a
    return a


OPERATIONS: Final[tuple[Operation, ...]] = (
    Operation("+", 1, 2, 0, lambda a, b: a + b, "{a} + {b}", "a + b"),
    Operation("-", 2, 2, 0, lambda a, b: a - b, "{a} - {b}", "a - b"),
    Operation("*", 3, 2, 0, lambda a, b: a * b, "{a} * {b}", "a times b"),
    Operation("%", 4, 2, 0, _divide, "{b} == 0.0F ? 1.0F : {a} / {b}", "1 if b = 0, else a / b"),
    Operation("abs", 5, 1, 0, abs, "{a} > 0.0F ? {a} : 0.0F - {a}", "a without its sign"),
    Operation(
        "sign", 6, 1, 0, _sign, "{a} > 0.0F ? 1.0F : ({a} < 0.0F ? -1.0F : 0.0F)", "1 if a > 0, -1 if a < 0, else 0"
    ),
    Operation("min", 7, 2, 0, lambda a, b: a if a < b else b, "{a} < {b} ? {a} : {b}", "a if a < b, else b"),
    Operation("max", 8, 2, 0, lambda a, b: a if a > b else b, "{a} > {b} ? {a} : {b}", "a if a > b, else b"),
    Operation("gt", 9, 2, 0, lambda a, b: _ONE if a > b else _ZERO, "{a} > {b} ? 1.0F : 0.0F", "1 if a > b, else 0"),
    Operation("if", 10, 3, 0, lambda a, b, c: b if a > _ZERO else c, "{a} > 0.0F ? {b} : {c}", "b if a > 0, else c"),
    Operation("ifltz", 11, 3, 0, lambda a, b, c: b if a < _ZERO else c, "{a} < 0.0F ? {b} : {c}", "b if a < 0, else c"),
    Operation(
        "interpolate", 12, 3, 0, _interpolate, "sv_interpolate({a}, {b}, {c})", "a + (b - a) c, c held within 0 and 1"
    ),
    Operation("sin", 13, 1, 0, float_math.sin, "sv_sin({a})", "sine of a in rad; 0 beyond abs(a) = 8192"),
    Operation("cos", 14, 1, 0, float_math.cos, "sv_cos({a})", "cosine of a in rad; 1 beyond abs(a) = 8192"),
    Operation("atan", 15, 1, 0, float_math.atan, "sv_atan({a})", "arc tangent of a, in rad"),
    Operation("exp", 16, 1, 0, float_math.exp, "sv_exp({a})", "e to the a, at most the largest finite number"),
    Operation("log", 17, 1, 0, float_math.log, "sv_log({a})", "natural logarithm of a; 0 if a <= 0"),
    Operation("tanh", 18, 1, 0, float_math.tanh, "sv_tanh({a})", "hyperbolic tangent of a"),
    Operation("sigmoid", 19, 1, 0, float_math.sigmoid, "sv_sigmoid({a})", "1 / (1 + exp(-a))"),
    Operation("delay", 20, 1, 1, _delay, "sv_delay({s}, {a})", "a of the step before; 0 at the start"),
    Operation("integrate", 21, 1, 1, _integrate, "sv_integrate({s}, {dt}, {a})", "running sum of dt a"),
    Operation(
        "differentiate",
        22,
        1,
        2,
        _differentiate,
        "sv_differentiate({s}, {dt}, {a})",
        "change of a since the step before, per second; 0 at the start",
    ),
    Operation(
        "smooth", 23, 2, 1, _smooth, "sv_smooth({s}, {a}, {b})", "s moved by b (a - s), b held within 0 and 1; gives s"
    ),
    Operation("memory", 24, 2, 1, _memory, "sv_memory({s}, {a}, {b})", "a of the latest step at which b > 0"),
    Operation("osc-wave", 25, 2, 1, _osc_wave, "sv_osc_wave({s}, {dt}, {a}, {b})", "sine wave of a Hz, b turns ahead"),
    Operation(
        "osc-saw", 26, 2, 1, _osc_saw, "sv_osc_saw({s}, {dt}, {a}, {b})", "saw tooth of a Hz, -1 rising to 1, b ahead"
    ),
    Operation(
        "osc-tri", 27, 2, 1, _osc_tri, "sv_osc_tri({s}, {dt}, {a}, {b})", "triangle of a Hz, -1 to 1 to -1, b ahead"
    ),
    Operation("load", 28, 0, 1, _load, "*{s}", "the value stored the step before", internal=True),
    Operation("store", 29, 1, 1, _store, "sv_store({s}, {a})", "a, kept for the next step", internal=True),
)

BY_NAME: Final[Mapping[str, Operation]] = MappingProxyType({operation.name: operation for operation in OPERATIONS})
BY_OPCODE: Final[Mapping[int, Operation]] = MappingProxyType({operation.opcode: operation for operation in OPERATIONS})

RESERVED: Final = frozenset({"list", "let", "last"} | {o.name for o in OPERATIONS if not o.internal})
"""Words of the program text: no terminal, output or definition may be called so."""
