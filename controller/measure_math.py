"""Measure the error of the float32 mathematics over all 2^32 bit patterns: `python -m controller.measure_math`."""

from __future__ import annotations

import argparse
import ctypes
import os
import sys
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from controller.library import library

Floats: TypeAlias = npt.NDArray[np.float32]
Doubles: TypeAlias = npt.NDArray[np.float64]

FLOAT_MAX: Final = float(np.finfo(np.float32).max)
TRIGONOMETRIC_RANGE: Final = 8192.0
CHUNK: Final = 1 << 22


def _sin(x: Doubles) -> Doubles:
    return np.where(np.abs(x) <= TRIGONOMETRIC_RANGE, np.sin(x), np.where(np.isnan(x), x, 0.0))


def _cos(x: Doubles) -> Doubles:
    return np.where(np.abs(x) <= TRIGONOMETRIC_RANGE, np.cos(x), np.where(np.isnan(x), x, 1.0))


def _exp(x: Doubles) -> Doubles:
    return np.minimum(np.exp(x), FLOAT_MAX)


def _log(x: Doubles) -> Doubles:
    return np.log(np.where(x <= 0.0, 1.0, x))


def _sigmoid(x: Doubles) -> Doubles:
    return 1.0 / (1.0 + np.exp(-x))


# In the order of `sv_math_function`: what each function must approximate, in double precision.
FUNCTIONS: Final[dict[str, Callable[[Doubles], Doubles]]] = {
    "sin": _sin,
    "cos": _cos,
    "atan": np.arctan,
    "exp": _exp,
    "log": _log,
    "tanh": np.tanh,
    "sigmoid": _sigmoid,
}


@dataclass(frozen=True)
class Error:
    """Hold the largest errors of a function over a set of inputs.

    Args:
        ulp: largest error [units in the last place of the exact result]
        ulp_at: bit pattern of the input where it is
        absolute: largest error
        absolute_at: bit pattern of the input where it is
        rounded: how many results are the correctly rounded ones
        count: how many inputs that are not NaN
        wrong_nan: how many results are NaN where they must not be, or not where they must
    """

    ulp: float
    ulp_at: int
    absolute: float
    absolute_at: int
    rounded: int
    count: int
    wrong_nan: int


def apply(name: str, x: Floats) -> Floats:
    """Apply the C function.

    Args:
        name: one of `FUNCTIONS`
        x: inputs, (n,)

    Returns:
        results, (n,)
    """
    x = np.ascontiguousarray(x, np.float32)
    y = np.empty_like(x)
    addresses = (ctypes.c_void_p(x.ctypes.data), ctypes.c_void_p(y.ctypes.data))
    status = library().sv_math_apply(list(FUNCTIONS).index(name), ctypes.c_int64(len(x)), *addresses)
    if status != 0:
        raise ValueError(f"no function {name}")
    return y


def measure(name: str, bits: npt.NDArray[np.uint32]) -> Error:
    """Measure the error of a C function against double precision.

    Args:
        name: one of `FUNCTIONS`
        bits: the inputs' bit patterns, (n,)

    Returns:
        the largest errors
    """
    x = bits.view(np.float32)
    with np.errstate(all="ignore"):
        y = apply(name, x).astype(np.float64)
        exact = FUNCTIONS[name](x.astype(np.float64))
        error = np.abs(y - exact)
        rounded = exact.astype(np.float32) == y
    is_nan = np.isnan(x)
    error[is_nan | (y == exact)] = 0.0  # infinities among them
    _, exponent = np.frexp(exact)
    exponent[~np.isfinite(exact)] = 128
    ulp = np.ldexp(error, -np.maximum(exponent - 24, -149))
    worst, worst_absolute = int(np.argmax(ulp)), int(np.argmax(error))
    return Error(
        ulp=float(ulp[worst]),
        ulp_at=int(bits[worst]),
        absolute=float(error[worst_absolute]),
        absolute_at=int(bits[worst_absolute]),
        rounded=int(np.count_nonzero(rounded & ~is_nan)),
        count=int(np.count_nonzero(~is_nan)),
        wrong_nan=int(np.count_nonzero(np.isnan(y) != is_nan)),
    )


def merge(errors: Iterable[Error]) -> Error:
    """Return the errors over the union of disjoint sets of inputs; of equals the first counts."""
    parts = tuple(errors)
    worst = max(parts, key=lambda part: part.ulp)
    worst_absolute = max(parts, key=lambda part: part.absolute)
    return Error(
        ulp=worst.ulp,
        ulp_at=worst.ulp_at,
        absolute=worst_absolute.absolute,
        absolute_at=worst_absolute.absolute_at,
        rounded=sum(part.rounded for part in parts),
        count=sum(part.count for part in parts),
        wrong_nan=sum(part.wrong_nan for part in parts),
    )


def measure_all(name: str, threads: int) -> Error:
    """Measure the error of a C function over all 2^32 bit patterns.

    Args:
        name: one of `FUNCTIONS`
        threads: how many threads share the work

    Returns:
        the largest errors
    """

    def chunk(start: int) -> Error:
        return measure(name, np.arange(start, start + CHUNK, dtype=np.uint64).astype(np.uint32))

    with ThreadPoolExecutor(threads) as pool:
        return merge(pool.map(chunk, range(0, 1 << 32, CHUNK)))


_HEADING: Final = """\
# Error of the float32 mathematics

Written by `python -m controller.measure_math`, which runs each function of `controller/runtime/sv_math.h` on all 2^32
bit patterns and compares it with double precision. Every NaN gives NaN and nothing else does. The errors are against
the functions as defined: sin and cos are 0 and 1 beyond |x| = 8192, log is 0 for x <= 0, exp is at most the largest
finite float. The unit in the last place (ulp) is that of the exact result, 2^-149 where it is subnormal. The last
column says how many of all results are the correctly rounded ones, the constant ends included.

| function | largest error [ulp] | at | bits | largest absolute error | at | bits | correctly rounded |
|---|---|---|---|---|---|---|---|
"""


def _value(bits: int) -> str:
    return f"{np.uint32(bits).view(np.float32):.9g}"


def table(errors: dict[str, Error]) -> str:
    """Return the measurement as a Markdown page.

    Args:
        errors: of each function
    """
    lines = []
    for name, error in errors.items():
        if error.wrong_nan:
            raise ValueError(f"{name} gives a NaN for a number, or a number for a NaN, {error.wrong_nan} times")
        lines.append(
            f"| {name} | {error.ulp:.4f} | {_value(error.ulp_at)} | {error.ulp_at:08x} | {error.absolute:.4g} "
            f"| {_value(error.absolute_at)} | {error.absolute_at:08x} | {error.rounded / error.count:.2%} |\n"
        )
    return _HEADING + "".join(lines)


def main() -> None:
    """Measure every function and write the page."""
    parser = argparse.ArgumentParser(prog="python -m controller.measure_math", description=__doc__)
    default = Path(__file__).parents[1] / "docs" / "float_math.md"
    parser.add_argument("--out", type=Path, default=default, help="the page to write (default: %(default)s)")
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    arguments = parser.parse_args()
    errors = {}
    for name in FUNCTIONS:
        errors[name] = measure_all(name, arguments.threads)
        sys.stderr.write(f"{name}: {errors[name].ulp:.4f} ulp at {_value(errors[name].ulp_at)}\n")
    arguments.out.write_text(table(errors), encoding="utf-8")


if __name__ == "__main__":
    main()
