"""Selection: who becomes a parent."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


def ranks(
    fitness: npt.NDArray[np.float64], complete: npt.NDArray[np.bool_], nodes: npt.NDArray[np.int64]
) -> npt.NDArray[np.int64]:
    """Rank a population: whoever met all conditions first, then the lower fitness, the fewer nodes, the lower index.

    Args:
        fitness: lower is better; NaN is worst, (population,)
        complete: whether the fitness is over all of the generation's conditions, (population,)
        nodes: size of each genotype, (population,)

    Returns:
        rank of each individual, 0 is the best, (population,)
    """
    order = np.lexsort((nodes, np.where(np.isnan(fitness), np.inf, fitness), ~complete))
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return rank


def tournament(rng: np.random.Generator, rank: npt.NDArray[np.int64], size: int) -> int:
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
