"""Literals round once: judged by exact fractions over the two nearest floats."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from controller.decimals import format_decimal, parse_decimal

FLOAT_MAX = Fraction(2**128 - 2**104)


def bits(value):
    return int(value.view(np.uint32))


def nearest(value: Fraction) -> int:
    """Return the bits of the float nearest to a value >= 0, ties to even, by bisection over all floats."""
    low, high = 0, 0x7F7FFFFF
    while high - low > 1:
        middle = (low + high) // 2
        if Fraction(float(np.uint32(middle).view(np.float32))) <= value:
            low = middle
        else:
            high = middle
    below, above = (Fraction(float(np.uint32(word).view(np.float32))) for word in (low, high))
    if value - below == above - value:
        return low if low % 2 == 0 else high
    return low if value - below < above - value else high


@given(st.integers(0, 10**30), st.integers(-80, 15))
@example(10000001788139342151495725, -25)  # below a tie, but on it when rounded to double first
@example(7006492321624085354618647916449580656401309709382578858785341419448955413429303, -124)  # 2^-150: a tie, to 0
@example(16777217, 0)  # a tie, to even below
@example(16777219, 0)  # a tie, to even above
@example(117549428, -46)
def test_a_literal_is_the_nearest_float(digits, exponent):
    value = Fraction(digits) * Fraction(10) ** exponent
    text = f"{digits}e{exponent}"
    if value >= FLOAT_MAX + 2**103:
        with pytest.raises(OverflowError):
            parse_decimal(text)
    else:
        assert bits(parse_decimal(text)) == nearest(value)
        assert bits(parse_decimal(f"-{text}")) == nearest(value) | 0x80000000


@given(st.integers(0, 0x7F7FFFFF), st.integers(-1, 1))
def test_values_beside_a_tie_go_to_their_side(word, nudge):
    # halfway to the next float, exactly, or off by less than any double could hold
    low, high = (Fraction(float(np.uint32(w).view(np.float32))) for w in (word, min(word + 1, 0x7F7FFFFF)))
    tie = (low + high) / 2
    scale = 10**200
    digits = tie * scale
    assert digits.denominator == 1
    text = f"{digits.numerator}{'0' * 600}{'1' if nudge > 0 else '0'}e-801"
    if nudge < 0:
        text = f"{digits.numerator * 10**600 - 1}e-800"
    if tie == 0:
        return
    expected = nearest(tie) if nudge == 0 else nearest(tie + Fraction(nudge, 10**801))
    assert bits(parse_decimal(text)) == expected


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("1.0000001788139342151495725", 0x3F800001),
        ("0", 0),
        ("-0", 0x80000000),
        ("+.5", 0x3F000000),
        ("5.", 0x40A00000),
        ("1e-45", 1),
        ("1e-46", 0),
        ("-1e-999999999999999999", 0x80000000),
        ("0e999999999999999999", 0),
        ("3.40282356779733661637539395458142568447e38", 0x7F7FFFFF),
        ("1" + "0" * 5000 + "e-5000", 0x3F800000),
        ("." + "0" * 5000 + "1e5001", 0x3F800000),
    ],
)
def test_edges_of_the_range(text, word):
    assert bits(parse_decimal(text)) == word


@pytest.mark.parametrize("text", ["1e39", "3.40282356779733661637539395458142568448e38", "1e999999999999999999"])
def test_beyond_the_largest_float_is_an_error(text):
    with pytest.raises(OverflowError):
        parse_decimal(text)


@pytest.mark.parametrize("text", ["", ".", "1e", "e5", "1_0", "0x1p3", "nan", "inf", "--1", "1.2.3", "١", "1 "])
def test_other_spellings_are_refused(text):
    with pytest.raises(ValueError, match="no decimal"):
        parse_decimal(text)


@given(st.integers(0, 2**32 - 1).filter(lambda word: word & 0x7F800000 != 0x7F800000))
@example(0x80000000)
@example(1)
@example(0x7F7FFFFF)
@example(0x4D0BC6B7)
def test_printing_reads_back_with_nine_digits_at_most(word):
    value = np.uint32(word).view(np.float32)
    text = format_decimal(value)
    assert bits(parse_decimal(text)) == word
    digits = text.lstrip("-").partition("e")[0].replace(".", "").strip("0")
    assert len(digits) <= 9
