"""`servolve bench`: how fast the parts are, as ratios that another machine can check."""

from __future__ import annotations

import functools
import itertools
import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Any, Final, Literal

from cyclopts import Parameter
from rich.console import Console
from rich.status import Status
from rich.table import Table

from controller.errors import InputError, RunError

RIG: Final = "lamp-xc330"
FORMS: Final[tuple[Literal["planar", "free"], ...]] = ("planar", "free")
ROLLOUT_RATIO_MIN: Final = 0.95
SHIPPED_RATIO_MIN: Final = 1.0

_SEEDS: Final = 5
_SEEDS_MAX: Final = 100
_QUICK: Final = {"populations": 1, "size": 10, "turns": 1}
_TIMERS: Final = {True: "as shipped", False: "off on both sides"}

Rows = list[dict[str, Any]]
Tables = dict[str, Rows]
_SHOWN: Final = ("ratio", "bound", "ok")


@dataclass(frozen=True)
class Effort:
    """Say how much to measure.

    Args:
        quick: as little as shows that all works
        seeds: evolution runs of each side
        told: called with what is being run
    """

    quick: bool
    seeds: int
    told: Callable[[str], None]


def bench(
    name: str | None = None,
    /,
    *,
    quick: Annotated[bool, Parameter(negative="")] = False,
    seeds: int | None = None,
    json_: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> int:
    """Measure ratios of rates, each side by turns in this very run; absolute rates differ too much between machines.

    Args:
        name: rollout (against the engine alone), evolve (against a DEAP program) or bus (the host loop against loops on
            the vendor's SDK and on rustypot); left out: all
        quick: small evolution runs and few of them, whose ratios have no bounds
        seeds: evolution runs of each side; left out: 5, or 1 if quick
        json_: print one JSON object

    Returns:
        exit status; 1: a ratio is below its bound
    """
    if name is not None and name not in BENCHES:
        raise InputError(f"bench {name}: there is no such measurement; choose one of {', '.join(BENCHES)}")
    if seeds is not None and not 1 <= seeds <= _SEEDS_MAX:
        raise InputError(f"bench --seeds {seeds}: give a number from 1 to {_SEEDS_MAX}")
    console = Console(stderr=True)
    found: Tables = {}
    for chosen in BENCHES if name is None else (name,):
        with console.status(f"measuring {chosen}") as status:
            told = functools.partial(_tell, status, chosen)
            found |= BENCHES[chosen](Effort(quick, seeds or (1 if quick else _SEEDS), told))
    if json_:
        print(json.dumps(found))
    else:
        for chosen, rows in found.items():
            _print(chosen, rows)
    low = [f"{chosen} {row['ratio']:.3f}" for chosen, rows in found.items() for row in rows if not row.get("ok", True)]
    if low:
        raise RunError(f"bench: below their bounds: {', '.join(low)}; measure again on a quiet machine")
    return 0


def rollout(effort: Effort) -> Tables:
    """Compare closed-loop rollouts with the engine alone, planar and free, at one thread and two."""
    from controller import load_rig
    from sim_models.bench import INSTRUCTIONS, bench_rollout

    rig = load_rig(RIG)
    rows = []
    for timer, form, threads in itertools.product((True, False), FORMS, (1, 2)):
        bound = SHIPPED_RATIO_MIN if timer else ROLLOUT_RATIO_MIN
        effort.told(f"{form}, {threads} threads, timers {_TIMERS[timer]}")
        ratio = bench_rollout(rig, threads=threads, form=form, timer=timer)
        rows.append(
            {
                "timers": _TIMERS[timer],
                "form": ratio.form,
                "threads": ratio.threads,
                "cpus": len(os.sched_getaffinity(0)),
                "instructions": INSTRUCTIONS,
                "ratio": round(ratio.ratio, 4),
                "to_mjb_rollout": round(ratio.ratio_to_batch, 4),
                "to_mujoco_rollout": round(ratio.ratio_to_module, 4),
                "repeats": ratio.repeats,
                "bound": bound,
                "ok": ratio.ratio >= bound,
            }
        )
    return {"rollout": rows}


def evolve(effort: Effort) -> Tables:
    """Compare the time to the same quality with that of DEAP programs, and find what each measure gives."""
    from servolve.bench_evolve import make_contest, race, summary
    from servolve.bench_measures import measure

    contest = make_contest(effort.seeds, quick=effort.quick)
    rows = race(contest, effort.told)
    found = summary(contest, rows)
    if effort.quick:
        for row in found:
            del row["bound"], row["ok"]
    measures = measure(contest, effort.told, **(_QUICK if effort.quick else {}))
    return {"evolve": found, "evolve_runs": rows, "evolve_measures": measures}


def bus(effort: Effort) -> Tables:
    """Compare the host loop with loops on other clients, on one virtual rig."""
    from servolve.bench_bus import bench_bus

    return bench_bus(effort.told, seconds=2.0 if effort.quick else 10.0, turns=1 if effort.quick else 3)


BENCHES: Final[Mapping[str, Callable[[Effort], Tables]]] = MappingProxyType(
    {"rollout": rollout, "evolve": evolve, "bus": bus}
)
"""Measurements by name. Each gives tables; a row may have a `ratio`, its `bound` and whether that is kept, `ok`."""


def _tell(status: Status, name: str, what: str) -> None:
    """Say what is being measured."""
    status.update(f"measuring {name}: {what}")


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
