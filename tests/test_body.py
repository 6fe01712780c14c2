"""Bodies: what the lamp weighs, how it stands, and that its forms are one body."""

from __future__ import annotations

import dataclasses
import math

import mujoco
import numpy as np
import pytest

from controller import load_rig
from controller.errors import InputError
from sim_models.body import (
    base_force,
    base_pose,
    body_layout,
    build_model,
    clearance,
    settled_data,
    substeps,
)

GRAVITY = 9.81


@pytest.fixture(scope="module")
def rig():
    return load_rig("lamp-xc330")


@pytest.fixture(params=["free", "planar"])
def form(request):
    return request.param


def drive(model, rig, seconds):
    """Swing the second joint open-loop, from rest; return the trajectory of base and joints."""
    data, layout = settled_data(model, rig), body_layout(model, rig)
    rows = []
    for k in range(round(seconds / rig.period_s)):
        data.ctrl[layout.actuator] = (0.0, 0.3 * math.sin(2 * math.pi * 3 * k * rig.period_s), 0.1)
        mujoco.mj_step(model, data, substeps(rig, model.opt.timestep))
        pose = base_pose(model, data)
        rows.append((pose.x, pose.y, pose.z, pose.pitch, *data.qpos[layout.qpos]))
    return np.array(rows)


def test_mjcf_opens_by_itself_and_frames_a_metre(rig):
    model = mujoco.MjModel.from_xml_path(str(rig.body))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    camera = model.camera("side")
    wide = 2 * abs(camera.pos[1]) * math.tan(math.radians(camera.fovy[0]) / 2) * 16 / 9
    assert wide > 1.0


@pytest.mark.parametrize(("name", "mass"), [("lamp-xc330", 0.229), ("lamp-xl330", 0.214)])
def test_mass_follows_the_servo_product(name, mass, form):
    other = load_rig(name)
    model = build_model(other, form=form)
    assert model.body_mass.sum() == pytest.approx(mass)
    product = other.joints[0].product
    dof = body_layout(model, other).dof
    assert model.dof_armature[dof] == pytest.approx([product.armature_kg_m2] * 3)
    assert model.dof_frictionloss[dof] == pytest.approx([product.friction_loss_nm] * 3)
    assert model.dof_damping[dof] == pytest.approx([product.damping_nms_rad] * 3)


def test_rig_limits_are_the_joints(rig):
    model = build_model(rig)
    for joint in rig.joints:
        assert model.joint(joint.mjcf_joint).range == pytest.approx((joint.low_rad, joint.high_rad))


@pytest.mark.parametrize("lean", [False, True])
def test_settled_lamp_stands_still_on_its_feet(rig, form, lean):
    model = build_model(rig, form=form, lean=lean)
    data = settled_data(model, rig)
    layout = body_layout(model, rig)
    before = base_pose(model, data)
    assert abs(clearance(model, data, layout)) < 2e-4
    mujoco.mj_step(model, data, 500)
    after = base_pose(model, data)
    assert base_force(model, data) == pytest.approx(0.229 * GRAVITY, rel=1e-3)
    assert math.dist((before.x, before.y, before.z), (after.x, after.y, after.z)) < 2e-5
    assert np.abs(data.qpos[layout.qpos]).max() < 0.03


def test_force_is_what_the_contact_sensor_reads(rig, form):
    model = build_model(rig, form=form)
    data = settled_data(model, rig)
    data.qvel[model.joint("root" if form == "free" else "root_z").dofadr[0] + (2 if form == "free" else 0)] = -0.1
    mujoco.mj_forward(model, data)
    force = base_force(model, data)
    assert force > 2 * 0.229 * GRAVITY
    assert -data.sensor("base_contact").data[2] == pytest.approx(force, rel=1e-9)


def test_lean_body_moves_like_the_whole_one(rig, form):
    whole, lean = (drive(build_model(rig, form=form, lean=lean), rig, 0.5) for lean in (False, True))
    assert np.abs(whole - lean).max() < 1e-6


def test_planar_form_moves_like_the_free_one(rig):
    free, planar = (drive(build_model(rig, form=form), rig, 0.5) for form in ("free", "planar"))
    assert np.ptp(free[:, 3]) > 0.01  # it does rock
    assert np.abs(free[:, 1]).max() < 1e-6
    assert np.abs(free - planar)[:, :3].max() < 1e-3  # m
    assert np.abs(free - planar)[:, 3:].max() < 1e-2  # rad


def test_pose_is_heading_then_pitch_then_roll(rig):
    model = build_model(rig)
    data = mujoco.MjData(model)
    expected = {"heading": 0.7, "pitch": -0.4, "roll": 0.2}
    axes = {"heading": (0, 0, 1), "pitch": (0, 1, 0), "roll": (1, 0, 0)}
    total = np.array([1.0, 0, 0, 0])
    for name, angle in expected.items():
        turn, product = np.zeros(4), np.zeros(4)
        mujoco.mju_axisAngle2Quat(turn, np.array(axes[name], float), angle)
        mujoco.mju_mulQuat(product, total, turn)
        total = product
    data.qpos[:7] = (0.1, 0.2, 0.3, *total)
    pose = base_pose(model, data)
    assert (pose.x, pose.y, pose.z) == (0.1, 0.2, 0.3)
    for name, angle in expected.items():
        assert getattr(pose, name) == pytest.approx(angle)


def test_clearance_is_that_of_the_lowest_foot(rig, form):
    model = build_model(rig, form=form)
    data, layout = mujoco.MjData(model), body_layout(model, rig)
    z, pitch = (2, None) if form == "free" else (1, 2)
    data.qpos[z] += 0.05
    assert clearance(model, data, layout) == pytest.approx(0.05)
    angle = 0.3
    if pitch is None:
        data.qpos[3:7] = (math.cos(angle / 2), 0, math.sin(angle / 2), 0)
    else:
        data.qpos[pitch] = angle
    mujoco.mj_kinematics(model, data)
    feet = [i for i in range(model.ngeom) if model.geom(i).name.startswith("foot")]
    lowest = min(data.geom_xpos[i][2] - model.geom_size[i][0] for i in feet)
    assert clearance(model, data, layout) == pytest.approx(lowest)


@pytest.mark.parametrize("timestep", [0.003, 0.0, -0.002, 0.04])
def test_a_step_that_does_not_divide_the_period_is_refused(rig, timestep):
    with pytest.raises(InputError, match=r"does not divide the period of 0\.02 s of rig lamp-xc330; give a step"):
        build_model(rig, timestep_s=timestep)


def test_faults_of_a_body_are_told_in_one_sentence(rig, tmp_path):
    text = rig.body.read_text()
    faults = {
        "missing": (None, "cannot read this body"),
        "torn": (text[: len(text) // 2], "cannot read this body"),
        "baseless": (
            text.replace('name="base"', 'name="foot_plate"')
            .replace('body1="base"', 'body1="foot_plate"')
            .replace('objname="base"', 'objname="foot_plate"'),
            "no body 'base'",
        ),
        "armless": (
            text.replace('joint name="a2"', 'joint name="b2"').replace('joint="a2"', 'joint="b2"'),
            r"has no hinge 'a2'; it has a0, a1, b2",
        ),
        "footless": (text.replace('name="foot_', 'name="paw_'), "no geom's name begins with 'foot'"),
        "heavy": (text.replace('mass="0.060"', 'mass="-1"'), "cannot (read|compile) this body"),
    }
    for name, (content, expected) in faults.items():
        body = tmp_path / f"{name}.xml"
        if content is not None:
            body.write_text(content)
        other = dataclasses.replace(rig, body=body)
        with pytest.raises(InputError, match=expected) as told:
            body_layout(build_model(other), other)
        assert "\n" not in str(told.value)


def test_an_integral_gain_is_refused(rig):
    gains = {**rig.joints[0].gains, "position_i_gain": 5}
    joints = (dataclasses.replace(rig.joints[0], gains=gains), *rig.joints[1:])
    with pytest.raises(InputError, match="joint a0: i_gain: simulated servos have no integrator"):
        build_model(dataclasses.replace(rig, joints=joints))
