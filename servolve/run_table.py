"""Tell a person how a run went: findings, a table of figures, and the sentence that it ended by."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console
from rich.table import Table

from controller import Rig
from controller.errors import RunError
from deploy.finding import Finding
from deploy.host_loop import Outcome
from deploy.torque import unsure_sentence
from servolve.reading_table import reading_table


def warn(console: Console, findings: Sequence[Finding]) -> None:
    """Print findings, a line each.

    Args:
        console: where to
        findings: what was found
    """
    for finding in findings:
        console.print(f"servolve: {finding.level}: {finding.text}", highlight=False, markup=False, soft_wrap=True)


def not_told(outcome: Outcome, known: Sequence[Finding]) -> list[Finding]:
    """Return the findings that nothing else says: those known before are told, the first error is how the run ended.

    Args:
        outcome: of the run
        known: what was told before
    """
    first = next((finding for finding in outcome.findings if finding.level == "error"), None)
    return [finding for finding in outcome.findings if finding is not first and finding not in known]


def tell(console: Console, rig: Rig, outcome: Outcome, told: Mapping[str, Any], as_json: bool, armed: bool) -> None:
    """Print how a run went: one JSON object, or the figures of a run, or what a dry run has read.

    Args:
        console: where tables go
        rig: the rig
        outcome: of the run
        told: its figures
        as_json: whether to print these as JSON
        armed: whether torque was allowed
    """
    if as_json:
        print(json.dumps(told))
        return
    if not armed:
        console.print(reading_table(outcome.readings))
        for sensor in rig.sensors:
            value = outcome.pose.get(sensor.name)
            shown = "-" if value is None else f"{value:.4g}"
            console.print(f"sensor {sensor.name}: {shown}", highlight=False)
        if outcome.done:
            console.print(outcome.reason, highlight=False)
    elif outcome.cycles:
        console.print(_figures(told))


def exit_status(outcome: Outcome) -> int:
    """Return 0 for a run that did all that was asked for.

    Args:
        outcome: of the run

    Raises:
        RunError: it did not, with the reason
    """
    if outcome.done and not outcome.faulty:
        return 0
    unsure = unsure_sentence(outcome.unsure) if outcome.unsure else outcome.reason
    raise RunError(outcome.reason if unsure == outcome.reason else f"{outcome.reason}; {unsure}")


def _figures(told: Mapping[str, Any]) -> Table:
    table = Table(show_header=False)
    for name, unit in (
        ("state", ""),
        ("cycles", ""),
        ("missed_deadlines", ""),
        ("missed_replies", ""),
        ("bus_bytes", ""),
        ("goal_m", "m"),
        ("final_px_m", "m"),
        ("final_error_m", "m"),
        ("final_tilt_rad", "rad"),
        ("hops", ""),
        ("max_clearance_m", "m"),
        ("log", ""),
    ):
        value = told[name]
        if value is not None:
            label = name.removesuffix("_m").removesuffix("_rad").replace("_", " ")
            table.add_row(label, f"{value:.3f} {unit}" if isinstance(value, float) else str(value))
    return table
