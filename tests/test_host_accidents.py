"""The host loop when people stop it, disks are full, hosts stall: torque is off on every way out, and that is told."""

import itertools
import math
import os
import select

import pytest
from rich.console import Console
from rig_bench import RIG, Bench, sway

from controller import registers
from controller.errors import InputError, RunError
from deploy.buses.sensor_reader import checksum
from deploy.connection import connect_virtual
from deploy.host_loop import RunOptions, run_controller
from deploy.logs.log import RunLog
from deploy.states import State
from servolve.announcer import Announcer

TABLE = registers(RIG.joints[0].product)


@pytest.fixture
def bench(tmp_path):
    return lambda *faults, **options: Bench(tmp_path, *faults, **options)


@pytest.mark.parametrize("at", [0.0, 0.32, 0.4, 1.5])
def test_a_person_can_stop_it_in_every_state(bench, at):
    on = bench()
    outcome = on.run(3.0, stop=lambda bench: "a key was pressed" if bench.virtual.now >= at else None)
    assert not outcome.done and not outcome.faulty
    assert outcome.state is State.OFF and outcome.reason == "stopped: a key was pressed"
    assert on.torque() == [0, 0, 0]


def test_the_sensor_node_can_stop_it(bench, monkeypatch):
    on = bench()
    lines = on.virtual.sensor_until

    def with_stop(t):
        return lines(t) + (b"$E,1*%02X\r\n" % checksum(b"E,1") if t > 1.0 else b"")

    monkeypatch.setattr(on.virtual, "sensor_until", with_stop)
    outcome = on.run(3.0)
    assert outcome.reason == "stopped: the sensor node sent an emergency stop"
    assert on.torque() == [0, 0, 0]


def test_an_unforeseen_exception_switches_torque_off_on_its_way_up(bench, monkeypatch):
    on = bench()

    def burst(*_):
        raise ZeroDivisionError("a defect")

    monkeypatch.setattr("deploy.logs.cycle_message.CycleWords.message", burst)
    with pytest.raises(ZeroDivisionError):
        on.run()
    assert on.torque() == [0, 0, 0]


def test_a_full_disk_switches_torque_off(tmp_path, monkeypatch):
    on = Bench(tmp_path)
    with RunLog(on.path) as log, connect_virtual(on.virtual, lambda: None) as link:
        monkeypatch.setattr(log, "_writer", FullDisk(log._writer))
        outcome = run_controller(link, RIG, sway(), RunOptions(0.4, 0.0, 5.0, True, 1.0), log)
    assert outcome.faulty and "the log cannot be written any more" in outcome.reason
    assert outcome.cycles > 0
    assert on.torque() == [0, 0, 0]


class FullDisk:
    """Pass on to a writer until one second's worth is flushed for the third time."""

    def __init__(self, writer):
        self.writer, self.flushed = writer, 0

    def __getattr__(self, name):
        return getattr(self.writer, name)

    def flush(self):
        self.flushed += 1
        if self.flushed == 3:
            raise OSError(28, "No space left on device")
        self.writer.flush()


def test_a_tripped_watchdog_of_an_earlier_run_is_cleared(bench):
    on = bench()
    servo = on.virtual.servos[0]
    servo.table["torque_enable"] = 1
    servo.table["bus_watchdog"] = 5
    on.virtual.advance(0.5)
    assert servo.table["bus_watchdog"] == 255
    outcome = on.run(0.5)
    assert outcome.done, outcome.reason
    assert [finding.level for finding in outcome.findings] == ["warning"]


def test_a_host_that_was_silent_for_too_long_is_told(bench):
    stalled = []

    def stall(bench):
        if bench.virtual.now > 1.0 and not stalled:
            stalled.append(bench.link.clock.now())
            bench.link.clock.sleep_until(stalled[0] + 0.3)  # the process slept; the servos have not

    on = bench()
    outcome = on.run(3.0, stop=stall)
    assert outcome.faulty and "the host was silent for 0.3" in outcome.reason
    assert on.torque() == [0, 0, 0]
    assert [servo.table["bus_watchdog"] for servo in on.virtual.servos] == [0, 0, 0]


def test_a_short_stall_rides_through_and_the_controller_is_not_stepped_twice(bench):
    stalled = []

    def stall(bench):
        if bench.virtual.now > 1.0 and not stalled:
            stalled.append(bench.link.clock.now())
            bench.link.clock.sleep_until(stalled[0] + 0.07)

    on = bench()
    outcome = on.run(2.0, stop=stall)
    assert outcome.done and outcome.cycles == 100
    steps = [b["t"] - a["t"] for a, b in itertools.pairwise(on.log.cycles)]
    assert min(steps) > 0.0 and sum(step > 0.021 for step in steps) == 1
    assert [cycle["k"] for cycle in on.log.cycles] == list(range(100))
    assert sum(step < 0.019 for step in steps) <= 1  # the one that was late, made up for within its period


def test_the_bus_watchdog_is_armed_while_running(bench):
    seen = []
    on = bench()
    on.run(1.0, stop=lambda bench: seen.append([s.table["bus_watchdog"] for s in bench.virtual.servos]))
    counts = round(RIG.safety.watchdog_s / 0.02)
    assert seen[-1] == [counts] * 3


def test_a_controller_for_another_rig_is_refused_before_the_bus_is_touched(bench):
    on = bench()
    with pytest.raises(InputError, match="period_s"):
        on.run(controller=sway(period_s=0.01))
    assert on.virtual.now < 0.01


@pytest.mark.parametrize(("fault", "end"), [((), State.STOPPING), (("dead=2@1.0",), State.FAULT)])
def test_the_end_is_announced_and_logged_once_torque_is_off(bench, monkeypatch, fault, end):
    on = bench(*fault)
    found = {}
    write = RunLog.write

    def log(self, topic, t, message):
        if message.get("entered") == end.value:
            found["logged"] = on.torque()
        write(self, topic, t, message)

    monkeypatch.setattr(RunLog, "write", log)
    on.announce = lambda state: found.setdefault(state, on.torque())
    outcome = on.run(1.5)
    assert end in found and outcome.state in (State.OFF, State.FAULT)
    assert found[State.RUNNING] == [1, 1, 1]
    assert found[end] == found["logged"] == [0, 0, 0]
    assert on.log.events[-1]["t"] > next(e["t"] for e in on.log.events if e.get("entered") == "running")


@pytest.mark.parametrize("at", [0.0, 0.4, 1.0, math.inf])
def test_a_log_that_fails_leaves_no_torque_and_is_told(bench, monkeypatch, at):
    on = bench()
    write = RunLog.write

    def full(self, topic, t, message):
        # at any time, or as late as the release itself
        if topic == "/bus" and (t >= at or (math.isinf(at) and on.torque() == [0, 0, 0] and t > 1.0)):
            raise RunError("run.mcap: the log cannot be written any more (No space left on device)")
        write(self, topic, t, message)

    monkeypatch.setattr(RunLog, "write", full)
    outcome = on.run(1.0)
    assert outcome.faulty and "the log cannot be written any more" in outcome.reason
    assert outcome.unsure == [] and on.torque() == [0, 0, 0]


def test_an_announcer_that_fails_leaves_no_torque(bench):
    on = bench()

    def burst(state):
        if state is State.RUNNING:
            raise ZeroDivisionError("a defect")

    on.announce = burst
    with pytest.raises(ZeroDivisionError):
        on.run()
    assert on.torque() == [0, 0, 0]


def test_an_announcer_never_waits_for_a_terminal_that_stands_still():
    reader, writer = os.pipe()
    while True:  # until the pipe is full: whoever writes to it now waits
        os.set_blocking(writer, False)
        try:
            os.write(writer, bytes(65536))
        except BlockingIOError:
            break
    os.set_blocking(writer, True)
    with os.fdopen(writer, "w", buffering=1) as stopped, Announcer(Console(file=stopped), "rig") as announcer:
        for _ in range(10):
            announcer(State.RUNNING)
        os.set_blocking(reader, False)
        said = b""
        while said.count(b"rig: running") < 10:  # they all come once somebody reads
            said += os.read(reader, 1 << 20) if select.select([reader], [], [], 10.0)[0] else pytest.fail("silence")
    os.close(reader)
