"""`servolve simulate`: what it tells, logs and films, and its faults in one sentence."""

from __future__ import annotations

import json

import pytest
from PIL import Image

from deploy.logs.log import read_log
from deploy.virtual.twin import load_twin
from servolve.cli import main


@pytest.fixture
def hopper(request):
    return str(request.config.rootpath / "tests" / "golden" / "lamp-hop.controller.toml")


@pytest.fixture
def weak(tmp_path):
    path = tmp_path / "weak.toml"
    path.write_text('format = 1\n[twin]\nname = "weak"\ntorque_scale = 0.5\np_gain_scale = 0.5\narmature_scale = 1.5\n')
    return str(path)


def tell(capsys, *arguments):
    assert main(["simulate", *arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out.splitlines()[-1])


def test_it_tells_where_the_lamp_ended(capsys, hopper):
    told = tell(capsys, hopper, "--goal", "0.2", "--seconds", "3")
    assert told["rig"] == "lamp-xc330" and told["goal_m"] == 0.2 and told["seconds"] == 3.0
    assert told["final_error_m"] < 0.015 and told["hops"] >= 2 and told["upright"] is True
    assert 0 < told["first_hit_s"] <= told["arrived_s"] < 3
    assert told["max_clearance_m"] > 0.02
    other = tell(capsys, hopper, "--rig", "lamp-xl330", "--goal", "0.2", "--seconds", "3")
    assert other["rig"] == "lamp-xl330" and other["final_error_m"] != told["final_error_m"]


def test_its_log_replays_bit_for_bit(capsys, hopper, tmp_path):
    log, strip = tmp_path / "sim.mcap", tmp_path / "strip.png"
    tell(capsys, hopper, "--seconds", "1", "--log", str(log), "--strip", str(strip))
    again = tmp_path / "again.mcap"
    tell(capsys, hopper, "--seconds", "1", "--log", str(again))
    assert log.read_bytes() == again.read_bytes()
    assert main(["replay", str(log), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["cycles"] == 50 and told["bitwise"] is True
    with Image.open(strip) as picture:
        assert 3 * picture.height < picture.width <= 5 * picture.height


def test_a_twin_moves_otherwise(capsys, hopper, weak):
    nominal = tell(capsys, hopper, "--seconds", "2")
    twin = tell(capsys, hopper, "--seconds", "2", "--twin", weak)
    assert twin["max_clearance_m"] < 0.7 * nominal["max_clearance_m"]


def test_the_table_is_for_people(capsys, hopper):
    assert main(["simulate", hopper, "--seconds", "0.1"]) == 0
    out = capsys.readouterr().out
    assert "final error m" in out and "first hit s" in out and "upright" in out


@pytest.mark.parametrize(
    ("arguments", "fault"),
    [
        (["--goal", "1e9"], "--goal 1e+09: is no distance in reach"),
        (["--seconds", "0"], "--seconds 0: is not between 0.02 and 600"),
        (["--timestep", "0.003"], "--timestep 0.003: a simulation step of 0.003 s does not divide the period"),
        (["--timestep", "0"], "--timestep 0: a simulation step of 0 s does not divide the period"),
        (["--rig", "lamp-x"], "lamp-x"),
        (["--twin", "nowhere.toml"], "nowhere.toml"),
        (["--seconds", "0.1", "--strip", "strip.jpg"], "must end in .png"),
        (["--seconds", "0.1", "--video", "nowhere/film.mp4"], "there is no folder"),
        (["--seconds", "0.1", "--log", "nowhere/sim.mcap"], "nowhere/sim.mcap"),
    ],
)
def test_faults_are_one_sentence_and_status_2(capsys, hopper, arguments, fault, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", hopper, *arguments]) == 2
    told = capsys.readouterr().err
    assert fault in told and told.count("\n") == 1


def test_what_of_a_twin_a_simulation_leaves_out_is_said(capsys, hopper, tmp_path):
    path = tmp_path / "askew.toml"
    own = '[[joint]]\nname = "a1"\nencoder_bias_rad = 0.1\ntorque_scale = 0.5\n'
    path.write_text(f'format = 1\n[twin]\nname = "askew"\nsupply_ohm = 0.1\n{own}')
    assert main(["simulate", hopper, "--seconds", "0.1", "--twin", str(path)]) == 0
    told = " ".join(capsys.readouterr().err.split())
    assert "twin askew: encoder_bias_rad, supply_ohm act on the virtual rig only; left out here" in told
    path.write_text('format = 1\n[twin]\nname = "askew"\n[[joint]]\nname = "a9"\n')
    assert main(["simulate", hopper, "--seconds", "0.1", "--twin", str(path)]) == 2
    assert "has no joint 'a9'" in capsys.readouterr().err


def test_the_log_holds_the_text_of_a_shipped_twin(capsys, hopper, tmp_path):
    log = tmp_path / "sim.mcap"
    for command in ("simulate", "deploy"):
        rig = ["--rig", "lamp-xc330"]
        assert main([command, hopper, *rig, "--seconds", "0.1", "--twin", "weak-torque", "--log", str(log)]) == 0
        text = read_log(log).meta["twin"]
        assert text == load_twin("weak-torque").text and "torque_scale" in text
    capsys.readouterr()
