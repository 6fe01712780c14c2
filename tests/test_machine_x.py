"""A random master against virtual X servos, judged by the rules in `manual_x.py`."""

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import rule, run_state_machine_as_test
from machine_x import INDEX
from machine_x_one import AskOne
from machine_x_several import AskSeveral
from manual_x import (
    ALERT,
    ALL,
    BOOT_S,
    BULK_READ,
    CLEAR,
    CRC,
    FAIL,
    PING,
    READ,
    REBOOT,
    REG_WRITE,
    RESET,
    SYNC_READ,
    SYNC_WRITE,
    TRIPPED,
    WRITE,
    frame,
    statuses,
    two,
)

from deploy.virtual.faults import parse_fault


@pytest.mark.parametrize(
    ("servo", "instruction", "parameters", "told"),
    [
        (1, PING, "", "fffffd00010300 01 194e"),
        (ALL, PING, "", "fffffd00fe0300 01 3142"),
        (1, READ, "84000400", "fffffd00010700 02 84000400 1d15"),
        (1, WRITE, "740000020000", "fffffd00010900 03 740000020000 ca89"),
        (1, REG_WRITE, "6800c8000000", "fffffd00010900 04 6800c8000000 ae8e"),
        (1, RESET, "01", "fffffd00010400 06 01 a1e6"),
        (1, CLEAR, "0144584c22", "fffffd00010800 10 0144584c22 b1dc"),
        (ALL, SYNC_READ, "840004000102", "fffffd00fe0900 82 840004000102 cefa"),
        (ALL, BULK_READ, "01900002000292000100", "fffffd00fe0d00 92 01900002000292000100 1a05"),
    ],
)
def test_the_masters_packets_are_the_manuals(servo, instruction, parameters, told):
    assert frame(servo, instruction, bytes.fromhex(parameters)) == bytes.fromhex(told)


class XMachine(AskOne, AskSeveral):
    """Ask three servos of one line at random, and change who and how they are."""

    # identity

    def write_surely(self, servo, name, value):
        """Write what we must know of to find the servo again, unless what becomes of it is open."""
        item = servo.memory.items[name]
        self.look(servo)
        allowed = self.allowed(servo, [(item, value)])
        if servo.level == 2 or allowed == {0} or 0 not in allowed:
            self.write(servo, [(item, value)])

    @rule(index=INDEX, new=st.integers(0, 252))
    def change_the_id(self, index, new):
        servo = self.servos[index]
        taken = {other.memory[name] for other in self.servos for name in ("id", "secondary_id")}
        if new not in taken:
            self.write_surely(servo, "id", new)

    @rule(index=INDEX, new=st.integers(0, 255))
    def change_the_secondary_id(self, index, new):
        servo = self.servos[index]
        taken = {other.memory[name] for other in self.servos for name in ("id", "secondary_id")}
        if new not in taken:
            self.write_surely(servo, "secondary_id", new)

    @rule(index=INDEX, on=st.integers(0, 1))
    def write_to_the_secondary_id(self, index, on):
        servo = self.servos[index]
        second = servo.memory["secondary_id"]
        if second is None or second > 252 or not self.hears(servo):
            return
        led = servo.memory.items["led"]
        assert self.ask(second, WRITE, two(led.address) + led.encode(on)) == []
        servo.take(led, on)

    @rule(index=INDEX, rate=st.sampled_from([1, 2, 3, 3, 3, 4, 7, 8]))
    def change_the_bit_rate(self, index, rate):
        servo = self.servos[index]
        self.write_surely(servo, "baud_rate", rate)

    @rule(index=INDEX)
    def follow_the_bit_rate(self, index):
        self.baud = self.servos[index].baud
        self.rig.set_baud(self.baud)

    @rule(index=INDEX, level=st.sampled_from([0, 1, 2, 2, 2, 3]))
    def change_the_return_level(self, index, level):
        servo = self.servos[index]
        self.write(servo, [(servo.memory.items["status_return_level"], level)])
        if servo.level is None:
            servo.memory["status_return_level"] = 2

    # states

    @rule(index=INDEX)
    def reboot(self, index):
        servo = self.servos[index]
        self.judge(servo, self.ask(servo.id, REBOOT), {0})
        if self.hears(servo):
            servo.booted()
        self.pause(BOOT_S)

    @rule(index=INDEX, option=st.sampled_from([1, 2]))
    def reset_to_the_factorys(self, index, option):
        servo = self.servos[index]
        if servo.memory["torque_enable"] != 0:
            return
        kept = {"id": servo.id} | ({"baud_rate": servo.memory["baud_rate"]} if option == 2 else {})
        self.judge(servo, self.ask(servo.id, RESET, bytes([option])), {0})
        if self.hears(servo):
            servo.memory.start(eeprom=True)
            servo.registered = None
            for name, value in kept.items():
                servo.memory[name] = value
        self.pause(BOOT_S)

    @rule(index=INDEX)
    def clear_the_turns(self, index):
        servo = self.servos[index]
        self.judge(servo, self.ask(servo.id, CLEAR, b"\x01\x44\x58\x4c\x22"), {0, FAIL})
        servo.memory.forget("goal_position")

    @rule(index=INDEX, count=st.sampled_from([0, 1, 5, 50, 127, 128]))
    def arm_the_watchdog(self, index, count):
        servo = self.servos[index]
        self.look(servo)
        watchdog = servo.memory["bus_watchdog"]
        if watchdog is None or (watchdog == TRIPPED and count):
            return
        self.write(servo, [(servo.memory.items["bus_watchdog"], count)])

    @rule(seconds=st.sampled_from([0.004, 0.03, 0.2, 1.5, 3.0]))
    def pause(self, seconds):
        self.t = max(self.t, self.rig.now) + seconds
        self.rig.advance(self.t)

    @rule(index=INDEX, kind=st.sampled_from(["overload", "overheat"]))
    def a_hardware_error(self, index, kind):
        servo = self.servos[index]
        joint = self.rig.rig.joints[index]
        self.rig.set_faults([parse_fault(f"{kind}={joint.id}@{self.rig.now + 1e-3}-{self.rig.now + 2e-3}")])
        self.pause(0.02)
        self.rig.set_faults([])
        mask = servo.memory["shutdown"]
        servo.fuzzy = True
        servo.memory.forget("torque_enable")
        if self.hears(servo):
            [(_, error, _)] = self.ask(servo.id, PING)
            assert error & ALERT
            if mask is not None and mask & {"overload": 0x20, "overheat": 0x04}[kind]:
                servo.memory["torque_enable"] = 0
                self.read_item(servo, "torque_enable")
                servo.memory.forget("torque_enable")

    # a bad line

    @rule(junk=st.binary(max_size=40), cut=st.integers(1, 12), index=INDEX)
    def noise(self, junk, cut, index):
        whole = frame(self.servos[index].id, READ, two(0, 2))
        self.send(junk.replace(b"\xff\xff\xfd", b"\xff\xff\x00"))
        self.send(whole[:-cut])
        self.pause(0.2)
        self.look(*self.servos)

    @rule(index=INDEX, bit=st.integers(0, 15))
    def a_wrong_crc_changes_nothing(self, index, bit):
        servo = self.servos[index]
        led = servo.memory.items["led"]
        whole = bytearray(frame(servo.id, WRITE, two(led.address) + b"\x01"))
        whole[len(whole) - 2 + bit // 8] ^= 1 << bit % 8
        replies = statuses(self.send(bytes(whole)))
        assert all(error & ~ALERT == CRC for _, error, _ in replies)
        self.pause(0.2)


def test_a_goal_may_have_switched_torque_on_though_nobody_said_so():
    """In extended mode the manual leaves a goal's limits open; with bit 3 of the drive mode it switches torque on."""
    line = type("Line", (XMachine,), {"rig_name": "lamp-xl430"})()
    servo = line.servos[0]
    items = servo.memory.items
    line.write(servo, [(items["drive_mode"], 8)])
    line.write(servo, [(items["operating_mode"], 4)])
    goal = items["goal_position"]
    data = two(goal.address, goal.size) + bytes([servo.id]) + goal.encode(2000)
    line.write_several([servo], [[(goal, 2000)]], SYNC_WRITE, data)
    assert line.rig.servos[0].table["torque_enable"] == 1 and servo.memory["torque_enable"] is None
    line.write_surely(servo, "baud_rate", 7)


def test_a_goal_that_would_switch_a_shut_down_servo_on_may_fail():
    line = type("Line", (XMachine,), {"rig_name": "lamp-xl430"})()
    servo = line.servos[0]
    line.write(servo, [(servo.memory.items["drive_mode"], 8)])
    line.a_hardware_error(index=0, kind="overload")
    assert line.rig.servos[0].table["hardware_error_status"] == 0x20
    line.write(servo, [(servo.memory.items["goal_position"], 2000)])
    assert line.rig.servos[0].table["torque_enable"] == 0


@pytest.mark.parametrize("rig_name", ["lamp-xc330", "lamp-xl430", "xm430"])
def test_servos_keep_the_manuals_rules(rig_name, machine_steps):
    machine = type("Machine", (XMachine,), {"rig_name": rig_name})
    run_state_machine_as_test(
        machine,
        settings=settings(
            max_examples=-(-machine_steps // 100),
            stateful_step_count=100,
            deadline=None,
            suppress_health_check=list(HealthCheck),
            database=None,
            phases=[Phase.generate],  # shrinking would take minutes; the steps are printed
        ),
    )
