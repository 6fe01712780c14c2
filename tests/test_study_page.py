"""docs/reproductions.md says what its data say: tables and verdicts are made again from every generation's numbers."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from evolve.studies.cells import Curve
from evolve.studies.papers import STUDIES
from servolve.study_report import Finished, fragment, generations_csv, table_csv

DOCS = Path(__file__).parent.parent / "docs"
SHOWN = sorted(path.name.removesuffix(".generations.csv") for path in (DOCS / "studies").glob("*.generations.csv"))


def read(name):
    curves = {}
    with (DOCS / "studies" / f"{name}.generations.csv").open() as file:
        for row in list(csv.reader(file))[1:]:
            level, seed, _, _, best, passed, rollouts = row
            run = curves.setdefault(level, {}).setdefault(int(seed), [])
            run.append((float(best), int(passed), int(rollouts), 0.0))
    found = {
        level: tuple(Curve(*zip(*runs[seed], strict=True)) for seed in sorted(runs)) for level, runs in curves.items()
    }
    return Finished(STUDIES[name], "reduced", len(next(iter(found.values()))), found)


@pytest.mark.parametrize("name", SHOWN)
def test_tables_and_verdicts_follow_from_the_data(name):
    finished = read(name)
    assert tuple(finished.curves) == tuple(finished.scale.levels)
    assert {len(curves) for curves in finished.curves.values()} == {finished.seeds}
    assert generations_csv(finished) == (DOCS / "studies" / f"{name}.generations.csv").read_text()
    assert table_csv(finished) == (DOCS / "studies" / f"{name}.csv").read_text()
    assert fragment(finished, f"studies/{name}.svg") in (DOCS / "reproductions.md").read_text()
    assert (DOCS / "studies" / f"{name}.svg").is_file()


def test_the_page_shows_the_studies_that_were_run():
    assert {"population", "selection", "crossover", "gep-population"} <= set(SHOWN)
