"""The firmware's robot where nobody answers: what it sends, how it ends, and that its watchdog never starves."""

import ctypes

import dynamixel_sdk
import pytest
from rig_bench import RIG, sway
from robot_library import build_robot, compile_runtime
from test_velocity_rig import JUMPER, TURN

from controller import load_rig, parse_controller, registers

BITES_US = 100_000
POWER, WATCHDOG, FAULT = range(3)
OFF, FAULTY = 0, 6
FINDING, SELFTEST, RESET = 32, 54, 55
RIGS = {
    "lamp-xc330": (RIG, sway()),
    "lamp-sts3215": (load_rig("lamp-sts3215"), sway()),
    "jumper-xc330": (JUMPER, parse_controller(TURN, "turn")),
}


class Why(ctypes.Structure):
    """Mirror `sv_why` of sv_safety.h."""

    _fields_ = tuple((name, ctypes.c_int32) for name in ("reason", "joint", "a", "b"))


class Robot:
    """A robot at a silent bus."""

    def __init__(self, library, rig):
        self.library = library
        self.rig = rig

    def boot(self, selftest=0, reset=POWER):
        self.library.boot(selftest, reset, 0)
        self.at_boot = len(self.sent())
        return self

    def type(self, words):
        self.library.type(words, len(words))
        self.library.run()

    def sent(self):
        n = ctypes.c_int32()
        data = self.library.sent(ctypes.byref(n))
        return bytes(data[: n.value])

    def ended(self):
        why = Why()
        return self.library.state(ctypes.byref(why)), why


@pytest.fixture(scope="module")
def runtime(tmp_path_factory):
    return compile_runtime(tmp_path_factory.mktemp("runtime"))


@pytest.fixture(scope="module", params=RIGS)
def robot(request, runtime, tmp_path_factory):
    rig, controller = RIGS[request.param]
    return Robot(build_robot(tmp_path_factory.mktemp("robot"), runtime, rig, controller), rig)


def frames(rig, data):
    """Return what was sent, cut at the headers: (id, instruction, parameters)."""
    found = []
    while data:
        if rig.bus.protocol == "dynamixel-2.0":
            assert data[:4] == b"\xff\xff\xfd\0"
            end = 7 + int.from_bytes(data[5:7], "little")
            crc = dynamixel_sdk.PacketHandler(2.0).updateCRC(0, list(data[: end - 2]), end - 2)
            assert int.from_bytes(data[end - 2 : end], "little") == crc
            found.append((data[4], data[7], data[8 : end - 2]))
        else:
            assert data[:2] == b"\xff\xff"
            end = 4 + data[3]
            assert sum(data[2:end]) & 0xFF == 0xFF
            found.append((data[2], data[4], data[5 : end - 1]))
        data = data[end:]
    return found


def test_a_controller_that_computes_other_bits_never_gets_to_the_bus(robot):
    robot.boot(selftest=17).type(b"arm\nstart\n")
    state, why = robot.ended()
    assert (state, why.reason, why.a) == (FAULTY, SELFTEST, 17)
    assert len(robot.sent()) == robot.at_boot


def test_where_nobody_answers_nothing_is_written_and_the_watchdog_is_fed(robot):
    robot.boot().type(b"arm\nstart\n")
    state, why = robot.ended()
    assert (state, why.reason, why.joint) == (FAULTY, FINDING, 0)
    assert why.a >= len(robot.rig.joints) - 1
    assert {instruction for _, instruction, _ in frames(robot.rig, robot.sent()[robot.at_boot :])} == {1}  # pings
    assert robot.library.starved() < BITES_US


def test_a_board_that_is_switched_on_takes_the_torque_of_all_and_waits_for_nobody(robot):
    """It may have been switched off, or reset by a person, during a run: its servos have their own supply."""
    robot.boot()
    sent = frames(robot.rig, robot.sent())
    _check_zeros(robot.rig, sent)
    assert len(sent) == (2 if robot.rig is JUMPER else 1)
    state, why = robot.ended()
    assert (state, why.reason) == (OFF, 0)
    assert robot.library.now() == 0


@pytest.mark.parametrize("cause", [WATCHDOG, FAULT])
def test_after_a_reset_the_torque_of_every_servo_is_taken_first(robot, cause):
    robot.boot(reset=cause)
    state, why = robot.ended()
    assert (state, why.reason, why.a) == (FAULTY, RESET, cause)
    sent = frames(robot.rig, robot.sent())
    _check_zeros(robot.rig, sent)
    told = {servo for servo, instruction, _ in sent if instruction == 3}
    assert told == {joint.id for joint in robot.rig.joints}
    assert 1_000_000 <= robot.library.now() < 3_000_000
    assert robot.library.starved() < BITES_US


def test_a_panic_takes_the_torque_of_all_with_packets_alone(robot):
    robot.boot()
    robot.library.sv_robot_panic()
    assert robot.sent() == 2 * robot.sent()[: robot.at_boot]


def _check_zeros(rig, sent):
    """Check that the first packets tell all servos at once, and that everything that is written is 0."""
    joint = rig.joints[0]
    table, family = registers(joint.product), joint.family
    names = [family.goal_velocity] if joint.mode == "velocity" else []
    for (servo, instruction, parameters), name in zip(sent, [*names, family.torque_enable], strict=False):
        assert (servo, instruction) == (254, 0x83)
        wide = 2 if family.protocol == "dynamixel-2.0" else 1
        address, size = (int.from_bytes(parameters[at : at + wide], "little") for at in (0, wide))
        assert (address, size) == (table[name].address, table[name].size)
        values = parameters[2 * wide :]
        assert values == b"".join(bytes((joint.id, *bytes(size))) for joint in rig.joints)
    for _, instruction, parameters in sent:
        if instruction == 3:
            assert not any(parameters[2 if family.protocol == "dynamixel-2.0" else 1 :])
