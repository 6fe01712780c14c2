"""Rigs that nobody builds, and servos in velocity mode: files, closed-form physics, and who refuses them."""

from __future__ import annotations

import dataclasses
import json
import math
import re

import mujoco
import numpy as np
import pytest

from controller import load_rig
from controller.errors import InputError
from controller.products import IDEAL
from controller.rig_file import require_bus
from controller.terminals import terminals_of
from deploy.drivable import require_drivable
from deploy.virtual.rig import VirtualRig
from servolve.cli import main
from sim_models.body import body_layout, build_model, settled_data, substeps

PAPER = load_rig("paper-lamp")
LAMP = load_rig("lamp-xc330")
GRAVITY = 9.81
VELOCITY = """mode = "velocity"
speed_rad_s_max = 12.0
velocity_p_gain = 2000
velocity_i_gain = 0
"""


def written(folder, rig, *changes):
    """Write a rig's file with changes beside its body; return its path."""
    text = rig.text
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    (folder / rig.body.name).write_bytes(rig.body.read_bytes())
    path = folder / "mine.rig.toml"
    path.write_text(text)
    return path


def velocity_changes(count=3):
    return [("p_gain = 1450\ni_gain = 0\nd_gain = 0\n", VELOCITY)][:count]


def test_the_paper_lamp_has_the_papers_terminals():
    names = {"t", "a0", "a1", "a2", "s0", "px", "py", "pz", "vx", "vy", "vz", "goal_met", "goal_dist"}
    assert names <= set(terminals_of(PAPER))
    assert {terminals_of(PAPER)[name].unit for name in ("vx", "vy", "vz")} == {"m/s"}
    assert PAPER.simulated_only and all(joint.product == IDEAL for joint in PAPER.joints)
    for sensor in PAPER.sensors:
        assert (sensor.rate_hz, sensor.latency_s) == (pytest.approx(1 / PAPER.period_s), 0.0)


A1 = 'name = "a1"\nmjcf_joint = "a1"\nproduct = "ideal"\n'
MISTAKES = [
    (PAPER, 'protocol = "none"', 'protocol = "none"\nbaud = 9600', "baud means nothing with protocol"),
    (PAPER, "period_s = 0.02", "period_s = 0.02\nsupply_v = 5.0", "supply_v means nothing to a rig without a bus"),
    (PAPER, "[bus]", '[safety]\nstop = "off"\n[bus]', "safety means nothing to a rig without a bus"),
    (PAPER, A1, A1.replace("ideal", "xc330-m181"), "product 'xc330-m181' needs a bus"),
    (PAPER, A1, A1 + "id = 2\n", "joint 2 (a1): id belongs to a servo, and an ideal joint has none"),
    (PAPER, A1, A1 + 'mode = "torque"\n', "mode 'torque' is not known; known: position, velocity"),
    (PAPER, A1, A1 + "unlimited = true\n", 'unlimited is for mode = "velocity"'),
    (PAPER, A1, A1 + 'mode = "velocity"\n', "speed_rad_s_max is missing"),
    (PAPER, A1, A1 + 'mode = "velocity"\nspeed_rad_s_max = 5\nunlimited = true\n', "limits a joint that is unlimited"),
    (PAPER, A1, A1 + 'mode = "velocity"\nspeed_rad_s_max = 5\nunlimited = 1\n', "unlimited is neither true nor false"),
    (PAPER, "period_s = 0.02", 'period_s = 0.02\nfacing = "a7"', "facing 'a7' is not known"),
    (PAPER, 'name = "vx"\n', 'name = "vx"\nunit = "m"\n', "unit 'm' does not fit a sensor named vx"),
    (PAPER, "low_rad = -1.06", "low_rad = -5000.0", "too far to count; write unlimited = true"),
    (LAMP, 'product = "xc330-m181"', 'product = "ideal"', "product 'ideal' does not speak dynamixel-2.0"),
    (LAMP, "p_gain = 1450\n", 'p_gain = 1450\nmode = "velocity"\n', 'p_gain is for mode = "position"'),
    (LAMP, "p_gain = 1450\n", "p_gain = 1450\nspeed_rad_s_max = 3\n", 'speed_rad_s_max is for mode = "velocity"'),
]


@pytest.mark.parametrize(("rig", "old", "new", "expected"), MISTAKES, ids=[row[3] for row in MISTAKES])
def test_a_mistake_is_one_sentence(tmp_path, rig, old, new, expected):
    with pytest.raises(InputError) as told:
        load_rig(written(tmp_path, rig, (old, new)))
    assert expected in str(told.value)
    assert "\n" not in str(told.value) and re.search(r", line \d+: ", str(told.value))


def test_a_servo_is_not_asked_for_more_than_its_velocity_limit(tmp_path):
    path = written(tmp_path, LAMP, *velocity_changes())
    assert [joint.mode for joint in load_rig(path).joints] == ["velocity"] * 3
    path = written(tmp_path, LAMP, *velocity_changes(), ("speed_rad_s_max = 12.0", "speed_rad_s_max = 13.1"))
    with pytest.raises(InputError, match=r"above the servo's velocity limit; write at most 13\.06"):
        load_rig(path)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('<position name="a1" joint="a1"/>', "", "has no actuator 'a1' on the hinge 'a1'; write a <position>"),
        ('<position name="a1" joint="a1"/>', '<position name="a1" joint="a2"/>', "has no actuator 'a1' on the hinge"),
        ('<position name="a1" joint="a1"/>', '<velocity name="a1" joint="a1"/>', "takes no position; make it a <posit"),
        ('<position name="a1" joint="a1"/>', '<motor name="a1" joint="a1"/>', "takes no position"),
        (' forcerange="-12 12"', "", "has no forcerange that is the same both ways"),
        (' forcerange="-12 12"', ' forcerange="-3 12"', "has no forcerange that is the same both ways"),
    ],
)
def test_a_body_without_the_motor_that_the_rig_means_is_refused(tmp_path, old, new, expected):
    text = PAPER.body.read_text()
    assert old in text
    body = tmp_path / "body.xml"
    body.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=expected) as told:
        build_model(dataclasses.replace(PAPER, body=body))
    assert "\n" not in str(told.value)


def test_an_ideal_joint_gives_way_as_its_spring_says():
    model = build_model(PAPER)
    data, layout = settled_data(model, PAPER), body_layout(build_model(PAPER), PAPER)
    mujoco.mj_step(model, data, 1000)
    head, hinge = model.body("head"), model.joint("a2")
    arm = data.xipos[head.id, 0] - data.xanchor[hinge.id, 0]
    torque = head.mass[0] * GRAVITY * arm
    stiffness = model.actuator("a2").gainprm[0]
    assert data.qpos[layout.qpos[2]] == pytest.approx(torque / stiffness, rel=1e-3)
    # it pushes no harder than its range, whatever is asked of it
    data.ctrl[layout.actuator] = 3.0
    mujoco.mj_forward(model, data)
    assert data.actuator_force == pytest.approx([12.0] * 3)


def drive(rig, index, goal, seconds):
    """Command one joint's rate with the others at rest in the air; return its rate and torque at the end."""
    model = build_model(rig)
    model.opt.gravity[:] = 0.0
    model.geom_contype[:] = model.geom_conaffinity[:] = 0
    model.jnt_limited[:] = 0
    data, layout = mujoco.MjData(model), body_layout(model, rig)
    data.ctrl[layout.actuator[index]] = goal
    mujoco.mj_step(model, data, round(seconds / model.opt.timestep))
    return float(data.qvel[layout.dof[index]]), float(data.actuator_force[layout.actuator[index]])


def test_an_ideal_velocity_joint_turns_as_fast_as_it_is_told(tmp_path):
    text = PAPER.body.read_text().replace("<position", "<velocity")
    text = re.sub(r'kp="[\d.]+" kv="[\d.]+"', 'kv="20"', text)
    body = tmp_path / "velocity.xml"
    body.write_text(text)
    joints = tuple(dataclasses.replace(joint, mode="velocity", speed_rad_s_max=10.0) for joint in PAPER.joints)
    rig = dataclasses.replace(PAPER, body=body, joints=joints)
    rate, torque = drive(rig, 2, 0.5, 0.5)
    assert torque == pytest.approx(20 * (0.5 - rate), rel=1e-3)
    assert rate == pytest.approx(0.5, rel=0.01)


def test_a_velocity_servo_turns_as_fast_as_its_gain_lets_it(tmp_path):
    rig = load_rig(written(tmp_path, LAMP, *velocity_changes()))
    joint, product = rig.joints[2], rig.joints[2].product
    # duty = P (goal - rate); torque = stall (duty - rate / no-load speed), which friction and damping take up
    gain = 2000 / 128 / 885 / product.velocity_unit_rad_s  # duty per rad/s
    goal = 3.0
    scale = gain / (gain + 1 / product.no_load_speed_rad_s)
    rate, torque = drive(rig, 2, goal * scale, 1.0)
    expected = product.stall_torque_nm * (gain * (goal - rate) - rate / product.no_load_speed_rad_s)
    assert torque == pytest.approx(expected, rel=1e-3)
    assert 0.8 * goal < rate < goal
    assert joint.mode == "velocity"


def test_a_velocity_body_settles_at_its_neutral_pose(tmp_path):
    rig = load_rig(written(tmp_path, LAMP, *velocity_changes()))
    model = build_model(rig, timestep_s=0.004)
    data, layout = settled_data(model, rig), body_layout(model, rig)
    assert np.abs(data.qpos[layout.qpos]).max() < 0.05
    assert data.ctrl[layout.actuator].tolist() == [0.0] * 3
    mujoco.mj_step(model, data, 5 * substeps(rig, 0.004))
    assert np.abs(data.qpos[layout.qpos]).max() < 0.1


def test_an_integral_gain_of_a_velocity_servo_is_refused(tmp_path):
    path = written(tmp_path, LAMP, *velocity_changes(), ("velocity_i_gain = 0", "velocity_i_gain = 5"))
    with pytest.raises(InputError, match="velocity_i_gain: simulated servos have no integrator"):
        build_model(load_rig(path))


def test_what_needs_a_bus_names_a_rig_that_has_one(tmp_path):
    with pytest.raises(
        InputError, match=r"paper-lamp: exists in simulation only, and this needs a bus; .* as lamp-xc330"
    ):
        require_bus(PAPER, "this")
    require_bus(LAMP, "this")
    for refuse in (require_drivable, VirtualRig):
        with pytest.raises(InputError, match=r"needs a bus; choose a rig that can be built, as lamp-xc330"):
            refuse(PAPER)
    require_drivable(load_rig(written(tmp_path, LAMP, *velocity_changes())))


@pytest.mark.parametrize(
    "command",
    [
        ["deploy", "{hopper}", "--rig", "paper-lamp", "--log", "{log}"],
        ["deploy", "{hopper}", "--rig", "paper-lamp", "--port", "/dev/null"],
        ["rig", "serve", "paper-lamp"],
        ["simulate", "{hopper}", "--rig", "paper-lamp", "--twin", "weak-torque"],
    ],
)
def test_commands_that_need_a_bus_refuse(request, tmp_path, capsys, command):
    hopper = request.config.rootpath / "tests" / "golden" / "lamp-hop.controller.toml"
    words = [word.format(hopper=hopper, log=tmp_path / "run.mcap") for word in command]
    assert main(words) == 2
    told = capsys.readouterr().err
    assert "exists in simulation only" in told and "lamp-xc330" in told
    assert told.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_rig_list_says_what_is_simulation_only(capsys):
    assert main(["rig", "list"]) == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("paper-lamp "))
    assert "simulation only" in line
    assert main(["rig", "list", "--json"]) == 0
    rigs = {rig["name"]: rig for rig in json.loads(capsys.readouterr().out)["rigs"]}
    assert rigs["paper-lamp"]["simulated_only"] and not rigs["lamp-xc330"]["simulated_only"]


def test_velocities_of_the_base_are_seen_from_its_heading():
    from controller import parse_controller
    from sim_models.simulation import simulate

    inputs = "".join(
        f'[[input]]\nname = "{name}"\nunit = "{unit}"\nlow = -9.0\nhigh = 9.0\n'
        for name, unit in (("vx", "m/s"), ("vy", "m/s"), ("vz", "m/s"), ("t", "s"))
    )
    outputs = "".join(
        f'[[output]]\nname = "{name}"\nkind = "position"\nunit = "deg"\nlow = -60.0\nhigh = 60.0\nneutral = 0.0\n'
        for name in ("a0", "a1", "a2")
    )
    rock = '"(list (* 15 (sin (* 14 t))) (* 15 (sin (* 9 t))) 0)"'
    text = f"program = {rock}\n[controller]\nname = 'c'\nperiod_s = 0.02\n{inputs}{outputs}"
    run = simulate(parse_controller(text, "test"), PAPER, goal_dist=0.5, time_limit_s=2.0, timestep_s=0.002)
    x, y, z, heading = (run.channel(name).astype(float) for name in ("x", "y", "z", "heading"))
    seen = run.terminals[1:-1, :3]
    rate = [(line[2:] - line[:-2]) / (2 * PAPER.period_s) for line in (x, y, z)]
    ahead = rate[0] * np.cos(heading[1:-1]) + rate[1] * np.sin(heading[1:-1])
    assert np.ptp(seen[:, 0]) > 0.05  # it does rock
    for line, expected in ((seen[:, 0], ahead), (seen[:, 2], rate[2])):
        assert np.corrcoef(line, expected)[0, 1] > 0.9
        assert math.sqrt(np.mean((line - expected) ** 2)) < 0.5 * np.std(expected)
