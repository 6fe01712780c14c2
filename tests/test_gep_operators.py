"""Operators do to chromosomes what Ferreira's paper prints, and nothing that breaks one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controller import lower
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
from evolve.gep.operators import (
    exchange,
    insert,
    move_to_front,
    mutate,
    mutate_constants,
    recombine_at_one_point,
    recombine_at_two_points,
    recombine_genes,
    transpose,
    transpose_gene,
    transpose_to_root,
    tune_constant,
)
from evolve.gp.tree import Primitives
from evolve.streams import Stream, generator

LETTERS = "Q+-*/abc"
PAPER = Primitives(("sin", "+", "-", "*", "%"), ("a", "b", "c"), 1.0)
PRIMITIVES = Primitives(("+", "-", "*", "%", "ifltz"), ("t", "a0", "px"), 6.0)
LAYOUT = Layout(PRIMITIVES, 10, 4, 0.5)


def layout_of(head, ngene):
    return Layout(PAPER, head, ngene, 0.5)


def chromosome(letters, ngene):
    """Read a chromosome as Ferreira prints them."""
    codes = np.array([LETTERS.index(letter) for letter in letters], np.int16).reshape(ngene, -1)
    return Chromosome(codes, np.zeros(codes.shape, np.float32))


def letters_of(written):
    return "".join(LETTERS[code] for code in written.codes.reshape(-1))


def same(a, b):
    return a.codes.tobytes() == b.codes.tobytes() and a.values.tobytes() == b.values.tobytes()


def drawn(seed, count=2, layout=LAYOUT):
    rng = generator(seed, Stream.START)
    return [draw_chromosome(rng, layout) for _ in range(count)]


def test_an_insertion_sequence_goes_where_the_paper_puts_it():
    parent = chromosome("*-+*a-+a*bbabbaababab" + "Q**+abQbb*aabbaaaabba", 2)
    child = insert(layout_of(10, 2), parent, 21 + 12, 3, 0, 6)
    assert letters_of(child) == "*-+*a-bba+babbaabababQ**+abQbb*aabbaaaabba"


def test_a_root_insertion_sequence_goes_where_the_paper_puts_it():
    parent = chromosome("-ba*+-+-Q/abababbbaaa" + "Q*b/+bbabbaaaaaaaabbb", 2)
    child = insert(layout_of(10, 2), parent, 21 + 4, 3, 1, 0)
    assert letters_of(child) == "-ba*+-+-Q/abababbbaaa+bbQ*b/+bbaaaaaaaabbb"


def test_a_sequence_that_does_not_fit_the_head_is_cut():
    child = insert(layout_of(4, 1), chromosome("+-*/" + "abcab", 1), 0, 3, 0, 3)
    assert letters_of(child) == "+-*+" + "abcab"
    child = insert(layout_of(4, 1), chromosome("+-*/" + "abcab", 1), 3, 6, 0, 0)
    assert letters_of(child) == "/abc" + "abcab"


def test_a_gene_goes_to_the_front_as_the_paper_prints_it():
    parent = chromosome("*a-*abbab-QQ/aaabbQ+abababb", 3)
    assert letters_of(move_to_front(parent, 1)) == "-QQ/aaabb*a-*abbabQ+abababb"
    assert letters_of(move_to_front(parent, 2)) == "Q+abababb*a-*abbab-QQ/aaabb"


@pytest.mark.parametrize(
    ("mother", "father", "ngene", "begin", "end", "one", "other"),
    [
        ("-b+Qbbabb/aQbbbaab", "/-a/ababb-ba-abaaa", 2, 3, 18, "-b+/ababb-ba-abaaa", "/-aQbbabb/aQbbbaab"),
        (
            "+*a*bbcccac*baQ*acabab",
            "*cbb+cccbcc++**bacbaab",
            2,
            7,
            14,
            "+*a*bbccbcc++*Q*acabab",
            "*cbb+ccccac*ba*bacbaab",
        ),
        (
            "/aa-abaaa/a*bbaaab/Q*+aaaab",
            "/-*/abbabQ+aQbabaa-Q/Qbaaba",
            3,
            9,
            18,
            "/aa-abaaaQ+aQbabaa/Q*+aaaab",
            "/-*/abbab/a*bbaaab-Q/Qbaaba",
        ),
    ],
)
def test_recombination_exchanges_what_the_paper_prints(mother, father, ngene, begin, end, one, other):
    children = exchange(chromosome(mother, ngene), chromosome(father, ngene), begin, end)
    assert tuple(map(letters_of, children)) == (one, other)


OPERATORS = {
    "mutate": lambda rng, layout, one, other: mutate(rng, layout, one, 0.1),
    "transpose": lambda rng, layout, one, other: transpose(rng, layout, one, 4),
    "transpose_to_root": lambda rng, layout, one, other: transpose_to_root(rng, layout, one, 4),
    "transpose_gene": lambda rng, layout, one, other: transpose_gene(rng, layout, one),
    "one_point": lambda rng, layout, one, other: recombine_at_one_point(rng, layout, one, other)[rng.integers(2)],
    "two_points": lambda rng, layout, one, other: recombine_at_two_points(rng, layout, one, other)[rng.integers(2)],
    "genes": lambda rng, layout, one, other: recombine_genes(rng, layout, one, other)[rng.integers(2)],
    "mutate_constants": lambda rng, layout, one, other: mutate_constants(rng, layout, one, 0.5),
    "tune_constant": lambda rng, layout, one, other: tune_constant(rng, layout, one),
}


@settings(derandomize=True, deadline=None, max_examples=150)
@given(
    seed=st.integers(0, 2**32),
    names=st.lists(st.sampled_from(sorted(OPERATORS)), min_size=1, max_size=30),
    head=st.integers(1, 15),
    ngene=st.integers(1, 5),
    functions=st.sampled_from([PRIMITIVES.functions, ("sin",), ("+", "sin"), ("delay", "osc-wave", "interpolate")]),
)
def test_any_sequence_of_operators_leaves_a_program(seed, names, head, ngene, functions):
    layout = Layout(Primitives(functions, ("t", "px"), 6.0), head, ngene, 0.5)
    one, other = drawn(seed, layout=layout)
    rng = generator(seed, Stream.VARIATION)
    for name in names:
        before = Chromosome(one.codes.copy(), one.values.copy()), Chromosome(other.codes.copy(), other.values.copy())
        child = OPERATORS[name](rng, layout, one, other)
        assert same(one, before[0]) and same(other, before[1]), f"{name} changed a parent"
        if child is None:
            continue
        assert is_chromosome(layout, child), name
        assert np.all(np.abs(child.values) <= 6)
        one, other = child, one
    verify(lower(decode(layout, one), layout.primitives.terminals))
    assert same(parse_chromosome(layout, format_chromosome(layout, one)), one)


@settings(derandomize=True, deadline=None, max_examples=60)
@given(seed=st.integers(0, 2**32), name=st.sampled_from(["transpose", "transpose_to_root"]))
def test_transposition_shifts_one_head_and_leaves_the_rest(seed, name):
    (parent,) = drawn(seed, 1)
    child = OPERATORS[name](generator(seed, Stream.VARIATION), LAYOUT, parent, None)
    if child is None:
        return
    np.testing.assert_array_equal(child.codes[:, 10:], parent.codes[:, 10:])
    np.testing.assert_array_equal(child.values[:, 10:], parent.values[:, 10:])
    changed = [g for g in range(4) if child.codes[g].tobytes() != parent.codes[g].tobytes()]
    assert len(changed) <= 1
    for gene in changed:
        if name == "transpose":
            assert child.codes[gene, 0] == parent.codes[gene, 0]
        else:
            assert child.codes[gene, 0] < len(PRIMITIVES.functions)
        # one to four symbols went in, at one place, and what was there moved on
        old, new = parent.codes[gene, :10].tolist(), child.codes[gene, :10].tolist()
        sites = range(1, 10) if name == "transpose" else (0,)
        assert any(
            new == (old[:site] + new[site : site + length] + old[site:])[:10]
            for site in sites
            for length in (1, 2, 3, 4)
        )


def test_every_length_source_and_place_of_transposition_comes_up():
    layout = Layout(PRIMITIVES, 5, 2, 0.5)
    codes = np.full((2, 16), PRIMITIVES.constant, np.int16)
    parent = Chromosome(codes, np.arange(1, 33, dtype=np.float32).reshape(2, 16))  # values tell where they came from
    rng = generator(5, Stream.VARIATION)
    places, sources, lengths = set(), set(), set()
    for _ in range(10_000):
        values = transpose(rng, layout, parent, 4).values
        changed = np.argwhere(values != parent.values)
        if not len(changed):
            continue
        gene, site = changed[0].tolist()
        places.add((gene, site))
        sources.add(int(values[gene, site]))
        if site == 1:
            old, new = parent.values[gene, :5], values[gene, :5]
            lengths.add(next(n for n in range(1, 5) if np.array_equal(new[1 + n :], old[1 : 5 - n])))
    assert places == {(gene, site) for gene in (0, 1) for site in (1, 2, 3, 4)}
    assert sources == set(range(1, 33))
    assert lengths == {1, 2, 3, 4}


def test_without_a_function_or_a_place_nothing_is_transposed():
    rng = generator(6, Stream.VARIATION)
    leaves = Layout(PRIMITIVES, 5, 2, 0.0)
    assert all(transpose_to_root(rng, leaves, draw_chromosome(rng, leaves), 4) is None for _ in range(20))
    short = Layout(PRIMITIVES, 1, 2, 0.5)
    assert transpose(rng, short, draw_chromosome(rng, short), 4) is None
    alone = Layout(PRIMITIVES, 5, 1, 0.5)
    assert transpose_gene(rng, alone, draw_chromosome(rng, alone)) is None


def test_a_gene_is_exchanged_with_that_of_the_same_output():
    mother, father = drawn(7)
    rng = generator(7, Stream.VARIATION)
    seen = set()
    for _ in range(100):
        one, other = recombine_genes(rng, LAYOUT, mother, father)
        changed = np.flatnonzero((one.codes != mother.codes).any(1)).tolist()
        assert len(changed) == 1
        (gene,) = changed
        np.testing.assert_array_equal(one.codes[gene], father.codes[gene])
        np.testing.assert_array_equal(one.values[gene], father.values[gene])
        np.testing.assert_array_equal(other.codes[gene], mother.codes[gene])
        seen.add(gene)
    assert seen == {0, 1, 2, 3}


@pytest.mark.parametrize("recombine", [recombine_at_one_point, recombine_at_two_points])
def test_recombination_keeps_places_and_loses_nothing(recombine):
    mother, father = drawn(8)
    rng = generator(8, Stream.VARIATION)
    for _ in range(100):
        one, other = recombine(rng, LAYOUT, mother, father)
        swapped = (one.codes != mother.codes) | (one.values != mother.values)
        for child, parent, donor in ((one, mother, father), (other, father, mother)):
            np.testing.assert_array_equal(child.values, np.where(swapped, donor.values, parent.values))
            np.testing.assert_array_equal(child.codes, np.where(swapped, donor.codes, parent.codes))
        at = np.flatnonzero(swapped.reshape(-1))
        if recombine is recombine_at_one_point and len(at):
            differ = np.flatnonzero(((mother.codes != father.codes) | (mother.values != father.values)).reshape(-1))
            np.testing.assert_array_equal(at, differ[differ >= at[0]])


def test_each_symbol_mutates_with_the_same_chance():
    parent = drawn(9, 1)[0]
    rng = generator(9, Stream.VARIATION)
    trials, rate = 4000, 0.05
    changed = np.zeros(parent.codes.shape)
    for _ in range(trials):
        child = mutate(rng, LAYOUT, parent, rate)
        if child is not None:
            changed += (child.codes != parent.codes) | (child.values != parent.values)
    share = changed / trials
    # a symbol comes out as it was with its own share, at most 1 in 4 here, a constant never
    assert np.all(share < rate * 1.35) and np.all(share > 0.75 * rate * 0.7)
    assert 0.8 * rate < share.mean() < rate
    assert mutate(rng, LAYOUT, parent, 0.0) is None


def test_constants_mutate_and_nothing_else():
    parent = drawn(10, 1)[0]
    rng = generator(10, Stream.VARIATION)
    is_constant = parent.codes == PRIMITIVES.constant
    changed = np.zeros(parent.codes.shape)
    for _ in range(2000):
        child = mutate_constants(rng, LAYOUT, parent, 0.1)
        if child is not None:
            np.testing.assert_array_equal(child.codes, parent.codes)
            changed += child.values != parent.values
    assert np.all(changed[~is_constant] == 0)
    assert np.all(np.abs(changed[is_constant] / 2000 - 0.1) < 0.03)


def test_tuning_moves_one_expressed_constant_a_little():
    rng = generator(11, Stream.VARIATION)
    moved = 0
    for parent in drawn(11, 200):
        child = tune_constant(rng, LAYOUT, parent)
        is_expressed = np.arange(31) < expressed(LAYOUT, parent)[:, None]
        places = is_expressed & (parent.codes == PRIMITIVES.constant)
        if child is None:
            assert not places.any()
            continue
        np.testing.assert_array_equal(child.codes, parent.codes)
        changed = child.values != parent.values
        assert np.count_nonzero(changed) <= 1 and not np.any(changed & ~places)
        for at in np.argwhere(changed):
            old, new = parent.values[tuple(at)], child.values[tuple(at)]
            assert abs(new - old) < 6 * 0.1 * (abs(old) + 0.6)
            moved += 1
    assert moved > 100
