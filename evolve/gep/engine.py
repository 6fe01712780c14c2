"""Gene expression programming: how a population starts, and how the next one comes from it.

Rates are those of EMOT's Table 2; how what it leaves open is read here is said in docs/gep.md.

Source: Ferreira 2001; Kwaśnicka & Woźniak, EMOT, §4.2 and Table 2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from controller.source import Source
from evolve.engine import Choose, Individual
from evolve.gep.chromosome import (
    Chromosome,
    Layout,
    decode,
    draw_chromosome,
    expressed,
    format_chromosome,
    parse_chromosome,
)
from evolve.gep.operators import (
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
from evolve.gp.tree_gp import FUNCTIONS
from evolve.settings import Settings

_COPIED = "reproduction"

_Vary: TypeAlias = Callable[[Chromosome], Chromosome | None]
_Recombine: TypeAlias = Callable[[np.random.Generator, Layout, Chromosome, Chromosome], tuple[Chromosome, Chromosome]]


@dataclass(frozen=True)
class Gep:
    """Breed chromosomes by gene expression programming: an `evolve.engine.Engine`.

    Args:
        layout: of the chromosomes
        settings: the run's numbers
    """

    layout: Layout
    settings: Settings

    @property
    def name(self) -> str:
        """Return the name that `--engine` takes."""
        return "gep"

    def start(self, rng: np.random.Generator) -> list[Individual]:
        """Draw the first population, (population,)."""
        return [Individual(draw_chromosome(rng, self.layout), "start", ()) for _ in range(self.settings.population)]

    def breed(
        self, rng: np.random.Generator, population: Sequence[Individual], choose: Choose, elite: Sequence[int]
    ) -> list[Individual]:
        """Return the next population, (population,): the elite as they are, and copies of chosen parents that vary.

        Unlike in tree genetic programming a child may meet several operators, each by its own chance (Ferreira 2001,
        §5), in the order of EMOT's Table 2.
        """
        elites = [Individual(population[index].genotype, "elite", (index,)) for index in elite]
        chosen = [choose(rng) for _ in range(self.settings.population - len(elites))]
        brood = [Individual(population[index].genotype, _COPIED, (index,)) for index in chosen]
        numbers, layout = self.settings, self.layout
        alone: tuple[tuple[str, float, _Vary], ...]
        alone = (
            ("mutation", 1.0, lambda old: mutate(rng, layout, old, numbers.gep_mutation)),
            ("is", numbers.gep_is, lambda old: transpose(rng, layout, old, numbers.gep_is_length_max)),
            ("ris", numbers.gep_ris, lambda old: transpose_to_root(rng, layout, old, numbers.gep_ris_length_max)),
            ("gene_transposition", numbers.gep_gene_transposition, lambda old: transpose_gene(rng, layout, old)),
        )
        for name, rate, vary in alone:
            brood = _vary_each(rng, brood, name, rate, vary)
        brood = _vary_pairs(rng, layout, brood, "one_point", numbers.gep_one_point, recombine_at_one_point)
        brood = _vary_pairs(rng, layout, brood, "two_point", numbers.gep_two_point, recombine_at_two_points)
        brood = _vary_pairs(rng, layout, brood, "gene", numbers.gep_gene, recombine_genes)
        alone = (
            ("constant_mutation", 1.0, lambda old: mutate_constants(rng, layout, old, numbers.gep_constant_mutation)),
            ("constant_tuning", numbers.gep_constant_tuning, lambda old: tune_constant(rng, layout, old)),
        )
        for name, rate, vary in alone:
            brood = _vary_each(rng, brood, name, rate, vary)
        return elites + brood

    def source(self, individual: Individual) -> Source:
        """Return an individual's controller as source."""
        return decode(self.layout, individual.genotype)

    def nodes(self, individual: Individual) -> int:
        """Return the symbols that its genes' expressions take."""
        return int(expressed(self.layout, individual.genotype).sum())

    def write(self, individual: Individual) -> str:
        """Return the chromosome as text, what is not expressed too."""
        return format_chromosome(self.layout, individual.genotype)

    def read(self, text: str) -> Chromosome:
        """Return the chromosome of a text that `write` wrote, bit for bit."""
        return parse_chromosome(self.layout, text)


def gep(terminals: Sequence[str], noutput: int, settings: Settings) -> Gep:
    """Return gene expression programming over EMOT's function set, one gene for each output.

    Args:
        terminals: names of the inputs
        noutput: outputs of a controller
        settings: the run's numbers

    Returns:
        the engine
    """
    primitives = Primitives(FUNCTIONS, tuple(terminals), settings.constant_max)
    return Gep(Layout(primitives, settings.gep_head, noutput, settings.gep_function_share), settings)


def _vary_each(
    rng: np.random.Generator, brood: Sequence[Individual], name: str, rate: float, vary: _Vary
) -> list[Individual]:
    """Return the brood after an operator that each child meets with the same chance."""
    meets = (rng.random(len(brood)) < rate).tolist()
    varied = [vary(child.genotype) if met else None for child, met in zip(brood, meets, strict=True)]
    return [
        child if genotype is None else _after(child, name, genotype, ())
        for child, genotype in zip(brood, varied, strict=True)
    ]


def _vary_pairs(
    rng: np.random.Generator, layout: Layout, brood: Sequence[Individual], name: str, rate: float, recombine: _Recombine
) -> list[Individual]:
    """Return the brood after an operator that pairs meet with the same chance; of an odd number one stays alone."""
    order = rng.permutation(len(brood))
    children = list(brood)
    npair = len(brood) // 2
    for pair in np.flatnonzero(rng.random(npair) < rate).tolist():
        mother, father = (brood[index] for index in order[2 * pair : 2 * pair + 2])
        one, other = recombine(rng, layout, mother.genotype, father.genotype)
        children[order[2 * pair]] = _after(mother, name, one, father.parents)
        children[order[2 * pair + 1]] = _after(father, name, other, mother.parents)
    return children


def _after(child: Individual, name: str, genotype: Chromosome, parents: tuple[int, ...]) -> Individual:
    """Return a child after one operator more, with the parents that it brought in."""
    operator = name if child.operator == _COPIED else f"{child.operator}+{name}"
    return Individual(genotype, operator, tuple(dict.fromkeys(child.parents + parents)))
