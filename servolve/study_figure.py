"""The figure of a study: how fitness falls with the individuals examined, and where it ends."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from servolve.study_report import METRICS, Finished
from servolve.study_verdict import Values, median_interval

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_APART: Final = "#D55E00"  # a level that has no number
_SHOWN_MAX: Final = 1e5  # beyond, a fitness stands for one that is infinite
_STYLE: Final[Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "servolve",
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "grid.color": "#e6e8eb",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
}


def study_figure(finished: Finished) -> dict[str, bytes]:
    """Draw a study, medians with intervals over the seeds.

    Args:
        finished: the study

    Returns:
        the figure by the ending of a file's name, "svg" and "png"; undated, so that equal studies give equal files
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    metric = METRICS[finished.study.metric]
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(9.2, 3.6), layout="constrained")
        curves, ends = figure.subplots(1, 2, gridspec_kw={"width_ratios": [1.25, 1]}, sharey=True)
        _draw_curves(curves, finished)
        _draw_ends(ends, finished)
        figure.suptitle(finished.study.title, x=0.01, ha="left", fontsize=10.5)
        curves.set(xlabel="individuals examined", ylabel=metric, title="best of generation")
        ends.set(xlabel=finished.study.axis, title="last generation")
        curves.set_ylim(bottom=0.0)
        curves.set_xlim(left=0.0)
        curves.legend(title=finished.study.axis, loc="best", fontsize=8.0, ncols=2)
        written = {}
        for ending, metadata in (("svg", {"Date": None}), ("png", {})):
            buffer = io.BytesIO()
            figure.savefig(buffer, format=ending, metadata=metadata, dpi=150)
            written[ending] = buffer.getvalue()
    return written


def _draw_curves(ax: Axes, finished: Finished) -> None:
    """Draw each level's median over the individuals examined, with its interval."""
    for level, colour in _colours(finished).items():
        values = _finite(finished.values(level))
        individuals = finished.population(level) * np.arange(1, values.shape[1] + 1)
        median, low, high, _ = median_interval(values)
        ax.fill_between(individuals, low, high, color=colour, alpha=0.13, linewidth=0)
        ax.plot(individuals, median, color=colour, linewidth=1.5, label=level)


def _draw_ends(ax: Axes, finished: Finished) -> None:
    """Draw where each run ended, and each level's median with its interval."""
    colours = _colours(finished)
    for place, (level, colour) in enumerate(colours.items()):
        final = _finite(finished.values(level))[:, -1]
        median, low, high, _ = median_interval(final)
        ax.plot([place, place], [low, high], color=colour, linewidth=5.0, alpha=0.35, solid_capstyle="butt")
        ax.plot(np.full(len(final), place), final, "o", color=colour, markersize=3.0)
        ax.plot([place - 0.25, place + 0.25], [median, median], color=colour, linewidth=2.0)
    ax.set_xticks(range(len(colours)), list(colours), fontsize=8.0)


def _colours(finished: Finished) -> dict[str, Any]:
    """Return a colour for each level, dark to light along the scale."""
    import matplotlib as mpl

    levels = [level for level in finished.study.levels if level.name in finished.curves]
    placed = [level.name for level in levels if level.number is not None]
    shades = mpl.colormaps["viridis"](np.linspace(0.0, 0.88, max(len(placed), 1)))
    colours = dict(zip(placed, (tuple(shade) for shade in shades), strict=False))
    return {level.name: colours.get(level.name, _APART) for level in levels}


def _finite(values: Values) -> Values:
    """Leave out what stands for an infinite fitness."""
    return np.where(values < _SHOWN_MAX, values, np.nan)
