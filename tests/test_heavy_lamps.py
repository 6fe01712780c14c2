"""The lamps with heavier servos, one of each family: they stand, and their joints give way as the servos say."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from controller.controller_file import parse_controller
from controller.rig_file import load_rig
from controller.schedule import Transaction, TransactionKind, period, schedule_of
from controller.terminals import terminals_of
from sim_models.body import base_force, base_pose, body_layout, build_model, settled_data
from sim_models.perturbations import nominal_perturbations
from sim_models.rollouts import RolloutPool, make_cases

LAMPS = ["lamp-xl430", "lamp-sts3215", "lamp-ax12"]
WITHOUT_SERVOS_KG = 0.298


@pytest.fixture(scope="module", params=LAMPS)
def lamp(request):
    """Return a lamp's rig, model and settled data."""
    rig = load_rig(request.param)
    model = build_model(rig)
    return rig, model, settled_data(model, rig)


def test_a_lamp_stands_still_on_its_feet(lamp):
    rig, model, data = lamp
    weight = (WITHOUT_SERVOS_KG + sum(joint.product.mass_kg for joint in rig.joints)) * 9.81
    mujoco.mj_step(model, data, 500)
    pose = base_pose(model, data)
    assert base_force(model, data) == pytest.approx(weight, rel=1e-3)
    assert abs(pose.pitch) < 0.002 and abs(pose.x) < 1e-4
    assert np.abs(data.qvel).max() < 1e-3


def test_a_joint_sags_as_its_gain_and_friction_allow(lamp):
    """Gravity's torque on a joint is that of gain times sag, give or take the dry friction."""
    rig, model, data = lamp
    layout = body_layout(model, rig)
    for index, joint in enumerate(rig.joints):
        stall = joint.product.stall_torque_nm * rig.supply_v / joint.product.voltage_v
        sag = float(data.qpos[layout.qpos[index]])
        held = stall * sag / FULL_DUTY_RAD[rig.name]
        gravity = float(data.qfrc_bias[layout.dof[index]])
        assert abs(abs(held) - abs(gravity)) <= joint.product.friction_loss_nm * 1.01
        assert abs(sag) < 0.05


# P 1450 of 128 * 885 a tick; 50 * 0.1649 a radian, less a tick and 1.6 %; 16 counts of 300/1024 degrees
FULL_DUTY_RAD = {
    "lamp-xl430": 128 * 885 / 1450 * 2 * math.pi / 4096,
    "lamp-sts3215": 2 * math.pi / 4096 + 0.984 / (50 * 0.1649),
    "lamp-ax12": 16 * math.radians(300 / 1024),
}


SCHEDULES = {
    "lamp-xl430": ((126, 10), (116, 4), ((64, 7), (144, 3))),
    "lamp-sts3215": ((56, 6), (42, 2), ((40, 1), (62, 4))),
    "lamp-ax12": ((36, 6), (30, 2), ((24, 1), (42, 2))),
}


@pytest.mark.parametrize("name", LAMPS)
def test_the_schedule_is_the_familys(name):
    state, goal, health = SCHEDULES[name]
    for k, (servo, block) in enumerate([(i, block) for block in health for i in range(3)]):
        assert period(schedule_of(load_rig(name)), k) == (
            Transaction(TransactionKind.READ_STATE, -1, *state),
            Transaction(TransactionKind.RUN_CYCLE, -1, 0, 0),
            Transaction(TransactionKind.WRITE_GOALS, -1, *goal),
            Transaction(TransactionKind.READ_HEALTH, servo, *block),
        )


@pytest.mark.parametrize(
    ("name", "angle", "rate", "load"),
    [
        ("lamp-xl430", 2 * math.pi / 4096, 0.229 * math.pi / 30, 1 / 1000),
        ("lamp-sts3215", 2 * math.pi / 4096, 0.732 / 50 * math.pi / 30, 1 / 1000),
        ("lamp-ax12", math.radians(300 / 1024), 0.111 * math.pi / 30, 1 / 1023),
    ],
)
def test_terminals_count_as_the_manuals_say(name, angle, rate, load):
    specs = terminals_of(load_rig(name))
    assert specs["a0"].scale == pytest.approx(angle)
    assert specs["a2_vel"].scale == pytest.approx(-rate, rel=2e-3)
    assert specs["a1_load"].scale == pytest.approx(load)


SHAKE = """
format = 1
program = "(list (* 20 (sin (* 9 t))) (+ a0_load (* 30 (sin (* 7 t)))) (+ (+ a1_load a2_load) (* 25 (sin (* 11 t)))))"

[controller]
name = "shake"
period_s = 0.02
"""
INPUT = '[[input]]\nname = "{0}"\nunit = "{1}"\nlow = -1.0\nhigh = 9.0\n'
OUTPUT = '[[output]]\nname = "{0}"\nkind = "position"\nunit = "deg"\nlow = -50.0\nhigh = 50.0\nneutral = 0.0\n'


@pytest.mark.parametrize("name", LAMPS)
def test_the_load_is_the_duty_that_makes_torque_and_speed(name):
    rig = load_rig(name)
    inputs = [("t", "s"), ("a0_load", "1"), ("a1_load", "1"), ("a2_load", "1")]
    text = SHAKE + "".join(INPUT.format(*each) for each in inputs) + "".join(OUTPUT.format(f"a{i}") for i in range(3))
    with RolloutPool(rig, time_limit_s=1.0, threads=1) as pool:
        cases = make_cases(0, 0.3)
        run = pool.run([parse_controller(text, "shake")], cases, nominal_perturbations(1, 3), traces=True, record=True)
    alive = int(run.statistics["alive_steps"][0])
    assert alive > 15
    for index, joint in enumerate(rig.joints):
        product = joint.product
        torque = run.trace(0, f"a{index}_load") * product.stall_torque_nm * rig.supply_v / product.voltage_v
        stalled = torque / product.stall_torque_nm + run.trace(0, f"a{index}_vel") / product.no_load_speed_rad_s
        duty = np.clip(stalled * product.voltage_v / rig.supply_v, -1.0, 1.0)
        full = 1023 if name == "lamp-ax12" else 1000
        assert np.abs(run.raw[0, :, 6 + index] * joint.sign - full * duty)[:alive].max() <= 0.51
        assert np.abs(duty[:alive]).max() > 0.1
