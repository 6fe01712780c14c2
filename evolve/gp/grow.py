"""New trees: Koza's full and grow methods, ramped half and half."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from evolve.gp.tree import Bounds, Genotype, Primitives, Tree, genotype_key

_DISTINCT_TRIES_MAX = 100


def draw_constant(rng: np.random.Generator, primitives: Primitives) -> np.float32:
    """Draw an ephemeral constant, rounded to four decimals as the papers print theirs."""
    return np.float32(round(float(rng.uniform(-primitives.constant_max, primitives.constant_max)), 4))


def grow_tree(rng: np.random.Generator, primitives: Primitives, bounds: Bounds, depth: int, *, full: bool) -> Tree:
    """Draw a tree.

    Args:
        rng: source of chance
        primitives: what trees are made of
        bounds: the most a tree may be; functions that would overrun its nodes are not drawn
        depth: edges from the root to the deepest leaf: exactly (full), or at most
        full: draw functions at every node above `depth`; else any primitive (but a function at the root)

    Returns:
        the tree

    Source: Koza 1992, §6.2.
    """
    arities = primitives.arities
    nfunction = len(primitives.functions)
    codes: list[int] = []
    values: list[np.float32] = []
    pending = [0]  # depths of the nodes still to draw, the next one last
    while pending:
        level = pending.pop()
        room = bounds.nodes_max - len(codes) - len(pending) - 1  # nodes free for this one's operands
        fitting = [code for code in range(nfunction) if arities[code] <= room] if level < depth else []
        leaves = primitives.constant + 1 - nfunction
        pick = int(rng.integers(len(fitting) + (0 if fitting and (full or level == 0) else leaves)))
        code = fitting[pick] if pick < len(fitting) else nfunction + pick - len(fitting)
        codes.append(code)
        values.append(draw_constant(rng, primitives) if code == primitives.constant else np.float32(0))
        pending.extend([level + 1] * arities[code])
    return Tree(np.array(codes, np.int16), np.array(values, np.float32))


def ramped_half_and_half(
    rng: np.random.Generator,
    primitives: Primitives,
    bounds: Bounds,
    depths: tuple[int, int],
    noutput: int,
    population: int,
) -> list[Genotype]:
    """Draw a starting population, depths in equal shares, half of them full, all different as far as chance allows.

    Args:
        rng: source of chance
        primitives: what trees are made of
        bounds: the most a tree may be
        depths: smallest and largest depth
        noutput: trees of a genotype
        population: genotypes

    Returns:
        the population, (population,)

    Source: Koza 1992, §6.2.
    """
    low, high = depths
    seen: set[bytes] = set()
    genotypes: list[Genotype] = []
    for index in range(population):
        depth = low + (index // 2) % (high - low + 1)
        for _ in range(_DISTINCT_TRIES_MAX):
            genotype = tuple(grow_tree(rng, primitives, bounds, depth, full=index % 2 == 0) for _ in range(noutput))
            if genotype_key(genotype) not in seen:
                break
        seen.add(genotype_key(genotype))
        genotypes.append(genotype)
    return genotypes


def leaf(rng: np.random.Generator, primitives: Primitives) -> tuple[int, np.float32]:
    """Draw a leaf: its code and its value."""
    code = int(rng.integers(len(primitives.functions), primitives.constant + 1))
    return code, draw_constant(rng, primitives) if code == primitives.constant else np.float32(0)


def same_arity(primitives: Primitives, code: int) -> npt.NDArray[np.int64]:
    """Return the function codes that may stand in the place of a function."""
    arities = np.array(primitives.arities[: len(primitives.functions)])
    return np.flatnonzero(arities == primitives.arities[code])
