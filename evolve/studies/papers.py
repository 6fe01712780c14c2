"""The convergence experiments of the founding papers, as studies: grids, claims and margins, decided before any run.

What "worse" and "alike" mean is in `servolve.study_verdict`. A claim holds if it holds for each of its pairs.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from evolve.studies.study import Claim, Level, Scale, Study, against, grid

_LAMP_MARGIN: Final = 0.2
_JUMPER_MARGIN: Final = 0.1  # 0.96 and 0.95 are "best", 0.32 and 0.34 fail

# Gritz & Hahn 1997, §4: one set of goals for all generations and everyone meets all of them
_LAMP: Final = (
    "goals=3",
    "redraw=false",
    "race_goals=0",
    "selection=tournament",
    "tournament=6",
    "crossover=0.9",
    "mutate_subtree=0",
    "mutate_point=0",
    "mutate_constant=0",
    "elites=0",
)
_TINY_LAMP: Final = ("time_limit_s=0.5",)
_TINY: Final = "everything: it only shows that the study runs"

_POPULATION: Final = Study(
    name="population",
    title="Population size M of the robust lamp",
    source="Gritz & Hahn 1997, §4, figure 5",
    task="lamp-robust",
    rig="paper-lamp",
    engine="gp",
    settings=(*_LAMP, "generations=35"),
    axis="population",
    levels=grid("population", (10, 50, 100, 150, 200, 300, 400, 500, 600, 700)),
    claims=(
        Claim(
            "Populations under 200 end at a worse fitness than 200.",
            "worse",
            against("200", "10", "50", "100", "150"),
        ),
        Claim(
            "Above 200 the population makes little difference.",
            "alike",
            against("200", "300", "400", "500", "600", "700"),
        ),
    ),
    metric="raw",
    margin=_LAMP_MARGIN,
    scales={
        "full": Scale(("10", "50", "100", "150", "200", "300", "400", "500", "600", "700"), 10),
        "reduced": Scale(
            ("10", "50", "100", "200", "400"),
            8,
            ("generations=20",),
            "5 of the 10 populations; 20 generations instead of 35",
        ),
        "tiny": Scale(("10", "50"), 2, ("generations=2", *_TINY_LAMP), _TINY),
    },
)

_GENERATIONS: Final = Study(
    name="generations",
    title="Generations G of the robust lamp",
    source="Gritz & Hahn 1997, §4, figure 6",
    task="lamp-robust",
    rig="paper-lamp",
    engine="gp",
    settings=(*_LAMP, "population=300"),
    axis="generations",
    levels=grid("generations", (10, 20, 30, 40, 50, 75, 100)),
    claims=(
        Claim("Fewer than 30 generations end at a worse fitness than 30.", "worse", against("30", "10", "20")),
        Claim("More than 30 are no better.", "no better", against("30", "40", "50", "75", "100")),
        Claim("Very many, 75 or 100, are worse than 30.", "worse", against("30", "75", "100")),
    ),
    metric="raw",
    margin=_LAMP_MARGIN,
    scales={
        "full": Scale(("10", "20", "30", "40", "50", "75", "100"), 10),
        "reduced": Scale(
            ("10", "20", "30", "50", "100"),
            8,
            ("population=200",),
            "5 of the 7 numbers of generations; a population of 200 instead of 300",
        ),
        "tiny": Scale(("10", "20"), 2, ("population=6", *_TINY_LAMP), _TINY),
    },
)

_SIZES: Final = ("2", "4", "6", "10", "20")
_SELECTION: Final = Study(
    name="selection",
    title="Selection of the robust lamp: fitness-proportionate against tournaments",
    source="Gritz & Hahn 1997, §4, figure 7",
    task="lamp-robust",
    rig="paper-lamp",
    engine="gp",
    settings=(*_LAMP, "population=300", "generations=30"),
    axis="tournament size",
    levels=(Level("proportionate", ("selection=proportionate",)), *grid("tournament", (2, 4, 6, 10, 20))),
    claims=(
        Claim(
            "Fitness-proportionate selection is worse than a tournament of any size.",
            "worse",
            tuple(("proportionate", size) for size in _SIZES),
        ),
        Claim("The size of the tournament matters little.", "alike", against("6", "2", "4", "10", "20")),
        Claim(
            "A tournament of 6 is optimal: no other size is better.", "no better", against("6", "2", "4", "10", "20")
        ),
    ),
    metric="raw",
    margin=_LAMP_MARGIN,
    scales={
        "full": Scale(("proportionate", *_SIZES), 10),
        "reduced": Scale(
            ("proportionate", "2", "6", "20"),
            8,
            ("population=200", "generations=20"),
            "4 of the 6 ways to select; 200 × 20 individuals instead of 300 × 30",
        ),
        "tiny": Scale(("proportionate", "6"), 2, ("population=8", "generations=2", *_TINY_LAMP), _TINY),
    },
)

_CROSSOVER: Final = Study(
    name="crossover",
    title="Crossover probability Pc of the robust lamp, the rest reproduction",
    source="Gritz & Hahn 1997, §4, figure 8",
    task="lamp-robust",
    rig="paper-lamp",
    engine="gp",
    settings=(*_LAMP, "population=300", "generations=30"),
    axis="crossover [%]",
    levels=tuple(Level(f"{share}", (f"crossover={share / 100:g}",), share) for share in (0, 10, 50, 70, 80, 90, 100)),
    claims=(
        Claim("Reproduction alone is worse than 80 %.", "worse", against("80", "0")),
        Claim("10 % is not as good as higher shares.", "worse", (("10", "50"), ("10", "80"), ("10", "100"))),
        Claim("From 50 % up the share makes no great difference.", "alike", against("80", "50", "70", "90", "100")),
        Claim("80 % is the optimum: no other share is better.", "no better", against("80", "50", "70", "90", "100")),
    ),
    metric="raw",
    margin=_LAMP_MARGIN,
    scales={
        "full": Scale(("0", "10", "50", "70", "80", "90", "100"), 10),
        "reduced": Scale(
            ("0", "10", "50", "80", "100"),
            8,
            ("population=200", "generations=20"),
            "5 of the 7 shares; 200 × 20 individuals instead of 300 × 30",
        ),
        "tiny": Scale(("0", "80"), 2, ("population=8", "generations=2", *_TINY_LAMP), _TINY),
    },
)

_REDUCED_JUMPER: Final = ("generations=25", "time_limit_s=10", "screen_timestep_s=0.005")
_TINY_JUMPER: Final = ("generations=2", "time_limit_s=0.5")
_GEP_HEAD: Final = Study(
    name="gep-head",
    title="Head length of the jumper's genes",
    source="Kwaśnicka & Woźniak, EMOT, §5.1",
    task="jumper",
    rig="paper-jumper",
    engine="gep",
    settings=("population=100", "generations=50", "redraw=false", "race_goals=0"),
    axis="head length",
    levels=grid("gep_head", (3, 10, 15, 50)),
    claims=(
        Claim("A head of 3 is too short: it ends at a worse fitness than 10.", "worse", against("10", "3")),
        Claim("A head of 50 is too long: it ends at a worse fitness than 10.", "worse", against("10", "50")),
        Claim("10 and 15 are equally good.", "alike", against("10", "15")),
    ),
    metric="adjusted",
    margin=_JUMPER_MARGIN,
    scales={
        "full": Scale(("3", "10", "15", "50"), 10),
        "reduced": Scale(("3", "10", "15", "50"), 8, _REDUCED_JUMPER, "25 generations of 10 s in steps of 5 ms"),
        "tiny": Scale(("3", "10"), 2, ("population=8", *_TINY_JUMPER), _TINY),
    },
)

_GEP_POPULATION: Final = Study(
    name="gep-population",
    title="Population size of the jumper",
    source="Kwaśnicka & Woźniak, EMOT, §5.1",
    task="jumper",
    rig="paper-jumper",
    engine="gep",
    settings=("gep_head=10", "generations=50", "redraw=false", "race_goals=0"),
    axis="population",
    levels=grid("population", (10, 30, 50, 70, 100, 200, 300, 500, 1000, 2000)),
    claims=(
        Claim("50 or fewer evolve no acceptable solution, as 100 do.", "worse", against("100", "10", "30", "50")),
        Claim("70 are a meaningful change: 50 are worse.", "worse", against("70", "50")),
        Claim(
            "More than 100 bring nothing essentially better.",
            "no better",
            against("100", "200", "300", "500", "1000", "2000"),
        ),
    ),
    metric="adjusted",
    margin=_JUMPER_MARGIN,
    scales={
        "full": Scale(("10", "30", "50", "70", "100", "200", "300", "500", "1000", "2000"), 10),
        "reduced": Scale(
            ("10", "30", "50", "70", "100", "200"),
            8,
            _REDUCED_JUMPER,
            "6 of the 10 populations; 25 generations instead of 50, 10 s instead of 20, steps of 5 ms",
        ),
        "tiny": Scale(("10", "30"), 2, _TINY_JUMPER, _TINY),
    },
)

STUDIES: Final[Mapping[str, Study]] = MappingProxyType(
    {study.name: study for study in (_POPULATION, _GENERATIONS, _SELECTION, _CROSSOVER, _GEP_HEAD, _GEP_POPULATION)}
)
"""Studies by name."""
