"""The figures of a report, each an SVG fragment: rig and simulation in the same axes, units on every axis."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from deploy.logs.comparison import HOP_CLEARANCE_M, Array, Comparison, Track

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's palette: told apart with every common colour blindness, and in grey print by the dashes
RIG = "#0072B2"
SIM = "#D55E00"
GOAL = "#8a8f98"
MARK = "#009E73"
INK = "#30343b"

WIDTH_IN = 9.2

_TICK_DEG = 360.0 / 4096.0

_STYLE: Any = {
    "svg.fonttype": "none",
    "svg.hashsalt": "servolve",
    "font.size": 9.0,
    "axes.edgecolor": "#9aa0a8",
    "axes.labelcolor": INK,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.titlecolor": INK,
    "axes.labelsize": 9.0,
    "grid.color": "#e6e8eb",
    "grid.linewidth": 0.6,
    "xtick.color": "#6b7078",
    "ytick.color": "#6b7078",
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "lines.linewidth": 1.3,
    "lines.solid_joinstyle": "round",
    "legend.frameon": False,
    "legend.fontsize": 9.0,
}


_NOTE: Any = {
    "xycoords": ("axes fraction", "data"),
    "textcoords": "offset points",
    "fontsize": 8.0,
    "color": "#6b7078",
    "bbox": {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 1.0},
}


@contextmanager
def page_figure(height_in: float, svg: list[str]) -> Iterator[Figure]:
    """Open a figure of the page's width and leave its SVG in `svg`, undated: equal runs give equal files.

    Args:
        height_in: its height [inch]
        svg: to which the SVG element is added when the figure is done
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
        yield figure
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None}, transparent=True)
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    # the page scales it: no fixed size, and its own fonts
    text = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", text, count=1)
    text = re.sub(r'(<svg[^>]*?) width="[^"]*"', r'\1 role="img"', text, count=1)
    svg.append(text)


def joint_figure(found: Comparison) -> str:
    """Draw each joint's angle and error over time, beside the second in which any joint differs most.

    Args:
        found: the comparison

    Returns:
        an SVG element
    """
    svg: list[str] = []
    njoint = len(found.joints)
    end = float(found.time_s[-1])
    low = _second_to_enlarge(found)
    with page_figure(2.35 * njoint + 0.6, svg) as figure:
        axes = figure.subplots(
            2 * njoint,
            2,
            sharex="col",
            sharey="row",
            gridspec_kw={"width_ratios": [2.2, 1.0], "height_ratios": [2.2, 1.0] * njoint},
            squeeze=False,
        )
        for j, joint in enumerate(found.joints):
            for column in range(2):
                _draw_angles(axes[2 * j][column], found, j)
                _draw_errors(axes[2 * j + 1][column], found, j)
            axes[2 * j][0].set_title(
                f"{joint.name}: RMSE {joint.rmse_deg:.2f}°, largest {joint.max_deg:.2f}° at {joint.max_time_s:.2f} s"
            )
            axes[2 * j][0].set_ylabel("angle [°]")
            axes[2 * j + 1][0].set_ylabel("rig − sim. [°]")
        for ax in axes[:, 0]:
            ax.set_xlim(0.0, end)
            ax.axvspan(low, low + 1.0, color="#f4f0e0", zorder=0, linewidth=0)
        axes[0][1].set_xlim(low, low + 1.0)
        axes[0][1].set_title("The shaded second, enlarged")
        for ax in axes[-1]:
            ax.set_xlabel("time after the first cycle [s]")
        figure.legend(*axes[0][0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
        figure.align_ylabels(axes[:, 0])
    return svg[0]


def _second_to_enlarge(found: Comparison) -> float:
    """Return where the second around the largest difference begins; if none exceeds a tick, where the busiest does."""
    latest = max(0.0, float(found.time_s[-1]) - 1.0)
    worst = max(found.joints, key=lambda joint: joint.max_deg if joint.samples else -1.0)
    if worst.samples and worst.max_deg > _TICK_DEG:
        return max(0.0, min(worst.max_time_s - 0.5, latest))
    starts = found.time_s[found.time_s <= latest]
    moved = [
        np.abs(np.diff(found.sim.joint_rad[(found.time_s >= start) & (found.time_s < start + 1.0)], axis=0)).sum()
        for start in starts
    ]
    return float(starts[int(np.argmax(moved))]) if moved else 0.0


def _draw_angles(ax: Axes, found: Comparison, j: int) -> None:
    goal_time = np.append(found.goal_time_s, found.time_s[-1])
    goal = np.degrees(np.append(found.goal_rad[:, j], found.goal_rad[-1, j]))
    real, sim = np.degrees(found.real.joint_rad[:, j]), np.degrees(found.sim.joint_rad[:, j])
    ax.step(goal_time, goal, where="post", color=GOAL, linewidth=0.8, label="goal")
    ax.plot(found.time_s, real, color=RIG, linewidth=1.7, label="rig")
    ax.plot(found.time_s, sim, color=SIM, linewidth=1.1, dashes=(3, 1.6), label="simulation")


def _draw_errors(ax: Axes, found: Comparison, j: int) -> None:
    error = np.degrees(found.real.joint_rad[:, j] - found.sim.joint_rad[:, j])
    ax.axhline(0.0, color="#9aa0a8", linewidth=0.7)
    ax.fill_between(found.time_s, error, 0.0, color=INK, alpha=0.18, linewidth=0)
    ax.plot(found.time_s, error, color=INK, linewidth=0.9)
    # magnify no more than an encoder can tell: a tick is 0.088 degrees
    span = max(0.25, 1.15 * float(np.nanmax(np.abs(error), initial=0.0)))
    ax.set_ylim(-span, span)


def path_figure(found: Comparison) -> str:
    """Draw the base's path from the side and from above, the height of its feet, and its distance to the goal.

    Args:
        found: the comparison

    Returns:
        an SVG element
    """
    svg: list[str] = []
    along, across = _goal_frame(found)
    with page_figure(7.2, svg) as figure:
        side, top, clear, distance = figure.subplots(4, 1, gridspec_kw={"height_ratios": [1.25, 0.9, 1.3, 1.3]})
        for track, colour, label, line in _tracks(found):
            x, y = 100 * track.position_m[:, :2] @ along, 100 * track.position_m[:, :2] @ across
            side.plot(x, 100 * track.position_m[:, 2], color=colour, label=label, **line)
            top.plot(x, y, color=colour, **line)
            for ax, height in ((side, 100 * track.position_m[:, 2]), (top, y)):
                ax.plot(x[-1:], height[-1:], "o", color=colour, markersize=4.5)
            clear.plot(found.pose_time_s, 1000 * track.clearance_m, color=colour, **line)
            gap = goal_distance(track.position_m, found.goal_m)
            if gap is not None:
                distance.plot(found.pose_time_s, 100 * gap, color=colour, **line)
        if found.goal_m is not None:
            side.axvline(100 * found.goal_m[0], color=MARK, linewidth=1.0, dashes=(5, 2), label="goal")
            top.plot([100 * found.goal_m[0]], [0.0], "x", color=MARK, markersize=8, markeredgewidth=2)
            distance.axhline(1.5, color=MARK, linewidth=1.0, dashes=(5, 2))
            distance.annotate("1.5 cm: a hit", (0.005, 1.5), (0, 3), **_NOTE)
        clear.axhline(1000 * HOP_CLEARANCE_M, color=GOAL, linewidth=1.0, dashes=(5, 2))
        clear.annotate(f"{1000 * HOP_CLEARANCE_M:.0f} mm: a hop", (0.005, 1000 * HOP_CLEARANCE_M), (0, 3), **_NOTE)
        _label_path(found, side, top, clear, distance)
        figure.legend(*side.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return svg[0]


def _label_path(found: Comparison, side: Axes, top: Axes, clear: Axes, distance: Axes) -> None:
    real, sim = found.real_outcome, found.sim_outcome
    side.set(ylabel="height [cm]", title="Side view of the base's centre (the dot is where it ends)")
    top.set(xlabel="towards the goal [cm]", ylabel="left [cm]", title="The same from above")
    top.sharex(side)
    for ax in (side, top):
        ax.set_aspect("equal", adjustable="datalim")
    clear.set(
        ylabel="lowest foot [mm]",
        title=f"Clearance of the lowest foot: {_hops(real.hops)} on the rig, {_hops(sim.hops)} in simulation",
    )
    distance.set(
        ylabel="to the goal [cm]",
        xlabel="time after the first cycle [s]",
        title="Distance from the base's centre to the goal, on the floor",
    )
    distance.set_ylim(bottom=0.0)
    end = float(found.pose_time_s[-1]) if len(found.pose_time_s) else 1.0
    for ax in (clear, distance):
        ax.set_xlim(0.0, end)


def force_figure(found: Comparison) -> str:
    """Draw the base's contact force over time.

    Args:
        found: the comparison

    Returns:
        an SVG element
    """
    svg: list[str] = []
    with page_figure(2.3, svg) as figure:
        ax = figure.subplots()
        for track, colour, label, line in _tracks(found):
            ax.plot(found.force_time_s, track.force_n, color=colour, label=label, **line)
        ax.set(xlabel="time after the first cycle [s]", ylabel="force [N]")
        if len(found.force_time_s):
            ax.set_xlim(0.0, float(found.force_time_s[-1]))
        figure.legend(*ax.get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return svg[0]


def timing_figure(found: Comparison) -> str:
    """Draw histograms of the control period, the durations of its parts, and the ages of the sensor values used.

    Args:
        found: the comparison

    Returns:
        an SVG element
    """
    svg: list[str] = []
    timing = found.timing
    with page_figure(2.6, svg) as figure:
        period, parts, ages = figure.subplots(1, 3)
        _histogram(period, {"period": 1000 * np.diff(timing.start_s)}, (RIG,))
        period.axvline(1000 * timing.period_s, color=MARK, linewidth=1.0, dashes=(5, 2))
        period.set(xlabel="from cycle to cycle [ms]", ylabel="cycles", title="Period (dashed: as asked for)")
        durations = {"read": timing.read_s, "compute": timing.compute_s, "write": timing.write_s}
        _histogram(parts, {name: 1000 * values for name, values in durations.items()}, (RIG, GOAL, SIM))
        parts.set(xlabel="duration [ms]", title="Parts of a cycle")
        _histogram(ages, {name: 1000 * values for name, values in timing.ages_s.items()}, (RIG, SIM, MARK, GOAL))
        ages.set(xlabel="age when used [ms]", title="Age of sensor values")
        for ax in (parts, ages):
            if ax.get_legend_handles_labels()[0]:
                ax.legend(loc="upper right", ncols=3, handlelength=0.8, columnspacing=0.9, handletextpad=0.4)
    return svg[0]


def _histogram(ax: Axes, series: dict[str, Array], colours: tuple[str, ...]) -> None:
    finite = {name: values[np.isfinite(values)] for name, values in series.items()}
    finite = {name: values for name, values in finite.items() if len(values)}
    if not finite:
        ax.text(0.5, 0.5, "not in this log", transform=ax.transAxes, ha="center", color="#6b7078")
        return
    everything = np.concatenate(list(finite.values()))
    low, high = float(everything.min()), float(everything.max())
    # a lock-step run repeats itself to the microsecond: keep a readable width
    margin = max(0.0, 1.0 - (high - low)) / 2 + 0.02 * (high - low)
    bins = np.linspace(low - margin, high + margin, 41)
    most = 1.0
    for colour, (name, values) in zip(colours, finite.items(), strict=False):
        ax.hist(values, bins=bins.tolist(), color=colour, alpha=0.25, linewidth=0)
        counts, _, _ = ax.hist(values, bins=bins.tolist(), color=colour, histtype="step", linewidth=1.3, label=name)
        most = max(most, float(np.max(counts)))
    # few late cycles must be seen beside a thousand punctual ones
    ax.set_yscale("symlog", linthresh=1.0)
    ax.yaxis.set_major_formatter("{x:.0f}")
    # leave room for the legend above the bars
    ax.set_ylim(0.0, most * (1.5 if len(finite) == 1 else 8.0))
    ax.locator_params(axis="x", nbins=5)
    ax.grid(visible=False, axis="x")


def goal_distance(position_m: Array, goal_m: tuple[float, float] | None) -> Array | None:
    """Measure how far the base is from the goal, on the floor.

    Args:
        position_m: base positions in the frame of the start [m], (npose, 3)
        goal_m: distance and bearing of the goal ([m], [rad]), or None

    Returns:
        distances [m], (npose,); None without a goal
    """
    if goal_m is None:
        return None
    goal = goal_m[0] * np.array([math.cos(goal_m[1]), math.sin(goal_m[1])])
    distance: Array = np.hypot(*(position_m[:, :2] - goal).T)
    return distance


def _goal_frame(found: Comparison) -> tuple[Array, Array]:
    """Return unit vectors on the floor: towards the goal, and to its left."""
    bearing = found.goal_m[1] if found.goal_m is not None else 0.0
    return np.array([math.cos(bearing), math.sin(bearing)]), np.array([-math.sin(bearing), math.cos(bearing)])


def _tracks(found: Comparison) -> tuple[tuple[Track, str, str, dict[str, Any]], ...]:
    return (
        (found.real, RIG, "rig", {"linewidth": 1.7}),
        (found.sim, SIM, "simulation", {"linewidth": 1.1, "dashes": (3, 1.6)}),
    )


def _hops(hops: int | None) -> str:
    return "no one can tell" if hops is None else f"{hops} hop" + "s" * (hops != 1)
