"""A run that was interrupted goes on as if nothing had happened; what stands in its way is said in one sentence."""

from __future__ import annotations

import fcntl
import importlib.util
import json
import os
import resource
import shutil
import sqlite3
from pathlib import Path

import pytest

from controller.errors import InputError, RunError
from evolve import RunConfig, evolve, load_task, ordered_dump, resume
from servolve.cli import main

FILES = ("run.toml", "best.controller.toml", "validation.json")
KILLED_RUN = Path(__file__).parent / "killed_run.py"
SHIPPED = Path(__file__).parent.parent / "sim_models" / "lamp"

_specification = importlib.util.spec_from_file_location("killed_run", KILLED_RUN)
killed_run = importlib.util.module_from_spec(_specification)
_specification.loader.exec_module(killed_run)


def silent(progress):
    pass


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole") / "run"
    killed_run.start(folder, "gp", 2)
    return folder


@pytest.fixture(scope="module")
def interrupted(tmp_path_factory):
    def interrupt(progress):
        if progress.generation == 1:
            raise KeyboardInterrupt

    folder = tmp_path_factory.mktemp("interrupted") / "run"
    with pytest.raises(KeyboardInterrupt):
        killed_run.start(folder, "gp", 1, interrupt)
    return folder


@pytest.fixture
def begun(interrupted, tmp_path):
    """A run that was interrupted after its second generation."""
    return shutil.copytree(interrupted, tmp_path / "begun")


def assert_same_run(folder, other):
    for name in FILES:
        assert (folder / name).read_bytes() == (other / name).read_bytes(), name
    assert ordered_dump(folder / "history.sqlite") == ordered_dump(other / "history.sqlite")


def test_an_interrupted_run_goes_on_where_it_was(uninterrupted, begun):
    told = []
    before = sqlite3.connect(begun / "history.sqlite").execute("select sum(simulations) from generation").fetchone()[0]
    result = resume(begun, 3, told.append)
    assert [progress.generation for progress in told] == [2, 3, 4]
    assert told[0].simulations > before, "the count goes on"
    assert result.simulations == told[-1].simulations
    assert_same_run(begun, uninterrupted)


def test_a_resumed_run_says_at_once_what_goes_on(begun, capsys):
    assert main(["evolve", "--resume", str(begun), "--no-report"]) == 0
    first, second = capsys.readouterr().err.splitlines()[:2]
    assert first.startswith(f"{begun}: going on with ") and first.endswith("for 5 generations, 2 of them done")
    assert second.startswith("generation 2")


def test_nothing_is_said_where_nobody_asked_for_progress(begun, capsys):
    assert main(["evolve", "--resume", str(begun), "--no-report", "--quiet"]) == 0
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("left", [("run.toml",), ("run.toml", "history.sqlite"), ("run.toml", "history.sqlite-empty")])
def test_a_run_without_a_generation_begins(uninterrupted, tmp_path, left):
    folder = tmp_path / "run"
    folder.mkdir()
    for name in ("run.toml", "task.py"):
        shutil.copy(uninterrupted / name, folder)
    if len(left) > 1:
        connection = sqlite3.connect(folder / "history.sqlite")
        if left[1] == "history.sqlite":
            # killed before its tables were committed: the file has a header and nothing else
            connection.execute("pragma user_version = 0")
        connection.close()
    resume(folder, 1, silent)
    assert_same_run(folder, uninterrupted)


@pytest.mark.parametrize("missing", [("best.controller.toml",), ("best.controller.toml", "validation.json")])
def test_a_decision_that_was_interrupted_is_made_again(uninterrupted, tmp_path, missing):
    folder = tmp_path / "run"
    shutil.copytree(uninterrupted, folder)
    for name in missing:
        (folder / name).unlink()
    (folder / f"{missing[-1]}.part").write_text("half a f")
    resume(folder, 2, pytest.fail)
    assert_same_run(folder, uninterrupted)


def test_a_finished_run_says_so_and_tells_its_result_again(uninterrupted, capsys):
    folder = uninterrupted
    before = {path: path.read_bytes() for path in folder.iterdir()}
    assert main(["evolve", "--resume", str(folder), "--json", "--no-report"]) == 0
    said = capsys.readouterr()
    assert "finished" in said.err
    validation = json.loads((folder / "validation.json").read_text())
    summary = json.loads(said.out)
    assert summary["held_out"] == validation["held_out"]
    assert summary["stated"] == validation["stated"]
    assert summary["program_hash"] == validation["best"]["program"]
    assert {path: path.read_bytes() for path in folder.iterdir()} == before


def test_a_finished_run_is_told_whatever_has_changed_since(uninterrupted, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(uninterrupted, folder)
    text = (folder / "run.toml").read_text()
    (folder / "run.toml").write_text(text.replace('mujoco = "', 'mujoco = "0.').replace('body = "', 'body = "0'))
    assert resume(folder, 1, pytest.fail).validation is not None


def test_a_search_alone_is_resumed_as_such(tmp_path):
    whole = evolve(killed_run.config(tmp_path / "run", threads=1, decide=False), silent)
    assert whole.validation is None
    again = resume(tmp_path / "run", 1, silent)
    assert again.candidate.program == whole.candidate.program
    assert sorted(path.name for path in (tmp_path / "run").iterdir()) == ["history.sqlite", "run.toml", "task.py"]


@pytest.mark.parametrize(
    "numbers",
    [
        ["redraw=false"],
        ["redraw=false", "cache=false"],
        ["parsimony=tarpeian", "selection=proportionate"],
        ["parsimony=double"],
        ["objectives=size,peak_torque"],
    ],
)
def test_every_kind_of_search_goes_on_as_if_it_had_not_stopped(tmp_path, numbers):
    numbers = ["population=12", "generations=4", *numbers]

    def interrupt(progress):
        if progress.generation == 1:
            raise KeyboardInterrupt

    whole = evolve(killed_run.config(tmp_path / "whole", numbers, threads=1), silent)
    with pytest.raises(KeyboardInterrupt):
        evolve(killed_run.config(tmp_path / "run", numbers, threads=1), interrupt)
    assert resume(tmp_path / "run", 1, silent).simulations == whole.simulations
    assert_same_run(tmp_path / "run", tmp_path / "whole")
    pareto = [(tmp_path / name / "pareto.json") for name in ("run", "whole")]
    assert pareto[0].exists() == pareto[1].exists() == any("objectives" in number for number in numbers)
    assert not pareto[0].exists() or pareto[0].read_bytes() == pareto[1].read_bytes()


def test_two_processes_do_not_work_on_one_run(begun):
    other = os.open(begun, os.O_RDONLY)
    fcntl.flock(other, fcntl.LOCK_EX)
    try:
        with pytest.raises(InputError, match="another process"):
            resume(begun, 1, silent)
    finally:
        os.close(other)
    resume(begun, 1, silent)


@pytest.mark.parametrize("name", ["servolve", "mujoco", "numpy"])
def test_another_version_is_refused_unless_asked_for(uninterrupted, begun, name):
    text = (begun / "run.toml").read_text()
    start, _, rest = text.partition(f'{name} = "')
    (begun / "run.toml").write_text(f'{start}{name} = "0.0.{rest}')
    with pytest.raises(InputError, match=rf"{name} 0\.0\..* --any-version"):
        resume(begun, 1, silent)
    resume(begun, 1, silent, any_version=True)
    assert ordered_dump(begun / "history.sqlite") == ordered_dump(uninterrupted / "history.sqlite")


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["lamp", "--resume", "x"], "TASK"),
        (["--resume", "x", "--generations", "9"], "style points"),
        (["--resume", "x", "--seed", "1"], "--seed"),
        (["--resume", "x", "--rig", "lamp-xl330", "--set", "goals=2"], "--rig, --set"),
        (["--resume", "x"], "no run"),
        ([], "--resume RUN"),
        (["lamp", "--any-version"], "--any-version"),
    ],
)
def test_what_does_not_go_together_is_refused(tmp_path, monkeypatch, capsys, arguments, told):
    monkeypatch.chdir(tmp_path)
    assert main(["evolve", *arguments]) == 2
    said = capsys.readouterr().err
    assert told in said and len(said.strip().splitlines()) == 1


def test_a_new_run_does_not_take_the_folder_of_another(begun, capsys):
    assert main(["evolve", "lamp", "--out", str(begun)]) == 2
    assert "--resume" in capsys.readouterr().err


TASK_FILE = """
from evolve.task import Settings, Task

def fitness(rollouts, goal_m):
    end = rollouts.statistics
    return end["final_error"] + 0.5 * end["fallen"], end["end_joint_error"]

TASK = Task(name="own", rig="own/own.rig.toml", terminals=("t", "a0", "px"), fitness=fitness, settings=Settings(
    population=8, generations=3, goals=2, race_goals=0, time_limit_s=0.4, decision_goals=2, held_out_goals=2,
    stated_goals=1, hall_of_fame=2))
"""


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A run of a user's own task on a user's own rig, interrupted, beside the same run as a whole."""
    monkeypatch.chdir(tmp_path)
    Path("own").mkdir()
    rig = (SHIPPED / "lamp-xc330.rig.toml").read_text().replace('name = "lamp-xc330"', 'name = "own"')
    Path("own/own.rig.toml").write_text(rig)
    body = rig.split('body = "')[1].split('"')[0]
    shutil.copy(SHIPPED / body, Path("own") / body)
    Path("own_task.py").write_text(TASK_FILE)
    task, text = load_task("own_task.py"), Path("own_task.py").read_bytes()

    def interrupt(progress):
        raise KeyboardInterrupt

    evolve(RunConfig(task, Path("whole"), threads=1, task_text=text), silent)
    with pytest.raises(KeyboardInterrupt):
        evolve(RunConfig(task, Path("run"), threads=1, task_text=text), interrupt)
    return body


def test_a_run_needs_nothing_but_its_folder(own, tmp_path, monkeypatch):
    shutil.rmtree("own")
    Path("own_task.py").unlink()
    Path("elsewhere").mkdir()
    shutil.move("run", "elsewhere/run")
    monkeypatch.chdir("elsewhere")
    resume(Path("run"), 1, silent)
    assert_same_run(Path("run"), tmp_path / "whole")


@pytest.mark.parametrize("name", ["task.py", "rig/own.rig.toml", "body"])
def test_a_run_whose_files_were_changed_is_refused(own, name):
    path = Path("run") / ("rig/" + own if name == "body" else name)
    path.write_text(path.read_text() + "\n")
    with pytest.raises(InputError, match=f"{path.name}: .*has changed"):
        resume(Path("run"), 1, silent)
    path.unlink()
    with pytest.raises(InputError, match=path.name.replace(".", r"\.")):
        resume(Path("run"), 1, silent)


@pytest.mark.parametrize(("old", "new"), [("seed = 7", "seed = 8"), ("population = 20", "population = 30")])
def test_a_run_whose_seed_or_settings_were_edited_is_refused(begun, old, new):
    text = (begun / "run.toml").read_text()
    assert text.count(f"\n{old}\n") == 1
    (begun / "run.toml").write_text(text.replace(old, new))
    with pytest.raises(InputError, match=r"run\.toml: its seed or another .*has changed since the run began; put back"):
        resume(begun, 1, silent)
    (begun / "run.toml").write_text(text)
    resume(begun, 1, silent)


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        ("delete from evaluation where generation = 0", "generation 0 holds 0 of 20 individuals"),
        ("delete from evaluation where generation = 1 and individual = 3", "generation 1 holds 19 of 20"),
        ("delete from generation where generation = 0", "without a gap"),
        ("delete from candidate where generation = 0", "0 candidates"),
        ("delete from program", "holds 0 of 20"),
        ("drop table candidate", "damaged"),
    ],
)
def test_a_history_that_lacks_something_is_refused(begun, damage, told):
    with sqlite3.connect(begun / "history.sqlite") as connection:
        connection.execute(damage)
    with pytest.raises(InputError, match=rf"history\.sqlite: .*{told}.*; put back the run's own history"):
        resume(begun, 1, silent)
    assert not (begun / "best.controller.toml").exists()


@pytest.mark.parametrize("length", [0, 30, -60])
def test_a_run_file_that_was_cut_is_refused_in_words(begun, capsys, length):
    path = begun / "run.toml"
    path.write_text(path.read_text()[:length])
    assert main(["evolve", "--resume", str(begun)]) == 2
    said = capsys.readouterr().err
    assert "run.toml: " in said and "; put back the file" in said
    assert "Error" not in said and len(said.strip().splitlines()) == 1


def test_a_history_that_was_spoilt_is_refused_with_what_to_do(begun, capsys):
    (begun / "history.sqlite").write_bytes(b"spoilt " * 2000)
    for command in (["evolve", "--resume"], ["show"]):
        assert main([*command, str(begun)]) == 2
        assert "put back a copy of the run's own, or start a new run" in capsys.readouterr().err


@pytest.mark.parametrize("command", [["simulate"], ["transpile", "--out", "never"]])
def test_an_unfinished_run_is_said_to_be_so(begun, capsys, command):
    assert main([*command, str(begun)]) == 2
    assert f"unfinished and has not chosen its best; go on with it: servolve evolve --resume {begun}" in (
        capsys.readouterr().err
    )


def test_a_finished_run_tells_the_time_of_its_search(uninterrupted, capsys):
    assert main(["evolve", "--resume", str(uninterrupted), "--quiet", "--no-report"]) == 0
    said = capsys.readouterr()
    recorded = sqlite3.connect(uninterrupted / "history.sqlite").execute(
        "select sum(simulations), sum(seconds) from generation"
    )
    assert "{} rollouts in {:.0f} s ".format(*recorded.fetchone()) in said.out, "the report says the same"
    assert "in all" not in said.out


def test_a_history_of_another_format_is_refused(begun):
    with sqlite3.connect(begun / "history.sqlite") as connection:
        connection.execute("pragma user_version = 0")
    with pytest.raises(InputError, match="format 0"):
        resume(begun, 1, silent)


@pytest.mark.parametrize("room_bytes", [4096, 20_000, 60_000])
def test_a_full_disk_is_said_and_the_run_resumes_after_room_was_made(uninterrupted, tmp_path, room_bytes):
    folder = tmp_path / "run"
    child = os.fork()
    if child == 0:
        try:
            # no file grows beyond this: writes fail as on a full disk, for every user
            resource.setrlimit(resource.RLIMIT_FSIZE, (room_bytes, room_bytes))
            killed_run.start(folder, "gp", 1)
        except RunError as error:
            os._exit(1 if "make room" in str(error) and f"--resume {folder}" in str(error) else 3)
        except BaseException:
            os._exit(4)
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 1
    resume(folder, 1, silent)
    assert_same_run(folder, uninterrupted)
