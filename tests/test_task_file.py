"""Task files: users' own tasks run like the built-in ones; what is no task is refused in one sentence."""

from __future__ import annotations

import re

import numpy as np
import pytest

from controller.errors import InputError
from evolve.task import Task, load_task, score
from servolve.cli import main
from sim_models.rollouts import Rollouts
from sim_models.statistics import STATISTICS, STATUS_DIVERGED

GOOD = """
from evolve.task import Settings, Task

def fitness(rollouts, goal_m):
    end = rollouts.statistics
    return end["final_error"] + 0.5 * end["fallen"], end["end_joint_error"]

TASK = Task(
    name="walk",
    rig="lamp-xc330",
    terminals=("t", "px"),
    fitness=fitness,
    settings=Settings(population=6, generations=2, goals=2, time_limit_s=0.5, decision_goals=2, held_out_goals=2),
)
"""


def write(tmp_path, text, name="my_task.py"):
    path = tmp_path / name
    path.write_text(text)
    return str(path)


def refused(arguments, capsys):
    """Return the sentence with which a command refuses its input."""
    assert main(arguments) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert len(said.err.strip().splitlines()) == 1, said.err
    assert "Traceback" not in said.err
    return said.err


def test_a_users_task_runs_by_its_path(tmp_path, capsys):
    task = write(tmp_path, GOOD)
    out = tmp_path / "run"
    assert main(["evolve", task, "--out", str(out), "--quiet", "--no-report"]) == 0
    said = capsys.readouterr()
    assert said.err == "", "no progress"
    assert "held" not in said.out and "found in" in said.out and "search" in said.out, "but what came of it"
    assert 'task = "walk"' in (out / "run.toml").read_text()
    assert (out / "best.controller.toml").is_file()


def test_a_run_says_at_once_where_it_goes(tmp_path, capsys):
    task = write(tmp_path, GOOD)
    arguments = ["evolve", task, "--no-report", "--out"]
    assert main([*arguments, str(tmp_path / "run")]) == 0
    first, second = capsys.readouterr().err.splitlines()[:2]
    assert first == f"{tmp_path / 'run'}: evolving walk on lamp-xc330, seed 1, 6 individuals for 2 generations"
    assert second.startswith("generation 0")
    assert main([*arguments, str(tmp_path / "other"), "--json"]) == 0
    assert "evolving" not in capsys.readouterr().err
    assert "evolving" not in refused([*arguments, str(tmp_path / "run")], capsys), "nothing is, where nothing can be"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("def fitness(:\n", r"my_task\.py:1: SyntaxError"),
        ("import numpy\n\nx = 1 / 0\n", r"my_task\.py:3: ZeroDivisionError: division by zero"),
        ("import no_such_module_anywhere\n", r"my_task\.py:1: ModuleNotFoundError"),
        ("raise SystemExit(3)\n", r"my_task\.py:1: SystemExit"),
        ("x = 1\n", r"TASK is nothing; bind TASK"),
        ("TASK = 3\n", r"TASK is a int"),
        ("\0", r"my_task\.py"),
        (GOOD.replace('name="walk"', 'name="a b"'), r"'a b' is no name"),
        (GOOD.replace('("t", "px")', '("t", "t")'), r"listed twice"),
        (GOOD.replace('("t", "px")', '"t"'), r"give a tuple of names"),
        (GOOD.replace('("t", "px")', '("t", "vx")'), r"terminal 'vx' cannot be had on rig lamp-xc330.*goal_dist"),
        (
            GOOD.replace('("t", "px")', '("t", "goal")'),
            r"my_task\.py:11: terminal 'goal' cannot.*did you mean goal_met\?",
        ),
        (GOOD.replace("lamp-xc330", "lamp-xc33"), r"my_task\.py:10: there is no rig 'lamp-xc33'; did you mean"),
        (GOOD.replace("lamp-xc330", "gone.rig.toml"), r"my_task\.py:10: gone\.rig\.toml: .*no such file; name"),
        (GOOD.replace('rig="lamp-xc330"', "rig=3"), r"rig is 3"),
        (GOOD.replace("fitness=fitness", "fitness=3"), r"fitness is no function"),
        (GOOD.replace("population=6", "population=1"), r"population is 1; give a number from 2"),
        (GOOD.replace("population=6", "population='6'"), r"population is '6'; give a finite number"),
        (
            GOOD.replace("population=6", "populaton=6"),
            r"my_task\.py:13: Settings has no 'populaton'; did you mean population\?",
        ),
        (
            GOOD.replace("fitness=fitness", "fitnes=fitness"),
            r"my_task\.py:8: Task has no 'fitnes'; did you mean fitness\?",
        ),
        (GOOD.replace("final_error", "final_eror"), r"my_task\.py:6: (ValueError|KeyError|IndexError): .*final_eror"),
        (
            GOOD.replace('end["end_joint_error"]', "0.0, 1.0"),
            r"my_task\.py: fitness gave shapes.*return \(main, style\)",
        ),
        (GOOD.replace('end["end_joint_error"]', "[1.0]*77"), r"my_task\.py: fitness gave shapes.*\(77,\)"),
        (GOOD.replace('end["end_joint_error"]', "'x'"), r"my_task\.py.*ValueError"),
        (GOOD.replace("0.5 *", "float('nan') *"), r"my_task\.py:4: a controller that holds still has no finite"),
        (GOOD.replace('["end_joint_error"]', '["end_tilt"] / 0'), r"my_task\.py:4: .*; let fitness return finite"),
        (GOOD.replace('+ 0.5 * end["fallen"]', ".mean()"), r"my_task\.py: fitness gave shapes"),
    ],
)
def test_what_is_no_task_is_refused_with_its_line(tmp_path, capsys, text, told):
    sentence = refused(["evolve", write(tmp_path, text), "--out", str(tmp_path / "run"), "--quiet"], capsys)
    assert re.search(told, sentence), sentence


@pytest.mark.parametrize(
    ("name", "told"),
    [
        (".", "the task file is a folder"),
        ("missing.py", "the task file is missing"),
        ("lamp-robut", "did you mean lamp-robust?"),
        ("hexapod", "give one of lamp, lamp-robust, "),
    ],
)
def test_what_is_no_file_is_refused(tmp_path, capsys, name, told, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert told in refused(["evolve", name, "--quiet"], capsys)
    assert list(tmp_path.iterdir()) == [], "a refused run leaves nothing"


def test_bytes_that_are_no_python_are_refused(tmp_path, capsys):
    path = tmp_path / "my_task.py"
    path.write_bytes(b"\xff\xfe\x00broken")
    assert "my_task.py" in refused(["evolve", str(path), "--quiet"], capsys)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--population", "1"], "population"),
        (["--generations", "0"], "generations"),
        (["--threads", "0"], "--threads 0"),
        (["--seed", "-1"], "--seed -1"),
        (["--set", "populaton=3"], "did you mean population?"),
        (["--rig", "lamp-xc33"], "lamp-xc33"),
        (["--set", "screen_timestep_s=0.003"], "screen_timestep_s 0.003: a simulation step of 0.003 s does not divide"),
        (["--set", "decide_timestep_s=0.1"], "decide_timestep_s 0.1: a simulation step of 0.1 s does not divide"),
        (["--population", "many"], "many"),
        (["--population", "20", "--set", "population=30"], "--population and --set population say the same thing"),
        (["--set", "goals=2", "--set", "generations=3", "--generations", "3"], "--generations and --set generations"),
    ],
)
def test_wrong_options_are_refused(tmp_path, capsys, arguments, told, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert told in refused(["evolve", "lamp", "--quiet", *arguments], capsys)
    assert list(tmp_path.iterdir()) == [], "a refused run leaves nothing"


def test_a_run_does_not_overwrite(tmp_path, capsys):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "notes.txt").write_text("mine")
    assert "holds something already" in refused(["evolve", "lamp", "--quiet", "--out", str(tmp_path / "run")], capsys)
    assert "is a file" in refused(["evolve", "lamp", "--quiet", "--out", str(tmp_path / "run" / "notes.txt")], capsys)
    assert (tmp_path / "run" / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize("name", ["lamp", "lamp-robust"])
def test_the_built_in_tasks_pass_the_same_checks(name):
    task = load_task(name)
    assert task.name == name
    assert "px" in task.terminals


def test_loading_a_file_twice_gives_two_modules(tmp_path):
    first, second = (load_task(write(tmp_path, GOOD)) for _ in range(2))
    assert first.fitness is not second.fitness


def test_input_errors_of_a_task_file_pass_through(tmp_path):
    text = "from controller.errors import InputError\nraise InputError('the floor is missing')\n"
    with pytest.raises(InputError, match="the floor is missing"):
        load_task(write(tmp_path, text))


def test_one_number_will_do_for_the_style_of_all():
    rollouts = Rollouts(np.zeros(3, STATISTICS), (), None, None, None, None, 10, 0.02)
    task = Task(name="plain", rig="lamp-xc330", terminals=("t",), fitness=lambda rollouts, goal_m: (goal_m, 0.5))
    assert [part.tolist() for part in score(task, rollouts, np.arange(3.0))] == [[0, 1, 2], [0.5, 0.5, 0.5]]


@pytest.mark.filterwarnings("error")
def test_a_division_by_nothing_is_infinitely_bad_and_warns_nobody():
    rollouts = Rollouts(np.zeros(3, STATISTICS), (), None, None, None, None, 10, 0.02)
    ratio = Task(name="ratio", rig="lamp-xc330", terminals=("t",), fitness=lambda rollouts, goal_m: (1 / goal_m, 0.0))
    assert score(ratio, rollouts, np.array([0.0, 1.0, 2.0]))[0].tolist() == [np.inf, 1, 0.5]


def test_no_number_is_infinitely_bad_of_whatever_sign():
    statistics = np.zeros(6, STATISTICS)
    statistics["status"][5] = STATUS_DIVERGED
    rollouts = Rollouts(statistics, (), None, None, None, None, 10, 0.02)
    main = np.array([1, np.nan, -np.inf, np.inf, 2, 3])
    style = np.array([0.5, 0, 0, 0, -np.inf, 0])
    task = Task(name="odd", rig="lamp-xc330", terminals=("t",), fitness=lambda rollouts, goal_m: (main, style))
    found = score(task, rollouts, np.zeros(6))
    assert found[0].tolist() == [1, *[np.inf] * 5]
    assert found[1].tolist() == [0.5, *[0] * 5]
