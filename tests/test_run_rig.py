"""Commands that take a run folder find the rig that the run keeps, wherever the folder has gone since."""

from __future__ import annotations

import json
import shutil

import pytest

from controller import load_controller, load_rig
from controller.errors import InputError
from evolve import RunConfig, apply_overrides, evolve, load_task
from servolve.cli import main
from servolve.run_rig import rig_of

SMALL = ["population=4", "generations=1", "goals=1", "time_limit_s=0.4"]
SMALL += ["decision_goals=1", "held_out_goals=1", "stated_goals=1"]


def run_on(name, folder):
    """Leave a run on a user's own rig of a name, in `folder`; the rig's file is gone when it is done."""
    shipped = load_rig("lamp-xc330")
    own = folder.parent / "own"
    own.mkdir()
    text = shipped.text.replace('name = "lamp-xc330"', f'name = "{name}"').replace("supply_v = 5.0", "supply_v = 4.9")
    (own / "own.rig.toml").write_text(text)
    shutil.copy(shipped.body, own)
    task = load_task("lamp")
    settings = apply_overrides(task.settings, SMALL)
    evolve(RunConfig(task, folder.parent / "first", 1, settings, str(own / "own.rig.toml"), 1), lambda progress: None)
    shutil.rmtree(own)
    (folder.parent / "first").rename(folder)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rig") / "run"
    run_on("mine", folder)
    return folder


def test_it_is_simulated_and_deployed_on_the_rig_that_it_keeps(run, capsys):
    for command in ("simulate", "deploy"):
        assert main([command, str(run), "--seconds", "0.1", "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["rig"] == "mine"
    assert main(["simulate", str(run), "--seconds", "0.1", "--json", "--rig", "lamp-xc330"]) == 0
    assert json.loads(capsys.readouterr().out)["rig"] == "lamp-xc330"


@pytest.mark.parametrize("name", ["mine", "lamp-xc330"])
def test_it_is_the_run_s_own_even_if_another_has_its_name(tmp_path, name):
    run_on(name, tmp_path / "run")
    rig = rig_of(tmp_path / "run", load_controller(tmp_path / "run"), None, "lamp-xl330")
    assert (rig.name, rig.supply_v) == (name, 4.9)
    assert rig.path.is_relative_to(tmp_path / "run")
    rig.path.write_text(rig.text.replace("4.9", "4.8"))
    with pytest.raises(InputError, match="the rig has changed since the run began"):
        rig_of(tmp_path / "run", load_controller(tmp_path / "run"), None)


def test_it_is_shown_and_transpiled_without_asking(run, tmp_path, capsys):
    assert main(["show", str(run)]) == 0
    assert "lamp on mine" in capsys.readouterr().out
    assert main(["show", str(run), "--report", str(tmp_path / "report.html")]) == 0
    assert main(["transpile", str(run), "--out", str(tmp_path / "c")]) == 0


def test_a_controller_alone_says_what_is_missing(run, request, capsys):
    assert main(["simulate", str(run / "best.controller.toml")]) == 2
    told = capsys.readouterr().err
    assert "was evolved on rig 'mine'" in told and "--rig" in told
    nobody = str(request.config.rootpath / "tests" / "golden" / "lamp-hop.controller.toml")
    assert main(["deploy", nobody]) == 2
    assert "does not say on which rig" in capsys.readouterr().err
