"""Decimal literals and binary32: read rounded once, printed as the shortest decimal that reads back the same."""

from __future__ import annotations

import re
import struct
from typing import Final

import numpy as np

DECIMAL: Final = re.compile(r"([+-]?)(\d+(?:\.(\d*))?|\.(\d+))(?:[eE]([+-]?\d+))?", re.ASCII)

_DIGITS_MAX: Final = 120
"""More than the 113 significant digits of any value halfway between two floats."""

_EXPONENT_DIGITS_MAX: Final = 9


def parse_decimal(text: str) -> np.float32:
    """Round a decimal number correctly, once, to binary32 (half to even); too small a number is a zero.

    Work and memory are bounded by the length of the text, whatever its exponent.

    Args:
        text: as "-28.4382", "1e-3", ".5"

    Returns:
        the nearest float

    Raises:
        ValueError: it is no decimal number
        OverflowError: it rounds beyond the largest finite float
    """
    match = DECIMAL.fullmatch(text)
    if match is None:
        raise ValueError(f"{text!r} is no decimal number")
    sign, body, fraction, bare_fraction, exponent_text = match.groups()
    decimals = len(fraction or bare_fraction or "")
    digits = body.replace(".", "").lstrip("0")
    exponent = _bounded_exponent(exponent_text) - decimals
    if len(digits) > _DIGITS_MAX:
        # what follows can only break a tie: a 1 stands for any of it
        kept, dropped = digits[:_DIGITS_MAX], digits[_DIGITS_MAX:]
        exponent += len(dropped) - 1
        digits = kept + ("1" if dropped.strip("0") else "0")
    bits = _round_to_bits(int(digits), exponent, len(digits)) if digits else 0
    if sign == "-":
        bits |= 0x80000000
    return np.float32(struct.unpack("<f", struct.pack("<I", bits))[0])


def _bounded_exponent(text: str | None) -> int:
    """Return an exponent, held where no text of any possible length can bring it back into range."""
    digits = (text or "0").lstrip("+-").lstrip("0")
    size = int(digits or "0") if len(digits) <= _EXPONENT_DIGITS_MAX else 10**_EXPONENT_DIGITS_MAX
    return -size if text and text[0] == "-" else size


def _round_to_bits(digits: int, exponent: int, ndigit: int) -> int:
    """Return the bits of the float nearest to digits * 10**exponent, digits > 0."""
    # 10**(magnitude - 1) <= value < 10**magnitude
    magnitude = ndigit + exponent
    if magnitude > 39:
        raise OverflowError
    if magnitude < -45:
        return 0
    numerator = digits * 10**exponent if exponent > 0 else digits
    denominator = 10**-exponent if exponent < 0 else 1
    # scale by 2**-shift so that the quotient has 24 bits, or fewer for a subnormal
    shift = max(numerator.bit_length() - denominator.bit_length() - 24, -149)
    if numerator >= denominator << (shift + 24) if shift + 24 >= 0 else numerator << -(shift + 24) >= denominator:
        shift += 1
    if shift >= 0:
        denominator <<= shift
    else:
        numerator <<= -shift
    quotient, remainder = divmod(numerator, denominator)
    twice = 2 * remainder
    if twice > denominator or (twice == denominator and quotient & 1):
        quotient += 1
    # a carry out of the 24 bits flows into the exponent field, as it should
    bits = quotient + ((shift + 149) << 23) if quotient >= 0x800000 else quotient
    if bits >= 0x7F800000:
        raise OverflowError
    return bits


def format_decimal(value: np.float32) -> str:
    """Print a finite float as the shortest decimal that rounds back to it: at most 9 digits.

    Args:
        value: finite

    Returns:
        as "15.4963", "-0", "1e-10"
    """
    text = np.format_float_scientific(value, unique=True, trim="-", exp_digits=1)
    mantissa, _, exponent_text = text.partition("e")
    exponent = int(exponent_text)
    if -5 <= exponent < 9:
        return np.format_float_positional(value, unique=True, trim="-")
    return f"{mantissa}e{exponent}"
