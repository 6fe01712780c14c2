"""What a study leaves: tables as CSV and Markdown, the same bytes for the same runs."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from evolve.studies.cells import Curve
from evolve.studies.study import Scale, ScaleName, Study, level_settings
from servolve.study_verdict import ALPHA, ClaimTest, Values, judge, median_interval, overview, shown

METRICS = {"raw": "raw fitness", "adjusted": "adjusted fitness"}
"""What tables and axes call a metric."""


@dataclass(frozen=True, eq=False)
class Finished:
    """Hold a study whose cells are complete.

    Args:
        study: the study
        scale_name: how much of it was run
        seeds: how many, from 1
        curves: of each level, by name, a curve a seed
    """

    study: Study
    scale_name: ScaleName
    seeds: int
    curves: Mapping[str, Sequence[Curve]]

    @property
    def scale(self) -> Scale:
        """Return how much of the study was run."""
        return self.study.scales[self.scale_name]

    @property
    def final(self) -> dict[str, tuple[float, ...]]:
        """Return the best fitness of the last generation of each run, by level."""
        return {name: tuple(curve.best[-1] for curve in curves) for name, curves in self.curves.items()}

    def population(self, level: str) -> int:
        """Return the individuals of a generation at a level."""
        chosen = next(found for found in self.study.levels if found.name == level)
        return level_settings(self.study, self.scale, chosen).population

    def values(self, level: str) -> Values:
        """Return the study's metric of each run's generations at a level, (seeds, generations)."""
        return shown(self.study, np.array([curve.best for curve in self.curves[level]]))


@dataclass(frozen=True)
class Row:
    """Hold a line of a study's table.

    Args:
        level: its name
        runs: how many
        individuals: examined in each
        median: of the final values in the study's metric
        low: lower end of its interval
        high: upper end
        coverage: chance that the interval covers the median of all runs
        lowest: smallest final value
        highest: largest
        hit_runs: runs in which some individual came within 1.5 cm of the goal in every condition
        simulations: rollouts of all runs
    """

    level: str
    runs: int
    individuals: int
    median: float
    low: float
    high: float
    coverage: float
    lowest: float
    highest: float
    hit_runs: int
    simulations: int


def rows(finished: Finished) -> list[Row]:
    """Return the table of a study, a row a level.

    Args:
        finished: the study
    """
    found = []
    for level, curves in finished.curves.items():
        final = finished.values(level)[:, -1]
        median, low, high, coverage = median_interval(final)
        found.append(
            Row(
                level,
                len(curves),
                finished.population(level) * len(curves[0].best),
                float(median),
                float(low),
                float(high),
                coverage,
                float(final.min()),
                float(final.max()),
                sum(any(curve.passed) for curve in curves),
                sum(sum(curve.simulations) for curve in curves),
            )
        )
    return found


def table_csv(finished: Finished) -> str:
    """Return the table of a study as CSV.

    Args:
        finished: the study
    """
    metric = METRICS[finished.study.metric].replace(" ", "_")
    head = (
        finished.study.axis,
        *("runs", "individuals", f"{metric}_median", "low", "high", "coverage", "lowest", "highest"),
        *("runs_with_a_hit_in_every_case", "rollouts"),
    )
    return _csv([head, *(tuple(vars(row).values()) for row in rows(finished))])


def generations_csv(finished: Finished) -> str:
    """Return every generation of every run as CSV.

    Args:
        finished: the study
    """
    lines: list[tuple[object, ...]] = [
        (finished.study.axis, "seed", "generation", "individuals", "best", "passed", "rollouts")
    ]
    for level, curves in finished.curves.items():
        population = finished.population(level)
        for seed, curve in enumerate(curves, 1):
            columns = zip(curve.best, curve.passed, curve.simulations, strict=True)
            lines += [
                (level, seed, generation, population * (generation + 1), *column)
                for generation, column in enumerate(columns)
            ]
    return _csv(lines)


def fragment(finished: Finished, figure: str) -> str:
    """Return a study's part of a Markdown page: what was run, the table, the verdicts.

    Args:
        finished: the study
        figure: path of its figure, as the page links it

    Returns:
        the text
    """
    return "\n".join(_lines(finished, figure)) + "\n"


def _lines(finished: Finished, figure: str) -> Iterator[str]:
    """Yield the lines of the fragment."""
    study, scale = finished.study, finished.scale
    metric = METRICS[study.metric]
    better = "higher" if study.metric == "adjusted" else "lower"
    whole = overview(study, finished.final)
    yield f"### `servolve study {study.name}`: {study.title}"
    yield ""
    yield f"{study.source}. Task `{study.task}` on `{study.rig}`, engine `{study.engine}`,"
    yield f"`{' '.join(_in_force(*study.settings, *scale.settings))}`."
    yield f"Scale {finished.scale_name}; reduced: {scale.reduced}. Seeds 1 to {finished.seeds}."
    yield f"Best of the last generation, {metric} ({better} is better):"
    yield ""
    yield f"| {study.axis} | individuals | median | interval | all runs | hit in every case | rollouts |"
    yield "|---|---|---|---|---|---|---|"
    for row in rows(finished):
        yield (
            f"| {row.level} | {row.individuals} | {row.median:.3f} | {row.low:.3f} – {row.high:.3f}"
            f" ({row.coverage:.0%}) | {row.lowest:.3f} – {row.highest:.3f} | {row.hit_runs} of {row.runs} runs"
            f" | {row.simulations} |"
        )
    yield ""
    yield f"![{study.title}]({figure})"
    yield ""
    for test in judge(study, finished.final):
        yield from _claim_lines(study, test)
        yield ""
    yield (
        f"Over the whole grid: Kruskal–Wallis p = {_p(whole.kruskal_p)}; trend (Jonckheere–Terpstra as Kendall's τ)"
        f" {whole.trend:+.2f}, p = {_p(whole.trend_p)}."
    )


def _claim_lines(study: Study, test: ClaimTest) -> Iterator[str]:
    """Yield what came of one claim."""
    left_out = f" Not run: {', '.join(test.left_out)}." if test.left_out else ""
    yield f"**{test.verdict.capitalize()}**: “{test.claim.text}”{left_out}"
    if not test.pairs:
        return
    yield ""
    p_heads = "p worse | p better | p below | p above"
    yield f"| {study.axis} | against | A12 | worse by | margin | {p_heads} | {test.claim.kind} |"
    yield "|---|---|---|---|---|---|---|---|---|---|"
    for pair in test.pairs:
        p_values = " | ".join(_p(p) for p in (pair.p_worse, pair.p_better, pair.p_below, pair.p_above))
        yield (
            f"| {pair.level} | {pair.reference} | {pair.a12:.2f} | {pair.shift:+.3f} | {pair.margin:.3f}"
            f" | {p_values} | {pair.verdict} |"
        )


def _in_force(*overrides: str) -> list[str]:
    """Return the overrides of which no later one sets the same key."""
    last = {override.partition("=")[0]: override for override in overrides}
    return list(last.values())


def _p(p: float) -> str:
    """Write a p-value, bold where it is significant."""
    text = f"{p:.3f}" if p >= 0.0005 else "< 0.001"
    return f"**{text}**" if p <= ALPHA else text


def _csv(lines: Sequence[Sequence[object]]) -> str:
    """Write lines as CSV, floats so that they read back the same."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(
        [repr(cell) if isinstance(cell, float) else cell for cell in line] for line in lines
    )
    return text.getvalue()
