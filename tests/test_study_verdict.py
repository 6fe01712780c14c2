"""Verdicts of studies: on data whose truth is known they are confirmed, refuted or inconclusive as their rules say."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from evolve.studies.study import Claim, Scale, Study, against, grid
from servolve.study_verdict import ALPHA, holm, judge, median_interval, overview

TIGHT = np.array([-0.02, -0.01, 0.0, 0.01, 0.02])
WIDE = np.array([-0.6, -0.3, 0.0, 0.3, 0.6])


def study(kind="worse", pairs=None, margin=0.2, metric="raw"):
    claim = Claim("The level is as said.", kind, pairs or against("2", "1"))
    return Study(
        *("synthetic", "Synthetic", "none", "lamp-robust", "lamp-xc330", "gp", ()),
        axis="value",
        levels=grid("population", (1, 2, 3)),
        claims=(claim,),
        metric=metric,
        margin=margin,
        scales={"full": Scale(("1", "2", "3"), 5)},
    )


def verdict(kind, level, reference, **options):
    return judge(study(kind, **options), {"1": level, "2": reference})[0].verdict


# level and reference around 1 with a margin of 0.2: shift of the level, spread, what each kind comes to
CASES = {
    "far worse": (0.5, TIGHT, {"worse": "confirmed", "alike": "refuted", "no better": "confirmed"}),
    "alike": (0.0, TIGHT, {"worse": "refuted", "alike": "confirmed", "no better": "confirmed"}),
    "worse by less than the margin": (0.1, TIGHT, {"worse": "refuted", "alike": "confirmed", "no better": "confirmed"}),
    "better by less than the margin": (
        *(-0.1, TIGHT),
        {"worse": "refuted", "alike": "confirmed", "no better": "confirmed"},
    ),
    "far better": (-0.5, TIGHT, {"worse": "refuted", "alike": "refuted", "no better": "refuted"}),
    "spread too wide to tell": (
        *(0.05, WIDE),
        {"worse": "inconclusive", "alike": "inconclusive", "no better": "inconclusive"},
    ),
}


@pytest.mark.parametrize(("name", "kind"), list(itertools.product(CASES, ("worse", "alike", "no better"))))
def test_verdicts_on_data_of_known_truth(name, kind):
    shift, spread, expected = CASES[name]
    # the offset of a thousandth keeps ties away
    assert verdict(kind, 1.001 + shift + spread, 1 + spread) == expected[kind]


@pytest.mark.parametrize("kind", ["worse", "alike", "no better"])
def test_two_runs_tell_nothing(kind):
    assert verdict(kind, [1.5, 1.6], [1.0, 1.1]) == "inconclusive"


def test_adjusted_fitness_judges_the_same_side_as_worse():
    bad, good = 2.0 + TIGHT, 0.05 + TIGHT / 10
    for metric in ("raw", "adjusted"):
        assert verdict("worse", bad, good, metric=metric) == "confirmed"
        assert verdict("worse", good, bad, metric=metric) == "refuted"


def test_an_infinite_fitness_is_the_worst():
    assert verdict("worse", [math.inf] * 5, 1 + TIGHT) == "confirmed"
    assert verdict("no better", 1 + TIGHT, [math.inf] * 5) == "refuted"


def test_the_p_value_is_exact_and_the_effect_counts_pairs():
    pair = judge(study(), {"1": [2.0, 2.1, 2.2, 2.3, 2.4], "2": [1.0, 1.1, 1.2, 1.3, 1.4]})[0].pairs[0]
    assert pair.p_worse == pytest.approx(1 / math.comb(10, 5))
    assert (pair.a12, pair.shift, pair.margin) == pytest.approx((1.0, 1.0, 0.2 * 1.2))
    tied = judge(study(), {"1": [1.0, 2.0], "2": [1.0, 3.0]})[0].pairs[0]
    assert tied.a12 == pytest.approx((0.5 + 0 + 1 + 0) / 4)
    # of the six ways to take two of 1, 1, 2, 3 all but 1, 1 win as many pairs
    assert tied.p_worse == pytest.approx(5 / 6)


def test_a_claim_needs_all_its_pairs_and_one_refutes_it():
    claim = study(pairs=(*against("3", "1"), *against("3", "2")))
    good, bad = 1 + TIGHT, 2.001 + TIGHT
    assert judge(claim, {"1": bad, "2": bad + 0.003, "3": good})[0].verdict == "confirmed"
    assert judge(claim, {"1": bad, "2": good + 0.003, "3": good})[0].verdict == "refuted"
    assert judge(claim, {"1": bad, "2": 1.2 + WIDE, "3": good})[0].verdict == "inconclusive"


def test_what_was_not_run_is_not_judged():
    claim = study(pairs=(*against("3", "1"), *against("3", "2")))
    only_one = judge(claim, {"1": 2 + TIGHT, "3": 1 + TIGHT})[0]
    assert (only_one.verdict, only_one.left_out, len(only_one.pairs)) == ("confirmed", ("2",), 1)
    none = judge(claim, {"1": 2 + TIGHT, "2": 2 + TIGHT})[0]
    assert (none.verdict, none.left_out) == ("not tested", ("3",))


def test_holm_corrects_over_the_pairs_of_a_claim():
    # Holm 1979: sorted p times what is left, never falling
    assert holm([0.01, 0.04, 0.03]) == pytest.approx((0.03, 0.06, 0.06))
    assert holm([0.9, 0.8]) == (1.0, 1.0)
    level, reference = 1.25 + WIDE[:4] / 2, 1 + WIDE[:4] / 4
    alone = judge(study(), {"1": level, "2": reference})[0].pairs[0]
    pairs = (*against("2", "1"), *against("2", "3"))
    both = judge(study(pairs=pairs), {"1": level, "2": reference, "3": level + 1e-4})[0].pairs
    assert both[0].p_worse == pytest.approx(2 * alone.p_worse)


def test_chance_alone_seldom_confirms_or_refutes():
    rng = np.random.default_rng(1)
    # levels just at the border of each statement: no difference, and one of the margin
    draws = rng.normal(10, 0.5, (300, 2, 6))
    worse = [verdict("worse", level, reference, margin=1e-9) for level, reference in draws]
    alike = [verdict("alike", level + 2.0, reference, margin=0.2) for level, reference in draws]
    assert 0 < worse.count("confirmed") <= 300 * (ALPHA + 0.03)
    assert 0 < alike.count("confirmed") <= 300 * (ALPHA + 0.03)


def test_the_trend_is_the_jonckheere_terpstra_test():
    values = {"1": [1.0, 2.0, 4.0], "2": [3.0, 5.0, 6.0], "3": [7.0, 8.0, 9.0]}
    found = overview(study(), values)
    # pairs of runs of different levels in order: 9 + 9 + 8 of 27; J's mean 13.5, variance by Jonckheere's formula
    n, total = (3, 3, 3), 9
    j = 8 + 9 + 9
    mean = (total**2 - sum(k**2 for k in n)) / 4
    variance = (total**2 * (2 * total + 3) - sum(k**2 * (2 * k + 3) for k in n)) / 72
    assert found.trend_p == pytest.approx(math.erfc((j - mean) / math.sqrt(2 * variance)))
    assert found.trend > 0
    assert found.kruskal_p < ALPHA
    assert overview(study(), {"1": [1.0, 1.0], "2": [1.0, 1.0]}).kruskal_p == 1.0


@pytest.mark.parametrize(("runs", "places"), [(1, (0, 0)), (5, (0, 4)), (6, (0, 5)), (10, (1, 8)), (20, (5, 14))])
def test_the_interval_covers_the_median_as_often_as_said(runs, places):
    median, low, high, coverage = median_interval(np.arange(float(runs)))
    assert (float(median), float(low), float(high)) == ((runs - 1) / 2, *places)
    # below the lower end lie at most `places[0]` of the runs
    outside = 2 * sum(math.comb(runs, k) for k in range(places[0] + 1)) / 2**runs
    assert coverage == pytest.approx(max(0.0, 1 - outside))
