"""Intervals of float32: what an operation can give, for operands within intervals.

Rounding to nearest is monotone, so the rounded ends of a sum or a product are its exact hull in float32. Functions that
are computed by polynomials get `STEPS_OUT` units in the last place more on both sides, twice their largest error and
more (docs/float_math.md).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np

from controller import float_math

F = np.float32

STEPS_OUT: Final = 8
INFINITE: Final = math.inf
_TINY: Final = float(F(2.0**-149))
_BELOW_ONE: Final = float(F(1) - F(2.0**-24))


@dataclass(frozen=True)
class Interval:
    """Hold all numbers from low to high, ends included; NaN, too, where it says so.

    Args:
        low: lowest, may be -inf
        high: highest, may be inf; below low where there is no number at all
        nan: whether it may be NaN
    """

    low: float
    high: float
    nan: bool = False

    @property
    def infinite(self) -> bool:
        """Return whether one of the infinities is among the numbers."""
        return self.low <= self.high and (self.low == -INFINITE or self.high == INFINITE)

    def join(self, other: Interval) -> Interval:
        """Return what holds both.

        Args:
            other: the other one
        """
        return Interval(min(self.low, other.low), max(self.high, other.high), self.nan or other.nan)

    def holds(self, value: float) -> bool:
        """Return whether a value is in it.

        Args:
            value: any
        """
        return self.nan if math.isnan(value) else self.low <= value <= self.high


ZERO: Final = Interval(0.0, 0.0)
ONE: Final = Interval(1.0, 1.0)
UNIT: Final = Interval(-1.0, 1.0)
PHASE: Final = Interval(0.0, _BELOW_ONE)
NOTHING: Final = Interval(INFINITE, -INFINITE)


def _of(values: list[float], nan: bool) -> Interval:
    """Return the hull of corners; a NaN among them is a limit that others stand for."""
    numbers = [value for value in values if not math.isnan(value)]
    return Interval(min(numbers, default=-INFINITE), max(numbers, default=INFINITE), nan)


def _float(value: np.float32 | float) -> float:
    return float(value)


def _has(interval: Interval, value: float) -> bool:
    return interval.low <= value <= interval.high


def add(a: Interval, b: Interval) -> Interval:
    """Return a + b.

    Args:
        a: first operand
        b: second operand
    """
    if a.low > a.high or b.low > b.high:
        return Interval(INFINITE, -INFINITE, True)
    nan = (_has(a, INFINITE) and _has(b, -INFINITE)) or (_has(a, -INFINITE) and _has(b, INFINITE))
    low, high = _float(F(a.low) + F(b.low)), _float(F(a.high) + F(b.high))
    return Interval(
        -INFINITE if math.isnan(low) else low, INFINITE if math.isnan(high) else high, nan or a.nan or b.nan
    )


def negate(a: Interval) -> Interval:
    """Return -a.

    Args:
        a: operand
    """
    return Interval(-a.high, -a.low, a.nan)


def subtract(a: Interval, b: Interval) -> Interval:
    """Return a - b.

    Args:
        a: first operand
        b: second operand
    """
    return add(a, negate(b))


def multiply(a: Interval, b: Interval) -> Interval:
    """Return a times b.

    Args:
        a: first operand
        b: second operand
    """
    if a.low > a.high or b.low > b.high:
        return Interval(INFINITE, -INFINITE, True)
    corners = [_float(F(x) * F(y)) for x in (a.low, a.high) for y in (b.low, b.high)]
    lost = any(math.isnan(corner) for corner in corners)
    nan = (_has(a, 0.0) and b.infinite) or (_has(b, 0.0) and a.infinite)
    return _of([*corners, *([0.0] if lost else [])], nan or a.nan or b.nan)


def _quotient(a: Interval, b: Interval) -> Interval:
    """Return a / b, b without 0 inside."""
    corners = [_float(F(x) / F(y)) for x in (a.low, a.high) for y in (b.low, b.high)]
    lost = any(math.isnan(corner) for corner in corners)
    return _of([*corners, *([0.0] if lost else [])], (a.infinite and b.infinite) or a.nan or b.nan)


def divide(a: Interval, b: Interval) -> Interval:
    """Return 1 where b is 0, else a / b.

    Args:
        a: first operand
        b: second operand
    """
    if a.low > a.high or b.low > b.high:
        return Interval(1.0 if _has(b, 0.0) else INFINITE, 1.0 if _has(b, 0.0) else -INFINITE, True)
    result = Interval(INFINITE, -INFINITE, b.nan)
    if b.low < 0:
        result = result.join(_quotient(a, Interval(b.low, min(b.high, -_TINY))))
    if b.high > 0:
        result = result.join(_quotient(a, Interval(max(b.low, _TINY), b.high)))
    return result.join(ONE) if _has(b, 0.0) else result


def absolute(a: Interval) -> Interval:
    """Return a without its sign.

    Args:
        a: operand
    """
    low = 0.0 if _has(a, 0.0) else min(abs(a.low), abs(a.high))
    return Interval(low, max(abs(a.low), abs(a.high)), a.nan) if a.low <= a.high else a


def _choose(yes: bool, no: bool, a: Interval, b: Interval) -> Interval:
    result = NOTHING
    if yes:
        result = result.join(a)
    return result.join(b) if no else result


def minimum(a: Interval, b: Interval) -> Interval:
    """Return a where a < b, else b.

    Args:
        a: first operand
        b: second operand
    """
    smaller = Interval(min(a.low, b.low), min(a.high, b.high), b.nan)
    if a.low > a.high or b.low > b.high:
        smaller = Interval(b.low, b.high, b.nan)
    return smaller.join(b) if a.nan else smaller


def maximum(a: Interval, b: Interval) -> Interval:
    """Return a where a > b, else b.

    Args:
        a: first operand
        b: second operand
    """
    return negate(minimum(negate(a), negate(b)))


def greater(a: Interval, b: Interval) -> Interval:
    """Return 1 where a > b, else 0.

    Args:
        a: first operand
        b: second operand
    """
    return _choose(a.high > b.low, a.low <= b.high or a.nan or b.nan, ONE, ZERO)


def sign(a: Interval) -> Interval:
    """Return 1, -1 or 0.

    Args:
        a: operand
    """
    result = _choose(a.high > 0, _has(a, 0.0) or a.nan, ONE, ZERO)
    return result.join(Interval(-1.0, -1.0)) if a.low < 0 else result


def if_positive(a: Interval, b: Interval, c: Interval) -> Interval:
    """Return b where a > 0, else c.

    Args:
        a: what decides
        b: taken where it does
        c: taken where it does not
    """
    return _choose(a.high > 0, a.low <= 0 or a.nan, b, c)


def if_negative(a: Interval, b: Interval, c: Interval) -> Interval:
    """Return b where a < 0, else c.

    Args:
        a: what decides
        b: taken where it does
        c: taken where it does not
    """
    return _choose(a.low < 0, a.high >= 0 or a.nan, b, c)


def clamp01(w: Interval) -> Interval:
    """Return w held within 0 and 1.

    Args:
        w: operand
    """
    if w.low > w.high:
        return w
    return Interval(min(max(w.low, 0.0), 1.0), min(max(w.high, 0.0), 1.0), w.nan)


def _within(result: Interval, low: float, high: float) -> Interval:
    return Interval(max(result.low, low), min(result.high, high), result.nan)


def _slack(difference: Interval) -> float:
    """Return what rounding a difference can add to a number that is approached by it."""
    return 2.0 * float(np.spacing(F(max(abs(difference.low), abs(difference.high)))))


def interpolate(a: Interval, b: Interval, w: Interval) -> Interval:
    """Return a + (b - a) w, w held within 0 and 1.

    Args:
        a: where w is 0
        b: where w is 1
        w: weight
    """
    difference = subtract(b, a)
    result = add(a, multiply(difference, clamp01(w)))
    if difference.infinite or difference.low > difference.high:
        return result
    # never beyond a, and beyond b only by what the difference was rounded
    hull, slack = a.join(b), _slack(difference)
    return _within(result, outward(hull.low - slack, -1), outward(hull.high + slack, 1))


def approach(s: Interval, a: Interval, r: Interval) -> Interval:
    """Return s + r (a - s), r held within 0 and 1.

    Args:
        s: where it is
        a: where it goes
        r: the part of the way
    """
    difference = subtract(a, s)
    result = add(s, multiply(clamp01(r), difference))
    if difference.infinite or difference.low > difference.high:
        return result
    # from above it never rises, from below it rises to a and what the difference was rounded
    slack = _slack(difference)
    return _within(result, min(s.low, outward(a.low - slack, -1)), max(s.high, outward(a.high + slack, 1)))


def outward(value: float, direction: int, steps: int = 1) -> float:
    """Return a float32 at least so many steps beyond a value.

    Args:
        value: any number
        direction: 1 up, -1 down
        steps: of a unit in the last place
    """
    with np.errstate(all="ignore"):
        result = F(value)
        for _ in range(steps):
            result = np.nextafter(result, F(direction * np.inf))
    return float(result)


def _monotone(function: Callable[[np.float32], np.float32], low: float, high: float) -> Callable[[Interval], Interval]:
    """Return the transfer of a rising function whose values are within low and high."""

    def transfer(a: Interval) -> Interval:
        if a.low > a.high:
            return a
        ends = [float(function(F(end))) for end in (a.low, a.high)]
        result = Interval(outward(ends[0], -1, STEPS_OUT), outward(ends[1], 1, STEPS_OUT), a.nan)
        return _within(result, low, high)

    return transfer


def _wave(a: Interval) -> Interval:
    # the largest error near 1 is less than the step to the float above 1
    return Interval(-1.0, 1.0, a.nan)


def logarithm(a: Interval) -> Interval:
    """Return the logarithm of a, 0 where a <= 0.

    Args:
        a: operand
    """
    result = Interval(INFINITE, -INFINITE, a.nan)
    if a.high > 0:
        result = result.join(_LOG(Interval(max(a.low, _TINY), a.high)))
    return result.join(ZERO) if a.low <= 0 else result


_LOG: Final = _monotone(float_math.log, -INFINITE, INFINITE)
_FLOAT_MAX: Final = float(np.finfo(F).max)
_HALF_PI: Final = float(F(1.5707964))

STATELESS: Final = MappingProxyType[str, Callable[..., Interval]](
    {
        "+": add,
        "-": subtract,
        "*": multiply,
        "%": divide,
        "abs": absolute,
        "sign": sign,
        "min": minimum,
        "max": maximum,
        "gt": greater,
        "if": if_positive,
        "ifltz": if_negative,
        "interpolate": interpolate,
        "sin": _wave,
        "cos": _wave,
        "atan": _monotone(float_math.atan, -_HALF_PI, _HALF_PI),
        "exp": _monotone(float_math.exp, 0.0, _FLOAT_MAX),
        "log": logarithm,
        "tanh": _monotone(float_math.tanh, -1.0, 1.0),
        "sigmoid": _monotone(float_math.sigmoid, 0.0, 1.0),
    }
)
"""What each operation without state gives, by its name."""


def fraction(x: Interval) -> Interval:
    """Return x - floor(x), below 1; NaN for infinities and NaN.

    Args:
        x: operand
    """
    return Interval(PHASE.low, PHASE.high, x.nan or x.infinite)
