"""Gene expression programming breeds at the rates of its settings, and the same chance gives the same children."""

from __future__ import annotations

import dataclasses
import re
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from controller.text import format_expression
from evolve.engine import Individual
from evolve.gep.chromosome import is_chromosome
from evolve.gep.engine import gep
from evolve.settings import Settings
from evolve.streams import Stream, generator

TERMINALS = ("t", "a0", "px", "vx", "goal_dist")
RATES = ("gep_mutation", "gep_is", "gep_ris", "gep_gene_transposition", "gep_one_point", "gep_two_point", "gep_gene")
OFF = dict.fromkeys((*RATES, "gep_constant_mutation", "gep_constant_tuning"), 0.0)


def engine_of(noutput=4, **numbers):
    return gep(TERMINALS, noutput, dataclasses.replace(Settings(), population=40, constant_max=6.0, **numbers))


def any_parent(rng):
    return int(rng.integers(40))


def bred(engine, seed=1, elite=()):
    population = engine.start(generator(seed, Stream.START))
    return population, engine.breed(generator(seed, Stream.VARIATION, 1), population, any_parent, elite)


def texts(engine, population):
    return [engine.write(individual) for individual in population]


def test_without_operators_children_are_copies_of_chosen_parents():
    engine = engine_of(**OFF)
    population, children = bred(engine)
    assert len(children) == 40
    for child in children:
        assert child.operator == "reproduction" and len(child.parents) == 1
        assert engine.write(child) == engine.write(population[child.parents[0]])


def test_the_elite_passes_on_as_it_is():
    engine = engine_of(gep_mutation=1.0)
    population, children = bred(engine, elite=[7, 3])
    assert len(children) == 40
    assert [(child.operator, child.parents) for child in children[:2]] == [("elite", (7,)), ("elite", (3,))]
    assert texts(engine, children[:2]) == [engine.write(population[7]), engine.write(population[3])]
    assert all(child.operator != "elite" for child in children[2:])


@pytest.mark.parametrize(
    ("setting", "name", "sure"),
    [
        ("gep_is", "is", True),
        ("gep_ris", "ris", False),  # a head may hold no function
        ("gep_gene_transposition", "gene_transposition", True),
        ("gep_one_point", "one_point", True),
        ("gep_two_point", "two_point", True),
        ("gep_gene", "gene", True),
        ("gep_constant_tuning", "constant_tuning", False),  # no constant may be expressed
    ],
)
def test_each_operator_meets_the_share_of_children_that_its_setting_says(setting, name, sure):
    engine = engine_of(**{**OFF, setting: 0.3})
    population = engine.start(generator(2, Stream.START))
    operators: Counter[str] = Counter()
    for generation in range(100):
        children = engine.breed(generator(2, Stream.VARIATION, generation), population, any_parent, [])
        operators.update(child.operator for child in children)
    assert set(operators) == {name, "reproduction"}
    share = operators[name] / operators.total()
    assert share < 0.33
    assert share > (0.27 if sure else 0.15)
    always = engine_of(**{**OFF, setting: 1.0})
    share = Counter(child.operator for child in bred(always)[1])[name] / 40
    assert share == 1 if sure else share > 0.5


@pytest.mark.parametrize(
    ("setting", "name"), [("gep_mutation", "mutation"), ("gep_constant_mutation", "constant_mutation")]
)
def test_mutations_meet_symbols_by_their_rate(setting, name):
    engine = engine_of(**{**OFF, setting: 0.01})
    population = engine.start(generator(3, Stream.START))
    if name == "mutation":
        eligible = [individual.genotype.codes.size for individual in population]
    else:
        eligible = [np.count_nonzero(i.genotype.codes == engine.layout.primitives.constant) for i in population]
    expected = np.mean([1 - 0.99**count for count in eligible])
    met = 0
    for generation in range(50):
        children = engine.breed(generator(3, Stream.VARIATION, generation), population, any_parent, [])
        met += sum(child.operator == name for child in children)
    assert abs(met / 2000 - expected) < 0.05


def test_lineage_names_every_operator_and_every_parent():
    engine = engine_of(**{**OFF, "gep_is": 1.0, "gep_one_point": 1.0, "gep_gene": 1.0})
    population, children = bred(engine)
    assert {child.operator for child in children} == {"is+one_point+gene"}
    for child in children:
        assert 1 <= len(child.parents) <= 4 and len(set(child.parents)) == len(child.parents)
        words = {word for text in texts(engine, [population[p] for p in child.parents]) for word in text.split()}
        assert set(engine.write(child).split()) <= words, "no symbol comes from anywhere else"


def test_an_odd_brood_leaves_one_child_alone():
    engine = engine_of(**{**OFF, "gep_two_point": 1.0})
    _, children = bred(engine, elite=[0])
    assert sorted(Counter(child.operator for child in children).items()) == [
        ("elite", 1),
        ("reproduction", 1),
        ("two_point", 38),
    ]


def test_the_same_chance_gives_the_same_generations():
    def run(seed):
        engine = engine_of()
        population = engine.start(generator(seed, Stream.START))
        for generation in range(1, 6):
            rng = generator(seed, Stream.VARIATION, generation)
            population = engine.breed(rng, population, any_parent, [0])
        return [(engine.write(i), i.operator, i.parents) for i in population]

    assert run(4) == run(4)
    assert run(4) != run(5)


def test_table_2_of_emot_is_the_default():
    numbers = Settings()
    assert (numbers.gep_head, numbers.tournament) == (10, 6)
    assert (numbers.gep_mutation, numbers.gep_is, numbers.gep_ris) == (0.01, 0.1, 0.1)
    assert (numbers.gep_is_length_max, numbers.gep_ris_length_max) == (4, 4)
    assert (numbers.gep_gene_transposition, numbers.gep_one_point, numbers.gep_two_point) == (0.05, 0.2, 0.5)
    assert (numbers.gep_gene, numbers.gep_constant_mutation, numbers.gep_constant_tuning) == (0.1, 0.05, 0.9)


@pytest.mark.parametrize("head", [1, 3, 50])
@pytest.mark.parametrize("noutput", [1, 4])
def test_many_generations_stay_chromosomes(head, noutput):
    engine = engine_of(noutput, gep_head=head, gep_mutation=0.05, gep_is=0.5, gep_ris=0.5, gep_gene=0.5)
    population = engine.start(generator(6, Stream.START))
    for generation in range(10):
        population = engine.breed(generator(6, Stream.VARIATION, generation), population, any_parent, [1])
    for individual in population:
        assert is_chromosome(engine.layout, individual.genotype)
        assert len(engine.source(individual).outputs) == noutput


def test_the_gene_of_the_manual_reads_as_the_manual_says():
    page = (Path(__file__).parents[1] / "docs" / "gep.md").read_text()
    gene = re.search(r"^    (% .* \| .*)$", page, re.MULTILINE)
    reading = re.search(r"^It reads `(.*)`: (\d+) symbols", page, re.MULTILINE)
    engine = gep(("t", "a0", "a1", "px"), 1, Settings())
    individual = Individual(engine.read(gene[1]), "start", ())
    assert format_expression(engine.source(individual).outputs[0]) == reading[1]
    assert engine.nodes(individual) == int(reading[2])


def test_the_manual_names_every_setting_and_its_default():
    page = (Path(__file__).parents[1] / "docs" / "gep.md").read_text()
    numbers = {field.name: field.default for field in dataclasses.fields(Settings) if field.name.startswith("gep_")}
    for name, default in numbers.items():
        lines = [line for line in page.splitlines() if f"`{name}`" in line]
        assert any(str(default) in line for line in lines), name
