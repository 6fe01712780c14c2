"""Rank tests of a study's claims: confirmed, refuted or inconclusive.

A level's final values are compared with the reference's by one-sided Mann–Whitney tests. With ``d`` the amount by
which the level is worse and ``m`` the margin, four facts can be shown: ``d > 0`` (worse), ``d < 0`` (better), ``d < m``
(below) and ``d > -m`` (above); the latter two compare values that are shifted by the margin. Each of the four is
corrected after Holm over the pairs of a claim. Then

- "worse" is confirmed by worse without below, refuted by below;
- "alike" is confirmed by below with above, refuted by worse without below, or better without above;
- "no better" is confirmed by above, refuted by better without above;
- what is neither is inconclusive. A claim is confirmed if all its pairs are, refuted if any is.

Source: Wellek, Testing Statistical Hypotheses of Equivalence (2010), §6.2 (two one-sided rank tests); Vargha & Delaney,
A Critique and Improvement of the CL Common Language Effect Size (2000); Holm, A Simple Sequentially Rejective Multiple
Test Procedure (1979).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy import stats

from evolve.studies.study import Claim, Study

ALPHA: Final = 0.05
"""Significance level of each test, after Holm."""

INTERVAL: Final = 0.95
"""Least coverage that is asked of a median's interval."""

Verdict: TypeAlias = Literal["confirmed", "refuted", "inconclusive", "not tested"]
Values: TypeAlias = npt.NDArray[np.float64]

_EXACT_MAX: Final = 20_000  # arrangements that are counted one by one where values tie
_WORST: Final = 1e6  # stands for an infinite fitness


@dataclass(frozen=True)
class PairTest:
    """Hold how a level did against its reference.

    Args:
        level: its name
        reference: name of the reference
        a12: chance that a run of the level ends worse than one of the reference, ties half
        shift: median difference of their runs (Hodges–Lehmann), positive: the level is worse
        margin: the difference that matters
        p_worse: of no shift or a better level, after Holm, as the following
        p_better: of no shift or a worse level
        p_below: of a level worse by the margin or more
        p_above: of a level better by the margin or more
        verdict: on the claim for this pair
    """

    level: str
    reference: str
    a12: float
    shift: float
    margin: float
    p_worse: float
    p_better: float
    p_below: float
    p_above: float
    verdict: Verdict


@dataclass(frozen=True)
class ClaimTest:
    """Hold what came of a claim.

    Args:
        claim: the claim
        pairs: tests of those of its pairs that were run
        left_out: levels and references that were not run
        verdict: on all that were run
    """

    claim: Claim
    pairs: tuple[PairTest, ...]
    left_out: tuple[str, ...]
    verdict: Verdict


@dataclass(frozen=True)
class Overview:
    """Hold tests of the whole grid, which decide nothing.

    Args:
        kruskal_p: of equal levels (Kruskal–Wallis)
        trend: Kendall's tau-b of level number and value, as in the Jonckheere–Terpstra test; positive: rises
        trend_p: of no trend, two-sided
    """

    kruskal_p: float
    trend: float
    trend_p: float


def shown(study: Study, best: Sequence[float] | Values) -> Values:
    """Return fitness as the study's metric shows it.

    Args:
        study: the study
        best: best fitness, lower is better

    Returns:
        values in the metric
    """
    fitness = np.minimum(np.asarray(best, np.float64), _WORST)
    return 1 / (1 + fitness) if study.metric == "adjusted" else fitness


def judge(study: Study, final: Mapping[str, Sequence[float]]) -> tuple[ClaimTest, ...]:
    """Test the claims of a study.

    Args:
        study: the study
        final: best fitness of the last generation of each run, by level name

    Returns:
        what came of each claim
    """
    sign = -1.0 if study.metric == "adjusted" else 1.0
    loss = {name: sign * shown(study, values) for name, values in final.items()}
    return tuple(_judge_claim(claim, loss, study.margin) for claim in study.claims)


def overview(study: Study, final: Mapping[str, Sequence[float]]) -> Overview:
    """Test the grid as a whole: do levels differ at all, and is there a trend.

    Args:
        study: the study
        final: best fitness of the last generation of each run, by level name

    Returns:
        the tests, in the study's metric
    """
    values = {name: shown(study, fitness) for name, fitness in final.items()}
    if len(np.unique(np.concatenate(list(values.values())))) < 2:
        return Overview(1.0, 0.0, 1.0)
    kruskal = float(stats.kruskal(*values.values()).pvalue) if len(values) > 1 else 1.0
    placed = [(level.number, value) for level in study.levels for value in values.get(level.name, ())]
    ordered = [(number, value) for number, value in placed if number is not None]
    if len({number for number, _ in ordered}) < 2 or len({value for _, value in ordered}) < 2:
        return Overview(kruskal, 0.0, 1.0)
    trend = stats.kendalltau(*zip(*ordered, strict=True), method="asymptotic")
    return Overview(kruskal, float(trend.statistic), float(trend.pvalue))


def median_interval(values: Values) -> tuple[Values, Values, Values, float]:
    """Return the median of runs and an interval between two of them that covers the median of all.

    Args:
        values: a row a run, (nrun,) or (nrun, n)

    Returns:
        median, low, high, (n,) or scalars each, and the coverage, at least `INTERVAL` where enough runs are there
    """
    n = len(values)
    place = 1
    while place < n // 2 and _coverage(n, place + 1) >= INTERVAL:
        place += 1
    ordered = np.sort(values, axis=0)
    return np.median(values, axis=0), ordered[place - 1], ordered[n - place], _coverage(n, place)


def holm(p: Sequence[float]) -> tuple[float, ...]:
    """Correct p-values for their number.

    Args:
        p: p-values, (n,)

    Returns:
        corrected ones in the same order, (n,)

    Source: Holm 1979.
    """
    corrected = [0.0] * len(p)
    running = 0.0
    for place, index in enumerate(sorted(range(len(p)), key=lambda i: p[i])):
        running = max(running, min(1.0, (len(p) - place) * p[index]))
        corrected[index] = running
    return tuple(corrected)


def _coverage(n: int, place: int) -> float:
    """Return the chance that the median of all lies between the place-th smallest and largest of n runs."""
    return 1 - 2 * float(stats.binom.cdf(place - 1, n, 0.5))


def _judge_claim(claim: Claim, loss: Mapping[str, Values], share: float) -> ClaimTest:
    """Test the pairs that were run and put their verdicts together."""
    run = [pair for pair in claim.pairs if pair[0] in loss and pair[1] in loss]
    left_out = tuple(dict.fromkeys(name for pair in claim.pairs for name in pair if name not in loss))
    margins = [share * abs(float(np.median(loss[reference]))) for _, reference in run]
    facts = [
        _facts(loss[level], loss[reference], margin) for (level, reference), margin in zip(run, margins, strict=True)
    ]
    corrected = zip(*(holm(family) for family in zip(*facts, strict=True)), strict=True)
    pairs = tuple(_pair(claim, pair, loss, margin, *p) for pair, margin, p in zip(run, margins, corrected, strict=True))
    verdicts = {pair.verdict for pair in pairs}
    verdict: Verdict = "inconclusive"
    if not pairs:
        verdict = "not tested"
    elif "refuted" in verdicts:
        verdict = "refuted"
    elif verdicts == {"confirmed"}:
        verdict = "confirmed"
    return ClaimTest(claim, pairs, left_out, verdict)


def _pair(claim: Claim, pair: tuple[str, str], loss: Mapping[str, Values], margin: float, *p: float) -> PairTest:
    """Return the test of one pair."""
    level, reference = (loss[name] for name in pair)
    differences = np.subtract.outer(level, reference)
    a12 = float(np.mean((differences > 0) + 0.5 * (differences == 0)))
    worse, better, below, above = p
    shift = float(np.median(differences))
    verdict = _verdict(claim.kind, worse, better, below, above)
    return PairTest(*pair, a12, shift, margin, worse, better, below, above, verdict)


def _verdict(kind: str, p_worse: float, p_better: float, p_below: float, p_above: float) -> Verdict:
    """Return the verdict on one pair, by the rules at the top of this file."""
    worse, better, below, above = (p <= ALPHA for p in (p_worse, p_better, p_below, p_above))
    found: dict[str, tuple[bool, bool]] = {
        "worse": (worse and not below, below),
        "alike": (below and above, (worse and not below) or (better and not above)),
        "no better": (above, better and not above),
    }
    confirmed, refuted = found[kind]
    return "confirmed" if confirmed else "refuted" if refuted else "inconclusive"


def _facts(level: Values, reference: Values, margin: float) -> tuple[float, float, float, float]:
    """Return the p-values that stand against worse, better, below and above."""
    return (
        _mann_whitney(level, reference, "greater"),
        _mann_whitney(level, reference, "less"),
        _mann_whitney(level - margin, reference, "less"),
        _mann_whitney(level + margin, reference, "greater"),
    )


def _mann_whitney(x: Values, y: Values, alternative: str) -> float:
    """Return the one-sided p-value, exact where that can be counted."""
    together = np.concatenate((x, y))
    method: str | stats.PermutationMethod = "exact"
    if len(np.unique(together)) < len(together):
        countable = math.comb(len(together), len(x)) <= _EXACT_MAX
        method = stats.PermutationMethod(n_resamples=_EXACT_MAX, batch=1000) if countable else "asymptotic"
    return float(stats.mannwhitneyu(x, y, alternative=alternative, method=method).pvalue)
