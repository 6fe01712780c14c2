"""Trees are prefix vectors: measured by a recursive oracle, converted to sources that read as they should."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controller.source import Apply, Constant, Name
from evolve.gp.grow import grow_tree, ramped_half_and_half
from evolve.gp.tree import (
    Bounds,
    Primitives,
    Tree,
    from_source,
    genotype_key,
    is_tree,
    replace_subtree,
    shape,
    subtree,
    to_expression,
    to_source,
    within,
)
from evolve.streams import Stream, generator

PRIMITIVES = Primitives(("+", "-", "*", "%", "ifltz"), ("t", "a0", "px"), 30.0)
BOUNDS = Bounds(17, 200)
PLUS, MINUS, IFLTZ, T, A0, PX, CONSTANT = 0, 1, 4, 5, 6, 7, 8


def tree(*nodes):
    """Write a tree as codes; a float is a constant."""
    codes = [CONSTANT if isinstance(node, float) else node for node in nodes]
    values = [node if isinstance(node, float) else 0.0 for node in nodes]
    return Tree(np.array(codes, np.int16), np.array(values, np.float32))


def nested(expression):
    """Measure an expression the slow way: (nodes, height) by recursion."""
    if not isinstance(expression, Apply):
        return 1, 0
    parts = [nested(operand) for operand in expression.operands]
    return 1 + sum(p[0] for p in parts), 1 + max(p[1] for p in parts)


def subexpressions(expression, depth=0):
    """Yield every subexpression in prefix order with its depth."""
    yield expression, depth
    if isinstance(expression, Apply):
        for operand in expression.operands:
            yield from subexpressions(operand, depth + 1)


def test_a_hand_written_tree_reads_as_written():
    written = tree(PLUS, A0, IFLTZ, PX, -28.4382, MINUS, T, A0)
    assert to_expression(PRIMITIVES, written) == Apply(
        "+",
        (
            Name("a0"),
            Apply("ifltz", (Name("px"), Constant(np.float32(-28.4382)), Apply("-", (Name("t"), Name("a0"))))),
        ),
    )


@settings(derandomize=True, deadline=None)
@given(seed=st.integers(0, 2**32), depth=st.integers(0, 9), full=st.booleans())
def test_shape_agrees_with_recursion(seed, depth, full):
    drawn = grow_tree(generator(seed, Stream.START), PRIMITIVES, BOUNDS, depth, full=full)
    assert is_tree(PRIMITIVES, drawn)
    form = shape(PRIMITIVES, drawn)
    expected = [(*nested(e), level) for e, level in subexpressions(to_expression(PRIMITIVES, drawn))]
    assert list(zip(form.span.tolist(), form.height.tolist(), form.depth.tolist(), strict=True)) == expected


@settings(derandomize=True, deadline=None)
@given(seed=st.integers(0, 2**32), depth=st.integers(0, 17), full=st.booleans(), nodes=st.integers(1, 60))
def test_grown_trees_keep_their_bounds(seed, depth, full, nodes):
    bounds = Bounds(depth, nodes)
    drawn = grow_tree(generator(seed, Stream.START), PRIMITIVES, bounds, depth, full=full)
    assert is_tree(PRIMITIVES, drawn)
    assert within(PRIMITIVES, bounds, drawn)
    assert np.all(np.abs(drawn.values) <= 30)


def test_full_trees_are_full_and_grown_ones_are_not_all():
    rng = generator(1, Stream.START)
    full = [grow_tree(rng, PRIMITIVES, Bounds(17, 2000), 5, full=True) for _ in range(50)]
    for drawn in full:
        form = shape(PRIMITIVES, drawn)
        assert set(form.depth[form.span == 1].tolist()) == {5}
    grown = [grow_tree(rng, PRIMITIVES, Bounds(17, 2000), 5, full=False) for _ in range(50)]
    assert min(len(drawn) for drawn in grown) < min(len(drawn) for drawn in full)
    assert all(len(drawn) > 1 for drawn in grown), "a grown tree has a function at its root"


def test_the_start_is_ramped_and_distinct():
    genotypes = ramped_half_and_half(generator(3, Stream.START), PRIMITIVES, BOUNDS, (2, 6), 3, 200)
    assert len({genotype_key(g) for g in genotypes}) == 200
    assert all(len(g) == 3 for g in genotypes)
    heights = [{int(shape(PRIMITIVES, drawn).height[0]) for drawn in g} for g in genotypes[::2]]
    ternary_free = [h for h in heights if len(h) == 1]
    assert {min(h) for h in ternary_free} == {2, 3, 4, 5, 6}


def test_replacing_a_subtree_by_itself_changes_nothing():
    drawn = grow_tree(generator(5, Stream.START), PRIMITIVES, BOUNDS, 5, full=True)
    form = shape(PRIMITIVES, drawn)
    for at, span in enumerate(form.span.tolist()):
        same = replace_subtree(drawn, at, span, subtree(drawn, at, span))
        assert genotype_key((same,)) == genotype_key((drawn,))


@pytest.mark.parametrize(
    "broken",
    [
        tree(PLUS, T),
        tree(T, T),
        tree(),
        tree(IFLTZ, T, T),
        Tree(np.array([99], np.int16), np.zeros(1, np.float32)),
        Tree(np.array([T], np.int16), np.ones(1, np.float32)),
        Tree(np.array([CONSTANT], np.int16), np.array([np.nan], np.float32)),
    ],
)
def test_what_is_no_tree(broken):
    assert not is_tree(PRIMITIVES, broken)


def test_a_deep_tree_converts_without_recursion():
    depth = 20_000
    chain = tree(*([PLUS] * depth), *([T] * (depth + 1)))
    expression = to_source(PRIMITIVES, (chain,)).outputs[0]
    for _ in range(depth):
        expression = expression.operands[0]
    assert expression == Name("t")


def test_keys_tell_genotypes_apart():
    a, b = tree(PLUS, T, T), tree(PLUS, T, A0)
    assert genotype_key((a, b)) != genotype_key((b, a))
    assert genotype_key((tree(1.0),)) != genotype_key((tree(2.0),))


@pytest.mark.parametrize("seed", range(20))
def test_a_genotype_comes_back_from_its_source(seed):
    rng = generator(seed, Stream.START)
    for genotype in ramped_half_and_half(rng, PRIMITIVES, BOUNDS, (0, 6), 3, 20):
        assert genotype_key(from_source(PRIMITIVES, to_source(PRIMITIVES, genotype))) == genotype_key(genotype)
