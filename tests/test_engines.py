"""What every engine promises a search: whole populations, sources that lower, texts that come back bit for bit."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controller import lower, program_hash
from controller.errors import InputError
from controller.source import Apply
from controller.verifier import verify
from evolve.engine import Individual
from evolve.engines import ENGINES, make_engine
from evolve.settings import Settings
from evolve.streams import Stream, generator

TERMINALS = ("t", "a0", "px")
NUMBERS = dataclasses.replace(
    Settings(), population=12, crossover=0.5, mutate_subtree=0.1, mutate_point=0.1, mutate_constant=0.2
)


def any_parent(rng):
    return int(rng.integers(NUMBERS.population))


def evolved(name, seed, generations, noutput=3):
    """Return an engine and a population some generations on, parents drawn by chance."""
    engine = make_engine(name, TERMINALS, noutput, NUMBERS)
    population = engine.start(generator(seed, Stream.START))
    for number in range(1, generations + 1):
        rng = generator(seed, Stream.VARIATION, number)
        population = engine.breed(rng, population, any_parent, [0])
    return engine, population


def size(expression):
    """Count an expression's nodes."""
    return 1 + sum(map(size, expression.operands)) if isinstance(expression, Apply) else 1


@pytest.mark.parametrize("name", ENGINES)
@settings(derandomize=True, deadline=None, max_examples=30)
@given(seed=st.integers(0, 2**32), generations=st.integers(0, 8), noutput=st.integers(1, 5))
def test_every_individual_is_a_program_and_comes_back_from_its_text(name, seed, generations, noutput):
    engine, population = evolved(name, seed, generations, noutput)
    assert engine.name == name
    assert len(population) == NUMBERS.population
    for individual in population:
        source = engine.source(individual)
        program = lower(source, TERMINALS)
        verify(program)
        assert len(source.outputs) == noutput
        assert engine.nodes(individual) == sum(map(size, source.outputs))
        text = engine.write(individual)
        again = Individual(engine.read(text), individual.operator, individual.parents)
        assert engine.write(again) == text
        assert arrays(again.genotype) == arrays(individual.genotype)
        assert program_hash(lower(engine.source(again), TERMINALS)) == program_hash(program)


def arrays(genotype):
    """Return all bits of a genotype, whichever engine's."""
    parts = genotype if isinstance(genotype, tuple) else (genotype,)
    return [(array.dtype, array.shape, array.tobytes()) for part in parts for array in (part.codes, part.values)]


@pytest.mark.parametrize("name", ENGINES)
def test_a_search_goes_on_from_texts_as_it_would_have(name):
    engine, population = evolved(name, 5, 3)
    read = [Individual(engine.read(engine.write(i)), i.operator, i.parents) for i in population]
    ways = [engine.breed(generator(5, Stream.VARIATION, 4), start, any_parent, [2, 0]) for start in (population, read)]
    told = [[(engine.write(i), i.operator, i.parents) for i in way] for way in ways]
    assert told[0] == told[1]


@pytest.mark.parametrize("name", ENGINES)
def test_lineage_points_into_the_generation_before(name):
    engine, population = evolved(name, 6, 1)
    first = engine.start(generator(6, Stream.START))
    assert all(individual.operator == "start" and individual.parents == () for individual in first)
    assert (population[0].operator, population[0].parents) == ("elite", (0,))
    assert engine.write(population[0]) == engine.write(first[0])
    for individual in population:
        assert individual.operator and individual.parents
        assert all(0 <= parent < len(first) for parent in individual.parents)
        if individual.operator == "reproduction":
            assert engine.write(individual) == engine.write(first[individual.parents[0]])


@pytest.mark.parametrize("name", ENGINES)
def test_breeding_leaves_the_parents_alone(name):
    engine, population = evolved(name, 7, 2)
    before = [arrays(individual.genotype) for individual in population]
    engine.breed(generator(7, Stream.VARIATION, 9), population, any_parent, [])
    assert [arrays(individual.genotype) for individual in population] == before


@pytest.mark.parametrize("name", ENGINES)
def test_a_first_population_holds_constants_within_their_range(name):
    engine = make_engine(name, TERMINALS, 3, dataclasses.replace(NUMBERS, constant_max=2.5, population=40))
    parts = [i.genotype for i in engine.start(generator(8, Stream.START))]
    values = np.concatenate([part.values.reshape(-1) for g in parts for part in (g if isinstance(g, tuple) else (g,))])
    assert np.abs(values).max() <= 2.5
    assert np.abs(values).max() > 2


def test_an_unknown_engine_is_refused():
    with pytest.raises(InputError, match="choose one of gp, gep"):
        make_engine("gpe", TERMINALS, 3, NUMBERS)


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize(
    "spoil", ["", "px", "(list t)", "(list t (sin t) px)", "(let ((n t)) (list n n n))", "(list t t 1e99)"]
)
def test_a_text_of_something_else_is_refused(name, spoil):
    engine, _ = evolved(name, 9, 0)
    with pytest.raises(InputError):
        engine.read(spoil)


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize(("old", "new"), [(r"\bpx\b", "nowhere"), (r"-?\d+\.\d+", "1e99"), (r"\bt\b", "osc-wave")])
def test_a_spoilt_text_is_refused(name, old, new):
    engine, population = evolved(name, 9, 0)
    texts = [engine.write(individual) for individual in population]
    spoilt = [changed for text in texts if (changed := re.sub(old, new, text, count=1)) != text]
    assert spoilt
    for text in spoilt:
        with pytest.raises(InputError):
            engine.read(text)
