"""Make whole runs of a controller on the rig under test: by the host loop, or by firmware built for it."""

from __future__ import annotations

import functools
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from controller import Controller, Rig, controller_text, parse_controller
from deploy.host_loop import Outcome, RunOptions, run_controller
from deploy.logs.log import Log, RunLog, read_log
from deploy.period import Connection

SWAY_RAD = 0.1
SLEW_RAD_S = 1.0
NEVER = 1e9


@dataclass(frozen=True)
class Made:
    """Hold how a run went, and its log."""

    outcome: Outcome
    log: Log


Make = Callable[..., Made]
"""Makes a run: seconds; and arm, derate, stop_after_s, all by name."""


def swaying(rig: Rig) -> Controller:
    """Return a controller that moves every joint a little around neutral, and needs no sensor."""
    if rig.joints[0].mode != "position":
        pytest.skip("its joints are driven by speed, not to a position")
    outputs, goals = "", []
    for joint in rig.joints:
        goals.append(f"(+ {joint.neutral_rad} (* {SWAY_RAD} (osc-wave 0.5 0)))")
        limits = f"low = {max(joint.low_rad, -3.0)}\nhigh = {min(joint.high_rad, 3.0)}\nneutral = {joint.neutral_rad}"
        outputs += f'[[output]]\nname = "{joint.name}"\nkind = "position"\nunit = "rad"\n{limits}\n'
    head = f'program = "(list {" ".join(goals)})"\n[controller]\nname = "sway"\nperiod_s = {rig.period_s}\n'
    terminal = '[[input]]\nname = "t"\nunit = "s"\nlow = 0.0\nhigh = 60.0\n'
    return parse_controller(f"{head}slew_rad_s = {SLEW_RAD_S}\n{terminal}{outputs}", "sway")


def meta(rig: Rig, controller: Controller) -> dict[str, object]:
    """Return what a log must say of itself to be replayed."""
    fields: dict[str, object] = {"format": 1, "rig": rig.name, "rig_text": rig.text, "controller": controller.name}
    fields |= {"controller_text": controller_text(controller), "period_s": rig.period_s}
    return fields | {"goal_dist": 0.0, "goal_bearing": 0.0}


def by_host(
    link: Connection,
    rig: Rig,
    path: Path,
    seconds: float,
    *,
    arm: bool = True,
    derate: float = 1.0,
    stop_after_s: float = NEVER,
) -> Made:
    """Let the host loop run."""
    controller, until = swaying(rig), link.clock.now() + stop_after_s
    stopping = replace(link, stop=lambda: "enough" if link.clock.now() >= until else None)
    with RunLog(path) as log:
        log.write("/meta", 0.0, meta(rig, controller))
        outcome = run_controller(stopping, rig, controller, RunOptions(0.0, 0.0, seconds, arm, derate), log)
    return Made(outcome, read_log(path))


def by_firmware(
    body: object,
    link: Connection,
    rig: Rig,
    folder: Path,
    path: Path,
    seconds: float,
    *,
    arm: bool = True,
    derate: float = 1.0,
    stop_after_s: float = NEVER,
) -> Made:
    """Let the native twin of the firmware run, on the virtual rig that the link is connected to as well."""
    from deploy.firmware.run import run_firmware
    from deploy.firmware.twin import TwinProcess

    controller, until = swaying(rig), body.now + stop_after_s
    with RunLog(path) as log, closing(TwinProcess(_image(rig.name, rig, folder))) as firmware:
        log.write("/meta", 0.0, meta(rig, controller))
        options = RunOptions(0.0, 0.0, seconds, arm, derate)
        stop = lambda: "enough" if body.now >= until else None  # noqa: E731
        outcome, _ = run_firmware(body, firmware, controller, options, log, stop)
    link.clock.sleep_until(body.now)  # the firmware has moved the rig on
    return Made(outcome, read_log(path))


@functools.cache
def _image(_: str, rig: Rig, folder: Path) -> Path:
    from firmware_gen.projects.build import build_firmware

    return build_firmware(swaying(rig), rig, "host", folder)
