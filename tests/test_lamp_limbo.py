"""The limbo: the pole stands where it is said to, touches are seen, and count."""

from __future__ import annotations

import dataclasses
import json

import mujoco
import numpy as np
import pytest

from controller import load_rig, parse_controller
from evolve import load_task
from evolve.evaluate import is_hit
from evolve.tasks.lamp_limbo import POLE_RADIUS_SHARE, fitness
from servolve.cli import main
from sim_models.body import body_layout, build_model, settled_data
from sim_models.perturbations import nominal_perturbations
from sim_models.rollouts import RolloutPool, make_cases
from sim_models.standing import standing_height

RIGS = ("paper-lamp", "lamp-xc330")


def limbo(rig, **changes):
    task = load_task("lamp-limbo").for_rig(rig)
    return task, dataclasses.replace(task.settings, **changes)


def still(*degrees):
    """Return a controller that holds three angles."""
    text = f'program = "(list {" ".join(map(str, degrees))})"\n[controller]\nname = "c"\nperiod_s = 0.02\n'
    for name in ("a0", "a1", "a2"):
        text += f'[[output]]\nname = "{name}"\nkind = "position"\nunit = "deg"\nlow = -60\nhigh = 60\nneutral = 0\n'
    return parse_controller(text, "test")


@pytest.mark.parametrize("rig", RIGS)
def test_standing_height_is_that_of_the_head(rig):
    model = build_model(load_rig(rig))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    head = model.geom("head_ball")
    top = data.geom_xpos[head.id, 2] + head.size[0]
    assert standing_height(mujoco.MjSpec.from_file(str(load_rig(rig).body))) == pytest.approx(top)


@pytest.mark.parametrize("form", ["free", "planar"])
@pytest.mark.parametrize("lean", [False, True])
@pytest.mark.parametrize("rig", RIGS)
def test_the_pole_stands_where_it_is_stated(rig, form, lean):
    task, settings = limbo(rig, pole_share=0.8, pole_at=0.7)
    about = load_rig(rig)
    tall = standing_height(mujoco.MjSpec.from_file(str(about.body)))
    model = build_model(about, form=form, lean=lean, scene=task.scene_with(settings))
    data = settled_data(model, about)
    pole = model.geom("pole").id
    radius = POLE_RADIUS_SHARE * tall
    assert model.geom_size[pole, 0] == pytest.approx(radius)
    assert data.geom_xpos[pole] == pytest.approx([0.7 * settings.goal_high_m, 0.0, 0.8 * tall + radius])
    axis = data.geom_xmat[pole].reshape(3, 3)[:, 2]
    assert np.abs(axis) == pytest.approx([0, 1, 0])
    core = model.geom("pole_core").id
    assert data.geom_xpos[core].tolist() == data.geom_xpos[pole].tolist()
    # the lamp stands clear of it, as without it
    plain = settled_data(build_model(about, form=form, lean=lean), about)
    assert data.qpos == pytest.approx(plain.qpos, abs=1e-6)
    assert not any(pole in pair or core in pair for pair in data.contact.geom)


@pytest.mark.parametrize("part", ["head_ball", "base_box", "head_arm1_link", "head_arm2_link_2"])
def test_head_and_arms_knock_the_pole_off_and_the_base_can_not_pass(part):
    task, settings = limbo("lamp-xc330")
    rig = load_rig("lamp-xc330")
    model = build_model(rig, lean=True, scene=task.scene_with(settings))
    data = mujoco.MjData(model)
    geom, pole = model.geom(part).id, model.geom("pole_core" if part == "base_box" else "pole").id
    data.qpos[2] += 1.0
    mujoco.mj_kinematics(model, data)
    data.qpos[:3] += data.geom_xpos[pole] - data.geom_xpos[geom]
    mujoco.mj_forward(model, data)
    met = [i for i, pair in enumerate(data.contact.geom.tolist()) if {pole, geom} == set(pair)]
    assert met
    force = np.zeros(6)
    mujoco.mj_contactForce(model, data, met[0], force)
    assert force[0] > 0.1 if part == "base_box" else force[0] == 0.0
    head = body_layout(model, rig).head_geoms
    assert (geom in head) == (part != "base_box")


def touching(pole_share, controller):
    """Run a controller with the pole close before the head; return its statistics."""
    task, settings = limbo("paper-lamp", pole_share=pole_share, pole_at=0.5, goal_low_m=0.45, goal_high_m=0.45)
    with RolloutPool(
        load_rig("paper-lamp"), timestep_s=0.002, time_limit_s=1.0, stop=task.stop, scene=task.scene_with(settings)
    ) as pool:
        return pool.run([controller], make_cases(0, 0.45), nominal_perturbations(1, 3))


def test_a_touch_of_the_pole_is_seen_and_costs_much():
    # leaning forward, the head meets a low pole and passes below a high one
    low, high = (touching(share, still(8, 0, 0)) for share in (0.75, 3.0))
    assert low.statistics["head_touched"].tolist() == [1]
    assert high.statistics["head_touched"].tolist() == [0]
    assert low.statistics["alive_steps"][0] == low.nstep  # it is a matter of style: the rollout goes on
    goal = np.array([0.45])
    _, style = fitness(low, goal)
    touched = low.statistics["head_touched"].copy()
    low.statistics["head_touched"] = 0
    _, without = fitness(low, goal)
    assert style - without == pytest.approx(0.5)
    low.statistics["head_touched"] = touched


def test_who_touches_has_not_hit():
    run = touching(3.0, still(0, 0, 0))
    run.statistics["final_error"] = 0.0
    assert is_hit(run.statistics).tolist() == [True]
    run.statistics["head_touched"] = 1
    assert is_hit(run.statistics).tolist() == [False]


@pytest.mark.parametrize("rig", RIGS)
def test_the_limbo_runs(tmp_path, capsys, rig):
    small = ["time_limit_s=0.5", "goals=1", "race_goals=0", "hall_of_fame=2", "stated_goals=1", "decision_goals=1"]
    out = tmp_path / "run"
    command = ["evolve", "lamp-limbo", "--rig", rig, "--population", "8", "--generations", "2", "--threads", "1"]
    command += [
        "--out",
        str(out),
        "--quiet",
        *(word for key in [*small, "held_out_goals=1"] for word in ("--set", key)),
    ]
    assert main(command) == 0
    told = json.loads((out / "validation.json").read_text())
    # the case itself, told beside the perturbed ones
    assert told["stated"]["conditions"] == 1
    assert told["stated"]["head_touched"] in (0.0, 1.0)
    assert 0.0 <= told["held_out"]["head_touched"] <= 1.0
