"""`servolve bench`: how fast the parts are, as ratios that another machine can check."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Annotated, Any, Final

from cyclopts import Parameter
from rich.console import Console
from rich.table import Table

from controller.errors import InputError, RunError

RIG: Final = "lamp-xc330"
ROLLOUT_RATIO_MIN: Final = 0.95

Rows = list[dict[str, Any]]
_SHOWN: Final = ("ratio", "bound", "ok")


def bench(
    name: str | None = None,
    /,
    *,
    json_: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> int:
    """Measure ratios of rates, each side by turns in this very run; absolute rates differ too much between machines.

    Args:
        name: which, as `rollout`; left out: all
        json_: print one JSON object

    Returns:
        exit status; 1: a ratio is below its bound
    """
    if name is not None and name not in BENCHES:
        raise InputError(f"bench {name}: there is no such measurement; choose one of {', '.join(BENCHES)}")
    console = Console(stderr=True)
    found: dict[str, Rows] = {}
    for chosen in BENCHES if name is None else (name,):
        with console.status(f"measuring {chosen}"):
            found[chosen] = BENCHES[chosen]()
    if json_:
        print(json.dumps(found))
    else:
        for chosen, rows in found.items():
            _print(chosen, rows)
    low = [f"{chosen} {row['ratio']:.3f}" for chosen, rows in found.items() for row in rows if not row["ok"]]
    if low:
        raise RunError(f"bench: below their bounds: {', '.join(low)}; measure again on a quiet machine")
    return 0


def rollout() -> Rows:
    """Compare closed-loop rollouts with the engine alone at one and two threads, planar and free."""
    from controller import load_rig
    from sim_models.bench import INSTRUCTIONS, bench_rollout

    rig = load_rig(RIG)
    rows = []
    for form in ("planar", "free"):
        for threads in (1, 2):
            ratio = bench_rollout(rig, threads=threads, form=form)
            rows.append(
                {
                    "form": ratio.form,
                    "threads": ratio.threads,
                    "cpus": len(os.sched_getaffinity(0)),
                    "instructions": INSTRUCTIONS,
                    "ratio": round(ratio.ratio, 4),
                    "to_mjb_rollout": round(ratio.ratio_to_batch, 4),
                    "to_mujoco_rollout": round(ratio.ratio_to_module, 4),
                    "repeats": ratio.repeats,
                    "bound": ROLLOUT_RATIO_MIN,
                    "ok": ratio.ratio >= ROLLOUT_RATIO_MIN,
                }
            )
    return rows


BENCHES: Final[Mapping[str, Callable[[], Rows]]] = MappingProxyType({"rollout": rollout})
"""Measurements by name; each gives rows with a `ratio`, its `bound` and whether that is kept, `ok`."""


def _print(name: str, rows: Rows) -> None:
    """Print one measurement as a table: what differs between rows in columns, the rest below."""
    columns = [column for column in rows[0] if column in _SHOWN or len({str(row[column]) for row in rows}) > 1]
    table = Table(title=name, caption=", ".join(f"{c} {rows[0][c]}" for c in rows[0] if c not in columns))
    for column in columns:
        table.add_column(column.replace("_", " "), overflow="fold")
    for row in rows:
        values = (row[column] for column in columns)
        table.add_row(*(("yes" if value else "no") if isinstance(value, bool) else str(value) for value in values))
    Console().print(table)
