"""Lamps on STS3215 and AX-12A servos, asked over their lines: bodies, faults, and what outlives the rig."""

import pytest

from controller.rig_file import load_rig
from deploy.virtual import protocol1 as p1
from deploy.virtual.faults import parse_fault
from deploy.virtual.rig import VirtualRig

# addresses: torque, goal, present position, voltage; counts of a right angle
LAMPS = {"lamp-sts3215": (40, 42, 56, 62, 1024), "lamp-ax12": (24, 30, 36, 42, 307.2)}
OVERLOAD, VOLTAGE = 0x20, 0x01


class Master:
    """Ask a virtual rig, each question after the answers to the last."""

    def __init__(self, name, *faults, **settings):
        self.rig = VirtualRig(load_rig(name), faults=[parse_fault(fault) for fault in faults], **settings)
        self.torque, self.goal, self.position, self.volts, self.right_angle = LAMPS[name]

    def ask(self, servo, instruction, *parameters):
        """Send an instruction; return the status packets as (id, error, data)."""
        self.rig.transmit(p1.encode(servo, instruction, bytes(parameters)), self.rig.now)
        data = b""
        while (event := self.rig.next_event()) is not None:
            data += b"".join(frame for _, frame in self.rig.replies_until(event))
            self.rig.advance(event)
        return [(packet.id, packet.instruction, packet.parameters) for packet in p1.PacketParser().feed(data)]

    def word(self, servo, address):
        [(_, _, data)] = self.ask(servo, p1.READ, address, 2)
        return int.from_bytes(data, "little")

    def go(self, *goals):
        """Set all goals at once."""
        parts = [byte for i, goal in enumerate(goals, 1) for byte in (i, goal & 0xFF, goal >> 8)]
        assert self.ask(p1.BROADCAST, p1.SYNC_WRITE, self.goal, 2, *parts) == []

    def wait(self, seconds):
        self.rig.advance(self.rig.now + seconds)


@pytest.mark.parametrize("name", LAMPS)
def test_the_lamps_joints_go_where_the_counts_say(name):
    master = Master(name)
    for servo in (1, 2, 3):
        assert master.ask(servo, p1.WRITE, master.torque, 1) == [(servo, 0, b"")]
    joints = master.rig.rig.joints
    middle, signs = [joint.zero_tick for joint in joints], [joint.sign for joint in joints]
    step = round(master.right_angle / 6)
    master.go(*(zero + step for zero in middle))
    master.wait(1.0)
    angles = master.rig.truth().joint_rad
    # 15 degrees, less what gravity, friction and margin take
    assert angles == pytest.approx([0.262 * sign for sign in signs], abs=0.05)
    shown = [master.word(i, master.position) - zero for i, zero in enumerate(middle, 1)]
    assert [count / step * 0.262 for count in shown] == pytest.approx(list(angles * signs), abs=0.006)


@pytest.mark.parametrize("name", LAMPS)
def test_faults_show_in_the_error_byte(name):
    master = Master(name, "overload=1@0.5", "dead=2@0.5-1.0", "supply=4.5@1.5-2.0")
    master.wait(0.6)
    assert master.ask(1, p1.PING) == [(1, OVERLOAD, b"")]
    assert (master.ask(2, p1.PING), master.ask(3, p1.PING)) == ([], [(3, 0, b"")])
    assert master.ask(1, p1.WRITE, master.torque, 0) == [(1, 0, b"")]
    master.wait(0.8)
    assert master.ask(2, p1.PING) == [(2, 0, b"")]
    master.wait(0.2)
    low = VOLTAGE if name == "lamp-ax12" else 0  # an STS works from 4 V
    assert master.ask(3, p1.READ, master.volts, 1) == [(3, low, bytes([45]))]


def test_what_an_unlocked_sts_was_told_outlives_the_rig(tmp_path):
    path = tmp_path / "eeprom.json"
    master = Master("lamp-sts3215", eeprom_path=path)
    master.ask(1, p1.WRITE, 21, 77)  # P, while locked
    assert master.word(1, 21) & 0xFF == 77
    master.ask(2, p1.WRITE, 55, 0)
    master.ask(2, p1.WRITE, 31, 0x64, 0x08)  # an offset of -100
    master.ask(2, p1.WRITE, 5, 12)
    again = Master("lamp-sts3215", eeprom_path=path)
    assert again.word(1, 21) & 0xFF == 50
    assert again.ask(2, p1.PING) == []
    assert again.word(12, 31) == 0x0864
    assert again.word(12, 56) == pytest.approx(2048 + 100, abs=10)


def test_an_axs_eeprom_outlives_the_rig(tmp_path):
    path = tmp_path / "eeprom.json"
    assert Master("lamp-ax12", eeprom_path=path).ask(3, p1.WRITE, 6, 100, 0) == [(3, 0, b"")]
    assert Master("lamp-ax12", eeprom_path=path).word(3, 6) == 100


@pytest.mark.parametrize("name", LAMPS)
def test_the_same_questions_have_the_same_answers(name):
    def answers():
        master = Master(name, "drop=0.2", "corrupt=0.2", seed=3)
        told = []
        for goal in range(20):
            master.go(*(joint.zero_tick + goal for joint in master.rig.rig.joints))
            told += [master.ask(servo, p1.READ, master.position, 6) for servo in (1, 2, 3)]
            master.wait(0.02)
        return told, master.rig.truth().joint_rad.tobytes()

    assert answers() == answers()
