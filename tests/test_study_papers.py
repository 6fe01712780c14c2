"""The declared studies: grids and numbers as the papers print them, claims that name what is in the grid."""

from __future__ import annotations

import pytest

from evolve.studies.papers import STUDIES
from evolve.studies.study import level_settings

# Gritz & Hahn 1997, §4; Kwaśnicka & Woźniak, §5.1
GRIDS = {
    "population": [10, 50, 100, 150, 200, 300, 400, 500, 600, 700],
    "generations": [10, 20, 30, 40, 50, 75, 100],
    "selection": [2, 4, 6, 10, 20],
    "crossover": [0, 10, 50, 70, 80, 90, 100],
    "gep-head": [3, 10, 15, 50],
    "gep-population": [10, 30, 50, 70, 100, 200, 300, 500, 1000, 2000],
}
# what the text says of all runs of a figure
FIXED = {
    "population": {"generations": 35, "goals": 3, "crossover": 0.9},
    "generations": {"population": 300, "goals": 3, "crossover": 0.9},
    "selection": {"population": 300, "generations": 30, "goals": 3, "crossover": 0.9},
    "crossover": {"population": 300, "generations": 30, "goals": 3, "tournament": 6},
    "gep-head": {"population": 100, "generations": 50, "tournament": 6},
    "gep-population": {"gep_head": 10, "generations": 50, "tournament": 6},
}
VARIED = {
    "population": "population",
    "generations": "generations",
    "selection": "tournament",
    "crossover": "crossover",
    "gep-head": "gep_head",
    "gep-population": "population",
}


def test_the_grids_are_the_papers():
    assert {name: [level.number for level in s.levels if level.number is not None] for name, s in STUDIES.items()} == (
        GRIDS
    )
    assert STUDIES["selection"].levels[0].name == "proportionate"


@pytest.mark.parametrize("name", STUDIES)
def test_the_full_scale_runs_the_papers_numbers(name):
    study = STUDIES[name]
    full = study.scales["full"]
    assert full.levels == tuple(level.name for level in study.levels)
    assert full.settings == ()
    for level in study.levels:
        settings = level_settings(study, full, level)
        assert {key: getattr(settings, key) for key in FIXED[name]} == FIXED[name]
        if level.number is not None:
            share = 100 if name == "crossover" else 1
            assert getattr(settings, VARIED[name]) * share == pytest.approx(level.number)
        assert settings.selection == ("proportionate" if level.name == "proportionate" else "tournament")
        # the papers drew their conditions once, and let everyone meet all of them
        assert (settings.redraw, settings.parsimony) == (False, "none")
        assert settings.elites == 0 or study.engine == "gep"
        assert settings.race_goals == 0 or settings.goals == 1


@pytest.mark.parametrize("name", STUDIES)
def test_a_reduced_study_still_tests_each_claim(name):
    study = STUDIES[name]
    names = {level.name for level in study.levels}
    for claim in study.claims:
        assert {level for pair in claim.pairs for level in pair} <= names
        kept = study.scales["reduced"].levels
        assert [pair for pair in claim.pairs if set(pair) <= set(kept)]
    for scale in study.scales.values():
        assert set(scale.levels) <= names
        assert len(study.levels_at(scale)) == len(scale.levels)
        for level in study.levels_at(scale):
            level_settings(study, scale, level)
