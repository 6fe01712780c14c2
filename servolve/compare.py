"""`servolve compare`: how far a run on a rig and its goals in simulation differ."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from rich.console import Console

if TYPE_CHECKING:
    from deploy.logs.comparison import Array, Comparison


def compare(
    log: Path,
    /,
    *,
    report: Path | None = None,
    strip: Path | None = None,
    json_: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> int:
    """Replay a log's goals in simulation, at the times at which they reached the servos, and print the differences.

    Args:
        log: a log of `servolve deploy`
        report: write an HTML report there
        strip: a PNG film strip to put into the report
        json_: print one JSON object

    Returns:
        exit status
    """
    from deploy.logs.compare import compare as compare_log

    found = compare_log(log)
    stderr = Console(stderr=True, highlight=False, markup=False, soft_wrap=True)
    if not found.complete:
        stderr.print(f"{log}: ends abruptly; compared are the {len(found.timing.start_s)} cycles that it holds")
    if report is not None:
        from servolve.report import write_report

        write_report(found, report, strip)
        stderr.print(f"report: {report}")
    if json_:
        print(json.dumps(summary(found), allow_nan=False))
    else:
        _print_tables(found)
    return 0


def summary(found: Comparison) -> dict[str, object]:
    """Return a comparison's figures, without its tracks, as JSON can hold them.

    Args:
        found: the comparison
    """
    import numpy as np

    timing = found.timing
    periods = np.diff(timing.start_s)
    series = {"period_s": periods, "read_s": timing.read_s, "compute_s": timing.compute_s, "write_s": timing.write_s}
    series |= {f"age_{name}_s": ages for name, ages in timing.ages_s.items()}
    figures = {
        "log": str(found.log),
        "complete": found.complete,
        "rig": found.rig.name,
        "goal_m": None if found.goal_m is None else found.goal_m[0],
        "goal_bearing_rad": None if found.goal_m is None else found.goal_m[1],
        "joints": [asdict(joint) for joint in found.joints],
        "base_rms_m": found.base_rms_m,
        "pose_source": found.pose_source,
        "real": asdict(found.real_outcome),
        "sim": asdict(found.sim_outcome),
        "loop": {
            "cycles": len(timing.start_s),
            "period_s": timing.period_s,
            "overruns": timing.overruns,
            "missed_replies": timing.missed_replies,
            **{name: _spread(values) for name, values in series.items()},
        },
    }
    return {key: _without_nan(value) for key, value in figures.items()}


def _spread(values: Array) -> dict[str, float] | None:
    import numpy as np

    seen = values[np.isfinite(values)]
    if len(seen) == 0:
        return None
    return dict(zip(("median", "p99", "max"), map(float, np.percentile(seen, [50, 99, 100])), strict=True))


def _without_nan(value: object) -> object:
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_without_nan(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _print_tables(found: Comparison) -> None:
    from rich import box
    from rich.table import Table

    from servolve.report import error_rows, outcome_rows, timing_rows

    console = Console(highlight=False)
    titles = ("How it ended", "Rig against simulation", "Punctuality of the loop")
    for title, rows in zip(titles, (outcome_rows(found), error_rows(found), timing_rows(found)), strict=True):
        table = Table(box=box.SIMPLE_HEAD, title=title, title_justify="left", title_style="bold", pad_edge=False)
        for column, head in enumerate(rows.head):
            table.add_column(head, justify="left" if column < rows.text_columns else "right")
        for row in rows.rows:
            table.add_row(*row)
        console.print(table)
    timing = found.timing
    late = f"{timing.overruns} late, {timing.missed_replies} answers missed"
    console.print(f"{len(timing.start_s)} control cycles, {late}", markup=False)
