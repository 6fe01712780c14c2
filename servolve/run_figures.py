"""The figures of a run's report: fitness, sizes, hits, diversity, and the Pareto front."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from evolve.runs.record import GenerationSummary
from servolve.figures import GOAL, INK, MARK, RIG, SIM, page_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MEANS_SHOWN = 3.0  # times the best's range: the mean of a first generation would flatten the others


def fitness_figure(generations: Sequence[GenerationSummary]) -> str:
    """Draw best and mean fitness and the best's main goal over the generations, with the weight of style points.

    Args:
        generations: how each did

    Returns:
        an SVG element
    """
    svg: list[str] = []
    number = [g.generation for g in generations]
    best, main = [g.best for g in generations], [g.main for g in generations]
    with page_figure(3.2, svg) as figure:
        ax = figure.subplots()
        weight = ax.twinx()
        weight.fill_between(number, [g.phase for g in generations], color=GOAL, alpha=0.13, linewidth=0)
        weight.set(ylim=(0, 1), ylabel="weight of style points (grey)")
        weight.grid(visible=False)
        ax.set_zorder(weight.get_zorder() + 1)
        ax.patch.set_visible(False)
        ax.plot(number, [g.mean if math.isfinite(g.mean) else np.nan for g in generations], color=GOAL, label="mean")
        ax.plot(number, best, color=RIG, linewidth=1.8, label="best")
        ax.plot(number, main, color=SIM, dashes=(3, 1.6), label="main goal of the best")
        finite = [value for value in (*best, *main) if math.isfinite(value)]
        top = max(finite, default=1.0)
        shown = [g.mean for g in generations if math.isfinite(g.mean) and g.mean < _MEANS_SHOWN * top]
        ax.set(xlabel="generation", ylabel="fitness (lower is better)")
        ax.set_ylim(min(0.0, *finite, 0.0), 1.05 * max([top, *shown]) or 1.0)
        _whole_generations(ax)
        figure.legend(*ax.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return svg[0]


def population_figure(generations: Sequence[GenerationSummary], nodes: Sequence[Sequence[int]]) -> str:
    """Draw sizes, hits, diversity and rollouts over the generations.

    Args:
        generations: how each did
        nodes: sizes of each generation's individuals

    Returns:
        an SVG element
    """
    svg: list[str] = []
    number = [g.generation for g in generations]
    with page_figure(4.4, svg) as figure:
        (size, hits), (distinct, work) = figure.subplots(2, 2, sharex=True)
        low, middle, high = np.array([np.percentile(of, (25, 50, 75)) for of in nodes]).T
        size.fill_between(number, low, high, color=GOAL, alpha=0.25, linewidth=0)
        size.plot(number, middle, color=GOAL, label="median and quartiles")
        size.plot(number, [g.nodes for g in generations], color=RIG, label="best")
        size.set(title="Size", ylabel="nodes", ylim=(0, None))
        hits.plot(number, [100 * g.hits / g.conditions for g in generations], color=RIG, label="best hits")
        hits.plot(
            *(number, [100 * g.passed / g.conditions for g in generations]),
            color=SIM,
            dashes=(3, 1.6),
            label="best passes",
        )
        hits.plot(number, [100 * g.hit_all / g.population for g in generations], color=MARK, label="hit everything")
        hits.set(title="Hits", ylabel="% of conditions, individuals", ylim=(-3, 103))
        distinct.plot(number, [100 * g.distinct / g.population for g in generations], color=RIG)
        distinct.set(title="Different programs", ylabel="% of the population", ylim=(0, 103), xlabel="generation")
        work.plot(number, [g.simulations for g in generations], color=INK)
        work.set(title="Rollouts that a generation took", ylabel="rollouts", ylim=(0, None), xlabel="generation")
        for ax in (size, hits):
            ax.legend(loc="best", handlelength=1.4)
        _whole_generations(distinct)
    return svg[0]


def pareto_figure(front: Sequence[Mapping[str, Any]], objectives: Sequence[str]) -> str:
    """Draw a Pareto front, fitness over each objective.

    Args:
        front: its members, as `pareto.json` says
        objectives: names of those beside fitness

    Returns:
        an SVG element
    """
    svg: list[str] = []
    with page_figure(2.6, svg) as figure:
        axes = figure.subplots(1, len(objectives), sharey=True, squeeze=False)[0]
        for ax, name in zip(axes, objectives, strict=True):
            ax.plot([one[name] for one in front], [one["fitness"] for one in front], "o", color=RIG, markersize=4)
            ax.set(xlabel=name.replace("_", " "))
        axes[0].set(ylabel="fitness (lower is better)")
    return svg[0]


def _whole_generations(ax: Axes) -> None:
    """Put ticks at whole generations."""
    from matplotlib.ticker import MaxNLocator

    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
