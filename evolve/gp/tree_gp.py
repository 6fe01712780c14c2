"""Tree genetic programming: how a population starts, and how the next one comes from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from controller import format_source, parse
from controller.errors import InputError
from controller.source import Source
from evolve.engine import Choose, Individual
from evolve.gp.grow import ramped_half_and_half
from evolve.gp.tree import Bounds, Genotype, Primitives, from_source, to_source
from evolve.gp.variation import crossover, mutate_constant, mutate_point, mutate_subtree
from evolve.settings import Settings

FUNCTIONS = ("+", "-", "*", "%", "ifltz")


@dataclass(frozen=True)
class TreeGp:
    """Breed lists of expression trees by tree genetic programming: an `evolve.engine.Engine`.

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

    @property
    def name(self) -> str:
        """Return the name that `--engine` takes."""
        return "gp"

    def start(self, rng: np.random.Generator) -> list[Individual]:
        """Draw the first population, ramped half and half, (population,)."""
        depths = self.settings.grow_depth_low, self.settings.grow_depth_high
        genotypes = ramped_half_and_half(
            rng, self.primitives, self.bounds, depths, self.noutput, self.settings.population
        )
        return [Individual(genotype, "start", ()) for genotype in genotypes]

    def breed(
        self, rng: np.random.Generator, population: Sequence[Individual], choose: Choose, elite: Sequence[int]
    ) -> list[Individual]:
        """Return the next population, (population,): the elite as they are, then children of chosen parents."""
        children = [Individual(population[index].genotype, "elite", (index,)) for index in elite]
        while len(children) < self.settings.population:
            children.append(self._child(rng, population, choose))
        return children

    def source(self, individual: Individual) -> Source:
        """Return an individual's controller as source."""
        return to_source(self.primitives, individual.genotype)

    def nodes(self, individual: Individual) -> int:
        """Return the nodes of all its trees."""
        return sum(len(tree) for tree in individual.genotype)

    def write(self, individual: Individual) -> str:
        """Return the trees as the controller's text."""
        return format_source(self.source(individual))

    def read(self, text: str) -> Genotype:
        """Return the trees of a text that `write` wrote, bit for bit."""
        source = parse(text, self.primitives.terminals)
        if len(source.outputs) != self.noutput:
            raise InputError(
                f"a genotype here has {self.noutput} trees, not {len(source.outputs)}; give one of this run"
            )
        return from_source(self.primitives, source)

    def _child(self, rng: np.random.Generator, population: Sequence[Individual], choose: Choose) -> Individual:
        """Draw an operator by its share, and choose its parents."""
        numbers = self.settings
        draw = rng.random()
        mother = choose(rng)
        genotype = population[mother].genotype
        if draw < numbers.crossover:
            father = choose(rng)
            child = crossover(rng, self.primitives, self.bounds, genotype, population[father].genotype)
            return Individual(child, "crossover", (mother, father))
        draw -= numbers.crossover
        if draw < numbers.mutate_subtree:
            return Individual(mutate_subtree(rng, self.primitives, self.bounds, genotype), "mutate_subtree", (mother,))
        draw -= numbers.mutate_subtree
        if draw < numbers.mutate_point:
            return Individual(mutate_point(rng, self.primitives, genotype), "mutate_point", (mother,))
        draw -= numbers.mutate_point
        if draw < numbers.mutate_constant:
            return Individual(mutate_constant(rng, self.primitives, genotype), "mutate_constant", (mother,))
        return Individual(genotype, "reproduction", (mother,))


def tree_gp(terminals: Sequence[str], noutput: int, settings: Settings) -> TreeGp:
    """Return tree genetic programming over the papers' function set.

    Args:
        terminals: names of the inputs
        noutput: outputs of a controller
        settings: the run's numbers

    Returns:
        the engine
    """
    return TreeGp(
        Primitives(FUNCTIONS, tuple(terminals), settings.constant_max),
        Bounds(settings.depth_max, settings.nodes_max),
        noutput,
        settings,
    )
