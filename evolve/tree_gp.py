"""Tree genetic programming: how a population starts, and how the next one comes from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from controller.source import Source
from evolve.grow import ramped_half_and_half
from evolve.selection import tournament
from evolve.settings import Settings
from evolve.tree import Bounds, Genotype, Primitives, to_source
from evolve.variation import crossover, mutate_constant, mutate_point, mutate_subtree

FUNCTIONS = ("+", "-", "*", "%", "ifltz")


@dataclass(frozen=True, eq=False)
class Individual:
    """Hold one member of a population and how it came to be.

    Args:
        genotype: its trees
        operator: "start", "elite", "crossover", "reproduction" or a mutation's name
        parents: individuals of the generation before
    """

    genotype: Genotype
    operator: str
    parents: tuple[int, ...]

    @property
    def nodes(self) -> int:
        """Return the nodes of all its trees."""
        return sum(len(tree) for tree in self.genotype)


@dataclass(frozen=True)
class TreeGp:
    """Hold what tree genetic programming needs to know of a run.

    Args:
        primitives: what trees are made of
        bounds: of each tree
        noutput: trees of a genotype
        settings: the run's numbers
    """

    primitives: Primitives
    bounds: Bounds
    noutput: int
    settings: Settings


def tree_gp(terminals: Sequence[str], noutput: int, settings: Settings) -> TreeGp:
    """Return tree genetic programming over the papers' function set.

    Args:
        terminals: names of the inputs
        noutput: outputs of a controller
        settings: the run's numbers

    Returns:
        what `start`, `breed` and `source` take
    """
    return TreeGp(
        Primitives(FUNCTIONS, tuple(terminals), settings.constant_max),
        Bounds(settings.depth_max, settings.nodes_max),
        noutput,
        settings,
    )


def start(rng: np.random.Generator, gp: TreeGp) -> list[Individual]:
    """Draw the first population, ramped half and half.

    Args:
        rng: source of chance
        gp: the method

    Returns:
        the population, (population,)
    """
    depths = gp.settings.grow_depth_low, gp.settings.grow_depth_high
    genotypes = ramped_half_and_half(rng, gp.primitives, gp.bounds, depths, gp.noutput, gp.settings.population)
    return [Individual(genotype, "start", ()) for genotype in genotypes]


def breed(
    rng: np.random.Generator, gp: TreeGp, population: Sequence[Individual], rank: npt.NDArray[np.int64]
) -> list[Individual]:
    """Return the next population: the elite, then children of tournament winners.

    Args:
        rng: source of chance
        gp: the method
        population: the parents, (population,)
        rank: rank of each, 0 is the best, (population,)

    Returns:
        the children, (population,)
    """
    elite = np.argsort(rank)[: gp.settings.elites].tolist()
    children = [Individual(population[index].genotype, "elite", (index,)) for index in elite]
    while len(children) < gp.settings.population:
        children.append(_child(rng, gp, population, rank))
    return children


def source(gp: TreeGp, individual: Individual) -> Source:
    """Return an individual's controller as source."""
    return to_source(gp.primitives, individual.genotype)


def _child(
    rng: np.random.Generator, gp: TreeGp, population: Sequence[Individual], rank: npt.NDArray[np.int64]
) -> Individual:
    """Draw an operator by its share, and its parents by tournament."""
    numbers = gp.settings
    draw = rng.random()
    mother = tournament(rng, rank, numbers.tournament)
    genotype = population[mother].genotype
    if draw < numbers.crossover:
        father = tournament(rng, rank, numbers.tournament)
        child = crossover(rng, gp.primitives, gp.bounds, genotype, population[father].genotype)
        return Individual(child, "crossover", (mother, father))
    draw -= numbers.crossover
    if draw < numbers.mutate_subtree:
        return Individual(mutate_subtree(rng, gp.primitives, gp.bounds, genotype), "mutate_subtree", (mother,))
    draw -= numbers.mutate_subtree
    if draw < numbers.mutate_point:
        return Individual(mutate_point(rng, gp.primitives, genotype), "mutate_point", (mother,))
    draw -= numbers.mutate_point
    if draw < numbers.mutate_constant:
        return Individual(mutate_constant(rng, gp.primitives, genotype), "mutate_constant", (mother,))
    return Individual(genotype, "reproduction", (mother,))
