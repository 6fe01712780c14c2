"""The firmware's clock begins anew every 2^32 us: no run, no question and no record takes notice of that."""

import ctypes
from dataclasses import replace

import pytest
import runtime_shim
from firmware_runs import STS3215, XC330, Task, firmware_run, image
from rig_bench import RIG, sway
from robot_library import build_robot, compile_runtime
from runtime_shim import Bus
from two_masters import Line

from deploy.firmware.console_decoder import ConsoleDecoder
from deploy.firmware.qemu import Qemu
from deploy.firmware.records import Event, Started
from deploy.firmware.run_log import shape_of
from deploy.firmware.twin import TwinProcess

runtime = runtime_shim.runtime

WRAP_US = 2**32
SIGN_US = 2**31
BITES_US = 100_000
LINE_US = 250  # that a question and its answer need on the line, and more
HOUR_US = 3_600_000_000
EIGHTH_US = 2**17
"""Sensor lines are dated in eighths of a second: clocks that differ by whole ones date them alike."""


class Old:
    """Stand between bench and firmware; let the firmware's clock have run for a while already."""

    def __init__(self, firmware, ago_us):
        self.firmware = firmware
        self.ago_us = ago_us

    def resume(self, given):
        taken = self.firmware.resume(replace(given, now_us=given.now_us + self.ago_us))
        return replace(taken, until_us=taken.until_us - self.ago_us)

    def close(self):
        self.firmware.close()


# a run


@pytest.mark.parametrize(
    ("task", "faults", "ago_us"),
    [
        (XC330, (), WRAP_US - 5 * EIGHTH_US),  # while homing
        (XC330, (), WRAP_US - 15 * EIGHTH_US),  # while running
        (XC330, (), SIGN_US - 12 * EIGHTH_US),
        (STS3215, (), WRAP_US - 15 * EIGHTH_US),
        (XC330, ("drop=0.05", "corrupt=0.03"), WRAP_US - 11 * EIGHTH_US),
        (XC330, ("dead=2@1.3",), WRAP_US - 10 * EIGHTH_US),  # while it is missed
        (XC330, ("sensor-silent@1.3",), WRAP_US - 10 * EIGHTH_US),  # while it grows old
        (XC330, ("stuck=1@1.3",), WRAP_US - 11 * EIGHTH_US),
    ],
    ids=lambda value: value.rig.name if isinstance(value, Task) else str(value),
)
def test_a_run_is_the_same_whenever_the_clock_begins_anew(tmp_path, monkeypatch, task, faults, ago_us):
    fresh = firmware_run(tmp_path / "fresh.mcap", task, faults, seconds=1.5)
    monkeypatch.setenv("SERVOLVE_NOW_US", str(ago_us))
    twin = lambda: Old(TwinProcess(image(task, "host")), ago_us)  # noqa: E731
    old = firmware_run(tmp_path / "old.mcap", task, faults, seconds=1.5, machine=twin)
    assert fresh.virtual.now + 1e-6 * ago_us > 1e-6 * (SIGN_US if ago_us < SIGN_US else WRAP_US)
    assert len(old.frames) > 100
    assert old.frames == fresh.frames
    assert old.outcome == fresh.outcome
    assert (tmp_path / "old.mcap").read_bytes() == (tmp_path / "fresh.mcap").read_bytes()


def test_an_emulated_boards_run_is_the_same_whenever_the_clock_begins_anew(tmp_path):
    twin = firmware_run(tmp_path / "twin.mcap", XC330, seconds=1.0)
    board = firmware_run(
        tmp_path / "board.mcap",
        XC330,
        seconds=1.0,
        machine=lambda: Old(Qemu(image(XC330, "stm32f405"), "netduinoplus2"), WRAP_US - 9 * EIGHTH_US),
    )
    assert twin.virtual.now > 1.2
    assert board.frames == twin.frames
    assert (tmp_path / "board.mcap").read_bytes() == (tmp_path / "twin.mcap").read_bytes()


# a question after any time


@pytest.mark.parametrize("protocol", ["dynamixel-2.0", "feetech-sts"])
@pytest.mark.parametrize(
    "idle_us",
    [0, 1000, *(at + off for at in (SIGN_US, WRAP_US) for off in (-50_000, -3000, -100, 0, 100, 3000, 50_000))],
)
def test_a_question_has_as_long_as_any_other_however_long_nobody_has_asked(runtime, protocol, idle_us):
    line = Line(lambda frame: [])
    line.now_us = 7
    bus = Bus(runtime, line, protocol, [1])
    took_us = []
    for rest_us in (0, 1000, idle_us):
        line.rest(rest_us)
        asked_us = line.now_us
        assert bus.read(1, 0, 4).status == "missing"
        took_us.append(line.now_us - asked_us)
    # at times the line looks as if the last question's bytes were on it still; or more is asked for, a reply being late
    assert took_us[0] <= took_us[2] <= took_us[0] + LINE_US


# idle


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    objects = compile_runtime(tmp_path_factory.mktemp("runtime"))
    return build_robot(tmp_path_factory.mktemp("robot"), objects, RIG, sway())


def records(library):
    n = ctypes.c_int32()
    data = library.heard(ctypes.byref(n))
    return list(ConsoleDecoder(shape_of(RIG, sway())).feed(bytes(data[: n.value])))


@pytest.mark.parametrize("boot_us", [0, SIGN_US - 5_000_000, WRAP_US - 5_000_000, WRAP_US - 1])
@pytest.mark.parametrize("idle_us", [10_000_000, HOUR_US // 2, 2 * HOUR_US])
def test_records_tell_the_time_since_boot_however_long_nobody_has_run(robot, boot_us, idle_us):
    robot.boot(0, 0, boot_us)
    robot.idle(idle_us)
    assert robot.starved() < BITES_US
    assert robot.now() < boot_us + idle_us + 20_000
    started_us = robot.now()
    robot.type(b"start\n", 6)
    robot.run()
    (start,) = (record for record in records(robot) if isinstance(record, Started))
    assert start.t_us == started_us
    assert robot.starved() < BITES_US


@pytest.mark.parametrize("before_us", [1, 40_000, 500_000])
def test_torque_is_taken_for_as_long_whenever_the_clock_begins_anew(robot, before_us):
    took_us = []
    for boot_us in (0, SIGN_US - before_us, WRAP_US - before_us):
        robot.boot(0, 1, boot_us)
        took_us.append(robot.now() - boot_us)
        assert robot.starved() < BITES_US
        (unsure,) = (record for record in records(robot) if isinstance(record, Event))
        assert unsure.t_us == robot.now()
    assert took_us[0] >= 1_000_000
    assert len(set(took_us)) == 1
