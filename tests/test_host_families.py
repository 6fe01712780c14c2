"""The host loop with servos of every family: one loop, and what each family asks of it."""

import itertools
import math
from dataclasses import replace

import pytest
from rig_bench import Bench

from controller import load_rig, parse_controller, registers
from controller.products import PRODUCTS
from deploy.checks import check_derating
from deploy.host_loop import State
from deploy.joint_counts import count_limits, joint_count, joint_speed

RIGS = {name: load_rig(name) for name in ("lamp-xc330", "lamp-xl430", "lamp-sts3215", "lamp-ax12", "jumper-xc330")}
LAMPS = ("lamp-xl430", "lamp-sts3215", "lamp-ax12")
JUMPER = RIGS["jumper-xc330"]

TWIST = """
program = "(list (* 60 (osc-wave 0.5 0)) (* 200 (osc-wave 1 0)) (* -200 (osc-wave 1 0)) (* 300 (osc-wave 0.5 0.25)))"
[controller]
name = "twist"
period_s = 0.02
slew_rad_s = 40.0
[[input]]
name = "t"
unit = "s"
low = 0
high = 100
""" + "".join(
    f'[[output]]\nname = "{joint.name}"\nkind = "velocity"\nunit = "deg/s"\nlow = -300\nhigh = 300\nneutral = 0\n'
    for joint in JUMPER.joints
)


def bench_of(tmp_path, name, *faults, **options):
    return Bench(tmp_path, *faults, rig=RIGS[name], **options)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Return what a short, derated run on each lamp left behind."""
    left = {}
    for name in LAMPS:
        on = bench_of(tmp_path_factory.mktemp(name), name)
        on.eeprom_before = [servo.table.eeprom() for servo in on.virtual.servos]
        on.outcome = on.run(0.5, derate=0.5)
        left[name] = on
    return left


@pytest.mark.parametrize("name", LAMPS)
def test_every_family_goes_the_whole_road(runs, name):
    on = runs[name]
    assert on.outcome.reason == "the time is over" and on.outcome.state is State.OFF
    assert (on.outcome.cycles, on.outcome.missed_replies, on.outcome.missed_deadlines) == (25, 0, 0)
    assert on.states() == ["off", "checked", "armed", "homing", "running", "stopping", "off"]
    assert set(on.torque_read_back().values()) == {0}


@pytest.mark.parametrize("name", LAMPS)
def test_eeprom_is_compared_and_never_written(runs, name):
    on = runs[name]
    locked = {register.address for register in registers(on.rig.joints[0].product).values() if register.eeprom}
    assert locked and not locked & {address for _, _, address, _ in on.written()}
    assert [servo.table.eeprom() for servo in on.virtual.servos] == on.eeprom_before


@pytest.mark.parametrize("name", LAMPS)
def test_gains_and_the_derated_ceiling_are_in_the_servo_before_torque(runs, name):
    on = runs[name]
    for servo, joint in zip(on.virtual.servos, on.rig.joints, strict=True):
        table = registers(joint.product)
        assert {gain: servo.table[gain] for gain in joint.gains} == dict(joint.gains)
        assert servo.table[joint.family.torque_ceiling] == round(0.5 * joint.ceiling)
        order = [address for _, servo_id, address, _ in on.written() if servo_id == joint.id]
        places = {name: order.index(table[name].address) for name in (joint.family.torque_ceiling, "torque_enable")}
        seed = order.index(table["goal_position"].address)
        # a goal gives an STS servo torque: the ceiling is there before it
        assert places[joint.family.torque_ceiling] < seed < places["torque_enable"]


@pytest.mark.parametrize("name", LAMPS)
def test_goals_begin_where_the_joints_stand_and_home_slowly(tmp_path, name):
    on = bench_of(tmp_path, name, start="limp")
    on.virtual.advance(3.0)  # until the limp body has come to rest
    stood = {
        joint.name: joint.zero_tick + joint.sign * angle * joint.product.ticks_per_turn / (2 * math.pi)
        for joint, angle in zip(on.rig.joints, on.virtual.truth().joint_rad, strict=True)
    }
    assert on.run(0.1).done
    for joint in on.rig.joints:
        low, high = count_limits(joint)
        counts = [count for _, count in on.goals()[joint.name]]
        assert abs(counts[0] - min(max(stood[joint.name], low), high)) <= 4
        step_max = on.rig.safety.homing_rad_s * on.rig.period_s * joint.product.ticks_per_turn / (2 * math.pi) + 1
        assert all(abs(b - a) <= step_max for a, b in itertools.pairwise(counts[: len(counts) - 5]))
        assert joint_count(joint, joint.neutral_rad) in counts


def test_only_servos_without_a_watchdog_are_warned_of(runs):
    told = {name: [f.text for f in on.outcome.findings if "no bus watchdog" in f.text] for name, on in runs.items()}
    assert told["lamp-xl430"] == []
    for name in ("lamp-sts3215", "lamp-ax12"):
        (text,) = told[name]
        assert "they go on holding the last goal until their own overload protection or you cut them off" in text


def test_an_ax_line_is_asked_one_by_one_and_an_sts_line_at_once(runs):
    def questions(name):
        begin = runs[name].log.cycles[0]["t"]
        sent = [
            bytes.fromhex(f["hex"])
            for f in runs[name].log.messages["/bus"]
            if f["direction"] == "tx" and f["t"] >= begin
        ]
        return [(frame[2], frame[4]) for frame in sent[: 3 * 6]]

    assert questions("lamp-sts3215")[:3] == [(254, 0x82), (254, 0x83), (1, 0x02)]
    assert questions("lamp-ax12")[:5] == [(1, 0x02), (2, 0x02), (3, 0x02), (254, 0x83), (1, 0x02)]


def test_the_feetech_lock_keeps_eeprom_from_being_written_by_mistake(runs):
    on = runs["lamp-sts3215"]
    assert [servo.table["lock"] for servo in on.virtual.servos] == [1, 1, 1]
    assert [servo.table["lock"] for servo in runs["lamp-ax12"].virtual.servos] == [
        0,
        0,
        0,
    ]  # would last until power is cut


def test_servos_without_a_ceiling_in_ram_are_not_run_derated():
    joint = replace(RIGS["lamp-sts3215"].joints[0], product=PRODUCTS["scs0009"])
    rig = replace(RIGS["lamp-sts3215"], joints=(joint,))
    (finding,) = check_derating(rig, 0.5)
    assert finding.level == "error" and "scs0009 servos have no torque ceiling outside their EEPROM" in finding.text
    assert check_derating(rig, 1.0) == check_derating(RIGS["lamp-ax12"], 0.5) == []


# driven by their speed


@pytest.fixture(scope="module")
def twisted(tmp_path_factory):
    on = Bench(tmp_path_factory.mktemp("jumper"), rig=JUMPER)
    on.outcome = on.run(1.0, controller=parse_controller(TWIST, "twist"))
    return on


def test_a_velocity_rig_runs_and_ends_at_rest_without_torque(twisted):
    assert twisted.outcome.reason == "the time is over" and twisted.outcome.state is State.OFF
    assert set(twisted.torque_read_back().values()) == {0}
    for joint in JUMPER.joints:
        counts = [count for _, count in twisted.goals()[joint.name]]
        assert counts[0] == 0 and counts[-1] == 0  # seeded at rest, left at rest
        assert max(map(abs, counts)) > 0
        assert max(abs(joint_speed(joint, count)) for count in counts) <= joint.speed_rad_s_max + 0.03


def test_a_speed_is_no_more_than_the_joints_fastest_and_changes_as_slowly_as_told(twisted):
    for joint in JUMPER.joints:
        track = [0, *(cycle["goal_counts"][joint.name] for cycle in twisted.log.cycles)]
        pairs = [pair for pair in itertools.pairwise(track) if joint.unlimited or 0 not in pair]  # but at an end
        steps = [abs(joint_speed(joint, b) - joint_speed(joint, a)) for a, b in pairs]
        assert max(steps) <= 40.0 * 0.02 + joint.product.velocity_unit_rad_s + 1e-9


def test_velocity_rigs_stop_when_their_watchdog_or_a_servo_goes(tmp_path):
    on = Bench(tmp_path, "dead=2@1.2", rig=JUMPER)
    outcome = on.run(3.0, controller=parse_controller(TWIST, "twist"))
    assert outcome.faulty and "gave no reply for 4 periods" in outcome.reason
    read = on.torque_read_back()
    assert set(read.values()) == {0}
    assert all(track[-1][1] == 0 for track in on.goals().values())
