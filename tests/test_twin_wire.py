"""Each parameter of a twin does what it says, as a client on the wire, or a judge of the body, sees it."""

import math
from functools import reduce
from operator import xor

import numpy as np
import pytest
from rig_bench import Bench
from wire import LAMP, Wire

from controller.rig_file import load_rig
from deploy.virtual.twin import JointTwin, Twin, load_twin, twin_names

TICK = 2.0 * math.pi / 4096


def swing(twin, joint=2, ticks=300, seconds=0.3):
    """Return the path of a joint after a step of its goal, from the neutral pose [rad]."""
    wire = Wire(twin=twin).stand()
    start = wire.rig.truth().joint_rad[joint]
    wire.write(joint + 1, "goal_position", wire.joints[joint + 1].zero_tick + ticks)
    path = []
    for _ in range(round(seconds / 0.002)):
        wire.rig.advance(wire.rig.now + 0.002)
        path.append(wire.rig.truth().joint_rad[joint])
    return LAMP.joints[joint].sign * (np.array(path) - start)


def crossing(path, angle=0.2):
    return 0.002 * int(np.argmax(path > angle))


def stall(twin):
    """Return what the servos tell of a stall at full duty: current [mA], voltage [0.1 V]; and the torque [N m]."""
    wire = Wire("stuck=3", twin=twin).stand()
    wire.write(3, "goal_position", wire.joints[3].zero_tick + 1000)
    wire.rig.advance(wire.rig.now + 0.1)
    current, volts = wire.read(3, "present_current"), wire.read(3, "present_input_voltage")
    return abs(current), volts, abs(wire.rig.shafts[2].torque())


def test_weaker_and_stronger_motors():
    product = LAMP.joints[2].product
    current, _, torque = stall(Twin())
    assert current == pytest.approx(1e3 * product.stall_current_a, rel=0.01)
    assert torque == pytest.approx(product.stall_torque_nm, rel=0.01)
    # a weak winding draws less; a weak magnet draws the same for less torque
    assert stall(Twin(torque_scale=0.5))[::2] == pytest.approx((0.5 * current, 0.5 * torque), rel=0.02)
    assert stall(Twin(torque_constant_scale=0.5))[::2] == pytest.approx((current, 0.5 * torque), rel=0.02)
    slow, fast = (crossing(swing(Twin(torque_scale=scale))) for scale in (0.5, 1.0))
    assert slow > fast


def test_gains_mean_what_the_twin_says():
    def sag(twin):
        wire = Wire(twin=twin).stand()
        wire.rig.advance(wire.rig.now + 1.0)
        return np.abs(wire.rig.truth().joint_rad)

    assert (sag(Twin(p_gain_scale=0.4)) > 1.5 * sag(Twin())).any()
    wires = [Wire(twin=Twin(d_gain_scale=scale)).stand() for scale in (0.0, 1.0)]
    peaks = []
    for wire in wires:
        wire.write(3, "position_d_gain", 4000)
        wire.write(3, "goal_position", wire.joints[3].zero_tick + 300)
        speeds = []
        for _ in range(60):
            wire.rig.advance(wire.rig.now + 0.002)
            speeds.append(abs(wire.rig.truth().joint_vel[2]))
        peaks.append(max(speeds))
    assert peaks[0] > 1.1 * peaks[1]


@pytest.mark.parametrize("key", ["joint_friction_scale", "joint_damping_scale", "armature_scale"])
def test_friction_and_inertia_make_a_joint_slower(key):
    scale = {"joint_damping_scale": 15.0}.get(key, 5.0)
    assert crossing(swing(Twin(**{key: scale}))) > crossing(swing(Twin()))


def test_a_joint_of_its_own_is_the_only_one_that_differs():
    weak = Twin(joints=(("a2", JointTwin(torque_scale=0.4)),))
    assert crossing(swing(weak)) > crossing(swing(Twin()))
    assert swing(weak, joint=1, ticks=100, seconds=0.02) == pytest.approx(
        swing(Twin(), joint=1, ticks=100, seconds=0.02), abs=1e-3
    )


def test_an_encoder_that_is_off_tells_another_angle_and_holds_another():
    bias = 0.1
    off = Wire(twin=Twin(encoder_bias_rad=bias))
    for joint in LAMP.joints:
        told = off.read(joint.id, "present_position")
        true = off.rig.truth().joint_rad[off.about.joints.index(joint)]
        assert joint.sign * (told - joint.zero_tick) * TICK == pytest.approx(true + bias, abs=TICK)
    plain, off = Wire().stand(), off.stand()
    assert off.rig.truth().joint_rad == pytest.approx(plain.rig.truth().joint_rad - bias, abs=0.03)


def test_backlash_leaves_the_joint_loose_within_it():
    play = 6 * LAMP.joints[2].product.backlash_rad
    loose = Wire(twin=Twin(backlash_scale=6.0, timestep_s=0.0005)).stand()
    motor = loose.rig.shafts[2]
    gaps = []
    for k in range(40):
        loose.write(3, "goal_position", loose.joints[3].zero_tick + (250 if k % 2 else -250))
        for _ in range(10):
            loose.rig.advance(loose.rig.now + 0.01)
            gaps.append(motor.angle() - float(motor._qpos[0]))  # the wire does not tell the motor's own angle
    gaps = np.array(gaps)
    assert np.abs(gaps).max() < 0.6 * play
    assert gaps.max() > 0.4 * play, "the link leans on one stop"
    assert gaps.min() < -0.4 * play, "and on the other"


def test_the_supply_sags_under_load_and_recovers():
    ohm = 0.5
    current, volts, _ = stall(Twin(supply_ohm=ohm))
    drawn = 1e-3 * current
    assert volts == pytest.approx(10 * (5.0 - ohm * drawn), abs=1.5)
    # the others draw a little, too
    assert volts < 45
    wire = Wire(twin=Twin(supply_ohm=ohm))
    assert wire.read(1, "present_input_voltage") == 50, "nobody draws anything"


def test_a_supply_in_volts_and_over_the_rigs():
    assert Wire(twin=Twin(supply_v=4.4)).read(1, "present_input_voltage") == 44
    assert Wire(twin=Twin(supply_scale=0.9)).read(1, "present_input_voltage") == 45
    assert Wire(twin=Twin(supply_scale=0.9), rig=load_rig("lamp-sts3215")).read(1, "present_voltage") == 108


def test_goals_act_late():
    late, plain = swing(Twin(command_latency_s=0.03)), swing(Twin())
    assert crossing(late) - crossing(plain) == pytest.approx(0.03, abs=0.004)


def test_a_voltage_that_rises_slowly_delays_a_motion():
    slow, plain = swing(Twin(voltage_slope_scale=1.0)), swing(Twin())
    assert 0.004 < crossing(slow) - crossing(plain) < 0.03


def weighed(twin):
    """Return what the sensor lines tell of a lamp at rest: quantity => values, SI; and when each line came."""
    rig = Wire(twin=twin).rig
    values, times = {sensor.name: [] for sensor in LAMP.sensors}, []
    for k in range(1, 400):
        for line in rig.sensor_until(k * 0.005).split(b"\r\n")[:-1]:
            body, _, check = line.removeprefix(b"$").rpartition(b"*")
            assert check == b"%02X" % reduce(xor, body, 0)
            letter, _, t_us, *counts = body.decode().split(",")
            times.append(k * 0.005 - int(t_us) * 1e-6)
            for sensor in LAMP.sensors:
                if sensor.message == letter:
                    values[sensor.name].append((int(counts[sensor.field]) - sensor.zero) * sensor.scale)
    return {name: np.array(told) for name, told in values.items()}, np.array(times)


def test_masses_and_where_they_are():
    plain = weighed(Twin())[0]["force"].mean()
    assert weighed(Twin(mass_scale=1.4))[0]["force"].mean() == pytest.approx(1.4 * plain, rel=0.02)

    def lean(twin):
        rig = Wire(twin=twin).rig
        rig.advance(1.0)
        return rig.truth().base_rpy[:2]

    # it leans to its heavy side, for the ground is a little soft
    assert lean(Twin(com_y_m=0.03))[0] < -1e-5
    assert lean(Twin(com_y_m=-0.03))[0] > 1e-5
    assert lean(Twin(com_x_m=0.03))[1] > lean(Twin(com_x_m=-0.03))[1] + 1e-5


@pytest.mark.parametrize(
    ("key", "names"),
    [
        ("force", ("force",)),
        ("position", ("x", "y", "z")),
        ("angle", ("heading", "roll", "pitch")),
    ],
)
def test_noise_and_bias_of_each_quantity(key, names):
    unit = {"force": "n", "position": "m", "angle": "rad"}[key]
    plain, _ = weighed(Twin())
    noisy, _ = weighed(Twin(**{f"{key}_noise_{unit}": 0.05}))
    biased, _ = weighed(Twin(**{f"{key}_bias_{unit}": 0.07}))
    for name, values in plain.items():
        own = name in names
        assert np.std(noisy[name]) == pytest.approx(0.05 if own else np.std(values), rel=0.2, abs=1e-9)
        assert np.mean(biased[name] - values) == pytest.approx(0.07 if own else 0.0, abs=2e-3 if own else 1e-9)


def test_sensor_lines_come_later():
    _, plain = weighed(Twin())
    _, late = weighed(Twin(sensor_latency_s=0.025))
    assert late.min() - plain.min() == pytest.approx(0.025, abs=1e-6)


def test_the_floor():
    def slide(friction):
        wire = Wire(twin=Twin(friction_scale=friction)).stand()
        for k in range(30):
            wire.write(1, "goal_position", wire.joints[1].zero_tick + (200 if k % 2 else -200))
            wire.rig.advance(wire.rig.now + 0.05)
        return wire.rig.truth().base_pos

    assert np.abs(slide(0.1) - slide(2.0)).max() > 0.005


def test_every_key_makes_a_difference_and_none_a_disaster():
    plain = swing(Twin())
    for key, value in {
        "torque_scale": 0.7,
        "torque_constant_scale": 0.7,
        "p_gain_scale": 0.6,
        "joint_friction_scale": 3.0,
        "backlash_scale": 4.0,
        "voltage_slope_scale": 1.0,
        "encoder_bias_rad": 0.1,
        "mass_scale": 1.5,
        "com_x_m": 0.02,
        "stiction_scale": 3.0,
        "supply_scale": 0.8,
        "supply_ohm": 0.3,
        "timestep_s": 0.0005,
    }.items():
        difference = np.abs(swing(Twin(**{key: value})) - plain).max()
        assert 1e-5 < difference < 0.5, key


@pytest.mark.parametrize("name", twin_names())
@pytest.mark.parametrize("rig", ["lamp-xc330", "lamp-sts3215", "lamp-ax12", "jumper-xc330"])
def test_shipped_twins_stand_on_every_rig(name, rig):
    wire = Wire(twin=load_twin(name), rig=load_rig(rig))
    if rig.startswith("lamp"):
        wire.stand()
    wire.rig.advance(wire.rig.now + 0.5)
    truth = wire.rig.truth()
    assert np.abs(truth.base_rpy[:2]).max() < 0.1
    assert np.abs(truth.joint_rad).max() < 0.2
    assert len(wire.positions()) == len(wire.joints)


@pytest.mark.parametrize("name", twin_names())
def test_the_host_loop_drives_every_shipped_twin(name, tmp_path):
    outcome = Bench(tmp_path, twin=load_twin(name)).run(seconds=1.5)
    assert outcome.done, outcome.reason
    assert not outcome.faulty, outcome.reason
