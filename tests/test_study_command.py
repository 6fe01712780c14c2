"""`servolve study`: killed and run again, with any workers and in any order, a study leaves the same bytes."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from evolve.studies.cells import make_cells, read_curve, run_cells
from evolve.studies.papers import STUDIES
from servolve.cli import main

SEEDS = 4
NAME = "population"
FILES = tuple(f"{NAME}.{ending}" for ending in ("csv", "generations.csv", "md", "svg", "png"))


def command(folder, *more, seeds=SEEDS):
    return [
        *(sys.executable, "-m", "servolve", "study", NAME, "--scale", "tiny"),
        *("--seeds", str(seeds), "--out", str(folder), *more),
    ]


def start(folder, *more):
    # a group of its own, as a shell gives to a command in front: Ctrl-C reaches the workers too, and is not ignored as
    # it is in what a shell starts in the background, these tests perhaps
    return subprocess.Popen(
        ["env", "--default-signal=INT", *command(folder, *more)],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    )


def children(process):
    return [int(pid) for pid in Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()]


def content(folder):
    return {name: (folder / name).read_bytes() for name in FILES}


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study") / "whole"
    told = subprocess.run(command(folder, "--workers", "1", "--json"), capture_output=True, text=True, check=True)
    return folder, json.loads(told.stdout)


def test_a_study_that_is_stopped_and_killed_goes_on_to_the_same_bytes(finished, tmp_path):
    folder = tmp_path / "again"
    stopped = start(folder, "--workers", "2")
    assert stopped.stderr.readline().startswith("1/")
    os.killpg(stopped.pid, signal.SIGINT)
    told = stopped.communicate()[1]
    assert stopped.returncode == 1
    assert "the same command goes on" in told
    assert "Traceback" not in told
    assert not (folder / FILES[0]).exists()

    killed = start(folder, "--workers", "2")
    # the lines of what was done before come first
    for line in killed.stderr:
        if int(line.partition("/")[0]) >= 3:
            break
    workers = children(killed)
    killed.kill()
    killed.communicate()
    until = time.monotonic() + 30
    while any(Path(f"/proc/{pid}").exists() for pid in workers):
        assert time.monotonic() < until, "workers outlive the study"
        time.sleep(0.05)

    subprocess.run(command(folder, "--workers", "2", "--quiet"), check=True, stdout=subprocess.DEVNULL)
    assert content(folder) == content(finished[0])


def test_a_cell_that_was_killed_while_its_tables_were_made_is_not_complete(tmp_path):
    """Its journal takes back what was written when the file is opened next: until then the file is not empty."""
    folder = tmp_path / "half"
    cell = make_cells(STUDIES[NAME], STUDIES[NAME].scales["tiny"], 1, folder)[0]
    cell.folder.mkdir(parents=True)
    path = cell.folder / "history.sqlite"
    killed = (
        "import os, sqlite3, sys\n"
        "made = sqlite3.connect(sys.argv[1], isolation_level=None)\n"
        "made.execute('pragma cache_size = 1')\n"
        "made.execute('begin immediate')\n"
        "made.execute('create table program (text)')\n"
        "made.executemany('insert into program values (?)', [('x' * 4000,)] * 50)\n"
        "os._exit(9)\n"
    )
    assert subprocess.run([sys.executable, "-c", killed, path], check=False).returncode == 9
    assert path.stat().st_size > 0
    assert read_curve(cell) is None


def test_the_order_of_the_cells_changes_nothing(finished, tmp_path):
    study = STUDIES[NAME]
    found = []
    for out, order in ((finished[0], 1), (tmp_path / "backwards", -1)):
        curves = {}
        cells = make_cells(study, study.scales["tiny"], 2, out)[::order]
        run_cells(cells, out, 1, lambda cell, curve: curves.update({(cell.level.name, cell.seed): curve}))  # noqa: B023
        found.append({key: (curve.best, curve.passed, curve.simulations) for key, curve in curves.items()})
    assert found[0] == found[1]
    assert len(found[0]) == 4


def test_a_finished_study_runs_nothing_and_more_seeds_add_to_it(finished, tmp_path, capsys):
    folder = tmp_path / "copy"
    shutil.copytree(finished[0], folder)
    histories = {path: path.read_bytes() for path in folder.rglob("history.sqlite")}
    assert main([*command(folder)[3:], "--quiet", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["levels"] == finished[1]["levels"]
    assert content(folder) == content(finished[0])
    assert main([*command(folder, seeds=SEEDS + 1)[3:], "--quiet"]) == 0
    assert {path: path.read_bytes() for path in histories} == histories
    assert len(list(folder.rglob("history.sqlite"))) == len(histories) + 2


def test_the_summary_says_what_was_run(finished):
    folder, summary = finished
    assert (summary["study"], summary["scale"], summary["seeds"]) == (NAME, "tiny", SEEDS)
    assert [(row["level"], row["runs"], row["individuals"]) for row in summary["levels"]] == [
        *(("10", SEEDS, 20), ("50", SEEDS, 100)),
    ]
    # the reference, 200, is not in the tiny grid
    assert [claim["verdict"] for claim in summary["claims"]] == ["not tested", "not tested"]
    lines = (folder / f"{NAME}.generations.csv").read_text().splitlines()
    assert len(lines) == 1 + 2 * SEEDS * 2


def refused(folder, capsys, name=NAME, scale="tiny"):
    """Return the sentence with which a study refuses its folder, which stays as it is."""
    before = {path: path.is_dir() or path.read_bytes() for path in folder.rglob("*")}
    assert main(["study", name, "--scale", scale, "--seeds", "1", "--out", str(folder)]) == 2
    assert {path: path.is_dir() or path.read_bytes() for path in folder.rglob("*")} == before
    told = capsys.readouterr().err
    assert told.count("\n") == 1 and "remove" not in told and "give --out another folder" in told
    return told


def test_a_folder_of_another_study_is_refused_and_stays(finished, tmp_path, capsys):
    folder = tmp_path / "copy"
    shutil.copytree(finished[0], folder)
    assert "this one at another scale" in refused(folder, capsys, scale="full")
    for name in STUDIES:
        if name != NAME:
            assert "holds another study" in refused(folder, capsys, name)
    # a cell that this call does not ask for is another study's all the same
    (folder / "cells" / "50-2").rename(folder / "cells" / "51-2")
    assert "cells/51-2" in refused(folder, capsys)


def test_a_folder_of_something_else_is_refused_and_stays(finished, tmp_path, capsys):
    assert "holds a run" in refused(finished[0] / "cells" / "10-1", capsys)
    (tmp_path / "notes.txt").write_text("mine")
    assert "something else than a study" in refused(tmp_path, capsys)


def test_a_folder_where_a_study_runs_is_refused(finished, capsys):
    with (finished[0] / "study.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert main([*command(finished[0])[3:], "--quiet"]) == 2
    assert "another study is running there" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["nope"], "choose one of population"),
        ([NAME, "--workers", "0"], "--workers 0"),
        ([NAME, "--seeds", "0"], "--seeds 0"),
        ([NAME, "--out", "/dev/null"], "/dev/null"),
        ([NAME, "--out", "/proc/nowhere"], "give --out another folder"),
    ],
)
def test_bad_input_is_one_sentence(arguments, told, capsys):
    assert main(["study", *arguments]) == 2
    error = capsys.readouterr().err
    assert told in error
    assert error.count("\n") == 1


def test_the_list_names_all_studies(capsys):
    assert main(["study", "list"]) == 0
    shown = capsys.readouterr().out
    assert "EMOT" in shown
    assert main(["study", "list", "--json"]) == 0
    assert [study["name"] for study in json.loads(capsys.readouterr().out)] == list(STUDIES)


def test_a_broken_run_fails_the_study_with_its_sentence(finished, tmp_path, capsys):
    folder = tmp_path / "copy"
    shutil.copytree(finished[0], folder)
    (folder / "cells" / "10-1" / "history.sqlite").write_bytes(b"no history" * 1000)
    assert main([*command(folder)[3:], "--quiet"]) == 2
    error = capsys.readouterr().err
    assert "history" in error
    assert os.linesep.join(error.splitlines()).count("\n") == 0
