"""Every judge of the firmware against the host loop's: the same periods end the same runs for the same reasons."""

import math
import re
from ctypes import c_uint32
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rig_bench import sway
from safety_library import Judges, replies, reply_of
from test_velocity_rig import TURN

from controller import load_rig, parse_controller
from controller.needed_sensors import needed_sensors
from controller.terminals import joint_scale
from deploy import safety
from deploy.buses.servo_bus import Reply
from deploy.joint_counts import joint_angle

RIGS = {
    "lamp-xc330": sway(),
    "lamp-sts3215": sway(),
    "jumper-xc330": parse_controller(TURN, "turn"),
}
HALF_US = 5e-7
"""Times are whole microseconds: a limit between two of them is the same for whole and for floating seconds."""


def between(rig):
    """Return a rig whose time limits lie between two microseconds."""
    limits = replace(rig.safety, tracking_s_max=rig.safety.tracking_s_max + HALF_US)
    sensors = tuple(replace(sensor, age_s_max=sensor.age_s_max + HALF_US) for sensor in rig.sensors)
    return replace(rig, safety=limits, sensors=sensors)


class Pair:
    """A rig's judges in both languages."""

    def __init__(self, folder, name):
        self.rig = load_rig(name)
        self.host_rig = between(self.rig)
        self.controller = RIGS[name]
        self.judges = Judges(folder, self.rig, self.controller)
        self.needed = needed_sensors(self.rig, self.controller)
        self.start()

    def start(self):
        self.watch = safety.Watch()
        self.judges.start()

    def names(self, sentence, number):
        """Return whether a sentence is about a joint."""
        joint = self.rig.joints[number]
        return f"joint {joint.name} (servo {joint.id})" in sentence


@pytest.fixture(scope="module", params=RIGS)
def pair(request, tmp_path_factory):
    return Pair(tmp_path_factory.mktemp(request.param), request.param)


@pytest.fixture(scope="module")
def lamp(tmp_path_factory):
    return Pair(tmp_path_factory.mktemp("lamp"), "lamp-xc330")


@pytest.fixture(scope="module")
def jumper(tmp_path_factory):
    return Pair(tmp_path_factory.mktemp("jumper"), "jumper-xc330")


def agree(pair, said, told, reasons):
    """Check that both say the same; return whether the run has ended. reasons: words => number of sv_reason."""
    assert (said is None) == (told is None), (said, told)
    if said is None:
        return False
    reason, joint, *_ = told
    words = next(words for words in reasons if words in said)
    assert reasons[words] == reason, (said, told)
    assert joint == 255 or pair.names(said, joint), (said, told)
    return True


def numbers(sentence):
    """Return the numbers in a sentence that stand by themselves."""
    return [float(found) for found in re.findall(r"(?<![\w.(])-?\d+(?:\.\d+)?(?= |;|,)", sentence)]


REPLIES = st.builds(
    lambda status, error, alert, late: Reply(
        0, status, b"1234" if status == "data" else b"", error, 0.0, alert, "", late and status == "missing"
    ),
    st.sampled_from(("data", "data", "missing", "corrupt", "refused")),
    st.integers(0, 255),
    st.booleans(),
    st.booleans(),
)


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_silence(pair, data):
    pair.start()
    reasons = {"too late": 34, "no reply": 33, "no servo has": 33, "corrupt": 35, "refused": 36}
    share = data.draw(st.sampled_from((REPLIES, REPLIES.filter(lambda reply: reply.status != "data"))))
    for _ in range(30):
        given_replies = data.draw(st.lists(share, min_size=len(pair.rig.joints), max_size=len(pair.rig.joints)))
        by_id = {
            joint.id: replace(reply, id=joint.id) for joint, reply in zip(pair.rig.joints, given_replies, strict=True)
        }
        said = safety.judge_replies(pair.rig, pair.watch, by_id)
        told = pair.judges.judge("replies", replies(given_replies))
        if agree(pair, said, told, reasons):
            assert ("in most periods" in said) == bool(told[3] & 1)
            assert f"for {told[2]} periods" in said or told[3] & 1
            blamed = told[1] if told[1] != 255 else next(i for i, r in enumerate(given_replies) if r.status != "data")
            assert told[3] >> 8 == given_replies[blamed].error
            assert (told[1] == 255) == ("every servo" in said or "no servo" in said)
            return


@pytest.mark.parametrize("silent", [1, 2, 3])
def test_a_servo_that_answers_now_and_then(pair, silent):
    pair.start()
    said = None
    for period in range(60):
        seen = [Reply(joint.id, "data", b"1", 0, 0.0) for joint in pair.rig.joints]
        if period % (silent + 1):
            seen[1] = replace(seen[1], status="missing", data=b"")
        said = safety.judge_replies(pair.rig, pair.watch, {reply.id: reply for reply in seen})
        if agree(pair, said, pair.judges.judge("replies", replies(seen)), {"no reply in most": 33}):
            break
    assert (said is None) == (silent == 1)


@settings(max_examples=60, deadline=None)
@given(pattern=st.lists(st.sampled_from((None, (0, 0), (1, 1), (1, 32), (1, 33))), min_size=1, max_size=12))
def test_alerts(pair, pattern):
    pair.start()
    joint = pair.rig.joints[1]
    for said in pattern:
        reply = Reply(joint.id, "missing", b"", 0, 0.0)
        if said is not None:
            reply = Reply(joint.id, "data", b"1", said[1], 0.0, bool(said[0]))
        assert pair.judges.alert(1, reply_of(reply)) == safety.judge_alert(pair.watch, joint, reply)


@given(status=st.integers(0, 255), shutdown=st.one_of(st.none(), st.integers(0, 255)), number=st.integers(0, 2))
def test_hardware_errors(pair, status, shutdown, number):
    pair.start()
    joint = pair.rig.joints[number]
    said = safety.judge_hardware_error(joint, status, shutdown)
    told = pair.judges.judge("hardware_error", number, status, -1 if shutdown is None else shutdown)
    assert agree(pair, said, told, {"hardware error": 37}) == (status != 0)
    assert told is None or told[2:] == (status, -1 if shutdown is None else shutdown)


def test_lost_torque(pair):
    pair.start()
    for torque in (1, 0):
        said = safety.judge_torque(pair.rig.joints[2], torque)
        told = pair.judges.judge_torque(2, torque)
        assert agree(pair, said, told, {"has no torque": 38}) == (torque == 0)


@settings(max_examples=60, deadline=None)
@given(
    ages_us=st.lists(st.one_of(st.just(-1), st.integers(0, 130_000)), min_size=1, max_size=12), shift=st.integers(0, 5)
)
def test_stale_sensors(pair, ages_us, shift):
    pair.start()
    nsensor = len(pair.rig.sensors)
    for period in range(len(ages_us)):
        now = [ages_us[(period + shift * number) % len(ages_us)] for number in range(nsensor)]
        host = [math.inf if age < 0 else 1e-6 * age for age in now]
        said = safety.judge_sensors(pair.host_rig, pair.watch, pair.needed, host)
        told = pair.judges.judge("sensors", now)
        assert (said is None) == (told is None), (said, told)
        if said is not None:
            sensor = pair.rig.sensors[told[1]]
            assert told[0] == 39
            assert f"sensor {sensor.name} " in said
            assert told[2:] == (now[told[1]], round(1e6 * sensor.age_s_max))
            return


STEPS_US = st.sampled_from((20_000, 20_013, 40_000, 61_000))


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_encoders_that_jump(pair, data):
    pair.start()
    njoint = len(pair.rig.joints)
    now_us = 1_000_000
    counts = [2048] * njoint
    reasons = {"has jumped": 40}
    for _ in range(25):
        now_us += data.draw(STEPS_US)
        moved = data.draw(st.integers(0, njoint - 1))
        counts[moved] += data.draw(st.one_of(st.integers(-120, 120), st.sampled_from((400, -900, 4096))))
        statuses = data.draw(st.lists(st.sampled_from(("data", "data", "missing")), min_size=njoint, max_size=njoint))
        seen = [Reply(joint.id, status, b"", 0, 0.0) for joint, status in zip(pair.rig.joints, statuses, strict=True)]
        angles = [joint_angle(joint, count) for joint, count in zip(pair.rig.joints, counts, strict=True)]
        asked_us = now_us - data.draw(st.sampled_from((0, 812, 9_000)))
        by_id = {reply.id: reply for reply in seen}
        said = safety.judge_encoders(pair.rig, pair.watch, 1e-6 * asked_us, 1e-6 * now_us, by_id, angles)
        told = pair.judges.judge("encoders", c_uint32(asked_us), c_uint32(now_us), replies(seen), counts)
        if agree(pair, said, told, reasons):
            assert told[2] * abs(joint_scale(pair.rig.joints[told[1]])) == pytest.approx(numbers(said)[0], abs=0.006)
            assert told[3] / 1e6 == pytest.approx(numbers(said)[1], abs=0.006)
            return


@pytest.mark.parametrize("step_us", [20_000, 61_000])
def test_every_jump_of_an_encoder(lamp, step_us):
    seen = [Reply(joint.id, "data", b"1", 0, 0.0) for joint in lamp.rig.joints]
    by_id = {reply.id: reply for reply in seen}
    ended = set()
    for jump in range(0, 1200, 3):
        lamp.start()
        for now_us, counts in ((1_000_000, [2048] * 3), (1_000_000 + step_us, [2048, 2048 - jump, 2048])):
            angles = [joint_angle(joint, count) for joint, count in zip(lamp.rig.joints, counts, strict=True)]
            said = safety.judge_encoders(lamp.rig, lamp.watch, 1e-6 * now_us, 1e-6 * now_us, by_id, angles)
            told = lamp.judges.judge("encoders", c_uint32(now_us), c_uint32(now_us), replies(seen), counts)
        ended.add(agree(lamp, said, told, {"has jumped": 40}))
    assert ended == {False, True}


def test_every_speed_of_a_joint_that_is_asked_for_one(jumper):
    wanted = round(jumper.rig.joints[0].speed_rad_s_max / jumper.rig.joints[0].product.velocity_unit_rad_s)
    njoint = len(jumper.rig.joints)
    angles, rest = [0.0] * njoint, [joint.zero_tick for joint in jumper.rig.joints]
    ended = set()
    for asked in (wanted, wanted // 5 + 1, wanted // 5 - 1):
        for done in (speed for speed in range(-asked, asked + 1) if 5 * speed != asked):
            jumper.start()
            goals, speeds = [asked] + [0] * (njoint - 1), [done] + [0] * (njoint - 1)
            for now_us in (1_000_000, 9_000_000):
                said = safety.judge_speeds(jumper.host_rig, jumper.watch, 1e-6 * now_us, goals, speeds, angles)
                told = jumper.judges.judge("speeds", c_uint32(now_us), goals, speeds, rest)
            ended.add(agree(jumper, said, told, {"turns at": 43}))
    assert ended == {False, True}


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_joints_that_do_not_follow(lamp, data):
    lamp.start()
    now_us = 1_000_000
    far = round(lamp.rig.safety.tracking_rad_max / (2 * math.pi / 4096))
    for _ in range(30):
        now_us += data.draw(STEPS_US)
        goals = data.draw(st.lists(st.integers(1500, 2600), min_size=3, max_size=3))
        off = data.draw(st.lists(st.sampled_from((0, far, far + 1, -far - 1, 2 * far)), min_size=3, max_size=3))
        counts = [goal + away for goal, away in zip(goals, off, strict=True)]
        said = safety.judge_tracking(
            lamp.host_rig,
            lamp.watch,
            1e-6 * now_us,
            [joint_angle(joint, goal) for joint, goal in zip(lamp.rig.joints, goals, strict=True)],
            [joint_angle(joint, count) for joint, count in zip(lamp.rig.joints, counts, strict=True)],
        )
        told = lamp.judges.judge("tracking", c_uint32(now_us), goals, counts)
        if agree(lamp, said, told, {"from its goal": 41}):
            assert told[2] * abs(joint_scale(lamp.rig.joints[told[1]])) == pytest.approx(numbers(said)[0], abs=0.006)
            assert told[3] / 1e6 == pytest.approx(numbers(said)[1], abs=0.006)
            return


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_joints_that_are_driven_by_their_speed(jumper, data):
    jumper.start()
    now_us = 1_000_000
    njoint = len(jumper.rig.joints)
    lists = {"min_size": njoint, "max_size": njoint}
    asked = data.draw(st.lists(st.integers(-200, 200), **lists))
    for _ in range(30):
        now_us += data.draw(STEPS_US)
        share = data.draw(st.lists(st.sampled_from((-1.0, 0.0, 0.15, 0.25, 1.0)), **lists))
        done = [round(goal * part) for goal, part in zip(asked, share, strict=True)]
        counts = data.draw(st.lists(st.sampled_from((2048, 2048, 2200, 5000)), **lists))
        angles = [joint_angle(joint, count) for joint, count in zip(jumper.rig.joints, counts, strict=True)]
        said = safety.judge_speeds(jumper.host_rig, jumper.watch, 1e-6 * now_us, asked, done, angles)
        told = jumper.judges.judge("speeds", c_uint32(now_us), asked, done, counts)
        if agree(jumper, said, told, {"outside its limits": 42, "turns at": 43}):
            number = told[1]
            assert told[2:] == ((counts[number], 0) if told[0] == 42 else (done[number], asked[number]))
            return


@settings(max_examples=60, deadline=None)
@given(poses=st.lists(st.tuples(st.integers(-3140, 3140), st.integers(-3140, 3140)), min_size=1, max_size=10))
def test_a_base_that_falls(lamp, poses):
    lamp.start()
    sensors = {sensor.name: sensor for sensor in lamp.rig.sensors}
    for pose in poses:
        roll, pitch = (
            (raw - sensors[name].zero) * sensors[name].scale for raw, name in zip(pose, ("roll", "pitch"), strict=True)
        )
        tilt = math.acos(math.cos(roll) * math.cos(pitch))
        if abs(tilt - lamp.rig.safety.tilt_rad_max) < 1e-3:
            continue  # the firmware has single precision
        said = safety.judge_tilt(lamp.rig, lamp.watch, roll, pitch)
        told = lamp.judges.judge("tilt", *pose)
        if agree(lamp, said, told, {"has fallen": 44}):
            assert told[2:] == pose
            return


@settings(max_examples=60, deadline=None)
@given(readings=st.lists(st.tuples(st.integers(0, 160), st.integers(0, 100)), min_size=1, max_size=9))
def test_heat_and_voltage_at_every_count(pair, readings):
    pair.start()
    for counts, temperature in readings:
        scale = 0.1
        said = safety.judge_health(pair.rig, pair.watch, pair.rig.joints[0], round(counts * scale, 6), temperature)
        told = pair.judges.judge("health", 0, counts, temperature)
        if agree(pair, said, told, {"degrees Celsius": 45, "V are needed": 46}):
            assert told[2] == (temperature if told[0] == 45 else counts)
            return


@settings(max_examples=60, deadline=None)
@given(overran=st.lists(st.booleans(), max_size=25))
def test_periods_that_overrun(pair, overran):
    pair.start()
    for late in overran:
        said = safety.judge_timing(pair.rig, pair.watch, late)
        told = pair.judges.judge("timing", int(late))
        if agree(pair, said, told, {"periods in a row": 47}):
            assert said.startswith(f"{told[2]} periods")
            return
