"""The float32 mathematics of `runtime/sv_math.h`, operation for operation on numpy scalars: slow, and the judge.

Each line below is one rounded binary32 operation of the C function of the same name; tests hold both to the same bits.
"""

from __future__ import annotations

from typing import Final

import numpy as np

F = np.float32

_ROUND: Final = F(12582912.0)  # 1.5 * 2^23: adding and subtracting it rounds to an integer
_TINY: Final = F(0.000244140625)  # 2^-12: below it, sin, atan and tanh round to x
_ZERO: Final = F(0.0)
_HALF: Final = F(0.5)
_ONE: Final = F(1.0)
_TWO: Final = F(2.0)
_FLOAT_MAX: Final = F(3.40282347e38)


def _polynomial(z: F, *coefficients: F) -> F:
    """Evaluate a polynomial in z by Horner's rule, highest power first."""
    y = z * coefficients[0]
    for coefficient in coefficients[1:-1]:
        y = y + coefficient
        y = y * z
    return y + coefficients[-1]


_COS: Final = (F(2.44323273e-05), F(-0.00138873095), F(0.0416666456), F(-0.5))
_SIN: Final = (F(-0.000195180983), F(0.00833218824), F(-0.166666552))
_ATAN: Final = (
    F(-0.0017827769),
    F(0.0108685615),
    F(-0.0310968608),
    F(0.0578813367),
    F(-0.0839930549),
    F(0.109508805),
    F(-0.142640159),
    F(0.199985296),
    F(-0.333332986),
)
_EXP: Final = (F(0.00138214533), F(0.00836866163), F(0.0416682549), F(0.166665211), F(0.49999994))
_LOG: Final = (F(0.298712373), F(0.399775743), F(0.666667759))
_TANH: Final = (F(-0.0056922962), F(0.0206281673), F(-0.0537365153), F(0.133314058), F(-0.333332807))


def _quarter_turn(x: F, turn: int) -> F:
    """Evaluate sin(x + turn * pi / 2) for abs(x) <= 8192."""
    n = x * F(0.636619747)
    n = n + _ROUND
    n = n - _ROUND
    quadrant = (int(n) + turn) & 3
    z = x - n * F(1.5703125)
    z = z - n * F(0.000483751297)
    w = n * F(7.54953362e-08)
    r = z - w
    low = z - r
    low = low - w
    low = low - n * F(2.56334407e-12)
    z = r * r
    if quadrant & 1:
        y = _polynomial(z, *_COS) * z
        y = y - r * low
        y = y + _ONE
    else:
        y = _polynomial(z, *_SIN) * z
        y = y * r
        y = y + low
        y = y + r
    return -y if quadrant & 2 else y


def sin(x: F) -> F:
    """Return the sine of x, 0 beyond abs(x) = 8192.

    Args:
        x: angle [rad]
    """
    with np.errstate(all="ignore"):
        magnitude = -x if x < _ZERO else x
        if not magnitude <= F(8192.0):
            return x if x != x else _ZERO
        if magnitude < _TINY:
            return x
        return _quarter_turn(x, 0)


def cos(x: F) -> F:
    """Return the cosine of x, 1 beyond abs(x) = 8192.

    Args:
        x: angle [rad]
    """
    with np.errstate(all="ignore"):
        magnitude = -x if x < _ZERO else x
        if not magnitude <= F(8192.0):
            return x if x != x else _ONE
        return _quarter_turn(x, 1)


def atan(x: F) -> F:
    """Return the arc tangent of x [rad].

    Args:
        x: any value
    """
    with np.errstate(all="ignore"):
        magnitude = -x if x < _ZERO else x
        if not magnitude >= _TINY:
            return x
        t = _ONE / magnitude if magnitude > _ONE else magnitude
        z = t * t
        y = _polynomial(z, *_ATAN) * z
        y = y * t
        if magnitude > _ONE:
            y = y + F(4.37113883e-08)
            t = F(1.57079637) - t
            y = t - y
        else:
            y = y + t
        return -y if x < _ZERO else y


def exp(x: F) -> F:
    """Return e to the power x, at most the largest finite float.

    Args:
        x: any value
    """
    with np.errstate(all="ignore"):
        if x != x:
            return x
        if x > F(88.7228317):
            return _FLOAT_MAX
        if x < F(-103.972084):
            return _ZERO
        n = x * F(1.44269502)
        n = n + _ROUND
        n = n - _ROUND
        whole = int(n)
        r = x - n * F(0.693145752)
        r = r - n * F(1.42860677e-06)
        y = _polynomial(r, *_EXP) * r
        y = y * r
        y = y + r
        y = y + _ONE
        half = int(whole / 2)
        y = y * F(2.0**half)
        return y * F(2.0 ** (whole - half))


def log(x: F) -> F:
    """Return the natural logarithm of x, 0 where x <= 0.

    Args:
        x: any value
    """
    with np.errstate(all="ignore"):
        if x <= _ZERO:
            return _ZERO
        if not x <= _FLOAT_MAX:
            return x
        k = -127
        if x < F(1.17549435e-38):
            x = x * F(33554432.0)
            k = -152
        word = int(x.view(np.uint32)) + 0x004AFB0D
        k = k + (word >> 23)
        f = np.uint32((word & 0x007FFFFF) + 0x3F3504F3).view(F) - _ONE
        s = f / (f + _TWO)
        z = s * s
        y = _polynomial(z, *_LOG) * z
        half = f * f
        half = half * _HALF
        y = y + half
        y = y * s
        y = y + F(k) * F(1.42860677e-06)
        y = half - y
        y = y - f
        return F(k) * F(0.693145752) - y


def tanh(x: F) -> F:
    """Return the hyperbolic tangent of x.

    Args:
        x: any value
    """
    with np.errstate(all="ignore"):
        magnitude = -x if x < _ZERO else x
        if not magnitude >= _TINY:
            return x
        if magnitude < F(0.625):
            z = x * x
            y = _polynomial(z, *_TANH) * z
            y = y * x
            return y + x
        y = exp(magnitude + magnitude)
        y = y + _ONE
        y = _TWO / y
        y = _ONE - y
        return -y if x < _ZERO else y


def sigmoid(x: F) -> F:
    """Return the logistic function 1 / (1 + exp(-x)).

    Args:
        x: any value
    """
    with np.errstate(all="ignore"):
        part = exp(x if x < _ZERO else -x)
        whole = part + _ONE
        part = part if x < _ZERO else _ONE
        return x if x != x else part / whole
