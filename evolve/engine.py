"""Engines: the methods that breed controllers, all asked the same few things."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import numpy as np

from controller.source import Source

Choose: TypeAlias = Callable[[np.random.Generator], int]
"""Draw one parent: its index in the population."""


@dataclass(frozen=True, eq=False)
class Individual:
    """Hold one member of a population and how it came to be.

    Args:
        genotype: whatever its engine varies; only the engine looks inside
        operator: "start", "elite", "reproduction" or the names of the operators that made it
        parents: individuals of the generation before
    """

    genotype: Any
    operator: str
    parents: tuple[int, ...]


class Engine(Protocol):
    """Breed genotypes. An engine holds numbers and no state, so a search can go on from any generation."""

    @property
    def name(self) -> str:
        """Return the name that `--engine` takes."""
        ...

    def start(self, rng: np.random.Generator) -> list[Individual]:
        """Draw the first population, (population,)."""
        ...

    def breed(
        self, rng: np.random.Generator, population: Sequence[Individual], choose: Choose, elite: Sequence[int]
    ) -> list[Individual]:
        """Return the next population, (population,): the elite as they are, then children of chosen parents."""
        ...

    def source(self, individual: Individual) -> Source:
        """Return an individual's controller as source, one expression for each output."""
        ...

    def nodes(self, individual: Individual) -> int:
        """Return the size of an individual: the nodes of its expressions."""
        ...

    def write(self, individual: Individual) -> str:
        """Return a genotype as text."""
        ...

    def read(self, text: str) -> object:
        """Return the genotype that `write` wrote, bit for bit.

        Args:
            text: the genotype as text

        Returns:
            the genotype

        Raises:
            InputError: the text is no genotype of this engine and its settings
        """
        ...
