"""`servolve bench bus`: the host loop beside a plain SDK loop and beside rustypot, all on the same virtual rig."""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from controller.errors import RunError
from servolve.bench_bus_loop import LOOPS, RIG_FILE

LOOPS_COMPARED: Final = ("servolve", "dynamixel_sdk", "rustypot")
CYCLES_PER_S_MIN: Final = 1000.0
_START_LINES: Final = 3


def bench_bus(told: Callable[[str], None], *, seconds: float, turns: int) -> dict[str, list[dict[str, Any]]]:
    """Measure loops of 100 Hz on four virtual servos at 1 Mbit/s, by turns, and how fast the rig is without wire time.

    Args:
        told: called with what is being run
        seconds: length of each run
        turns: runs of each loop

    Returns:
        `bus`: a row for each loop, with medians of its cycle over the time that its bytes need on the wire, of its
        share of a core, and of both over the plain SDK loop's; `bus_rig`: four-servo cycles a second that the rig
        serves, over 1,000
    """
    loops = [name for name in LOOPS_COMPARED if name != "rustypot" or find_spec("rustypot")]
    runs: dict[str, list[dict[str, Any]]] = {name: [] for name in loops}
    for turn in range(turns):
        for name in loops:
            told(f"{name}, turn {turn + 1}")
            with served() as port:  # afresh: without torque the body sinks, and may come to rest beyond its limits
                runs[name].append(run_loop(name, port, seconds))
    middle = {
        name: {key: statistics.median(run[key] for run in found) for key in found[0]} for name, found in runs.items()
    }
    plain = middle["dynamixel_sdk"]
    rows = [
        {
            "loop": name,
            "cycle_to_wire": round(found["cycle_s"] / found["wire_s"], 3),
            "cycle_to_sdk": round(found["cycle_s"] / plain["cycle_s"], 3),
            "cpu": round(found["cpu"], 3),
            "cpu_to_sdk": round(found["cpu"] / plain["cpu"], 3),
            "in_time": round(found["in_time"], 4),
            "runs": turns,
        }
        for name, found in middle.items()
    ]
    told("the rig without wire time")
    with served("--no-wire-time") as port:
        rate = statistics.median(run_loop("flood", port, seconds / 2)["cycles_per_s"] for _ in range(turns))
    ratio = rate / CYCLES_PER_S_MIN
    return {"bus": rows, "bus_rig": [{"ratio": round(ratio, 2), "bound": 1.0, "ok": ratio >= 1.0}]}


@contextmanager
def served(*arguments: str) -> Iterator[str]:
    """Serve the bench's rig from another process.

    Args:
        *arguments: further ones of `servolve rig serve`

    Yields:
        its bus
    """
    with TemporaryDirectory() as folder:
        link = str(Path(folder) / "bus")
        command = [sys.executable, "-m", "servolve", "rig", "serve", str(RIG_FILE), "--link", link, *arguments]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            try:
                if process.stdout is None or not all(process.stdout.readline() for _ in range(_START_LINES)):
                    said = process.stderr.read() if process.stderr else ""
                    raise RunError(f"bench bus: the virtual rig can not be served: {said.strip()}")
                yield link
            finally:
                process.kill()


def run_loop(name: str, port: str, seconds: float) -> dict[str, Any]:
    """Run a loop in a process of its own; return what it measured.

    Args:
        name: a name of `servolve.bench_bus_loop.LOOPS`
        port: the bus
        seconds: how long
    """
    if name not in LOOPS:
        raise KeyError(name)
    command = [sys.executable, "-m", "servolve.bench_bus_loop", name, port, str(seconds)]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    if run.returncode:
        last = (run.stderr.strip() or "it said nothing").splitlines()[-1]
        raise RunError(f"bench bus: the loop on {name} ended early: {last}; measure again on a quiet machine")
    found: dict[str, Any] = json.loads(run.stdout.splitlines()[-1])
    return found
