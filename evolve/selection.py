"""Selection: who ranks before whom, who becomes a parent, and what keeps programs small."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from evolve.engine import Choose

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


def ranks(fitness: FloatArray, complete: npt.NDArray[np.bool_], nodes: IntArray) -> IntArray:
    """Rank a population: whoever met all conditions first, then the lower fitness, the fewer nodes, the lower index.

    Nodes decide only between equal fitness, which is lexicographic parsimony pressure without buckets: fitness is a
    real number, so hardly any but true copies in behaviour are ever equal.

    Args:
        fitness: lower is better; NaN is worst, (population,)
        complete: whether the fitness is over all of the generation's conditions, (population,)
        nodes: size of each genotype, (population,)

    Returns:
        rank of each individual, 0 is the best, (population,)
    """
    return _places(np.lexsort((nodes, _worst_for_nan(fitness), ~complete)))


def bucket_ranks(fitness: FloatArray, complete: npt.NDArray[np.bool_], nodes: IntArray, ratio: float) -> IntArray:
    """Rank a population as `ranks` does, but take those of nearly equal place in fitness for equal.

    The worst 1/ratio of the population share one place, then the worst 1/ratio of the rest, and so on: the worse, the
    coarser. Equal fitness is never parted. In a place the fewer nodes come first.

    Args:
        fitness: lower is better; NaN is worst, (population,)
        complete: whether the fitness is over all of the generation's conditions, (population,)
        nodes: size of each genotype, (population,)
        ratio: above 1

    Returns:
        rank of each individual, 0 is the best, (population,)

    Source: Luke & Panait 2002, "Lexicographic parsimony pressure", ratio bucketing.
    """
    worth = _worst_for_nan(fitness)
    order = np.lexsort((worth, ~complete))
    bucket = np.empty(len(order), np.int64)
    left = len(order)
    while left:
        start = min(left - 1, int(left * (1 - 1 / ratio)))
        while start and worth[order[start - 1]] == worth[order[start]]:
            start -= 1
        bucket[order[start:left]] = start
        left = start
    return _places(np.lexsort((worth, nodes, bucket, ~complete)))


def shares(fitness: FloatArray, complete: npt.NDArray[np.bool_]) -> FloatArray:
    """Return each individual's chance to be chosen in proportion to its fitness.

    The adjusted fitness is 1 / (1 + standardised fitness), the share is its part of the population's sum. Standardised
    fitness is the fitness itself, from 0 up; where some is negative the lowest counts as 0. Whoever did not meet all
    conditions counts no better than the worst of those who did. NaN and infinite fitness has no share.

    Args:
        fitness: lower is better, (population,)
        complete: whether the fitness is over all of the generation's conditions, (population,)

    Returns:
        shares that add up to 1; all equal where nobody has any, (population,)

    Source: Kwaśnicka & Woźniak, EMOT, §4; Koza 1992, §6.3.
    """
    worth = _worst_for_nan(fitness)
    finite = np.isfinite(worth)
    if not finite.any():
        return np.full(len(worth), 1 / len(worth))
    worst = worth[complete & finite].max(initial=-np.inf)
    worth = np.where(complete, worth, np.maximum(worth, worst))
    adjusted = np.where(finite, 1 / (1 + worth - min(0.0, worth[finite].min())), 0.0)
    return np.asarray(adjusted / adjusted.sum())


def tournament(rng: np.random.Generator, rank: IntArray, size: int) -> int:
    """Return the best of `size` individuals drawn with replacement.

    Args:
        rng: source of chance
        rank: rank of each individual, 0 is the best, (population,)
        size: how many are drawn

    Returns:
        index of the winner

    Source: Gritz & Hahn 1997, Table 1 (size 6).
    """
    drawn = rng.integers(len(rank), size=size)
    return int(drawn[np.argmin(rank[drawn])])


def roulette(rng: np.random.Generator, wheel: FloatArray) -> int:
    """Return one individual, drawn by its share.

    Args:
        rng: source of chance
        wheel: running sum of the shares, (population,)

    Returns:
        index of the chosen
    """
    return int(np.searchsorted(wheel, rng.random() * wheel[-1], side="right"))


def smaller_of_two(rng: np.random.Generator, choose: Choose, nodes: IntArray, size: float) -> int:
    """Choose two parents and return the smaller with the chance size / 2: a double tournament, fitness first.

    Args:
        rng: source of chance
        choose: the selection by fitness
        nodes: size of each genotype, (population,)
        size: of the tournament by nodes, 1 (blind) to 2 (always the smaller)

    Returns:
        index of the winner; of two of one size either

    Source: Luke & Panait 2002, "Fighting bloat with nonparametric parsimony pressure".
    """
    first, second = choose(rng), choose(rng)
    small, large = (second, first) if nodes[second] < nodes[first] else (first, second)
    return small if rng.random() < size / 2 else large


def condemned(rng: np.random.Generator, nodes: IntArray, share: float) -> npt.NDArray[np.bool_]:
    """Return who of those larger than the average is not even simulated.

    Args:
        rng: source of chance
        nodes: size of each genotype, (population,)
        share: chance of each

    Returns:
        whether each is, (population,)

    Source: Poli 2003, "A simple but theoretically-motivated method to control bloat in genetic programming" (Tarpeian).
    """
    return np.asarray((nodes > nodes.mean()) & (rng.random(len(nodes)) < share))


def _worst_for_nan(fitness: FloatArray) -> FloatArray:
    return np.where(np.isnan(fitness), np.inf, fitness)


def _places(order: npt.NDArray[np.intp]) -> IntArray:
    """Turn an order, best first, into the rank of each."""
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return rank
