"""Variation is closed: valid, bounded parents have valid, bounded children, and chance comes from `rng` alone."""

from __future__ import annotations

from collections import Counter

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from evolve.gp.grow import ramped_half_and_half
from evolve.gp.tree import Bounds, Primitives, genotype_key, is_tree, shape, subtree, within
from evolve.gp.variation import cross_trees, crossover, mutate_constant, mutate_point, mutate_subtree, pick_node
from evolve.streams import Stream, generator

PRIMITIVES = Primitives(("+", "-", "*", "%", "ifltz"), ("t", "a0", "a1", "px"), 30.0)


def start(seed, bounds, depth_high=6, population=12):
    return ramped_half_and_half(generator(seed, Stream.START), PRIMITIVES, bounds, (2, depth_high), 3, population)


def keys_of_subtrees(tree):
    spans = shape(PRIMITIVES, tree).span.tolist()
    return {genotype_key((subtree(tree, at, span),)) for at, span in enumerate(spans)}


@settings(derandomize=True, deadline=None, max_examples=60)
@given(seed=st.integers(0, 2**32), depth=st.integers(6, 8), nodes=st.integers(20, 60))
def test_operators_keep_trees_whole_and_bounded_over_many_generations(seed, depth, nodes):
    bounds = Bounds(depth, nodes)
    population = start(seed, bounds)
    rng = generator(seed, Stream.VARIATION)
    for _ in range(8):
        children = []
        for index in range(len(population)):
            mother = population[index]
            father = population[int(rng.integers(len(population)))]
            child = crossover(rng, PRIMITIVES, bounds, mother, father)
            child = mutate_subtree(rng, PRIMITIVES, bounds, child)
            child = mutate_point(rng, PRIMITIVES, child)
            children.append(mutate_constant(rng, PRIMITIVES, child))
        population = children
        for genotype in population:
            assert len(genotype) == 3
            for tree in genotype:
                assert is_tree(PRIMITIVES, tree)
                assert within(PRIMITIVES, bounds, tree)
                assert np.all(np.abs(tree.values) <= 30)


def test_a_child_is_its_mother_but_for_a_subtree_of_its_father():
    bounds = Bounds(17, 200)
    mother, father = start(11, bounds)[:2]
    rng = generator(11, Stream.VARIATION)
    for _ in range(200):
        child = crossover(rng, PRIMITIVES, bounds, mother, father)
        changed = [i for i in range(3) if genotype_key((child[i],)) != genotype_key((mother[i],))]
        assert len(changed) <= 1
        for i in changed:
            ours, theirs = mother[i], child[i]
            same_start = int(np.argmin(np.append(ours.codes[: len(theirs)] == theirs.codes[: len(ours)], False)))
            spans = shape(PRIMITIVES, theirs).span
            grafts = [
                genotype_key((subtree(theirs, at, int(spans[at])),)) for at in range(min(same_start + 1, len(spans)))
            ]
            assert set(grafts) & keys_of_subtrees(father[i]) or set(grafts) & keys_of_subtrees(mother[i])


def test_parents_are_left_alone():
    bounds = Bounds(17, 200)
    mother, father = start(12, bounds)[:2]
    before = genotype_key(mother), genotype_key(father)
    rng = generator(12, Stream.VARIATION)
    for _ in range(50):
        crossover(rng, PRIMITIVES, bounds, mother, father)
        mutate_subtree(rng, PRIMITIVES, bounds, mother)
        mutate_point(rng, PRIMITIVES, mother)
        mutate_constant(rng, PRIMITIVES, mother)
    assert (genotype_key(mother), genotype_key(father)) == before


def test_a_full_receiver_still_takes_something():
    bounds = Bounds(3, 15)
    receiver, donor = (g[0] for g in start(13, bounds, depth_high=3)[:2])
    rng = generator(13, Stream.VARIATION)
    children = [cross_trees(rng, PRIMITIVES, bounds, receiver, donor) for _ in range(100)]
    assert all(within(PRIMITIVES, bounds, child) for child in children)
    assert len({genotype_key((child,)) for child in children}) > 10


def test_nine_crossover_points_in_ten_are_functions():
    tree = start(14, Bounds(17, 200))[-2][0]
    spans = shape(PRIMITIVES, tree).span
    rng = generator(14, Stream.VARIATION)
    picked = Counter(bool(spans[pick_node(rng, spans, np.ones(len(tree), np.bool_))] > 1) for _ in range(2000))
    assert 0.87 < picked[True] / 2000 < 0.93


def test_a_constant_moves_and_nothing_else():
    rng = generator(15, Stream.VARIATION)
    for genotype in start(15, Bounds(17, 200)):
        child = mutate_constant(rng, PRIMITIVES, genotype)
        assert all(np.array_equal(a.codes, b.codes) for a, b in zip(genotype, child, strict=True))
        changed = sum(int(np.sum(a.values != b.values)) for a, b in zip(genotype, child, strict=True))
        constants = sum(int(np.sum(tree.codes == PRIMITIVES.constant)) for tree in genotype)
        assert changed <= min(1, constants)


def test_point_mutation_keeps_the_form():
    rng = generator(16, Stream.VARIATION)
    for genotype in start(16, Bounds(17, 200)) * 5:
        child = mutate_point(rng, PRIMITIVES, genotype)
        for a, b in zip(genotype, child, strict=True):
            assert np.array_equal(shape(PRIMITIVES, a).span, shape(PRIMITIVES, b).span)


def test_the_same_chance_gives_the_same_child():
    bounds = Bounds(17, 200)
    mother, father = start(17, bounds)[:2]
    children = [
        genotype_key(crossover(generator(seed, Stream.VARIATION, 4), PRIMITIVES, bounds, mother, father))
        for seed in (1, 1, 2, 3, 4)
    ]
    assert children[0] == children[1]
    assert len(set(children)) > 2
