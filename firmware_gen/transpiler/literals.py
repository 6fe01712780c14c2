"""Floats as C literals."""

from __future__ import annotations

import math

import numpy as np


def literal(value: np.float32) -> str:
    """Write a float as a decimal C literal that any correct compiler reads back to the same bits.

    Args:
        value: finite

    Returns:
        nine digits with the suffix F, negative ones in parentheses, as "(-28.4382F)"

    Raises:
        ValueError: the value is not finite
    """
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"{number} has no literal")
    text = f"{abs(number):.9g}"
    if not set(text) & set(".e"):
        text += ".0"
    return f"(-{text}F)" if math.copysign(1.0, number) < 0 else f"{text}F"
