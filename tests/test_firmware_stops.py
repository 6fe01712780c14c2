"""What stops firmware where the host loop, whose process has ended, has nothing to stop."""

from contextlib import closing
from dataclasses import replace

import pytest
from firmware_runs import XC330, Task, image

from deploy.firmware.bench import FirmwareBench
from deploy.firmware.console_decoder import ConsoleDecoder
from deploy.firmware.records import Cycle
from deploy.firmware.run_log import shape_of
from deploy.firmware.twin import TwinProcess
from deploy.virtual.rig import VirtualRig

HOLDING = Task(
    replace(XC330.rig, name="lamp-held", safety=replace(XC330.rig.safety, stop="hold")), XC330.controller, 0.4
)


@pytest.fixture(scope="module")
def program():
    return image(HOLDING, "host")


class Session:
    """Type at the native twin's console on a virtual rig, and see what the servos hold."""

    def __init__(self, firmware):
        self.virtual = VirtualRig(HOLDING.rig)
        self.bench = FirmwareBench(self.virtual, firmware)
        self.decoder = ConsoleDecoder(shape_of(HOLDING.rig, HOLDING.controller))
        self.said = b""

    def type(self, *lines, seconds):
        for line in lines:
            self.bench.say(line)
        until = self.bench.now + seconds
        while self.bench.now < until:
            self.step()

    def step(self):
        """Let the firmware work and wait once; return what it has said, taken apart."""
        _, taken = self.bench.wake()
        self.said += taken.console
        self.bench.send(taken)
        self.bench.wait(taken)
        return list(self.decoder.feed(taken.console))

    def torque(self):
        return [servo.table["torque_enable"] for servo in self.virtual.servos]


@pytest.fixture
def session(program):
    with closing(TwinProcess(program)) as firmware:
        yield Session(firmware)


def test_a_stop_takes_the_torque_that_a_finished_run_has_left_on(session):
    session.type("seconds 0.5", "arm", "start", seconds=3.0)
    assert b"ended by 5" in session.said, "the time was over"
    assert session.torque() == [1, 1, 1]
    session.type("stop", seconds=0.5)
    assert session.torque() == [0, 0, 0]


@pytest.mark.parametrize("stopped", ["after", "meanwhile"])
def test_a_stop_takes_the_torque_that_a_dry_run_has_found_on(session, stopped):
    session.type("seconds 0.5", "arm", "start", seconds=3.0)
    assert session.torque() == [1, 1, 1]
    session.type("start", seconds=0.1 if stopped == "meanwhile" else 3.0)
    assert (b"ended by 6" in session.said) == (stopped == "after"), "a dry run"
    assert session.torque() == [1, 1, 1]
    session.type("stop", seconds=1.0)
    assert session.torque() == [0, 0, 0]


def test_a_stop_that_comes_with_its_start_stops(session):
    session.type("arm", "start", "stop", seconds=3.0)
    assert b"ended by 16" in session.said, "a person's wish"
    assert session.torque() == [0, 0, 0]


def test_a_stop_in_the_very_last_period_takes_the_torque(session):
    session.type("seconds 0.5", "arm", "start", seconds=0.0)
    while not any(isinstance(one, Cycle) and one.k == 24 for one in session.step()):
        pass
    session.type("stop", seconds=1.0)
    assert b"ended by 16" in session.said, "a person's wish"
    assert session.torque() == [0, 0, 0]
