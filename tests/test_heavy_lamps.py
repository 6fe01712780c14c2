"""The lamps with heavier servos, one of each family: they stand, and their joints give way as the servos say."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from controller.rig_file import load_rig
from controller.schedule import Transaction, TransactionKind, period, schedule_of
from controller.terminals import terminals_of
from sim_models.body import base_force, base_pose, body_layout, build_model, settled_data

LAMPS = ["lamp-xl430", "lamp-sts3215", "lamp-ax12"]
WITHOUT_SERVOS_KG = 0.278


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
