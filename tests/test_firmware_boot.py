"""What a board sends when it boots: torque off for every servo, whoever has reset it and whatever they bear."""

from dataclasses import replace

import pytest
from firmware_runs import STS3215, XC330, Task, image
from test_firmware_rigs import swaying
from wire import Wire

from controller import load_rig
from deploy.firmware.bench import FirmwareBench
from deploy.firmware.machine import Given
from deploy.firmware.reasons import Reason, Why, sentence
from deploy.firmware.twin import TwinProcess
from deploy.virtual import dynamixel2 as dxl
from deploy.virtual import protocol1 as p1
from deploy.virtual.rig import VirtualRig

JUMPER = Task(load_rig("jumper-xc330"), swaying(load_rig("jumper-xc330")), 0.3)
IDS = [1, 2, 3]
STALLED_US = 200_000  # longer than the watchdog of the twin waits


def zeros(code, place, size, ids):
    """Return a sync write of zeros, built without the firmware."""
    return code.encode(0xFE, 0x83, place + b"".join(bytes([servo, *bytes(size)]) for servo in ids))


# Robotis e-Manual, X series: torque enable at 64, goal velocity at 104, four bytes; Feetech STS: torque enable at 40
TORQUE_OFF = {
    "lamp-xc330": (XC330, (zeros(dxl, bytes([64, 0, 1, 0]), 1, IDS),)),
    "lamp-sts3215": (STS3215, (zeros(p1, bytes([40, 1]), 1, IDS),)),
    "jumper-xc330": (
        JUMPER,
        (zeros(dxl, bytes([104, 0, 4, 0]), 4, [*IDS, 4]), zeros(dxl, bytes([64, 0, 1, 0]), 1, [*IDS, 4])),
    ),
}
RIGS = pytest.mark.parametrize("name", TORQUE_OFF)


def work(bench, seconds):
    """Let a bench's firmware work for a time."""
    until = bench.now + seconds
    while bench.now < until:
        _, taken = bench.wake()
        bench.send(taken)
        bench.wait(taken)


@RIGS
def test_the_first_packets_are_torque_off_for_every_servo_and_there_is_nothing_else(name):
    task, packets = TORQUE_OFF[name]
    with TwinProcess(image(task, "host")) as twin:
        first = twin.resume(Given(0))
        assert (first.boot, first.bus) == (packets, ())
        later = [twin.resume(Given(10_000 * n)) for n in range(1, 20)]
        assert {(taken.boot, taken.bus) for taken in later} == {((), ())}


@RIGS
def test_servos_that_bear_torque_lose_it_when_their_board_is_switched_on(name):
    """A supply that failed, or a finger on the reset button, in the middle of a run."""
    task, packets = TORQUE_OFF[name]
    wire = Wire(rig=task.rig)
    heard = []
    for servo in wire.joints:
        wire.write(servo, "torque_enable", 1)
        if task is JUMPER:
            wire.write(servo, "goal_velocity", 20)
    wire.rig.advance(1.0)
    with TwinProcess(image(task, "host")) as twin:
        bench = FirmwareBench(wire.rig, twin, lambda way, _, data: heard.append((way, data)))
        work(bench, 0.1)
    assert heard == [("tx", packet) for packet in packets]
    assert {wire.read(servo, "torque_enable") for servo in wire.joints} == {0}
    if task is JUMPER:
        assert {wire.read(servo, "goal_velocity") for servo in wire.joints} == {0}


@RIGS
def test_a_rig_that_is_switched_on_with_its_board_begins_its_clock_after_the_boot(name):
    task, _ = TORQUE_OFF[name]
    heard = []
    with TwinProcess(image(task, "host")) as twin:
        bench = FirmwareBench(VirtualRig(task.rig), twin, lambda way, t, data: heard.append((way, t, data)))
        bench.say("start")
        _, taken = bench.wake()
        assert len(taken.boot) > 0
        bench.send(taken)
    ping = (dxl if task.rig.bus.protocol == "dynamixel-2.0" else p1).encode(1, 1)
    assert heard == [("tx", 0.0, ping)]


class Stalling:
    """Stand between bench and firmware, and let time leap for the firmware once: its watchdog bites."""

    def __init__(self, firmware, at_us):
        self.firmware = firmware
        self.at_us = at_us

    def resume(self, given):
        ahead = STALLED_US if given.now_us >= self.at_us else 0
        taken = self.firmware.resume(replace(given, now_us=given.now_us + ahead))
        return replace(taken, until_us=taken.until_us - ahead)


@RIGS
def test_a_board_that_is_reset_during_a_run_says_so_to_the_servos_first(name):
    task, packets = TORQUE_OFF[name]
    virtual, heard = VirtualRig(task.rig), []
    with TwinProcess(image(task, "host")) as twin:
        bench = FirmwareBench(virtual, Stalling(twin, 1_500_000), lambda *sent: heard.append(sent))
        for line in ("arm", "start"):
            bench.say(line)
        work(bench, 1.4)
        assert {servo.table["torque_enable"] for servo in virtual.servos} == {1}
        work(bench, 0.3)
    sent = [data for way, t, data in heard if way == "tx" and t >= 1.5]
    assert tuple(sent[: len(packets)]) == packets
    assert {servo.table["torque_enable"] for servo in virtual.servos} == {0}


@pytest.mark.parametrize(
    ("cause", "words"),
    [
        (1, "by the watchdog, for the main loop hung; torque was switched off: report"),
        (2, "by a fault handler; torque was switched off: report"),
        (3, "by its falling supply; torque was switched off: feed it from another"),
        (4, "by the loss of its crystal's clock; torque was switched off: look at the crystal"),
        (9, "by cause 9; torque was switched off: report"),
    ],
)
def test_why_a_board_has_reset_itself_is_told_with_its_remedy(cause, words):
    assert f"the board was reset {words}" in sentence(Why(Reason.RESET, 255, cause, 0), XC330.rig, "bus")
