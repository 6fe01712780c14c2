"""The jumpers: their bodies, the direction that they face, their fitness, and whole small runs."""

from __future__ import annotations

import dataclasses
import json
import math

import mujoco
import numpy as np
import pytest

from controller import load_rig, lower, parse, save_controller
from controller.native import run_cycle
from evolve import RunConfig, apply_overrides, evolve, load_task, ordered_dump
from evolve.task import score
from evolve.tasks import jumper, jumper_paper
from evolve.template import controller_template
from servolve.cli import main
from sim_models.body import body_layout, build_model, settled_data
from sim_models.rollouts import Rollouts
from sim_models.simulation import simulate
from sim_models.statistics import STATISTICS

RIGS = ("jumper-xc330", "paper-jumper")
HOLD = "(list (* 4 heading_error) (* -6 {1}) (* -6 {2}) (* -6 {3}))"  # turn the leg to the goal and keep the pose
TASK = load_task("jumper")


def controller(rig, text):
    """Return a controller of the task; {0} to {3} are the rig's joints."""
    task = TASK.for_rig(rig.name)
    template = controller_template(task, rig, task.settings)
    source = parse(text.format(*(joint.name for joint in rig.joints)), task.terminals)
    return dataclasses.replace(template, source=source, program=lower(source, task.terminals))


def wrapped(angle):
    return math.remainder(angle, 2 * math.pi)


@pytest.mark.parametrize(("name", "mass"), [("jumper-xc330", 0.263), ("paper-jumper", 0.99)])
def test_it_has_five_elements_four_joints_and_its_weight(name, mass):
    rig = load_rig(name)
    model = build_model(rig)
    elements = ("base", "bearing", "leg1", "leg2", "head")
    assert [model.body(body).name for body in elements] == list(elements)
    assert model.body_subtreemass[model.body("base").id] == pytest.approx(mass)
    axes = [model.jnt_axis[model.joint(joint.mjcf_joint).id].tolist() for joint in rig.joints]
    assert axes == [[0, 0, 1], [0, 1, 0], [0, 1, 0], [-1, 0, 0]]
    assert all(joint.mode == "velocity" for joint in rig.joints)
    assert [joint.unlimited for joint in rig.joints] == [True, False, False, False]
    assert rig.facing == rig.joints[0].name
    limited = [bool(model.jnt_limited[model.joint(joint.mjcf_joint).id]) for joint in rig.joints]
    assert limited == [False, True, True, True]


@pytest.mark.parametrize("name", RIGS)
def test_it_stands_at_its_neutral_pose(name):
    rig = load_rig(name)
    model = build_model(rig)
    data = settled_data(model, rig)
    layout = body_layout(model, rig)
    assert data.qpos[:2] == pytest.approx([0, 0], abs=1e-3)
    assert data.qpos[layout.qpos] == pytest.approx([0, 0, 0, 0], abs=0.1)
    base = model.body("base").id
    assert all(base in model.geom_bodyid[data.contact.geom[i]] for i in range(data.ncon)), "it stands on its feet only"


@pytest.mark.parametrize("name", RIGS)
def test_the_head_touches_floor_and_base_and_nothing_else_of_it_touches_itself(name):
    model = build_model(load_rig(name))
    head, floor, base = (model.geom(geom).id for geom in ("head_ball", "floor", "base_disc"))
    for other in (floor, base):
        assert (model.geom_contype[head] & model.geom_conaffinity[other]) or (
            model.geom_contype[other] & model.geom_conaffinity[head]
        )
    data = mujoco.MjData(model)
    for pose in np.random.default_rng(1).uniform(-1, 1, (20, 4)):
        data.qpos[2] = 1.0
        data.qpos[7:11] = pose
        mujoco.mj_forward(model, data)
        assert all(head in data.contact.geom[i] for i in range(data.ncon))


@pytest.mark.parametrize("name", RIGS)
@pytest.mark.parametrize("bearing", [-3.0, -1.2, 0.7, 2.4])
def test_a_hand_written_controller_turns_the_leg_to_the_goal(name, bearing):
    rig = load_rig(name)
    run = simulate(controller(rig, HOLD), rig, goal_dist=0.4, goal_bearing=bearing, timestep_s=0.005, time_limit_s=2.5)
    a0 = rig.joints[0].name
    facing = run.channel("heading")[-1] + run.channel(a0)[-1]
    assert wrapped(facing - bearing) == pytest.approx(0, abs=0.05)
    assert run.statistics["upright_end"] == 1
    assert run.statistics["final_error"] == pytest.approx(0.4, abs=0.02), "it turns on the spot"


def test_the_command_simulates_goals_in_any_direction(tmp_path, capsys):
    rig = load_rig("jumper-xc330")
    path = tmp_path / "hold.controller.toml"
    save_controller(controller(rig, HOLD), path)
    command = ["simulate", str(path), "--rig", rig.name, "--goal", "0.3", "--seconds", "2", "--timestep", "0.005"]
    for bearing in (-2.0, 1.0):
        assert main([*command, "--bearing", str(bearing), "--json"]) == 0
        told = json.loads(capsys.readouterr().out)
        assert told["bearing_rad"] == bearing
        assert told["final_px_m"] == pytest.approx(0.3 * math.cos(bearing), abs=0.05), "px of the end is the base's"
    assert main([*command, "--bearing", "10"]) == 2
    assert "--bearing 10: is more than a turn; give radians" in capsys.readouterr().err


@pytest.mark.parametrize("name", RIGS)
def test_the_bearing_turns_for_ever_and_the_heading_error_wraps(name):
    rig = load_rig(name)
    turning = controller(rig, "(list 5 (* -6 {1}) (* -6 {2}) (* -6 {3}))")
    run = simulate(turning, rig, goal_dist=0.4, goal_bearing=0.5, timestep_s=0.005, time_limit_s=3.0)
    angle = run.channel(rig.joints[0].name)
    assert angle[-1] > 1.5 * 2 * math.pi
    names = [terminal.name for terminal in turning.inputs]
    seen = {name: run.terminals[:, names.index(name)] for name in (rig.joints[0].name, "heading_error", "px")}
    assert seen[rig.joints[0].name] == pytest.approx(angle, abs=0.002), "the angle itself does not wrap"
    assert np.abs(seen["heading_error"]).max() <= np.float32(math.pi)
    dx = 0.4 * math.cos(0.5) - run.channel("x")
    dy = 0.4 * math.sin(0.5) - run.channel("y")
    error = np.arctan2(dy, dx) - run.channel("heading") - angle
    # the pose is a line of the sensor node: a little older than the angle
    assert np.cos(seen["heading_error"] - error) == pytest.approx(np.ones(len(angle)), abs=0.01)
    assert seen["px"] == pytest.approx(np.hypot(dx, dy) * np.cos(error), abs=0.01)


def test_what_it_sees_is_the_goal_turned_by_heading_and_bearing():
    rig = load_rig("paper-jumper")
    hold = controller(rig, HOLD)
    names = [terminal.name for terminal in hold.inputs]
    sensors = [sensor.name for sensor in rig.sensors]
    tick = 2 * math.pi / rig.joints[0].product.ticks_per_turn
    scale = {sensor.name: sensor.scale for sensor in rig.sensors}
    raw = np.zeros((2, rig.nraw), np.int32)  # at the start it looks along x
    x, y, heading, k0 = 0.1, -0.2, 0.3, 7.0
    raw[1, 0] = round(k0 / tick)
    for name, value in (("x", x), ("y", y), ("heading", heading)):
        raw[1, 3 * len(rig.joints) + sensors.index(name)] = round(value / scale[name])
    terminals, _, _ = run_cycle(hold, rig, raw, (0.5, 0.4))
    dx, dy = 0.5 * math.cos(0.4) - x, 0.5 * math.sin(0.4) - y
    away = math.atan2(dy, dx) - heading - k0
    distance = math.hypot(dx, dy)
    expected = {
        "px": distance * math.cos(away),
        "py": distance * math.sin(away),
        "heading_error": wrapped(away),
    }
    for name, value in expected.items():
        assert terminals[1, names.index(name)] == pytest.approx(value, abs=2e-5), name


def statistics(**fields):
    """Return statistics of rollouts that stood still at the goal, but for these fields."""
    n = max(len(values) for values in fields.values())
    rows = np.zeros(n, STATISTICS)
    rows["upright_end"] = 1
    for name, values in fields.items():
        rows[name] = values
    return Rollouts(rows, (), None, None, None, None, nstep=1000, period_s=0.02)


def test_emots_fitness_is_what_its_pseudocode_says():
    rollouts = statistics(
        final_error=[0.1, 0.1, 0.1, 0.1, 0.9],
        idle_steps=[0, 500, 0, 250, 0],
        end_joint_error=[0, 0, 0.5, 0.1, 0],
        end_joint_speed=[0, 0, 0, 0.2, 0],
        head_touched=[0, 0, 0, 1, 0],
        fallen=[0, 0, 0, 2, 1],
    )
    main, style = score(TASK.for_rig("paper-jumper"), rollouts, np.full(5, 0.5))
    assert main == pytest.approx([0.2, 0.2, 0.2, 1.0, 1.8])
    assert style == pytest.approx([0.0, 0.33 * 0.5, 0.33, 1.0, 1.0])
    safe = statistics(idle_steps=[250], end_joint_error=[0.1], end_joint_speed=[0.2])
    _, style = jumper_paper.fitness(safe, np.full(1, 0.5))
    assert style == pytest.approx([0.33 * 0.25 + 0.33 * 0.4 + 0.33 * 0.8])


def test_a_jumper_that_shakes_is_told_from_one_that_stands():
    shaking = statistics(end_speed=[0.0, 0.14, 0.3], end_joint_speed=[0.0, 0.003, 0.0])
    _, style = jumper_paper.fitness(shaking, np.full(3, 0.5))
    assert style == pytest.approx([0, 0.33 * (5 * 0.14 + 4 * 0.003), 0.33]), (
        "five elements in m/s, four joints in rad/s"
    )


def test_a_buildable_jumpers_fitness_counts_the_way_made_by_hopping():
    there, away, beside = 0.0, 0.9, 0.05
    rollouts = statistics(
        final_error=[there, 0.3, beside, there, away, 0.3],
        end_speed=[0, 0, 0.1, 0, 0, 0],
        arrive_step=[100, -1, -1, 200, -1, -1],
        hops=[3, 0, 1, 0, 9, 5],
        max_clearance=[0.02, 0, 0.012, 0, 0.02, 0.02],
        upright_end=[1, 1, 0, 1, 1, 1],
    )
    main, style = jumper.fitness(rollouts, np.full(6, 0.3))
    far = math.exp(-0.3 / 0.05)
    hopping = 0.3 + 0.7 / 2
    got = 0.7 * 5 / 6 + 0.3 / math.e
    once = 1 - got * hopping - 0.05 * got * (1 - hopping) + 0.3 + 0.01
    assert main == pytest.approx([0, 1 - 0.05 * 0.3 * far, once, 0.95, 1, 1 - 0.3 * far], abs=1e-6), (
        "hopping on the spot, or away, earns nothing"
    )
    unrest = 0.2 + 0.15 + 0.2 * (1 - 1 / math.e)
    stayed = 0.7 - 0.3 * far * (0.7 - 0.2 - 0.2 * (1 - far))
    assert style == pytest.approx([0.02, 0.7, 0.3 + 0.7 - got * hopping * (0.7 - unrest), 0.7, 0.7, stayed], abs=1e-6)


def test_its_defaults_are_emots_on_the_papers_body():
    paper = TASK.for_rig("paper-jumper")
    numbers = paper.settings
    assert (paper.engine, numbers.population, numbers.generations, numbers.gep_head) == ("gep", 100, 50, 10)
    assert (numbers.tournament, numbers.time_limit_s, numbers.constant_max) == (6, 20.0, 6.0)
    assert load_rig("paper-jumper").period_s == 0.01
    steps = {getattr(numbers, f"{stage}_timestep_s") for stage in ("screen", "decide", "verify")}
    assert steps == {0.002}, "what is reported is what was bred"
    rates = {name: getattr(numbers, f"gep_{name}") for name in ("mutation", "is", "ris", "gene_transposition")}
    assert rates == {"mutation": 0.01, "is": 0.1, "ris": 0.1, "gene_transposition": 0.05}
    assert (numbers.gep_one_point, numbers.gep_two_point, numbers.gep_gene) == (0.2, 0.5, 0.1)
    assert (numbers.gep_constant_mutation, numbers.gep_constant_tuning) == (0.05, 0.9)
    assert TASK.for_rig("jumper-xc330") is TASK
    assert TASK.engine == "gp"


@pytest.mark.parametrize("name", RIGS)
def test_a_small_run_is_the_same_at_any_thread_count(name, tmp_path):
    task = TASK.for_rig(name)
    small = apply_overrides(
        task.settings,
        [
            "population=12",
            "generations=2",
            "time_limit_s=0.6",
            "hall_of_fame=2",
            "stated_goals=1",
            "decision_goals=2",
            "held_out_goals=2",
        ],
    )
    for threads in (1, 2):
        evolve(RunConfig(task, tmp_path / str(threads), 3, small, name, threads), lambda progress: None)
    one, two = tmp_path / "1", tmp_path / "2"
    assert ordered_dump(one / "history.sqlite") == ordered_dump(two / "history.sqlite")
    for file in ("best.controller.toml", "validation.json"):
        assert (one / file).read_bytes() == (two / file).read_bytes()
