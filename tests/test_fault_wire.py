"""Each fault of the virtual rig, as a client on the wire meets it."""

from dataclasses import replace

import numpy as np
import pytest
from rig_bench import Bench
from wire import LAMP, PATIENCE_S, Wire

from controller.errors import InputError
from controller.rig_file import load_rig
from deploy.virtual import dynamixel2 as dxl
from deploy.virtual.twin import Twin

FAMILIES = ("lamp-xc330", "lamp-xl430", "lamp-sts3215", "lamp-ax12")


def ping(wire, servo=1, seconds=PATIENCE_S):
    return wire.frames(servo, dxl.PING, seconds=seconds)


SOUND = ping(Wire())[0][1]


def test_a_count_is_exact_and_begins_anew_when_faults_are_set():
    wire = Wire("drop=#3")
    assert [len(ping(wire)) for _ in range(6)] == [0, 0, 0, 1, 1, 1]
    wire.faults("drop=#2")
    assert [len(ping(wire)) for _ in range(4)] == [0, 0, 1, 1]
    later = Wire("drop=#1@0.02")
    assert [len(ping(later)) for _ in range(8)].count(0) == 1
    assert len(ping(Wire("drop=#1@5"))) == 1


def test_a_corrupt_packet_has_one_wrong_bit():
    wire = Wire("corrupt=#5")
    for _ in range(5):
        [(_, frame)] = ping(wire)
        wrong = int.from_bytes(frame, "big") ^ int.from_bytes(SOUND, "big")
        assert wrong.bit_count() == 1
        assert len(frame) == len(SOUND)
    assert ping(wire)[0][1] == SOUND


def test_a_truncated_packet_is_the_beginning_of_one():
    wire = Wire("truncate=#20")
    lengths = set()
    for _ in range(20):
        [(_, frame)] = ping(wire)
        assert 0 < len(frame) < len(SOUND)
        assert SOUND.startswith(frame)
        lengths.add(len(frame))
    assert len(lengths) > 5
    assert ping(wire)[0][1] == SOUND


def test_a_late_packet_comes_whole_after_its_time():
    asked = Wire("late=#1:7.5")
    [(at, frame)] = ping(asked, seconds=0.02)
    [(soon, _)] = ping(Wire())
    assert frame == SOUND
    assert at - soon == pytest.approx(0.0075, abs=1e-6)
    usual = Wire("late=1")
    assert ping(usual, seconds=0.0199) == []
    # the late answer to one question is there when the next one is asked
    wire = Wire("late=#1:6")
    line = wire.line(1, "id")
    first = wire.frames(1, 2, wire.place(line.address, 1))
    second = ping(wire)
    assert first == []
    assert [len(frame) for _, frame in second] == [len(SOUND), 12]


def test_next_event_leads_to_a_late_packet():
    wire = Wire("late=#1:6")
    wire.send(1, dxl.PING, b"")
    times = []
    while (at := wire.rig.next_event()) is not None:
        times += [at for at, _ in wire.rig.replies_until(at)]
    assert len(times) == 1


def test_a_duplicate_comes_twice_and_an_unsolicited_one_is_an_old_one():
    assert [frame for _, frame in ping(Wire("duplicate=#1"))] == [SOUND, SOUND]
    wire = Wire()
    line = wire.line(1, "id")
    [(_, old)] = wire.frames(1, 2, wire.place(line.address, 1))
    wire.faults("unsolicited=#1")
    (first, asked), (second, stray) = ping(wire)
    assert asked == SOUND
    assert stray == old
    assert second - first == pytest.approx(1e-3, abs=1e-9)
    assert len(ping(wire)) == 1


def test_a_latency_timer_gathers_what_comes():
    wire = Wire("latency-timer=16")
    times = []
    for _ in range(12):
        times += [at for at, _ in ping(wire)]
    assert times
    assert all(at / 0.016 == pytest.approx(round(at / 0.016), abs=1e-6) for at in times)
    assert len(times) >= 8
    assert len(set(times)) <= 4


def test_an_unplugged_adapter_carries_nothing_and_the_servos_go_on():
    wire = Wire().stand()
    wire.faults(f"unplug@{wire.rig.now + 0.1}-{wire.rig.now + 0.3}")
    assert len(ping(wire)) == 1
    wire.rig.advance(wire.rig.now + 0.1)
    assert wire.rig.unplugged
    goal = wire.joints[1].zero_tick + 100
    assert wire.write(1, "goal_position", goal) == []
    assert len(wire.rig.sensor_until(wire.rig.now)) > 0
    wire.rig.advance(wire.rig.now + 0.3)
    assert not wire.rig.unplugged
    assert wire.read(1, "torque_enable") == 1
    assert wire.read(1, "goal_position") == goal - 100, "what was sent meanwhile was not heard"


@pytest.mark.parametrize("fault", ["unplug@2", "unplug@2-2.05"])
def test_an_unplugged_adapter_ends_a_run_in_lock_step(tmp_path, fault):
    bench = Bench(tmp_path, fault)
    outcome = bench.run(seconds=3.0)
    assert outcome.faulty
    assert "the port is gone" in outcome.reason


@pytest.mark.parametrize("name", FAMILIES)
def test_a_dead_servo_and_a_brownout_lose_torque_and_ram(name):
    rig = load_rig(name)
    for fault, lost in (("dead=2", [2]), ("brownout", [1, 2, 3])):
        wire = Wire(rig=rig).stand()
        wire.faults(f"{fault}@{wire.rig.now}-{wire.rig.now + 0.2}")
        assert [servo for servo in wire.joints if not ping(wire, servo)] == lost
        wire.rig.advance(wire.rig.now + 1.0)
        assert [wire.read(servo, "torque_enable") for servo in wire.joints] == [
            0 if servo in lost else 1 for servo in wire.joints
        ]


@pytest.mark.parametrize("name", FAMILIES)
def test_two_servos_with_one_id_answer_at_once(name):
    wire = Wire("duplicate-id=1", rig=load_rig(name)).stand()
    line = wire.line(1, "present_position")
    frames = wire.frames(1, 2, wire.place(line.address, line.size))
    assert len(frames) == 1, "both at the same time"
    assert ping(wire, 2) == [], "the one after it no longer answers to its own id"
    assert ping(wire, 3)
    goal = wire.joints[1].zero_tick + 60
    wire.write(1, "goal_position", goal)
    wire.rig.advance(wire.rig.now + 0.5)
    moved = wire.rig.truth().joint_rad
    assert moved[0] == pytest.approx(moved[1], abs=0.05), "both obey"
    wire.faults()
    assert ping(wire, 2)


@pytest.mark.parametrize("name", FAMILIES)
def test_a_stuck_horn_does_not_move_and_pulls_in_vain(name):
    wire = Wire(rig=load_rig(name)).stand()
    before = wire.positions()
    wire.faults("stuck=3")
    wire.write(3, "goal_position", wire.joints[3].zero_tick + 200)
    wire.rig.advance(wire.rig.now + 0.5)
    assert abs(wire.positions()[2] - before[2]) <= 2
    load = wire.read(3, wire.joints[3].family.load)
    assert abs(load) > 100
    wire.faults()
    wire.rig.advance(wire.rig.now + 0.5)
    assert abs(wire.positions()[2] - before[2]) > 100


@pytest.mark.parametrize("name", FAMILIES)
@pytest.mark.parametrize("kind", ["overload", "overheat"])
def test_overload_and_overheating_are_reported(name, kind):
    wire = Wire(rig=load_rig(name)).stand()
    wire.faults(f"{kind}=2")
    bit = {"overload": 0x20, "overheat": 0x04}[kind]
    register = wire.joints[2].family.hardware_error
    if register is None:
        [(_, frame)] = ping(wire, 2)
        assert frame[4] & bit
    else:
        assert wire.read(2, register) & bit
        assert not wire.read(1, register)


def test_a_wrapped_encoder_counts_from_elsewhere():
    wire = Wire().stand()
    before = wire.positions()
    wire.faults("wrap=2:-300")
    assert wire.read(2, "present_position") == pytest.approx(before[1] - 300, abs=2)
    turn = Wire("wrap=2")
    assert turn.read(2, "present_position") == pytest.approx(4096 + LAMP.joints[1].zero_tick, abs=20)
    turn.faults()
    assert turn.read(2, "present_position") == pytest.approx(LAMP.joints[1].zero_tick, abs=20)


def test_a_servo_with_a_wrapped_encoder_drives_its_joint_away():
    wire = Wire().stand()
    wire.faults("wrap=3:100")
    wire.rig.advance(wire.rig.now + 1.0)
    turned = wire.rig.truth().joint_rad[2]
    assert turned == pytest.approx(-100 * 2 * np.pi / 4096 * LAMP.joints[2].sign, abs=0.05)
    assert wire.read(3, "present_position") == pytest.approx(LAMP.joints[2].zero_tick, abs=20)


def test_an_sts_does_not_see_a_whole_turn():
    rig = load_rig("lamp-sts3215")
    wire = Wire("wrap=2", rig=rig)
    assert wire.read(2, "present_position") == pytest.approx(rig.joints[1].zero_tick, abs=30)
    wire.faults("wrap=2:2100")
    assert wire.read(2, "present_position") == pytest.approx((rig.joints[1].zero_tick + 2100) % 4096, abs=30)


@pytest.mark.parametrize("name", FAMILIES)
def test_the_supply_falls_for_all(name):
    rig = load_rig(name)
    volts = 0.8 * rig.supply_v
    wire = Wire(f"supply={volts}@0.05-0.2", rig=rig)
    register = rig.joints[0].family.voltage
    assert wire.read(1, register) == round(10 * rig.supply_v)
    wire.rig.advance(0.1)
    assert [wire.read(servo, register) for servo in wire.joints] == [round(10 * volts)] * 3
    wire.rig.advance(0.3)
    assert wire.read(1, register) == round(10 * rig.supply_v)


def test_the_sensor_node_is_silent_or_babbles():
    silent = Wire("sensor-silent@0.5-1.0").rig
    assert silent.sensor_until(0.51)
    assert silent.sensor_until(0.99) == b""
    assert silent.sensor_until(1.2)
    plain = Wire().rig.sensor_until(1.0)
    babble = Wire("sensor-babble").rig.sensor_until(1.0)
    assert len(babble) > 1.5 * len(plain)
    assert all(line + b"\r\n" in babble for line in plain.split(b"\r\n")[:-1]), "the lines are in it, whole"


EVERY = (
    *("drop=0.05", "corrupt=0.05", "truncate=0.05", "late=0.05:3", "duplicate=0.05", "unsolicited=0.05", "deaf=0.02"),
    *("sensor-babble", "sensor-drop=0.1", "wrap=2:50@0.3", "stuck=3@0.4-0.6", "brownout@0.7-0.75", "latency-timer=2"),
)


def traffic(seed, step):
    """Return all that a master hears while it asks, polling as often as it likes."""
    wire = Wire(*EVERY, seed=seed, twin=Twin(supply_ohm=0.1, force_noise_n=0.1))
    line = wire.line(1, "present_position")
    heard = []
    for k in range(120):
        t = k * 0.01
        wire.rig.advance(t)
        wire.send(1 + k % 3, 2, wire.place(line.address, line.size))
        for poll in np.arange(t, t + 0.01, step)[1:]:
            heard += wire.rig.replies_until(float(poll))
        heard += wire.rig.replies_until(t + 0.01)
    return heard, wire.rig.sensor_until(2.0), wire.rig.truth().joint_rad.tolist()


def test_the_same_seed_meets_the_same_faults_however_often_it_listens():
    first = traffic(3, 0.01)
    assert first == traffic(3, 0.01)
    assert first == traffic(3, 0.0013)
    assert first != traffic(4, 0.01)


def test_a_fault_that_acts_on_no_servo_of_the_rig_is_refused():
    one = replace(LAMP, joints=LAMP.joints[:2])
    with pytest.raises(InputError, match="has no such servo"):
        Wire("stuck=3", rig=one)
