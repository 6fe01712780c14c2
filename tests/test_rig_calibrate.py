"""`servolve rig calibrate`: what a person's hand shows becomes a rig file, in which nothing else is touched."""

import json
import math
import os
import tomllib
from contextlib import contextmanager
from io import StringIO

import pytest
from rich.console import Console
from served_rig import serve

from controller import load_rig
from controller.errors import InputError, RunError
from controller.registers import registers
from deploy.buses.lockstep_port import LockstepPort
from deploy.buses.open_bus import open_bus
from deploy.clock import LockstepClock
from deploy.commissioning.calibration import Travel, begin_travel, calibrate_joint
from deploy.commissioning.range_recorder import read_counts, record_travel
from deploy.commissioning.servo_backup import load_backup
from deploy.virtual.faults import parse_fault
from deploy.virtual.lockstep import LockstepBench
from deploy.virtual.rig import VirtualRig
from servolve.cli import main
from servolve.rehome import Pose, centred, rehome

X330 = load_rig("lamp-xc330")
STS = load_rig("lamp-sts3215")


# following joints that move


@contextmanager
def following(name, seconds=1.0, faults=(), patience=10**9, offsets=()):
    """Let go of a lamp that stands, and follow its joints as it sinks; give bus, rig, travels and the true angles."""
    rig = load_rig(name)
    virtual = VirtualRig(rig, faults=[parse_fault(fault) for fault in faults])
    truth = []
    with LockstepBench(virtual) as bench:
        bus = open_bus(LockstepPort(bench, rig.bus.baud), rig)
        try:
            for joint, offset in zip(rig.joints, offsets, strict=False):
                bus.write_register(joint.id, registers(joint.product)["lock"], 0)
                bus.write_register(joint.id, registers(joint.product)["homing_offset"], offset)
            for value in (1, 0):
                for joint in rig.joints:
                    bus.write_register(joint.id, registers(joint.product)[joint.family.torque_enable], value)

            def watch(travels, left_s):
                truth.append(virtual.truth().joint_rad.copy())
                return len(truth) < patience

            start = read_counts(bus, rig.joints)
            truth.append(virtual.truth().joint_rad.copy())
            yield bus, rig, record_travel(bus, rig.joints, LockstepClock(bench), start, seconds, watch), truth
        finally:
            bus.close()


def follow(name, **how):
    with following(name, **how) as (_, rig, travels, truth):
        return rig, travels, truth


@pytest.mark.parametrize("name", ["lamp-xc330", "lamp-ax12", "lamp-sts3215"])
def test_joints_are_followed_as_they_go(name):
    rig, travels, truth = follow(name)
    moved = 0.0
    for index, joint in enumerate(rig.joints):
        angles = [angles[index] for angles in truth]
        unit = 2.0 * math.pi / joint.product.ticks_per_turn
        ends = sorted(joint.zero_tick + joint.sign * angle / unit for angle in (min(angles), max(angles)))
        slack = 3.0 + (joint.product.backlash_rad + 0.03) / unit
        assert [travels[joint.name].low, travels[joint.name].high] == pytest.approx(ends, abs=slack)
        moved = max(moved, max(angles) - min(angles))
    assert moved > 0.1, "a lamp that nobody holds sinks"


def test_following_can_be_ended_early():
    _, _, truth = follow("lamp-xc330", seconds=100.0, patience=5)
    assert len(truth) == 5


def test_a_servo_that_is_silent_for_long_ends_it_and_one_lost_reply_does_not():
    with pytest.raises(RunError, match=r"joint a1 \(servo 2\): did not answer for 0.5 s while it was followed"):
        follow("lamp-xc330", faults=["dead=2@0.3"])
    _, travels, _ = follow("lamp-xc330", faults=["drop=0.05"])
    assert set(travels) == {"a0", "a1", "a2"}
    assert travels["a0"] != begin_travel(travels["a0"].low)


# the command


def changed_lines(before, after):
    pairs = zip(before.splitlines(), after.splitlines(), strict=True)
    return [new for old, new in pairs if old != new]


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    process = serve(tmp_path_factory.mktemp("rig"), "lamp-xc330", "--no-wire-time")
    yield process
    process.kill()


def test_neutral_makes_the_present_pose_the_neutral_one(served, tmp_path, capfd):
    out = tmp_path / "mine.rig.toml"
    arguments = ["lamp-xc330", "--port", str(served.bus), "--neutral", "--out", str(out), "--json"]
    assert main(["rig", "calibrate", *arguments]) == 0
    told = json.loads(capfd.readouterr().out)
    made = load_rig(out)
    stands = {name: values["zero_tick"] for name, values in told["joints"].items()}
    assert {joint.name: joint.zero_tick for joint in made.joints} == stands
    assert all(0 < abs(tick - 2048) < 20 for tick in stands.values()), "it stands near its neutral pose, not at it"
    assert made.body.resolve() == X330.body.resolve()
    lines = changed_lines(X330.text, out.read_text())
    assert [line.split(" = ")[0] for line in lines] == ["body", "zero_tick", "zero_tick", "zero_tick"]


def test_one_joint_alone(served, tmp_path):
    out = tmp_path / "mine.rig.toml"
    arguments = ["lamp-xc330", "--port", str(served.bus), "--neutral", "--joints", "a1", "--out", str(out)]
    assert main(["rig", "calibrate", *arguments]) == 0
    assert [joint.zero_tick == 2048 for joint in load_rig(out).joints] == [True, False, True]


def test_a_calibration_goes_out_and_comes_back(tmp_path, capfd):
    motors = tmp_path / "motors.json"
    assert main(["rig", "calibrate", "lamp-sts3215", "--export", str(motors)]) == 0
    exported = json.loads(motors.read_text())
    joint = STS.joints[0]
    ends = [joint.zero_tick + round(angle * 4096 / (2 * math.pi)) for angle in (joint.low_rad, joint.high_rad)]
    assert exported["a0"] == {"id": 1, "drive_mode": 0, "homing_offset": 0, "range_min": ends[0], "range_max": ends[1]}
    assert exported["a2"]["drive_mode"] == 1, "the joint counts backwards"
    out = tmp_path / "mine.rig.toml"
    arguments = ["lamp-sts3215", "--import", str(motors), "--margin", "0", "--out", str(out)]
    assert main(["rig", "calibrate", *arguments]) == 0
    for before, after in zip(STS.joints, load_rig(out).joints, strict=True):
        assert after.zero_tick == before.zero_tick
        assert [after.low_rad, after.high_rad] == pytest.approx([before.low_rad, before.high_rad], abs=2e-3)


def test_a_published_calibration_of_three_motors_fits_a_rig(tmp_path):
    # the first three motors of an SO-101 follower
    arm = {
        "shoulder_pan": {"id": 1, "drive_mode": 0, "homing_offset": -1365, "range_min": 746, "range_max": 3477},
        "shoulder_lift": {"id": 2, "drive_mode": 0, "homing_offset": -1200, "range_min": 822, "range_max": 3211},
        "elbow_flex": {"id": 3, "drive_mode": 0, "homing_offset": -986, "range_min": 901, "range_max": 3110},
    }
    (tmp_path / "arm.json").write_text(json.dumps(arm))
    out = tmp_path / "mine.rig.toml"
    arguments = ["lamp-sts3215", "--import", str(tmp_path / "arm.json"), "--middle", "--margin", "0", "--out", str(out)]
    assert main(["rig", "calibrate", *arguments]) == 0
    for joint, motor in zip(load_rig(out).joints, arm.values(), strict=True):
        middle = (motor["range_min"] + motor["range_max"]) / 2  # where LeRobot's degrees are 0
        assert joint.zero_tick == pytest.approx(middle, abs=0.5)
        assert joint.high_rad == pytest.approx((motor["range_max"] - middle) * 2 * math.pi / 4096, abs=2e-3)


def test_a_servo_whose_travel_crosses_the_wrap_is_re_homed(tmp_path):
    _, plain, _ = follow("lamp-sts3215")
    middles = [(plain[joint.name].low + plain[joint.name].high) // 2 for joint in STS.joints]
    offsets = [(middle + 2047) % 4095 - 2047 for middle in middles]  # the wrap in the middle of the travel
    with following("lamp-sts3215", offsets=offsets) as (bus, rig, travels, _):
        moved = max(rig.joints, key=lambda joint: travels[joint.name].high - travels[joint.name].low)
        travel = travels[moved.name]
        assert travel.low < 0 or travel.high > 4095
        with pytest.raises(InputError, match="across the encoder's wrap at 4095; add --center"):
            calibrate_joint(moved, travel=travel, middle=True)
        pose = Pose(moved, {"homing_offset": offsets[rig.joints.index(moved)]}, None, travel)
        fixes, (after,) = centred([pose], True, 0.0)
        assert (after.travel.low + after.travel.high) / 2 == pytest.approx(2048, abs=1)
        rehome(bus, rig, "port", fixes, tmp_path / "backup.json", True, Console(quiet=True))
        table = registers(moved.product)
        assert bus.read_register(moved.id, table["homing_offset"]) == after.settings["homing_offset"]
        assert bus.read_register(moved.id, table["lock"]) == 1
        assert read_counts(bus, [moved])[moved.name] == pytest.approx(after.travel.last, abs=3), (
            "it has hardly moved since"
        )
    held = load_backup(tmp_path / "backup.json")[0]
    assert (held.id, held.values["homing_offset"]) == (moved.id, pose.settings["homing_offset"])


def test_nothing_is_re_homed_without_consent_or_where_it_would_not_help(tmp_path, monkeypatch):
    monkeypatch.setattr("sys.stdin", StringIO("n\n"))
    with following("lamp-sts3215", seconds=0.1) as (bus, rig, _, _):
        pose = Pose(rig.joints[0], {"homing_offset": 0}, None, Travel(3900, 4500, 3900))
        fixes, _ = centred([pose], True, 0.0)
        with pytest.raises(RunError, match="the servos were not re-homed; nothing was written"):
            rehome(
                bus, rig, "port", fixes, tmp_path / "b.json", False, Console(quiet=True, file=StringIO(), stderr=False)
            )
        still = Pose(rig.joints[0], {"homing_offset": 0}, None, Travel(4090, 4100, 4090))
        with pytest.raises(InputError, match="move it from stop to stop"):
            centred([still], True, 0.0)
    assert not (tmp_path / "b.json").exists()


def test_a_rig_file_of_ones_own_may_be_written_again_and_others_not(tmp_path, capfd):
    motors = tmp_path / "motors.json"
    assert main(["rig", "calibrate", "lamp-sts3215", "--export", str(motors)]) == 0
    out = tmp_path / "mine.rig.toml"
    again = ["rig", "calibrate", "lamp-sts3215", "--import", str(motors), "--out", str(out)]
    assert main(again) == 0
    before = out.read_text()
    assert main(again) == 2
    assert "is there already; name a new file" in capfd.readouterr().err
    assert main(["rig", "calibrate", str(out), "--import", str(motors), "--margin", "0.1", "--out", str(out)]) == 0
    assert [line.split(" = ")[0] for line in changed_lines(before, out.read_text())] == ["low_rad", "high_rad"] * 3
    assert main(["rig", "calibrate", "lamp-sts3215", "--import", str(motors), "--out", str(STS.path)]) == 2
    assert tomllib.loads(STS.path.read_text()) == tomllib.loads(STS.text)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["lamp-xc330", "--port", "/dev/null"], "nothing is asked for"),
        (["lamp-xc330", "--neutral"], "name their --port"),
        (["lamp-xc330", "--port", "/dev/null", "--range", "0"], "--range 0: is no time"),
        (["lamp-xc330", "--port", "/dev/null", "--range", "1", "--import", "x"], "choose one of them"),
        (["lamp-xc330", "--port", "/dev/null", "--neutral", "--middle"], "--middle: needs a travel"),
        (["lamp-xc330", "--port", "/dev/null", "--neutral", "--center"], "--center: needs to know the travel"),
        (["lamp-xc330", "--port", "/dev/null", "--range", "1", "--center"], "there is nobody to ask"),
        (["lamp-xc330", "--port", "/dev/null", "--neutral", "--yes"], "--yes: means nothing without --center"),
        (["lamp-xc330", "--port", "/dev/null", "--neutral", "--margin", "nan"], "--margin nan"),
        (["lamp-xc330", "--port", "/dev/null", "--neutral", "--joints", "a7"], "no joint 'a7'; the rig has a0, a1, a2"),
        (["lamp-xc330", "--port", "/dev/null", "--neutral", "--out", "/no/such/x.toml"], "its folder is not there"),
        (["lamp-xc330", "--import", "/no/such"], "can not be read (No such file"),
        (["paper-lamp", "--neutral"], "calibration needs a bus"),
    ],
)
def test_wrong_arguments_are_one_sentence(arguments, expected, capfd, monkeypatch):
    monkeypatch.setattr("sys.stdin", open(os.devnull))  # noqa: SIM115, PTH123
    assert main(["rig", "calibrate", *arguments]) == 2
    error = capfd.readouterr().err
    assert expected in error
    assert error.count("\n") == 1


def test_motors_that_do_not_fit_the_rig(tmp_path, capfd):
    motors = tmp_path / "motors.json"
    entry = {"drive_mode": 0, "homing_offset": 0, "range_min": 1000, "range_max": 3000}
    motors.write_text(json.dumps({"a0": entry | {"id": 1}, "a1": entry | {"id": 2}}))
    assert main(["rig", "calibrate", "lamp-sts3215", "--import", str(motors)]) == 2
    assert "holds no motor with id 3 (joint a2); name the joints with --joints" in capfd.readouterr().err
    motors.write_text(json.dumps({"a0": entry | {"id": 2}, "a1": entry | {"id": 1}}))
    assert main(["rig", "calibrate", "lamp-sts3215", "--import", str(motors), "--joints", "a0"]) == 2
    assert "motor 'a0' has id 2, the rig says 1" in capfd.readouterr().err
    motors.write_text(json.dumps({"a0": entry | {"id": 1, "homing_offset": 3000}}))
    assert main(["rig", "calibrate", "lamp-sts3215", "--import", str(motors), "--joints", "a0"]) == 2
    assert "homing_offset 3000 is more than the 2047 that its sts3215 holds" in capfd.readouterr().err


def test_an_offset_that_was_imported_without_a_servo_to_ask_is_exported_again(tmp_path):
    motor = {"id": 1, "drive_mode": 0, "homing_offset": -100, "range_min": 1213, "range_max": 2887}
    (tmp_path / "motors.json").write_text(json.dumps({"a0": motor}))
    files = ("--import", str(tmp_path / "motors.json"), "--export", str(tmp_path / "again.json"))
    made = str(tmp_path / "mine.rig.toml")
    assert main(["rig", "calibrate", "lamp-sts3215", "--joints", "a0", *files, "--out", made]) == 0
    assert json.loads((tmp_path / "again.json").read_text())["a0"]["homing_offset"] == -100
