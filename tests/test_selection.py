"""Selection against closed forms: the order of ranks, who wins how often, what parsimony does to whom."""

from __future__ import annotations

import numpy as np
import pytest

from evolve.selection import bucket_ranks, condemned, ranks, roulette, shares, smaller_of_two, tournament
from evolve.streams import Stream, generator


def test_ranks_put_the_complete_first_then_fitness_then_size_then_index():
    fitness = np.array([0.5, 0.1, 0.3, 0.3, 0.3, np.nan, 0.01])
    complete = np.array([True, True, True, True, True, True, False])
    nodes = np.array([1, 9, 7, 5, 5, 1, 1])
    assert ranks(fitness, complete, nodes).tolist() == [4, 0, 3, 1, 2, 5, 6]


def test_buckets_are_the_coarser_the_worse():
    fitness, everyone = np.arange(16.0), np.ones(16, bool)
    alike = bucket_ranks(fitness, everyone, np.ones(16, int), 2.0)
    assert alike.tolist() == list(range(16)), "among equal sizes fitness decides"
    larger_if_fitter = bucket_ranks(fitness, everyone, np.arange(16)[::-1], 2.0)
    # the worst 8, the next 4, the next 2, then one by one
    assert larger_if_fitter.tolist() == [0, 1, 3, 2, 7, 6, 5, 4, *range(15, 7, -1)]


def test_buckets_never_part_equal_fitness_nor_mix_who_met_fewer_conditions():
    nodes = np.arange(8)[::-1]
    assert bucket_ranks(np.full(8, 0.5), np.ones(8, bool), nodes, 2.0).tolist() == nodes.tolist()
    complete = np.arange(8) % 2 == 0
    rank = bucket_ranks(np.zeros(8), complete, nodes, 2.0)
    assert rank[complete].max() < rank[~complete].min()
    assert bucket_ranks(np.array([np.nan, 1.0]), np.ones(2, bool), np.array([1, 9]), 2.0).tolist() == [1, 0]


def test_shares_are_adjusted_fitness_in_parts_of_their_sum():
    everyone = np.ones(3, bool)
    assert shares(np.array([0.0, 1.0, 3.0]), everyone) == pytest.approx(np.array([1, 1 / 2, 1 / 4]) / 1.75)
    assert shares(np.array([-1.0, 0.0, 2.0]), everyone) == pytest.approx(np.array([1, 1 / 2, 1 / 4]) / 1.75)
    assert shares(np.array([0.0, np.inf, np.nan]), everyone).tolist() == [1, 0, 0]
    assert shares(np.full(3, np.inf), everyone).tolist() == [1 / 3] * 3


def test_who_met_fewer_conditions_has_no_more_than_the_worst_who_met_all():
    found = shares(np.array([0.0, 1.0, 0.5, 3.0]), np.array([True, True, False, False]))
    assert found == pytest.approx(np.array([1, 1 / 2, 1 / 2, 1 / 4]) / 2.25)


def test_the_wheel_stops_in_proportion():
    wheel = np.cumsum(shares(np.array([0.0, np.inf, 1.0, 3.0, 0.25]), np.ones(5, bool)))
    expected = np.array([1, 0, 1 / 2, 1 / 4, 4 / 5]) / 2.55
    rng, tries = generator(1, Stream.VARIATION), 20_000
    stops = np.bincount([roulette(rng, wheel) for _ in range(tries)], minlength=5)
    assert stops[1] == 0
    possible = expected > 0
    chi_square = np.sum((stops - tries * expected)[possible] ** 2 / (tries * expected[possible]))
    assert chi_square < 16.27, "three degrees of freedom, one in a thousand"


@pytest.mark.parametrize("size", [1.0, 1.4, 2.0])
def test_the_smaller_of_two_wins_half_the_size_of_its_tournament(size):
    nodes, tries = np.array([10, 20]), 4000
    rng = generator(3, Stream.VARIATION)
    # the two differ in half of the draws
    won = np.mean([smaller_of_two(rng, lambda r: int(r.integers(2)), nodes, size) == 0 for _ in range(tries)])
    assert abs(won - (1 / 4 + size / 4)) < 4 * np.sqrt(0.25 / tries)


def test_only_those_larger_than_the_average_are_condemned_and_a_share_of_them():
    nodes = np.arange(2000)
    out = condemned(generator(1, Stream.PARSIMONY), nodes, 0.3)
    assert not out[:1000].any()
    assert abs(out[1000:].mean() - 0.3) < 4 * np.sqrt(0.21 / 1000)
    assert not condemned(generator(1, Stream.PARSIMONY), nodes, 0.0).any()
    assert condemned(generator(1, Stream.PARSIMONY), nodes, 1.0).sum() == 1000
    assert not condemned(generator(1, Stream.PARSIMONY), np.full(9, 7), 1.0).any(), "someone is always left"


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
