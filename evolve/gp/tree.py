"""Expression trees as flat prefix vectors, one for each output of a controller."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from controller.errors import InputError
from controller.operations import BY_NAME
from controller.source import Apply, Constant, Expression, Name, Source


@dataclass(frozen=True)
class Primitives:
    """Hold what trees are made of; a node's code is its index in functions, then terminals, then the constant.

    Args:
        functions: names of operations
        terminals: names of inputs
        constant_max: ephemeral constants lie in ±constant_max
    """

    functions: tuple[str, ...]
    terminals: tuple[str, ...]
    constant_max: float

    @cached_property
    def arities(self) -> tuple[int, ...]:
        """Return the number of operands of each code."""
        return (*(BY_NAME[name].arity for name in self.functions), *(0 for _ in self.terminals), 0)

    @cached_property
    def constant(self) -> int:
        """Return the code of an ephemeral constant."""
        return len(self.functions) + len(self.terminals)

    @cached_property
    def leaves(self) -> tuple[Name, ...]:
        """Return the expression of each terminal, (nterminal,)."""
        return tuple(Name(name) for name in self.terminals)


@dataclass(frozen=True)
class Bounds:
    """Bound a tree.

    Args:
        depth_max: edges from the root to the deepest leaf
        nodes_max: nodes
    """

    depth_max: int
    nodes_max: int


@dataclass(frozen=True, eq=False)
class Tree:
    """Hold one expression in prefix order.

    Args:
        codes: code of each node, int16, (nnode,)
        values: value of each constant, 0 at every other node, float32, (nnode,)
    """

    codes: npt.NDArray[np.int16]
    values: npt.NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.codes)


Genotype: TypeAlias = tuple[Tree, ...]
"""One tree for each output."""


@dataclass(frozen=True, eq=False)
class Shape:
    """Hold what variation needs to know of a tree's nodes.

    Args:
        span: nodes of the subtree at each node, (nnode,)
        height: edges from each node down to its deepest leaf, (nnode,)
        depth: edges from the root down to each node, (nnode,)
    """

    span: npt.NDArray[np.int64]
    height: npt.NDArray[np.int64]
    depth: npt.NDArray[np.int64]


def shape(primitives: Primitives, tree: Tree) -> Shape:
    """Measure every subtree of a tree in one pass up and one pass down."""
    arities = primitives.arities
    codes = tree.codes.tolist()
    count = len(codes)
    span, height, depth = [1] * count, [0] * count, [0] * count
    for node in range(count - 1, -1, -1):
        arity = arities[codes[node]]
        if arity:
            child, below = node + 1, 0
            for _ in range(arity):
                below = max(below, height[child])
                child += span[child]
            span[node], height[node] = child - node, below + 1
    for node in range(count):
        if span[node] > 1:
            child, level = node + 1, depth[node] + 1
            end = node + span[node]
            while child < end:
                depth[child] = level
                child += span[child]
    return Shape(np.array(span), np.array(height), np.array(depth))


def is_tree(primitives: Primitives, tree: Tree) -> bool:
    """Return whether the vectors hold exactly one whole expression of these primitives."""
    if not len(tree) or len(tree.codes) != len(tree.values):
        return False
    if tree.codes.min() < 0 or tree.codes.max() > primitives.constant:
        return False
    open_operands = 1
    for code in tree.codes.tolist():
        if open_operands == 0:
            return False
        open_operands += primitives.arities[code] - 1
    is_constant = tree.codes == primitives.constant
    return open_operands == 0 and bool(np.all(is_constant | (tree.values == 0)) and np.all(np.isfinite(tree.values)))


def within(primitives: Primitives, bounds: Bounds, tree: Tree) -> bool:
    """Return whether a tree keeps the bounds."""
    return len(tree) <= bounds.nodes_max and int(shape(primitives, tree).height[0]) <= bounds.depth_max


def replace_subtree(tree: Tree, at: int, span: int, graft: Tree) -> Tree:
    """Return the tree with the `span` nodes from `at` on replaced by a whole other tree."""
    return Tree(
        np.concatenate((tree.codes[:at], graft.codes, tree.codes[at + span :])),
        np.concatenate((tree.values[:at], graft.values, tree.values[at + span :])),
    )


def subtree(tree: Tree, at: int, span: int) -> Tree:
    """Return the subtree of `span` nodes at node `at`."""
    return Tree(tree.codes[at : at + span], tree.values[at : at + span])


def to_expression(primitives: Primitives, tree: Tree) -> Expression:
    """Convert prefix vectors to an expression: last node first, each function taking its operands from the stack."""
    nfunction, constant = len(primitives.functions), primitives.constant
    functions, arities, leaves, values = primitives.functions, primitives.arities, primitives.leaves, tree.values
    stack: list[Expression] = []
    push, pop = stack.append, stack.pop
    at = len(values)
    for code in reversed(tree.codes.tolist()):
        at -= 1
        if code == constant:
            push(Constant(values[at]))
        elif code >= nfunction:
            push(leaves[code - nfunction])
        elif arities[code] == 2:
            push(Apply(functions[code], (pop(), pop())))
        else:
            push(Apply(functions[code], tuple([pop() for _ in range(arities[code])])))
    return pop()


def to_source(primitives: Primitives, genotype: Genotype) -> Source:
    """Convert a genotype to the controller's source, one expression for each output."""
    return Source(tuple(to_expression(primitives, tree) for tree in genotype))


def from_source(primitives: Primitives, source: Source) -> Genotype:
    """Convert a controller's source back to the genotype that `to_source` gave it.

    Args:
        primitives: what the trees are made of
        source: one expression for each output, without definitions

    Returns:
        the genotype

    Raises:
        InputError: the source holds what no tree of these primitives does
    """
    if source.definitions:
        raise InputError("trees have no definitions; write every expression out")
    return tuple(_from_expression(primitives, expression) for expression in source.outputs)


def _from_expression(primitives: Primitives, root: Expression) -> Tree:
    """Convert an expression to prefix vectors, with a stack of its own."""
    codes: list[int] = []
    values: list[np.float32] = []
    pending = [root]
    while pending:
        node = pending.pop()
        value = np.float32(0)
        match node:
            case Apply(operation=operation, operands=operands):
                if operation not in primitives.functions:
                    raise InputError(f"'{operation}' is no function here; use only {' '.join(primitives.functions)}")
                codes.append(primitives.functions.index(operation))
                pending.extend(reversed(operands))
            case Name(name=name):
                codes.append(len(primitives.functions) + primitives.terminals.index(name))
            case Constant():
                codes.append(primitives.constant)
                value = node.value
        values.append(value)
    return Tree(np.array(codes, np.int16), np.array(values, np.float32))


def genotype_key(genotype: Genotype) -> bytes:
    """Return bytes that are equal exactly for equal genotypes."""
    return b"".join(len(tree).to_bytes(4, "little") + tree.codes.tobytes() + tree.values.tobytes() for tree in genotype)
