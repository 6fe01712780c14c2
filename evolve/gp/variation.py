"""Variation: how children come from parents. Every operator is closed: bounds that hold before hold after."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from evolve.gp.grow import draw_constant, grow_tree, leaf, same_arity
from evolve.gp.tree import Bounds, Genotype, Primitives, Shape, Tree, replace_subtree, shape, subtree

_INNER_SHARE = 0.9  # of crossover points that are functions (Koza 1992, §6.4.1)
_MUTANT_DEPTH = 4
_CONSTANT_REDRAWN = 0.1  # of constants' mutations are new draws
_CONSTANT_STEP = 0.1  # standard deviation of a constant's mutation, as a share of its size and of the range


def pick_node(rng: np.random.Generator, spans: npt.NDArray[np.int64], allowed: npt.NDArray[np.bool_]) -> int:
    """Pick an allowed node: a function nine times in ten where there is one.

    Args:
        rng: source of chance
        spans: nodes of the subtree at each node, (nnode,)
        allowed: which nodes may be picked, at least one, (nnode,)

    Returns:
        the node
    """
    take_inner = rng.random() < _INNER_SHARE
    nodes = np.flatnonzero(allowed & ((spans > 1) == take_inner))
    if not len(nodes):
        nodes = np.flatnonzero(allowed)
    return int(nodes[rng.integers(len(nodes))])


def cross_trees(rng: np.random.Generator, primitives: Primitives, bounds: Bounds, receiver: Tree, donor: Tree) -> Tree:
    """Replace a subtree of the receiver by one of the donor's that the bounds allow there.

    Args:
        rng: source of chance
        primitives: what trees are made of
        bounds: what both parents keep and the child will keep
        receiver: the child's tree but for one subtree
        donor: where that subtree comes from

    Returns:
        the child
    """
    ours, theirs = shape(primitives, receiver), shape(primitives, donor)
    at = pick_node(rng, ours.span, np.ones(len(receiver), np.bool_))
    nodes_room, depth_room = _room(bounds, receiver, ours, at)
    source = pick_node(rng, theirs.span, (theirs.span <= nodes_room) & (theirs.height <= depth_room))
    return replace_subtree(receiver, at, int(ours.span[at]), subtree(donor, source, int(theirs.span[source])))


def crossover(
    rng: np.random.Generator, primitives: Primitives, bounds: Bounds, receiver: Genotype, donor: Genotype
) -> Genotype:
    """Exchange one subtree within one output's expression, never the list itself.

    Args:
        rng: source of chance
        primitives: what trees are made of
        bounds: of each tree
        receiver: the parent that the child resembles
        donor: the parent that gives a subtree of the same output's expression

    Returns:
        the child

    Source: Gritz & Hahn 1995, §4.2.
    """
    output = int(rng.integers(len(receiver)))
    child = cross_trees(rng, primitives, bounds, receiver[output], donor[output])
    return (*receiver[:output], child, *receiver[output + 1 :])


def mutate_subtree(rng: np.random.Generator, primitives: Primitives, bounds: Bounds, parent: Genotype) -> Genotype:
    """Replace a subtree of one tree by a newly grown one."""
    output = int(rng.integers(len(parent)))
    tree = parent[output]
    form = shape(primitives, tree)
    at = pick_node(rng, form.span, np.ones(len(tree), np.bool_))
    nodes_room, depth_room = _room(bounds, tree, form, at)
    inside = Bounds(depth_room, nodes_room)
    graft = grow_tree(rng, primitives, inside, min(_MUTANT_DEPTH, depth_room), full=False)
    return (*parent[:output], replace_subtree(tree, at, int(form.span[at]), graft), *parent[output + 1 :])


def mutate_point(rng: np.random.Generator, primitives: Primitives, parent: Genotype) -> Genotype:
    """Replace one node by another of the same arity."""
    output = int(rng.integers(len(parent)))
    tree = parent[output]
    at = int(rng.integers(len(tree)))
    codes, values = tree.codes.copy(), tree.values.copy()
    if codes[at] < len(primitives.functions):
        choices = same_arity(primitives, int(codes[at]))
        codes[at] = choices[rng.integers(len(choices))]
    else:
        codes[at], values[at] = leaf(rng, primitives)
    return (*parent[:output], Tree(codes, values), *parent[output + 1 :])


def mutate_constant(rng: np.random.Generator, primitives: Primitives, parent: Genotype) -> Genotype:
    """Move one constant a little; a controller without constants stays as it is."""
    places = [(i, at) for i, tree in enumerate(parent) for at in np.flatnonzero(tree.codes == primitives.constant)]
    if not places:
        return parent
    output, at = places[rng.integers(len(places))]
    tree = parent[output]
    old = float(tree.values[at])
    if rng.random() < _CONSTANT_REDRAWN:
        new = draw_constant(rng, primitives)
    else:
        new = nudge(rng, primitives, old)
    values = tree.values.copy()
    values[at] = new
    return (*parent[:output], Tree(tree.codes, values), *parent[output + 1 :])


def nudge(rng: np.random.Generator, primitives: Primitives, old: float) -> np.float32:
    """Return a constant moved a little: a normal step of a tenth of its size and a hundredth of the range.

    Args:
        rng: source of chance
        primitives: which hold the constants' range
        old: the constant

    Returns:
        the new one, within the range, rounded to four decimals
    """
    step = _CONSTANT_STEP * (abs(old) + _CONSTANT_STEP * primitives.constant_max)
    moved = float(np.clip(old + step * rng.standard_normal(), -primitives.constant_max, primitives.constant_max))
    return np.float32(round(moved, 4))


def _room(bounds: Bounds, tree: Tree, form: Shape, at: int) -> tuple[int, int]:
    """Return how many nodes and how much depth a subtree at `at` may have."""
    return bounds.nodes_max - (len(tree) - int(form.span[at])), bounds.depth_max - int(form.depth[at])
