"""The same run by the host loop and by firmware: built images, and what each run leaves behind."""

import functools
import tempfile
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from controller import Controller, controller_text, load_controller, load_rig
from controller.rig import Rig
from deploy.connection import connect_virtual
from deploy.firmware.twin import TwinProcess
from deploy.host_loop import Outcome, RunOptions, run_controller
from deploy.logs.log import Log, RunLog, read_log
from deploy.virtual.faults import parse_fault
from deploy.virtual.rig import VirtualRig
from firmware_gen.projects.build import build_firmware

GOLDEN = Path(__file__).parent / "golden"


@dataclass(frozen=True, eq=False)
class Task:
    """Say what is run: a rig, an evolved controller, and a goal that it reaches."""

    rig: Rig
    controller: Controller
    goal: float

    def options(self, seconds, **changes):
        fields = {"goal_dist": self.goal, "goal_bearing": 0.0, "seconds": seconds, "arm": True, "derate": 1.0}
        return RunOptions(**fields | changes)

    @property
    def meta(self):
        meta = {"format": 1, "rig": self.rig.name, "rig_text": self.rig.text, "controller": self.controller.name}
        meta |= {"controller_text": controller_text(self.controller), "period_s": self.rig.period_s}
        return meta | {"goal_dist": self.goal, "goal_bearing": 0.0}


# `servolve evolve lamp-robust --rig lamp-xc330 --seed 1` and `servolve evolve lamp --rig lamp-sts3215 --seed 1`
XC330 = Task(load_rig("lamp-xc330"), load_controller(GOLDEN / "lamp-robust.controller.toml"), 0.4)
STS3215 = Task(load_rig("lamp-sts3215"), load_controller(GOLDEN / "lamp-sts.controller.toml"), 0.35)


@dataclass(frozen=True)
class Run:
    """Hold what a run leaves behind."""

    outcome: Outcome
    seen: dict
    log: Log
    virtual: VirtualRig
    console: bytes = b""

    @property
    def goals(self):
        return [tuple(cycle["goal_counts"].values()) for cycle in self.log.cycles]

    @property
    def frames(self):
        """Return every frame: direction, time, bytes."""
        return [(frame["direction"], frame["t"], frame["hex"]) for frame in self.log.messages["/bus"]]

    def asked_per_cycle(self):
        """Return what was asked in each control period, instruction by instruction, and when."""
        starts = [cycle["t"] for cycle in self.log.cycles]
        asked = [[] for _ in starts]
        for direction, t, data in self.frames:
            if direction == "tx" and starts and t >= starts[0]:
                number = max(k for k, start in enumerate(starts) if start <= t)
                asked[number].append((t, data))
        return asked

    def told(self):
        """Return the log's events but for their times: what a check finds is told when it is over, or at once."""
        return [(event["kind"], event["text"]) for event in self.log.events]


class Recorder:
    """Stand between bench and firmware; keep all that came from the console."""

    def __init__(self, firmware):
        self.firmware = firmware
        self.console = b""

    def resume(self, given):
        taken = self.firmware.resume(given)
        self.console += taken.console
        return taken

    def close(self):
        self.firmware.close()


@functools.cache
def _folder():
    return tempfile.TemporaryDirectory(prefix="servolve-firmware-")


@functools.cache
def image(task, board):
    """Build a task's firmware for a board, once in a process; return the linked image."""
    return build_firmware(task.controller, task.rig, board, Path(_folder().name) / f"{task.rig.name}-{board}")


def virtual_rig(task, faults, held):
    """Return the rig with faults, and servos that hold counts: number => register => count."""
    virtual = VirtualRig(task.rig, faults=[parse_fault(fault) for fault in faults])
    for number, counts in held.items():
        for register, count in counts.items():
            virtual.servos[number].table[register] = count
    return virtual


def host_run(path, task, faults=(), seconds=2.0, stop=lambda virtual: None, held=MappingProxyType({}), **changes):
    """Run the host loop."""
    virtual = virtual_rig(task, faults, held)
    options = task.options(seconds, **changes)
    with RunLog(path) as log, connect_virtual(virtual, lambda: stop(virtual)) as link:
        log.write("/meta", 0.0, task.meta)
        outcome = run_controller(link, task.rig, task.controller, options, log)
        seen = link.witness.verdict(task.goal, 0.0)
    return Run(outcome, seen, read_log(path), virtual)


def firmware_run(
    path,
    task,
    faults=(),
    seconds=2.0,
    stop=lambda virtual: None,
    held=MappingProxyType({}),
    machine=None,
    restless=False,
    **changes,
):
    """Run firmware: the native twin, or what a machine runs."""
    from deploy.firmware.run import run_firmware

    virtual = virtual_rig(task, faults, held)
    options = task.options(seconds, **changes)
    firmware = Recorder(machine() if machine else TwinProcess(image(task, "host")))
    try:
        with RunLog(path) as log:
            log.write("/meta", 0.0, task.meta)
            outcome, witness = run_firmware(
                virtual, firmware, task.controller, options, log, lambda: stop(virtual), restless=restless
            )
    finally:
        firmware.close()
    return Run(outcome, witness.verdict(task.goal, 0.0), read_log(path), virtual, firmware.console)
