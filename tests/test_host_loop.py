"""The host loop on the virtual rig in lock step: the whole road, and what each fault does to it."""

import itertools
import math
import os
import select
from dataclasses import replace

import pytest
from rich.console import Console
from rig_bench import RIG, SWAY, Bench, sway

from controller import controller_text, parse_controller, registers
from controller.errors import InputError, RunError
from deploy.connection import connect_virtual
from deploy.host_loop import RunOptions, run_controller
from deploy.joint_counts import count_limits, joint_count
from deploy.log import RunLog
from deploy.sensor_reader import checksum
from deploy.states import WAYS, State, StateMachine
from deploy.summary import summary
from deploy.torque import hold
from servolve.announcer import Announcer

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


# people and accidents


@pytest.mark.parametrize("at", [0.0, 0.32, 0.4, 1.5])
def test_a_person_can_stop_it_in_every_state(bench, at):
    on = bench()
    outcome = on.run(3.0, stop=lambda bench: "a key was pressed" if bench.virtual.now >= at else None)
    assert not outcome.done and not outcome.faulty
    assert outcome.state is State.OFF and outcome.reason == "stopped: a key was pressed"
    assert on.torque() == [0, 0, 0]


def test_the_sensor_node_can_stop_it(bench, monkeypatch):
    on = bench()
    lines = on.virtual.sensor_until

    def with_stop(t):
        return lines(t) + (b"$E,1*%02X\r\n" % checksum(b"E,1") if t > 1.0 else b"")

    monkeypatch.setattr(on.virtual, "sensor_until", with_stop)
    outcome = on.run(3.0)
    assert outcome.reason == "stopped: the sensor node sent an emergency stop"
    assert on.torque() == [0, 0, 0]


def test_an_unforeseen_exception_switches_torque_off_on_its_way_up(bench, monkeypatch):
    on = bench()

    def burst(*_):
        raise ZeroDivisionError("a defect")

    monkeypatch.setattr("deploy.cycle_message.CycleWords.message", burst)
    with pytest.raises(ZeroDivisionError):
        on.run()
    assert on.torque() == [0, 0, 0]


def test_a_full_disk_switches_torque_off(tmp_path, monkeypatch):
    on = Bench(tmp_path)
    with RunLog(on.path) as log, connect_virtual(on.virtual, lambda: None) as link:
        monkeypatch.setattr(log, "_writer", FullDisk(log._writer))
        outcome = run_controller(link, RIG, sway(), RunOptions(0.4, 0.0, 5.0, True, 1.0), log)
    assert outcome.faulty and "the log cannot be written any more" in outcome.reason
    assert outcome.cycles > 0
    assert on.torque() == [0, 0, 0]


class FullDisk:
    """Pass on to a writer until one second's worth is flushed for the third time."""

    def __init__(self, writer):
        self.writer, self.flushed = writer, 0

    def __getattr__(self, name):
        return getattr(self.writer, name)

    def flush(self):
        self.flushed += 1
        if self.flushed == 3:
            raise OSError(28, "No space left on device")
        self.writer.flush()


def test_a_tripped_watchdog_of_an_earlier_run_is_cleared(bench):
    on = bench()
    servo = on.virtual.servos[0]
    servo.table["torque_enable"] = 1
    servo.table["bus_watchdog"] = 5
    on.virtual.advance(0.5)
    assert servo.table["bus_watchdog"] == 255
    outcome = on.run(0.5)
    assert outcome.done, outcome.reason
    assert [finding.level for finding in outcome.findings] == ["warning"]


def test_a_host_that_was_silent_for_too_long_is_told(bench):
    stalled = []

    def stall(bench):
        if bench.virtual.now > 1.0 and not stalled:
            stalled.append(bench.link.clock.now())
            bench.link.clock.sleep_until(stalled[0] + 0.3)  # the process slept; the servos have not

    on = bench()
    outcome = on.run(3.0, stop=stall)
    assert outcome.faulty and "the host was silent for 0.3" in outcome.reason
    assert on.torque() == [0, 0, 0]
    assert [servo.table["bus_watchdog"] for servo in on.virtual.servos] == [0, 0, 0]


def test_a_short_stall_rides_through_and_the_controller_is_not_stepped_twice(bench):
    stalled = []

    def stall(bench):
        if bench.virtual.now > 1.0 and not stalled:
            stalled.append(bench.link.clock.now())
            bench.link.clock.sleep_until(stalled[0] + 0.07)

    on = bench()
    outcome = on.run(2.0, stop=stall)
    assert outcome.done and outcome.cycles == 100
    steps = [b["t"] - a["t"] for a, b in itertools.pairwise(on.log.cycles)]
    assert min(steps) > 0.0 and sum(step > 0.021 for step in steps) == 1
    assert [cycle["k"] for cycle in on.log.cycles] == list(range(100))
    assert sum(step < 0.019 for step in steps) <= 1  # the one that was late, made up for within its period


def test_the_bus_watchdog_is_armed_while_running(bench):
    seen = []
    on = bench()
    on.run(1.0, stop=lambda bench: seen.append([s.table["bus_watchdog"] for s in bench.virtual.servos]))
    counts = round(RIG.safety.watchdog_s / 0.02)
    assert seen[-1] == [counts] * 3


def test_a_controller_for_another_rig_is_refused_before_the_bus_is_touched(bench):
    on = bench()
    with pytest.raises(InputError, match="period_s"):
        on.run(controller=sway(period_s=0.01))
    assert on.virtual.now < 0.01


@pytest.mark.parametrize(("fault", "end"), [((), State.STOPPING), (("dead=2@1.0",), State.FAULT)])
def test_the_end_is_announced_and_logged_once_torque_is_off(bench, monkeypatch, fault, end):
    on = bench(*fault)
    found = {}
    write = RunLog.write

    def log(self, topic, t, message):
        if message.get("entered") == end.value:
            found["logged"] = on.torque()
        write(self, topic, t, message)

    monkeypatch.setattr(RunLog, "write", log)
    on.announce = lambda state: found.setdefault(state, on.torque())
    outcome = on.run(1.5)
    assert end in found and outcome.state in (State.OFF, State.FAULT)
    assert found[State.RUNNING] == [1, 1, 1]
    assert found[end] == found["logged"] == [0, 0, 0]
    assert on.log.events[-1]["t"] > next(e["t"] for e in on.log.events if e.get("entered") == "running")


@pytest.mark.parametrize("at", [0.0, 0.4, 1.0, math.inf])
def test_a_log_that_fails_leaves_no_torque_and_is_told(bench, monkeypatch, at):
    on = bench()
    write = RunLog.write

    def full(self, topic, t, message):
        # at any time, or as late as the release itself
        if topic == "/bus" and (t >= at or (math.isinf(at) and on.torque() == [0, 0, 0] and t > 1.0)):
            raise RunError("run.mcap: the log cannot be written any more (No space left on device)")
        write(self, topic, t, message)

    monkeypatch.setattr(RunLog, "write", full)
    outcome = on.run(1.0)
    assert outcome.faulty and "the log cannot be written any more" in outcome.reason
    assert outcome.unsure == [] and on.torque() == [0, 0, 0]


def test_an_announcer_that_fails_leaves_no_torque(bench):
    on = bench()

    def burst(state):
        if state is State.RUNNING:
            raise ZeroDivisionError("a defect")

    on.announce = burst
    with pytest.raises(ZeroDivisionError):
        on.run()
    assert on.torque() == [0, 0, 0]


def test_an_announcer_never_waits_for_a_terminal_that_stands_still():
    reader, writer = os.pipe()
    while True:  # until the pipe is full: whoever writes to it now waits
        os.set_blocking(writer, False)
        try:
            os.write(writer, bytes(65536))
        except BlockingIOError:
            break
    os.set_blocking(writer, True)
    with os.fdopen(writer, "w", buffering=1) as stopped, Announcer(Console(file=stopped), "rig") as announcer:
        for _ in range(10):
            announcer(State.RUNNING)
        os.set_blocking(reader, False)
        said = b""
        while said.count(b"rig: running") < 10:  # they all come once somebody reads
            said += os.read(reader, 1 << 20) if select.select([reader], [], [], 10.0)[0] else pytest.fail("silence")
    os.close(reader)
