"""The host loop when servos and lines go wrong: glitches ride through, what lasts stops with its sentence."""

import math
from dataclasses import replace

import pytest
from rig_bench import RIG, SWAY, Bench, sway

from controller import controller_text, parse_controller, registers
from deploy.states import State

TABLE = registers(RIG.joints[0].product)


@pytest.fixture
def bench(tmp_path):
    return lambda *faults, **options: Bench(tmp_path, *faults, **options)


# glitches ride through


def test_lost_and_corrupt_replies_ride_through_and_nothing_stale_passes_for_fresh(bench):
    on = bench("drop=0.01", "corrupt=0.01", seed=4)
    outcome = on.run(30.0)
    assert outcome.done and outcome.state is State.OFF and outcome.cycles == 1500
    assert 40 < outcome.missed_replies < 150  # 2 % of 4,500
    last = None
    for cycle, truth in zip(on.log.cycles, on.log.messages["/truth"][1:-1], strict=True):
        for joint in RIG.joints:
            raw, age = cycle["raw"][joint.name], cycle["age_s"][joint.name]
            if joint.id in cycle["missed"]:
                assert last is not None
                assert raw == last["raw"][joint.name]  # held …
                assert age > 0.019  # … and known to be old
            else:
                assert age < 0.005
                stands = joint.zero_tick + joint.sign * truth["joint_rad"][joint.name] * 4096 / (2 * math.pi)
                assert abs(raw - stands) < 8  # really the servo's position of now, not of another time
        last = cycle
    assert on.torque() == [0, 0, 0]


@pytest.mark.parametrize(
    "faults",
    [
        ("deaf=0.02",),
        ("sensor-drop=0.1", "sensor-corrupt=0.1"),
        ("mute=2@1.0-1.05",),
        ("sensor-dead=P@1.0-1.09",),
        ("supply=4.0@1.0-1.15",),
    ],
)
def test_what_does_not_last_does_not_stop(bench, faults):
    on = bench(*faults)
    outcome = on.run(3.0)
    assert outcome.done, outcome.reason
    assert on.torque() == [0, 0, 0]


# persistent faults stop


@pytest.mark.parametrize(
    ("fault", "sentence", "unsure"),
    [
        ("dead=2@1.0", "joint a1 (servo 2) gave no reply for 4 periods", ["a1"]),
        ("mute=1@1.0", "joint a0 (servo 1) gave no reply for 4 periods", ["a0"]),
        ("mute=3@1.0-1.5", "joint a2 (servo 3) gave no reply for 4 periods", []),  # back in time to be told
        ("drop=1@1.0", "no servo has answered for 4 periods", ["a0", "a1", "a2"]),
        ("corrupt=1@1.0", "no servo has answered for 4 periods", ["a0", "a1", "a2"]),
        ("overload=2@1.0", "joint a1 (servo 2) reports a hardware error (overload)", []),
        ("overheat=3@1.0", "joint a2 (servo 3) reports a hardware error (overheating)", []),
        ("supply=4.0@1.0", "gets 4 V, 4.2 V are needed", []),
        ("sensor-dead=P@1.0", "sensor x (lines $P) has given nothing new", []),
        ("sensor-dead=F@1.0", "sensor force (lines $F) has given nothing new", []),
        ("sensor-corrupt=1@1.0", "has given nothing new", []),
    ],
)
def test_a_fault_that_lasts_stops_with_its_sentence_and_torque_off(bench, fault, sentence, unsure):
    on = bench(fault)
    outcome = on.run(5.0)
    assert outcome.faulty and outcome.state is State.FAULT and not outcome.done
    assert sentence in outcome.reason
    assert outcome.reason.count(".") <= 3 and "\n" not in outcome.reason
    assert on.states()[-2:] == ["running", "fault"]
    assert 10 < outcome.cycles < 60
    assert [joint.name for joint in outcome.unsure] == unsure
    # read where the bus does not reach: a servo whose line is cut hears nothing, every other is off
    assert on.torque() == [int(fault.startswith("mute") and joint.name in unsure) for joint in RIG.joints]
    last = on.log.cycles[-1]
    assert last["t_write"] is None or "hardware" in sentence or "V" in sentence  # no goal after the fault was known


def test_a_servo_that_restarts_unheard_stops_the_run(bench):
    # it is away for less than the periods that may be missed, and comes back limp
    rig = replace(RIG, safety=replace(RIG.safety, missed_cycles_max=40, tracking_rad_max=3.0))
    on = bench("dead=2@1.0-1.05", rig=rig)
    outcome = on.run(3.0)
    assert outcome.faulty and outcome.state is State.FAULT
    assert outcome.reason.startswith("joint a1 (servo 2) has no torque; it has restarted")
    assert on.torque() == [0, 0, 0] and outcome.unsure == []
    assert {message.get("torque") for message in on.log.messages["/health"]} == {0, 1, None}


@pytest.mark.parametrize(
    ("shutdown", "sentence"),
    [
        (0x35, "reports a hardware error (overload) and has switched its torque off; remove"),
        (0x15, "reports a hardware error (overload), for which its shutdown register (63) of 21 does not switch its"),
    ],
)
def test_a_hardware_error_says_what_became_of_torque(bench, shutdown, sentence):
    on = bench("overload=2@1.0")
    on.virtual.servos[1].table["shutdown"] = shutdown
    outcome = on.run(3.0)
    assert outcome.faulty and sentence in outcome.reason
    assert on.torque() == [0, 0, 0]


def test_a_blocked_joint_stops_the_run(bench):
    # the controller commands what the servo, left with next to no torque, can not do
    weak = replace(RIG, safety=replace(RIG.safety, tracking_rad_max=0.1, tracking_s_max=0.2))
    on = bench(rig=weak)
    text = controller_text(sway(slew_rad_s=0.0)).replace("(* 10 ", "(* 50 ")
    outcome = on.run(6.0, controller=parse_controller(text, "far"), derate=0.05)
    assert outcome.faulty and "rad from its goal for 0.2" in outcome.reason
    assert on.torque() == [0, 0, 0]


def test_a_fall_stops_the_run(bench):
    rig = replace(RIG, safety=replace(RIG.safety, tilt_rad_max=0.02))
    text = controller_text(sway(slew_rad_s=0.0)).replace("(* 10 ", "(* 60 ").replace("(* 8 ", "(* 60 ")
    on = bench(rig=rig)
    outcome = on.run(6.0, controller=parse_controller(text.replace("osc-wave 0.5", "osc-wave 3"), "tumble"))
    assert outcome.faulty and "the base has fallen" in outcome.reason
    assert on.torque() == [0, 0, 0]


def test_a_controller_that_needs_no_force_ignores_a_dead_force_sensor(bench):
    text = SWAY.replace("(+ px s0)", "px")
    text = text[: text.index('[[input]]\nname = "s0"')] + text[text.index("[[output]]") :]
    on = bench("sensor-dead=F@1.0")
    outcome = on.run(3.0, controller=parse_controller(text, "no force"))
    assert outcome.done
    assert on.log.cycles[-1]["age_s"]["force"] > 1.0
    assert on.log.cycles[-1]["age_s"]["x"] < 0.02
