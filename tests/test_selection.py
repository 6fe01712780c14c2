"""Selection against closed forms: the order of ranks, and a tournament's distribution of winners."""

from __future__ import annotations

import numpy as np
import pytest

from evolve.selection import ranks, tournament
from evolve.streams import Stream, generator


def test_ranks_put_the_complete_first_then_fitness_then_size_then_index():
    fitness = np.array([0.5, 0.1, 0.3, 0.3, 0.3, np.nan, 0.01])
    complete = np.array([True, True, True, True, True, True, False])
    nodes = np.array([1, 9, 7, 5, 5, 1, 1])
    assert ranks(fitness, complete, nodes).tolist() == [4, 0, 3, 1, 2, 5, 6]


@pytest.mark.parametrize("size", [1, 2, 6])
def test_the_best_wins_as_often_as_it_is_drawn(size):
    population, tries = 20, 20_000
    rank = np.random.default_rng(0).permutation(population)
    rng = generator(size, Stream.VARIATION)
    winners = np.bincount([rank[tournament(rng, rank, size)] for _ in range(tries)], minlength=population) / tries
    at_least = 1 - np.arange(population + 1) / population  # chance that one draw ranks k or worse
    expected = at_least[:-1] ** size - at_least[1:] ** size
    assert np.allclose(winners, expected, atol=4 * np.sqrt(0.25 / tries))


def test_a_tournament_of_everyone_mostly_takes_the_best_and_one_is_blind():
    rank = np.arange(10)
    rng = generator(2, Stream.VARIATION)
    assert {tournament(rng, rank, 200) for _ in range(50)} == {0}
    assert {tournament(rng, rank, 1) for _ in range(500)} == set(range(10))
