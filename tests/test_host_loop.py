"""The host loop on the virtual rig in lock step: the whole road, and what each fault does to it."""

import itertools
import math
from dataclasses import replace

import pytest
from rig_bench import RIG, Bench, sway

from controller import controller_text, parse_controller, registers
from deploy.host_loop import RunOptions
from deploy.joint_counts import count_limits, joint_count
from deploy.logs.summary import summary
from deploy.states import WAYS, State, StateMachine
from deploy.torque import hold

TABLE = registers(RIG.joints[0].product)


@pytest.fixture
def bench(tmp_path):
    return lambda *faults, **options: Bench(tmp_path, *faults, **options)


# the whole road


def test_a_run_goes_through_every_state_and_ends_with_torque_off(bench):
    on = bench()
    outcome = on.run()
    assert on.states() == ["off", "checked", "armed", "homing", "running", "stopping", "off"]
    assert (outcome.state, outcome.done, outcome.faulty) == (State.OFF, True, False)
    assert (outcome.cycles, outcome.missed_deadlines, outcome.missed_replies) == (100, 0, 0)
    assert len(on.log.cycles) == 100
    assert len(on.log.messages["/truth"]) == 102  # and before the first, and after the last
    assert on.log.events[-3]["t"] - on.log.cycles[0]["t"] == pytest.approx(2.0)
    assert on.torque() == [0, 0, 0]
    assert on.log.events[-2]["text"] == "torque is off on every servo, as read back"


def test_settings_are_the_rigs_and_eeprom_is_not_written(bench):
    on = bench()
    eeprom = [servo.table.eeprom() for servo in on.virtual.servos]
    on.run(0.2, derate=0.5)
    for servo, joint in zip(on.virtual.servos, RIG.joints, strict=True):
        assert servo.table["position_p_gain"] == joint.p_gain != TABLE["position_p_gain"].initial
        assert servo.table["position_d_gain"] == joint.d_gain != TABLE["position_d_gain"].initial
        assert servo.table["goal_pwm"] == round(0.5 * joint.pwm_limit)
        assert servo.table["bus_watchdog"] == 0
    assert [servo.table.eeprom() for servo in on.virtual.servos] == eeprom
    assert all(frame[8] + 256 * frame[9] >= 64 for frame in on.frames(0x03))


def test_goals_are_seeded_where_the_joints_stand_before_torque(bench):
    on = bench(start="limp")  # the lamp has sunk before anybody looks
    on.virtual.advance(1.0)
    on.run(0.2)
    written = [(frame[4], frame[8] + 256 * frame[9], frame[10:-2]) for frame in on.frames(0x03)]
    stood = [cycle for cycle in on.log.events if cycle.get("entered") == "armed"]
    assert stood
    for joint in RIG.joints:
        of_it = [(address, data) for servo, address, data in written if servo == joint.id]
        addresses = [address for address, _ in of_it]
        seed, on_at = addresses.index(TABLE["goal_position"].address), addresses.index(TABLE["torque_enable"].address)
        assert seed < on_at
        low, high = count_limits(joint)
        assert low <= int.from_bytes(of_it[seed][1], "little", signed=True) <= high


def test_homing_is_slow_and_ends_in_neutral(bench):
    on = bench(start="limp")
    on.virtual.advance(1.0)
    on.run(0.2)
    begin, end = (next(e["t"] for e in on.log.events if e.get("entered") == state) for state in ("homing", "running"))
    goals = []
    for frame in on.log.messages["/bus"]:
        data = bytes.fromhex(frame["hex"])
        if frame["direction"] == "tx" and data[7] == 0x83 and data[8] == 116 and begin <= frame["t"] <= end:
            goals.append([int.from_bytes(data[13 + 5 * n : 17 + 5 * n], "little") for n in range(3)])
    step_max = RIG.safety.homing_rad_s * RIG.period_s * 4096 / (2 * math.pi) + 1
    assert len(goals) > 40
    assert all(
        abs(a - b) <= step_max for row, after in itertools.pairwise(goals) for a, b in zip(row, after, strict=True)
    )
    assert goals[-1] == [joint_count(joint, joint.neutral_rad) for joint in RIG.joints]
    first = on.log.cycles[0]
    for joint in RIG.joints:
        assert abs(first["raw"][joint.name] - joint_count(joint, joint.neutral_rad)) < 20
        assert abs(first["raw"][f"{joint.name}_vel"]) <= 2


def test_every_period_has_the_schedules_transactions(bench):
    on = bench()
    on.run(1.0)
    kinds = []
    begin = on.log.cycles[0]["t"]
    for frame in on.log.messages["/bus"]:
        if frame["direction"] == "tx" and begin <= frame["t"] <= on.log.cycles[-1]["t"] + 0.01:
            kinds.append(int(frame["hex"][14:16], 16))
    assert kinds == [0x82, 0x83, 0x02] * 50
    assert [cycle["t"] - begin for cycle in on.log.cycles] == pytest.approx([0.02 * k for k in range(50)], abs=1e-9)
    assert {message["joint"] for message in on.log.messages["/health"]} == {"a0", "a1", "a2"}


def test_goals_keep_limits_and_rate(bench):
    wild = sway(slew_rad_s=3.0)
    wild = replace(wild, outputs=tuple(replace(output, low=-90.0, high=90.0) for output in wild.outputs))
    text = controller_text(wild).replace("(* 10 ", "(* 4000 ")
    on = bench()
    on.run(1.5, controller=parse_controller(text, "wild"))
    neutral = {joint.name: joint_count(joint, joint.neutral_rad) for joint in RIG.joints}
    rows = [neutral, *(cycle["goal_counts"] for cycle in on.log.cycles)]
    step_max = 3.0 * RIG.period_s * 4096 / (2 * math.pi) + 1
    for joint in RIG.joints:
        track = [row[joint.name] for row in rows]
        low, high = count_limits(joint)
        assert low <= min(track) and max(track) <= high
        assert max(abs(a - b) for a, b in itertools.pairwise(track)) <= step_max
    assert max(row["a0"] for row in rows) == count_limits(RIG.joints[0])[1]


def test_hold_leaves_torque_on_and_the_watchdog_disarmed(bench):
    rig = replace(RIG, safety=replace(RIG.safety, stop="hold"))
    on = bench(rig=rig)
    outcome = on.run(0.5)
    assert outcome.state is State.OFF and outcome.done
    assert on.torque() == [1, 1, 1]
    assert [servo.table["bus_watchdog"] for servo in on.virtual.servos] == [0, 0, 0]
    on.virtual.advance(on.virtual.now + 2.0)
    assert [servo.table["bus_watchdog"] for servo in on.virtual.servos] == [0, 0, 0]


def test_a_stop_in_the_very_last_period_takes_the_torque(bench):
    rig = replace(RIG, safety=replace(RIG.safety, stop="hold"))
    on = bench(rig=rig)
    on.run(0.5)
    late = on.log.cycles[-1]["t"] + 0.9 * RIG.period_s
    on = bench(rig=rig)
    outcome = on.run(0.5, stop=lambda bench: "a key was pressed" if bench.virtual.now >= late else None)
    assert (outcome.cycles, outcome.reason) == (25, "stopped: a key was pressed")
    assert on.torque() == [0, 0, 0]


def test_a_rig_that_can_not_hold_is_released_and_told(bench, monkeypatch):
    on = bench(rig=replace(RIG, safety=replace(RIG.safety, stop="hold")))

    def trip(bus, rig):
        on.virtual.servos[1].table["torque_enable"] = 0
        hold(bus, rig)

    monkeypatch.setattr("deploy.host_loop.hold", trip)
    outcome = on.run(0.5)
    assert outcome.faulty and outcome.state is State.FAULT
    assert outcome.reason == "joint a1 (servo 2) was to hold, but its torque is off; every servo was released"
    assert on.torque() == [0, 0, 0]


def test_hold_does_not_outlast_a_fault(bench):
    on = bench("dead=1@1.0", rig=replace(RIG, safety=replace(RIG.safety, stop="hold")))
    assert on.run(2.0).faulty
    assert on.torque() == [0, 0, 0]


def test_a_dry_run_reads_and_writes_nothing(bench):
    on = bench()
    outcome = on.run(arm=False)
    assert on.states() == ["off", "checked", "off"]
    assert outcome.done and not outcome.touched and outcome.cycles == 0
    assert {frame[7] for frame in on.frames(0x01) + on.frames(0x02)} == {0x01, 0x02}
    assert on.frames(0x03) == on.frames(0x83) == on.frames(0x08) == []
    assert outcome.readings[0].values["present_input_voltage"] == 50


def test_there_is_no_way_but_the_ways():
    machine = StateMachine(lambda left, entered, reason: None)
    with pytest.raises(ValueError, match="no way from off to running"):
        machine.enter(State.RUNNING, "")
    assert WAYS.keys() == set(State)


# checks


@pytest.mark.parametrize(
    ("register", "value", "sentence"),
    [
        ("drive_mode", 1, "drive_mode is 1 and must be 0; set register 10 to 0"),
        ("operating_mode", 4, "operating_mode is 4 and must be 3; set register 11 to 3"),
        ("return_delay_time", 250, "return_delay_time is 500 us, the rig says 0 us; set register 9 to 0"),
        ("homing_offset", 100, "homing_offset is 100 and must be 0"),
        ("secondary_id", 7, "secondary_id 7 is active"),
        ("max_position_limit", 2100, "max_position_limit 2100 cuts off travel"),
        ("min_position_limit", 2000, "min_position_limit 2000 cuts off travel"),
        ("pwm_limit", 500, "pwm_limit 500 is below the rig's 885"),
        ("hardware_error_status", 0x20, "reports a hardware error (overload)"),
        ("model_number", 1200, "is a model 1200, the rig says xc330-m181 (model 1230)"),
    ],
)
def test_a_wrong_servo_is_refused_before_anything_is_written(bench, register, value, sentence):
    on = bench()
    on.virtual.servos[1].table[register] = value
    outcome = on.run()
    assert outcome.faulty and outcome.state is State.FAULT
    assert sentence in outcome.reason and "joint a1 (servo 2)" in outcome.reason
    assert on.states() == ["off", "fault"]
    assert on.frames(0x03) == on.frames(0x83) == []


@pytest.mark.parametrize(
    ("fault", "sentence"),
    [
        ("dead=3", "joint a2 (servo 3): does not answer on virtual lamp-xc330 at 1000000 baud; check its power"),
        ("corrupt=1", "joint a0 (servo 1): answers with corrupt packets only"),
        ("supply=3.9", "its supply is 3.9 V, at least 4.2 V are needed"),
        ("supply=6.9", "its supply is 6.9 V, the rig says 5 V"),
        ("sensor-dead=P", "sensor x: $P lines should come 100 times a second, but no line has come"),
    ],
)
def test_a_wrong_rig_is_refused(bench, fault, sentence):
    on = bench(fault)
    outcome = on.run()
    assert outcome.faulty and sentence in outcome.reason
    assert on.torque() == [0, 0, 0]


def test_a_joint_outside_its_limits_is_refused(bench):
    joints = (RIG.joints[0], replace(RIG.joints[1], zero_tick=3000), RIG.joints[2])
    on = bench()
    on.rig = replace(RIG, joints=joints)  # the rig file's zero is wrong, the servo stands at its own
    outcome = on.run()
    assert outcome.faulty and "outside its limits" in outcome.reason


def test_two_servos_with_one_id_are_suspected(bench):
    on = bench()
    on.virtual.servos[1].id = 1
    outcome = on.run()
    assert outcome.faulty and "two servos may share id 1" in outcome.reason


def test_what_no_sensor_has_sent_is_no_value(bench):
    on = bench("sensor-dead=P")
    outcome = on.run(arm=False)
    assert outcome.pose.keys() == {"force"}
    assert summary(outcome, RunOptions(0.4, 0.0, 1.0, False, 1.0), {})["final_tilt_rad"] is None
