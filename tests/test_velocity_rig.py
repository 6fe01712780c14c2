"""A rig in velocity mode on the virtual line: its servos turn as they are told, and the host loop drives it."""

import math

import numpy as np
import pytest
from rig_bench import Bench
from wire import Wire

from controller import load_rig, parse_controller, registers
from deploy.virtual.twin import Twin

JUMPER = load_rig("jumper-xc330")
UNIT = JUMPER.joints[0].product.velocity_unit_rad_s

TURN = """
program = "(list 0.5 (osc-wave 1 0) (osc-wave 1 0.5) 0)"
[controller]
name = "turn"
period_s = 0.02
""" + "".join(
    f'[[output]]\nname = "{joint.name}"\nkind = "velocity"\nunit = "rad/s"\nlow = -2\nhigh = 2\nneutral = 0\n'
    for joint in JUMPER.joints
)


def switched_on(**settings):
    wire = Wire(rig=JUMPER, **settings)
    for servo, joint in wire.joints.items():
        for name, count in joint.gains.items():
            wire.write(servo, name, count)
        wire.write(servo, "torque_enable", 1)
        wire.write(servo, "goal_velocity", 0)
    return wire


def test_servos_are_commissioned_for_velocity_mode_and_joints_held_until_they_are_on():
    wire = Wire(rig=JUMPER)
    before = wire.rig.truth().joint_rad
    wire.rig.advance(2.0)
    assert [wire.read(servo, "operating_mode") for servo in wire.joints] == [1] * 4
    assert wire.rig.truth().joint_rad == pytest.approx(before, abs=0.02), "held as by hand"


def test_a_joint_turns_as_fast_as_its_gain_lets_it():
    wire = switched_on()
    goal = 40
    wire.write(1, "goal_velocity", goal)
    wire.rig.advance(wire.rig.now + 0.5)
    line = registers(JUMPER.joints[0].product)["present_velocity"]
    assert line.scale == UNIT
    told = []
    for _ in range(20):
        wire.rig.advance(wire.rig.now + 0.01)
        told.append(wire.read(1, "present_velocity"))
    # without an integral: gain times what is missing makes the duty that turns the joint against its friction
    product, gain = JUMPER.joints[0].product, JUMPER.joints[0].velocity_p_gain
    speed = np.mean(told) * UNIT
    brake = product.stall_torque_nm / product.no_load_speed_rad_s + product.damping_nms_rad
    duty = (goal - np.mean(told)) * gain / 128 / 885
    assert duty * product.stall_torque_nm == pytest.approx(brake * speed + product.friction_loss_nm, abs=0.008)
    assert 0.5 * goal < np.mean(told) < goal


def test_an_integral_gain_makes_it_as_fast_as_told():
    wire = switched_on()
    wire.write(1, "velocity_i_gain", 1600)
    wire.write(1, "goal_velocity", 40)
    wire.rig.advance(wire.rig.now + 2.0)
    assert wire.read(1, "present_velocity") == pytest.approx(40, abs=2)


def test_a_latency_of_the_twin_delays_velocities_too():
    paths = []
    for latency in (0.0, 0.05):
        wire = switched_on(twin=Twin(command_latency_s=latency))
        wire.rig.advance(0.5)
        wire.write(1, "goal_velocity", 60)
        path = []
        for _ in range(100):
            wire.rig.advance(wire.rig.now + 0.002)
            path.append(abs(wire.rig.truth().joint_vel[0]))
        paths.append(int(np.argmax(np.array(path) > 20 * UNIT)))
    assert 0.002 * (paths[1] - paths[0]) == pytest.approx(0.05, abs=0.005)


@pytest.mark.parametrize("start", ["settled", "limp"])
def test_a_controller_with_a_slew_limit_starts_wherever_homing_ended(tmp_path, start):
    """A limp body lets its joints come to rest a little off neutral, with a speed still asked for."""
    bench = Bench(tmp_path, rig=JUMPER, start=start)
    bench.virtual.advance(1.0)
    text = TURN.replace("period_s = 0.02", "period_s = 0.02\nslew_rad_s = 20.0").replace("0.5 (osc", "-2 (osc")
    outcome = bench.run(seconds=0.5, controller=parse_controller(text, "turn"))
    assert outcome.done, outcome.reason
    steps = np.diff([goal for _, goal in bench.goals()["a0"]][-27:-2])
    assert np.abs(steps).max() * UNIT <= 20.0 * 0.02 + UNIT


def test_the_host_loop_drives_it_and_leaves_it_off(tmp_path):
    bench = Bench(tmp_path, rig=JUMPER)
    outcome = bench.run(seconds=2.0, controller=parse_controller(TURN, "turn"))
    assert outcome.done, outcome.reason
    assert bench.torque() == [0, 0, 0, 0]
    goals = bench.goals()
    assert max(goal for _, goal in goals["a0"]) == round(0.5 / UNIT)
    turned = bench.virtual.truth().joint_rad[0] - JUMPER.joints[0].neutral_rad
    assert 0.3 < abs(turned) < 1.05
    assert math.copysign(1, turned) == 1


def test_a_joint_whose_first_reply_is_lost_is_not_taken_to_stand_at_count_zero(tmp_path):
    first = Bench(tmp_path, rig=JUMPER)
    first.run(seconds=0.1, controller=parse_controller(TURN, "turn"))
    read = JUMPER.period_s + next(event["t"] for event in first.log.events if event.get("entered") == "homing")
    bench = Bench(tmp_path, f"drop=1@{read - 0.001:.4f}-{read + 0.004:.4f}", rig=JUMPER)
    outcome = bench.run(seconds=0.1, controller=parse_controller(TURN, "turn"))
    assert outcome.done, outcome.reason
    assert outcome.missed_replies == 0, "only homing has lost some"
