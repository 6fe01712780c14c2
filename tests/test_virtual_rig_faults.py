"""The virtual rig under twins, which move otherwise, and under faults, which come as asked."""

import numpy as np
import pytest
from standing_lamp import RIG, goals, lines_of, read, standing

from deploy.virtual import dynamixel2 as dxl
from deploy.virtual.faults import parse_fault
from deploy.virtual.rig import VirtualRig
from deploy.virtual.twin import Twin

# twins


def swing(twin):
    """Return the path of the head's joint after a step of its goal, and where it ends."""
    rig = standing(twin=twin)
    goals(rig, [2048, 2048, 2348])
    path = []
    for _ in range(150):
        rig.advance(rig.now + 0.002)
        path.append(float(rig.truth().joint_rad[2]))
    return np.array(path)


@pytest.mark.parametrize(
    "change",
    [
        {"torque_scale": 0.8},
        {"p_gain_scale": 0.7},
        {"mass_scale": 1.3},
        {"joint_friction_scale": 3.0},
        {"joint_damping_scale": 5.0},
        {"armature_scale": 2.0},
        {"stiction_scale": 3.0},
        {"command_latency_s": 0.03},
        {"supply_v": 4.0},
        {"timestep_s": 0.0005},
    ],
    ids=lambda change: next(iter(change)),
)
def test_a_twin_moves_otherwise(change):
    difference = np.abs(swing(Twin(**change)) - swing(Twin())).max()
    assert 1e-5 < difference < 0.5


def test_latency_is_a_delay_and_weak_torque_is_slow():
    plain, late, weak = swing(Twin()), swing(Twin(command_latency_s=0.03)), swing(Twin(torque_scale=0.5))
    half = abs(plain[-1]) / 2
    crossing = [int(np.argmax(np.abs(path) > half)) * 0.002 for path in (plain, late, weak)]
    assert crossing[1] - crossing[0] == pytest.approx(0.03, abs=0.004)
    assert crossing[2] > crossing[0] + 0.003


def test_friction_of_the_floor_is_the_twins():
    distance = []
    for friction in (0.1, 2.0):
        rig = standing(twin=Twin(friction_scale=friction))
        for k in range(40):
            goals(rig, [2048 + (200 if k % 2 else -200), 2048, 2048])
            rig.advance(rig.now + 0.05)
        distance.append(rig.truth().base_pos)
    assert np.abs(distance[0] - distance[1]).max() > 0.005


# faults


def test_a_dead_servo_is_silent_and_limp_and_boots_when_it_comes_back():
    rig = standing(faults=[parse_fault("dead=2@0.5-1.5")])
    rig.advance(0.45)
    assert len(read(rig, "present_position")) == 3
    rig.advance(1.4)
    assert abs(float(rig.truth().joint_rad[1])) > 0.3
    assert len(read(rig, "present_position")) == 1, "who waits for a dead servo stays silent too"
    rig.advance(2.0)
    assert read(rig, "torque_enable") == [1, 0, 1]
    assert read(rig, "position_p_gain") == [1450, 1200, 1450]


def test_a_mute_servo_drives_on():
    rig = standing(faults=[parse_fault("mute=2@0.5")])
    rig.advance(1.5)
    assert abs(float(rig.truth().joint_rad[1])) < 0.1
    assert len(read(rig, "present_position")) == 1


def counts(faults, seed=5):
    """Return how many of 400 questions are answered rightly, wrongly, or not by servo 1."""
    rig = VirtualRig(RIG, seed=seed, faults=[parse_fault(spec) for spec in faults])
    right = wrong = missing = 0
    for _ in range(400):
        rig.transmit(dxl.encode(1, dxl.PING), rig.now)
        rig.advance(rig.now + 1e-3)
        frames = rig.replies_until(rig.now)
        good = bool(frames) and bool(dxl.PacketParser().feed(frames[0][1]))
        right, wrong, missing = right + good, wrong + (bool(frames) and not good), missing + (not frames)
    return right, wrong, missing


def test_lost_and_damaged_answers_come_as_often_as_asked():
    assert counts([]) == (400, 0, 0)
    assert counts(["drop=1"]) == (0, 0, 400)
    _, wrong, missing = counts(["drop=0.1", "corrupt=0.2"])
    assert 20 <= missing <= 62
    assert 45 <= wrong <= 105
    assert counts(["deaf=0.5"])[0] == pytest.approx(200, abs=40)
    # 400 questions take 0.45 s
    assert counts(["drop=1@1.0"]) == (400, 0, 0)
    assert counts(["drop=1@0.2"])[0] == pytest.approx(180, abs=10)


def test_sensor_faults():
    def letters(faults):
        data = VirtualRig(RIG, faults=[parse_fault(spec) for spec in faults]).sensor_until(2.0)
        found = [line[0] for line in lines_of(data)]
        return found.count("P"), found.count("F")

    pose, force = letters([])
    assert pose == force > 150
    assert letters(["sensor-dead=F"]) == (pose, 0)
    assert letters(["sensor-dead=P@1.0"])[0] == pytest.approx(pose / 2, abs=2)
    assert letters(["sensor-drop=0.5"])[0] == pytest.approx(pose / 2, abs=35)
    assert letters(["sensor-corrupt=0.5"])[1] == pytest.approx(force / 2, abs=35)


def test_the_emergency_stop_line_comes_once_at_its_time():
    rig = VirtualRig(RIG, faults=[parse_fault("estop@0.3")])
    assert b"$E*45\r\n" not in rig.sensor_until(0.2999)
    assert b"$E*45\r\n" in rig.sensor_until(0.3)
    assert b"$E" not in rig.sensor_until(1.0)


def test_faults_can_be_switched_while_it_runs():
    rig = standing()
    rig.set_faults([parse_fault("dead=3")])
    rig.advance(rig.now + 0.1)
    assert len(read(rig, "present_position")) == 2
    rig.set_faults([])
    rig.advance(rig.now + 0.5)
    assert len(read(rig, "present_position")) == 3
