"""Make one run of firmware on the virtual rig: tell it what to do, and record what it says and what really happens."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from typing import Final, Literal

from controller.controller import Controller
from controller.errors import RunError
from deploy.buses.sensor_reader import SensorReader
from deploy.firmware.bench import FirmwareBench
from deploy.firmware.commands import commands
from deploy.firmware.console_decoder import ConsoleDecoder, Text
from deploy.firmware.machine import Firmware, Given
from deploy.firmware.reasons import Reason
from deploy.firmware.records import Change, Cycle, Record
from deploy.firmware.run_log import RecordLog, shape_of
from deploy.host_loop import Outcome, RunOptions
from deploy.logs.log import RunLog
from deploy.states import State
from deploy.virtual.rig import VirtualRig
from deploy.witness import Witness

_AROUND_S: Final = 60.0
"""Checks, homing and the way out are over in this time, or never."""
_RUNNING: Final = tuple(State).index(State.RUNNING)


def run_firmware(
    virtual: VirtualRig,
    firmware: Firmware,
    controller: Controller,
    options: RunOptions,
    log: RunLog,
    stop: Callable[[], str | None] = lambda: None,
    *,
    restless: bool = False,
) -> tuple[Outcome, Witness]:
    """Run firmware on a virtual rig in lock step, from torque off to torque off.

    Args:
        virtual: the rig
        firmware: the image, not yet booted; the caller closes it
        controller: what is in the image
        options: what to run
        log: where everything is recorded, `/meta` is there already; the caller closes it
        stop: gives the reason why a person wants to stop, or None
        restless: whether the firmware is woken for every sensor line

    Returns:
        how it went, as the firmware and as the rig's judge saw it; a fault is told there, not raised

    Raises:
        InputError: the run is longer than firmware takes
        RunError: the firmware has died, does not take what it is told, or does not end
    """
    return _Run(virtual, firmware, controller, options, log, stop, restless).go()


class _Run:
    """Hold what a run needs from one wait to the next."""

    def __init__(
        self,
        virtual: VirtualRig,
        firmware: Firmware,
        controller: Controller,
        options: RunOptions,
        log: RunLog,
        stop: Callable[[], str | None],
        restless: bool,
    ) -> None:
        rig = virtual.rig
        self._rig = rig
        self._log = log
        self._stop = stop
        self._bench = FirmwareBench(virtual, firmware, self._tap, restless=restless)
        self._decoder = ConsoleDecoder(shape_of(rig, controller))
        self._records = RecordLog(rig, controller, f"virtual {rig.name}", log.write)
        self._witness = Witness(virtual)
        self._sensors = SensorReader(rig.sensors)
        self._digest = hashlib.sha256()
        self._nbyte = 0
        self._origin = virtual.now
        self._until_s = virtual.now + options.seconds + _AROUND_S
        for line in commands(options, rig.period_s):
            self._bench.say(line)

    def go(self) -> tuple[Outcome, Witness]:
        """Carry bytes until the run has ended."""
        bench, records, stopped = self._bench, self._records, False
        while not records.ended:
            if not stopped and self._stop() is not None:
                bench.say("stop")
                stopped = True
            given, taken = bench.wake()
            self._sensors.feed(given.sensors, 1e-6 * given.now_us)
            heard = self._heard(taken.console, given)
            leaves = any(isinstance(one, Change) and one.left == _RUNNING for one in heard)
            # what ends the run is sent at the same time as its record; the judge looks before
            if leaves:
                self._look()
            bench.send(taken)
            if not leaves and any(_is_step(one) for one in heard):
                self._look()
            if not records.ended:
                bench.wait(taken)
            if bench.now > self._until_s:
                raise RunError(f"the firmware has not ended its run by {bench.now:.1f} s; this is a defect in it")
        bench.flush()
        outcome = records.outcome
        outcome.pose = outcome.pose or self._pose()
        outcome.bus_bytes, outcome.bus_sha256 = self._nbyte, self._digest.hexdigest()
        return outcome, self._witness

    def _heard(self, console: bytes, given: Given) -> Sequence[Record]:
        """Take what the firmware has said; return its records."""
        heard: list[Record] = []
        for one in self._decoder.feed(console):
            if isinstance(one, Text):
                if one.line.startswith(("what?", "busy")):
                    raise RunError(f"the firmware does not take what it is told: {one.line}")
            elif isinstance(one, Record):
                self._records.hear(one)
                heard.append(one)
                if isinstance(one, Change) and one.left == _RUNNING and one.reason == Reason.TIME:
                    self._records.outcome.pose = self._pose()  # as the firmware has read it at the very end
        return heard

    def _pose(self) -> dict[str, float]:
        """Return the newest value of every sensor that has sent one."""
        values = {}
        for number, sensor in enumerate(self._rig.sensors):
            raw = self._sensors.raw(number)
            if raw is not None:
                values[sensor.name] = (raw - sensor.zero) * sensor.scale
        return values

    def _look(self) -> None:
        seen = self._witness.look()
        self._log.write("/truth", self._witness.t - self._origin, seen)

    def _tap(self, direction: Literal["tx", "rx"], t: float, data: bytes) -> None:
        self._nbyte += len(data)
        self._digest.update(data)
        self._log.write("/bus", t - self._origin, {"direction": direction, "hex": data.hex()})


def _is_step(record: Record) -> bool:
    return isinstance(record, Cycle) or (isinstance(record, Change) and record.entered == _RUNNING)
