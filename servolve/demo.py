"""`servolve demo`: the whole road once, by the commands that one would type."""

from __future__ import annotations

import json
import math
import shlex
import shutil
import sqlite3
import time
import tomllib
from contextlib import closing, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
from cyclopts import Parameter
from rich.console import Console
from rich.table import Table

from controller.errors import InputError, RunError

TASK: Final = "lamp-robust"
RIG: Final = "lamp-xc330"

DISTANCE_M_MAX: Final = 0.05
HOPS_MIN: Final = 2
RMSE_DEG_MAX: Final = 1.0
HELD_OUT_SHARE: Final = 0.75
"""A controller is good enough to go on with if so many of its held-out runs end upright within `DISTANCE_M_MAX`."""

_NUMBERS: Final = ("population=300", "generations=20")  # the demo wants a lamp that hops soon, not the best one
_ATTEMPTS: Final = 3
_EVOLVING_S_MAX: Final = 300.0
"""After this long no other seed is begun [s]."""

_GOAL_STREAM: Final = 0x676F616C
_GOAL_LOW_M: Final = 0.2
_GOAL_APART_M: Final = 0.001
_MARK: Final = "demo.json"
_TWIN: Final = """# Servos with four fifths of the datasheet's stall torque.
format = 1

[twin]
name = "weak-torque"
torque_scale = 0.8
"""


@dataclass(frozen=True)
class Gate:
    """Hold one thing that the demo demands.

    Args:
        name: what it is
        passed: whether it is so
        found: what was found, for the sentence that says it is not so
    """

    name: str
    passed: bool
    found: str


def demo(
    *,
    out: Path = Path("demo-out"),
    seed: int = 1,
    threads: int | None = None,
    set_: Annotated[tuple[str, ...], Parameter(name="--set", negative="")] = (),
    json_: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> int:
    """Evolve a lamp that hops, transpile it, run it on a virtual Dynamixel rig, compare rig and simulation.

    Leaves in the folder: best.controller.toml, its C, sim.mcap, rig.mcap, strip.png and report.html. Takes about four
    minutes on two CPUs.

    Args:
        out: folder for all of it; made anew if it is there from an earlier demo
        seed: of all chance; if what it finds is not good enough, the next ones are tried
        threads: threads that simulate; left out: one per CPU
        set_: KEY=VALUE, one of the evolution's settings, as often as needed
        json_: print one JSON object

    Returns:
        exit status; 1: a gate is not met
    """
    if seed < 0:
        raise InputError(f"--seed {seed}: is negative; give a whole number from 0")
    stages = _Stages(Console(stderr=True, highlight=False))
    _make_folder(out)
    evolved = _evolve(stages, out, seed, threads, set_)
    goal_m = unseen_goal(Path(evolved["run"]), seed)
    found = _road(stages, out, goal_m) | {"evolved": evolved}
    gates = judge(found)
    told = {"folder": str(out), "goal_m": goal_m, **found, "gates": {gate.name: gate.passed for gate in gates}}
    (out / _MARK).write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")
    stages.head("Done")
    if json_:
        print(json.dumps(told))
    else:
        Console().print(_table(out, goal_m, found, gates))
    failed = next((gate for gate in gates if not gate.passed), None)
    if failed is not None:
        raise RunError(f"demo: gate not met: {failed.name}: {failed.found}; everything recorded is in {out}")
    return 0


class _Stages:
    """Run commands of this command line, in this process, and say so."""

    def __init__(self, console: Console) -> None:
        self.console = console
        self._number = 0

    def head(self, title: str) -> None:
        """Begin a stage."""
        self._number += 1
        self.console.rule(f"[bold]{self._number}  {title}", align="left")

    def say(self, text: str) -> None:
        """Tell something."""
        self.console.print(text, markup=False, soft_wrap=True)

    def run(self, *arguments: str | Path | float, may_fail: bool = False) -> str:
        """Run a command; return what it printed."""
        from servolve.cli import main

        words = [str(argument) for argument in arguments]
        self.say(f"$ servolve {shlex.join(words)}")
        printed = StringIO()
        with redirect_stdout(printed):
            status = main(words)
        if status != 0 and not may_fail:
            raise RunError(f"demo: `servolve {words[0]}` ended with status {status}; its own sentence says why")
        return printed.getvalue()

    def ask(self, *arguments: str | Path | float, may_fail: bool = False) -> dict[str, Any]:
        """Run a command with --json; return its object, empty if it printed none."""
        lines = self.run(*arguments, "--json", may_fail=may_fail).strip().splitlines()
        answer: dict[str, Any] = json.loads(lines[-1]) if lines else {}
        return answer


def _make_folder(out: Path) -> None:
    """Make the folder, or empty that of an earlier demo."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        if any(out.iterdir()):
            if not (out / _MARK).is_file():
                raise InputError(f"{out}: holds something that is not an earlier demo's; give --out another folder")
            for path in out.iterdir():
                shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()
        # marks it as ours from now on, also if this is the last thing that happens
        (out / _MARK).write_text("{}\n", encoding="utf-8")
    except OSError as error:
        raise InputError(f"{out}: cannot be made ({error.strerror}); give --out another folder") from None


def _evolve(stages: _Stages, out: Path, seed: int, threads: int | None, overrides: tuple[str, ...]) -> dict[str, Any]:
    """Evolve until a controller passes its validation, or seeds or time are used up; return the best one's figures."""
    stages.head(f"Evolve {TASK} on {RIG}")
    started = time.monotonic()
    best: dict[str, Any] = {}
    options = [word for setting in (*_NUMBERS, *overrides) for word in ("--set", setting)]
    if threads is not None:
        options += ["--threads", str(threads)]
    for attempt in range(_ATTEMPTS):
        run = out / f"evolution-{seed + attempt}"
        evolved = stages.ask("evolve", TASK, "--rig", RIG, "--seed", seed + attempt, "--out", run, *options)
        evolved["seed"] = seed + attempt
        share = evolved["held_out"]["within_50_mm"]
        stages.say(f"seed {seed + attempt}: {share:.0%} of the held-out runs end upright within 5 cm")
        if not best or share > best["held_out"]["within_50_mm"]:
            best = evolved
        if share >= HELD_OUT_SHARE:
            break
        if attempt + 1 == _ATTEMPTS or time.monotonic() - started > _EVOLVING_S_MAX:
            stages.say(f"{HELD_OUT_SHARE:.0%} are wanted, but enough time is spent: going on with the best so far")
            break
        stages.say(f"{HELD_OUT_SHARE:.0%} are wanted: trying the next seed")
    shutil.copyfile(best["controller"], out / "best.controller.toml")
    return best


def unseen_goal(run: Path, seed: int) -> float:
    """Draw a goal that neither evolution nor the choice of its best has seen.

    Args:
        run: the run's folder
        seed: of the draw; its stream is not one of evolution's

    Returns:
        a distance far enough for two hops [m]
    """
    seen = goals_seen(run)
    rng = np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=(_GOAL_STREAM,))))
    while True:
        goal = round(float(rng.uniform(max(_GOAL_LOW_M, min(seen)), max(*seen, _GOAL_LOW_M + 0.1))), 3)
        if min(abs(goal - other) for other in seen) >= _GOAL_APART_M:
            return goal


def goals_seen(run: Path) -> list[float]:
    """Return the goal distances that a run has used [m]: to evolve, to choose its best, and to judge it.

    Args:
        run: the run's folder
    """
    from controller import load_rig
    from evolve.conditions import draw_conditions
    from evolve.settings import Settings
    from evolve.streams import Stream, generator

    about = tomllib.loads((run / "run.toml").read_text("utf-8"))
    settings = Settings(**about["settings"])
    njoint = len(load_rig(about["run"]["rig"]).joints)
    rng = generator(about["run"]["seed"], Stream.DECISION)
    seen: list[float] = draw_conditions(rng, settings, settings.decision_goals, njoint).goal_m.tolist()
    seen += json.loads((run / "validation.json").read_text("utf-8"))["goal_m"]
    with closing(sqlite3.connect(f"{(run / 'history.sqlite').resolve().as_uri()}?mode=ro", uri=True)) as history:
        for (goals,) in history.execute("select goals from generation"):
            seen += json.loads(goals)
    return seen


def _road(stages: _Stages, out: Path, goal_m: float) -> dict[str, Any]:
    """Take the controller from C to the rig and back; return what each command said."""
    best, log, weak_log = out / "best.controller.toml", out / "rig.mcap", out / "rig-weak-torque.mcap"
    stages.head("Transpile it to C, and compare that with the virtual machine")
    transpiled = stages.ask("transpile", best, "--out", out, "--name", "lamp", "--check", "--force")

    stages.head(f"Simulate it, to a goal that evolution has not seen: {100 * goal_m:.1f} cm")
    simulated = stages.ask(
        "simulate", best, "--rig", RIG, "--goal", goal_m, "--log", out / "sim.mcap", "--strip", out / "strip.png"
    )

    stages.head("Run it on the virtual Dynamixel rig")
    stages.say("its servos are on a bus, its position and force come as lines on a second port")
    deployed = stages.ask("deploy", best, "--rig", RIG, "--goal", goal_m, "--log", log)
    replayed = stages.ask("replay", log, may_fail=True)
    stages.say("the terminals recorded there, through the virtual machine and through the C:")
    recorded = _differences_on_recorded(stages, out, log)

    stages.head("Compare: the same goals at the same times in simulation")
    strip = ("--strip", out / "strip.png")
    compared = stages.ask("compare", log, "--report", out / "report.html", *strip)

    stages.head("Compare with a twin whose servos lack 20 % of their torque")
    twin = out / "weak-torque.twin.toml"
    twin.write_text(_TWIN, encoding="utf-8")
    stages.ask("deploy", best, "--rig", RIG, "--goal", goal_m, "--twin", twin, "--log", weak_log, may_fail=True)
    weak = stages.ask("compare", weak_log, may_fail=True)
    return {
        "transpiled": transpiled,
        "simulated": simulated,
        "deployed": deployed,
        "replayed": replayed,
        "recorded": recorded,
        "compared": compared,
        "weak": weak,
    }


def _differences_on_recorded(stages: _Stages, out: Path, log: Path) -> dict[str, int]:
    """Put a log's terminals through virtual machine and C; count the outputs that differ from the log's."""
    from deploy.logs.log import read_log

    cycles = read_log(log).cycles
    table = out / "rig-terminals.csv"
    rows = [",".join(f"0x{bits}" for bits in cycle["terminal_bits"].split()) for cycle in cycles]
    table.write_text("\n".join([",".join(cycles[0]["terminals"]), *rows]) + "\n", encoding="utf-8")
    wanted = [[f"0x{bits}" for bits in cycle["output_bits"].split()] for cycle in cycles]
    differences = {"values": sum(map(len, wanted))}
    for backend in ("vm", "c"):
        printed = stages.run("eval", out / "best.controller.toml", "--inputs", table, "--backend", backend)
        found = [line.split(",") for line in printed.splitlines()[1:]]
        differences[backend] = sum(
            a != b for row, other in zip(found, wanted, strict=True) for a, b in zip(row, other, strict=True)
        )
    return differences


def judge(found: dict[str, Any]) -> list[Gate]:
    """Return what the demo demands, in the order of the road.

    Args:
        found: what each command said, by stage
    """
    held_out, checks = found["evolved"]["held_out"], found["transpiled"]["check"]
    recorded, deployed, compared = found["recorded"], found["deployed"], found["compared"]
    share, distance_m, hops = held_out["within_50_mm"], deployed["final_error_m"], deployed["hops"]
    differences = sum(row["vm_differences"] + row["reference_differences"] + (row["selftest"] != 0) for row in checks)
    worst = max(compared["joints"], key=lambda joint: _nan_last(joint["rmse_deg"]))
    rmse = _nan_last(worst["rmse_deg"])
    return [
        Gate(
            "the best passes its validation",
            share >= HELD_OUT_SHARE,
            f"{share:.0%} of its held-out runs end upright within 5 cm, {HELD_OUT_SHARE:.0%} are wanted",
        ),
        Gate(
            "C computes what the virtual machine does", bool(checks) and differences == 0, f"{differences} differences"
        ),
        Gate(
            "the recorded terminals give the recorded outputs",
            recorded["vm"] == recorded["c"] == 0,
            f"{recorded['vm']} outputs of the virtual machine and {recorded['c']} of C differ",
        ),
        Gate("the log replays bit for bit", found["replayed"].get("bitwise") is True, str(found["replayed"])),
        Gate("the lamp ends upright", deployed["upright"] is True, f"it tilts {deployed['final_tilt_rad']} rad"),
        Gate("near its goal", distance_m <= DISTANCE_M_MAX, f"it is {100 * distance_m:.1f} cm away, 5 cm are allowed"),
        Gate("having hopped", hops >= HOPS_MIN, f"it made {hops} hops of 10 mm, {HOPS_MIN} are wanted"),
        Gate(
            "rig and simulation agree",
            rmse <= RMSE_DEG_MAX,
            f"joint {worst['name']} differs by {rmse:.2f} degrees RMS, {RMSE_DEG_MAX:g} is allowed",
        ),
    ]


def _nan_last(value: float | None) -> float:
    return math.inf if value is None else value


def _table(out: Path, goal_m: float, found: dict[str, Any], gates: list[Gate]) -> Table:
    """Return all figures, and which gates are met."""
    held_out, checks = found["evolved"]["held_out"], found["transpiled"]["check"]
    deployed, compared, recorded = found["deployed"], found["compared"], found["recorded"]
    steps = sum(row["steps"] for row in checks)
    builds = ", ".join(f"{row['compiler']} {row['flags']}" for row in checks)
    differences = sum(row["vm_differences"] for row in checks)
    table = Table(
        title=f"A lamp that hops, from evolution to the bench ({out})", title_justify="left", show_header=False
    )
    table.add_column()
    table.add_column(overflow="fold")
    table.add_row(
        "held-out error",
        f"mean {100 * held_out['mean_error_m']:.1f} cm, median {100 * held_out['median_error_m']:.1f} cm over "
        f"{held_out['conditions']} unseen goals and rigs; {held_out['within_50_mm']:.0%} upright within 5 cm",
    )
    table.add_row("C = VM", f"{differences} differences in {steps} random steps ({builds})")
    table.add_row("", f"{recorded['c']} differences in {recorded['values']} outputs recorded on the rig")
    table.add_row("bus cycles", f"{deployed['cycles']}, {deployed['bus_bytes']} bytes")
    table.add_row("deadline misses", f"{deployed['missed_deadlines']}, {deployed['missed_replies']} answers missed")
    table.add_row("goal", f"{100 * goal_m:.1f} cm, not seen by evolution")
    table.add_row(
        "final distance",
        f"{100 * deployed['final_error_m']:.1f} cm on the rig, "
        f"{100 * found['simulated']['final_error_m']:.1f} cm in closed-loop simulation",
    )
    table.add_row("hops", f"{deployed['hops']}, up to {1000 * deployed['max_clearance_m']:.0f} mm, all feet clear")
    table.add_row("sim-to-rig RMSE", _rmse(compared))
    table.add_row("  torque −20 %", _rmse(found["weak"]))
    table.add_row("report", str(out / "report.html"))
    table.add_section()
    for gate in gates:
        table.add_row("[green]met[/green]" if gate.passed else "[red]not met[/red]", gate.name)
    return table


def _rmse(compared: dict[str, Any]) -> str:
    """Return the joints' errors in one line."""
    return (
        "   ".join(f"{joint['name']} {_nan_last(joint['rmse_deg']):.2f}°" for joint in compared.get("joints", ()))
        or "–"
    )
