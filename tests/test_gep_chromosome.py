"""Chromosomes decode as Ferreira's paper prints them, and every one of them is a program."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controller import lower
from controller.errors import InputError
from controller.operations import OPERATIONS
from controller.reference import run_program
from controller.text import format_expression
from controller.verifier import verify
from evolve.gep.chromosome import (
    Chromosome,
    Layout,
    decode,
    draw_chromosome,
    expressed,
    format_chromosome,
    is_chromosome,
    parse_chromosome,
)
from evolve.gp.tree import Primitives
from evolve.streams import Stream, generator

# Ferreira's alphabet; her Q, the square root, is any function of one operand here
SYMBOLS = dict(zip("Q+-*/abcd", ("sin", "+", "-", "*", "%", "a", "b", "c", "d"), strict=True))
PAPER = Primitives(("sin", "+", "-", "*", "%"), ("a", "b", "c", "d"), 1.0)
WRITTEN_TEXT = tuple(operation.name for operation in OPERATIONS if not operation.internal)


def layout_of(head, ngene=1, primitives=PAPER, function_share=0.5):
    return Layout(primitives, head, ngene, function_share)


def gene(letters, head, ngene=1):
    """Read a chromosome as Ferreira prints them."""
    layout = layout_of(head, ngene)
    length = len(letters) // ngene
    rows = [" ".join(SYMBOLS[letter] for letter in letters[i : i + length]) for i in range(0, len(letters), length)]
    return layout, parse_chromosome(layout, "\n".join(rows))


def read(letters, head, ngene=1):
    """Return expressions as text in her alphabet, and where each gene's ends."""
    layout, chromosome = gene(letters, head, ngene)
    back = {"sin": "Q", "%": "/"}
    texts = [format_expression(output) for output in decode(layout, chromosome).outputs]
    texts = [re.sub(r"sin|%", lambda match: back[match.group()], text) for text in texts]
    return texts, (expressed(layout, chromosome) - 1).tolist()


@pytest.mark.parametrize(
    ("letters", "head", "expression", "end"),
    [
        # the K-expressions (3.2), (3.3) and (3.10), with the shortest head that has a tail for what follows
        ("Q*+-abcd" + "a", 4, "(Q (* (+ a b) (- c d)))", 7),
        ("Q*+*a*Qaaba" + "aaaa", 7, "(Q (* (+ a (* a b)) (* (Q a) a)))", 10),
        ("+Q**-bQ+abbba" + "aaaa", 8, "(+ (Q (* (Q b) (+ b a))) (* (- a b) b))", 12),
        # gene (3.5), and what mutations make of it
        ("+Q-/b*aaQbaabaabbaaab", 10, "(+ (Q (/ a a)) (- b (* (Q a) b)))", 10),
        ("+Q-/b*aaQ+aabaabbaaab", 10, "(+ (Q (/ a a)) (- b (* (Q a) (+ a b))))", 12),
        ("+Q-/b*+*Qbaabaabbaaab", 10, "(+ (Q (/ (+ a a) (* b a))) (- b (* (Q a) b)))", 14),
        ("+Q-/baaaQbaabaabbaaab", 10, "(+ (Q (/ a a)) (- b a))", 7),
        # a head of 15 (Ferreira, WSC6 tutorial, 2001)
        ("*b+a-aQab+//+b+babbabbbababbaaa", 15, "(* b (+ a (- a (Q a))))", 7),
    ],
)
def test_printed_genes_decode_as_printed(letters, head, expression, end):
    assert read(letters, head) == ([expression], [end])


def test_the_printed_chromosome_of_three_genes_ends_where_printed():
    texts, ends = read("-b*babbab*Qb+abbba-*Qabbaba", 4, ngene=3)
    assert texts == ["(- b (* b a))", "(* (Q (+ a b)) b)", "(- (* a b) (Q b))"]
    assert ends == [4, 5, 5]


@pytest.mark.parametrize(
    ("letters", "head", "ngene"), [("*++/**aaaaaaa", 6, 1), ("**-*a+aaaaaaa++**a*aaaaaaa*+-a/aaaaaaaa", 6, 3)]
)
def test_the_printed_solutions_of_symbolic_regression_solve_it(letters, head, ngene):
    layout, chromosome = gene(letters, head, ngene)
    program = lower(decode(layout, chromosome), PAPER.terminals)
    for a in (2.81, 6.0, 7.043, -8.0):
        total = float(np.sum(run_program(program, 0.02, np.array([[a, 0, 0, 0]], np.float32))))
        assert total == pytest.approx(a**4 + a**3 + a**2 + a, rel=1e-5)


def test_the_tail_is_long_enough_for_a_head_of_nothing_but_the_widest_function():
    for operation in OPERATIONS:
        if operation.internal:
            continue
        layout = layout_of(7, primitives=Primitives((operation.name,), ("a",), 1.0), function_share=1.0)
        assert layout.tail == 7 * (operation.arity - 1) + 1
        drawn = draw_chromosome(generator(1, Stream.START), layout)
        assert expressed(layout, drawn) == [layout.head + layout.tail]


@settings(derandomize=True, deadline=None, max_examples=150)
@given(
    seed=st.integers(0, 2**32),
    names=st.sets(st.sampled_from(WRITTEN_TEXT), min_size=1),
    head=st.integers(1, 20),
    ngene=st.integers(1, 5),
    share=st.floats(0, 1),
)
def test_every_chromosome_of_any_primitives_is_a_program_and_comes_back_from_its_text(seed, names, head, ngene, share):
    primitives = Primitives(tuple(sorted(names)), ("t", "px"), 30.0)
    layout = layout_of(head, ngene, primitives, share)
    drawn = draw_chromosome(generator(seed, Stream.START), layout)
    assert is_chromosome(layout, drawn)
    source = decode(layout, drawn)
    program = lower(source, primitives.terminals)
    verify(program)
    assert len(program.outputs) == ngene
    again = parse_chromosome(layout, format_chromosome(layout, drawn))
    assert again.codes.dtype == np.int16 and again.values.dtype == np.float32
    assert again.codes.tobytes() == drawn.codes.tobytes()
    assert again.values.tobytes() == drawn.values.tobytes()


def test_a_negative_zero_and_the_smallest_constant_come_back_from_their_text():
    layout = layout_of(1)
    codes = np.full((1, 3), PAPER.constant, np.int16)
    written = Chromosome(codes, np.array([[-0.0, 1e-45, -28.4382]], np.float32))
    again = parse_chromosome(layout, format_chromosome(layout, written))
    assert again.values.tobytes() == written.values.tobytes()


def test_symbols_are_drawn_by_their_shares():
    layout = layout_of(10, 4, function_share=0.7)
    rng = generator(3, Stream.START)
    codes = np.stack([draw_chromosome(rng, layout).codes for _ in range(500)])
    head, tail = codes[..., :10], codes[..., 10:]
    nfunction = len(PAPER.functions)
    assert abs(np.mean(head < nfunction) - 0.7) < 0.02
    assert tail.min() == nfunction
    for symbols, low, high in ((head[head < nfunction], 0, nfunction), (tail, nfunction, PAPER.constant + 1)):
        shares = np.bincount(symbols.reshape(-1), minlength=high)[low:high] / symbols.size
        assert np.all(np.abs(shares - 1 / (high - low)) < 0.02), shares


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("+ a a | a a\n+ a a | a a a", "2 genes of 5 symbols"),
        ("+ a a | a a", "2 genes of 5 symbols"),
        ("+ a x | a a\n+ a a | a a", "'x' is no symbol"),
        ("+ a a | + a\n+ a a | a a", "a tail holds a function"),
        ("", "2 genes of 5 symbols"),
    ],
)
def test_what_is_no_chromosome_is_refused(text, told):
    with pytest.raises(InputError, match=re.escape(told)):
        parse_chromosome(layout_of(2, 2), text)


def test_what_breaks_a_chromosome_is_seen():
    layout = layout_of(3, 2)
    whole = draw_chromosome(generator(4, Stream.START), layout)
    assert is_chromosome(layout, whole)
    for at, code in (((0, 3), 0), ((1, 6), 4), ((0, 0), -1), ((0, 0), PAPER.constant + 1)):
        codes = whole.codes.copy()
        codes[at] = code
        assert not is_chromosome(layout, Chromosome(codes, whole.values))
    terminal = np.argwhere(whole.codes < PAPER.constant)[0]
    for broken in (np.nan, 1.0):
        values = whole.values.copy()
        values[tuple(terminal)] = broken
        assert not is_chromosome(layout, Chromosome(whole.codes, values))
    assert not is_chromosome(layout_of(3, 3), whole)
    assert not is_chromosome(layout_of(4, 2), whole)
