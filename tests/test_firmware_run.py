"""`servolve firmware --run` says what `deploy` says, and `servolve log` makes a log of a recorded console."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time

import pytest
from firmware_runs import GOLDEN, STS3215, XC330, firmware_run

from deploy.firmware.console_decoder import checked, crc16
from deploy.firmware.dump import dumped_runs
from deploy.logs.log import read_log
from firmware_gen.projects.board import load_board
from servolve.cli import main

LAMP = str(GOLDEN / "lamp-robust.controller.toml")


def asked(capsys, *arguments):
    """Run the command line; return its exit status, its JSON object, and what it said."""
    status = main([str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    return status, json.loads(out.splitlines()[-1]) if out else {}, err


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    return tmp_path_factory.mktemp("firmware") / "lamp"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Run the twin twice; return the run, and the console's bytes of both."""
    folder = tmp_path_factory.mktemp("recorded")
    first = firmware_run(folder / "first.mcap", XC330, ["dead=2@1.0"], seconds=1.0)
    run = firmware_run(folder / "run.mcap", XC330, seconds=1.0)
    return run, first.console, run.console


@pytest.mark.parametrize("fault", [(), ("--fault", "dead=2@1.0")], ids=str)
def test_a_run_is_told_and_logged_as_the_host_loops(capsys, tmp_path, project, fault):
    options = ("--goal", 0.3, "--seconds", 1, "--seed", 5, *fault, "--json")
    log = tmp_path / "run.mcap"
    host = asked(capsys, "deploy", LAMP, "--log", tmp_path / "host.mcap", *options)
    board = asked(capsys, "firmware", LAMP, "--board", "host", "--out", project, "--run", "--log", log, *options)
    assert board[0] == host[0] == (1 if fault else 0)
    own = {"out", "board", "image", "text_bytes", "ram_bytes", "data_bytes", "bss_bytes", "port", "log", "files"}
    assert {name: value for name, value in board[1].items() if name not in own} == {
        name: value for name, value in host[1].items() if name not in own
    }
    assert (board[1]["board"], board[1]["port"]) == ("host", "firmware twin")
    assert board[2] == host[2]
    logs = [read_log(path) for path in (tmp_path / "host.mcap", log)]
    assert logs[0].messages.keys() == logs[1].messages.keys()
    assert [cycle["goal_counts"] for cycle in logs[1].cycles] == [cycle["goal_counts"] for cycle in logs[0].cycles]
    assert main(["replay", str(log)]) == 0
    assert main(["compare", str(log)]) == 0


def test_a_check_that_finds_something_is_told_as_the_host_loops(capsys, project):
    options = ("--fault", "dead=2", "--json")
    host = asked(capsys, "deploy", LAMP, *options)
    board = asked(capsys, "firmware", LAMP, "--board", "host", "--out", project, "--run", *options)
    assert host[1]["cycles"] == 0 and host[1]["upright"]
    assert {name: board[1][name] for name in host[1] if name != "port"} == {
        name: value for name, value in host[1].items() if name != "port"
    }


def test_a_board_whose_machine_is_unknown_is_not_built_to_be_run(capsys, tmp_path):
    shutil.copytree(load_board("host").folder, tmp_path / "mine")
    text = (tmp_path / "mine" / "board.toml").read_text()
    (tmp_path / "mine" / "board.toml").write_text(text.replace('machine = "twin"', 'machine = "raspi"'))
    folder = tmp_path / "robot"
    status, _, err = asked(capsys, "firmware", LAMP, "--board", tmp_path / "mine", "--out", folder, "--run")
    assert (status, folder.exists()) == (2, False)
    assert "no board of servolve is QEMU's machine 'raspi'; choose one of" in err


def test_a_table_is_printed_without_json(capsys, tmp_path, project):
    status = main(["firmware", LAMP, "--board", "host", "--out", str(project), "--run", "--seconds", "0.5"])
    out, err = capsys.readouterr()
    assert status == 0
    assert "build/firmware" in out
    assert "final error" in err
    assert "cycles" in err


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--goal", "0.3"), "are of a run; add --run"),
        (("--run", "--seconds", "5000"), "firmware runs for less than 4000 s; give less"),
        (("--run", "--seconds", "0.001"), "is less than a control period"),
        (("--run", "--derate", "2"), "is not above 0 and at most 1"),
        (("--run", "--seed", "-1"), "is negative"),
        (("--run", "--goal", "1e-12"), "--goal 1e-12: firmware takes at most 9 decimal places; round it"),
        (("--run", "--log", "/nowhere/x.mcap"), "the log cannot be written there (its folder is not there)"),
        (("--run", "--log", LAMP), "is there and is no log, so it is not overwritten"),
        (("--run", "--fault", "nonsense"), "nonsense"),
    ],
)
def test_what_nobody_can_mean_is_refused_in_one_sentence(capsys, project, arguments, sentence):
    status, _, err = asked(capsys, "firmware", LAMP, "--board", "host", "--out", project, *arguments)
    assert status == 2
    assert sentence in err
    assert len(err.splitlines()) == 1


def test_a_recorded_console_becomes_the_log_of_its_last_run(capsys, tmp_path, recorded):
    run, first, last = recorded
    path, out = tmp_path / "console.bin", tmp_path / "board.mcap"
    path.write_bytes(first + last)
    status, told, _ = asked(capsys, "log", path, "--controller", LAMP, "--rig", "lamp-xc330", "--out", out, "--json")
    assert status == 0
    assert (told["complete"], told["damaged"], told["lost_cycles"], told["cycles"]) == (True, 0, 0, 50)
    assert (told["state"], told["goal_m"]) == ("off", 0.4)
    log = read_log(out)
    for topic in ("/cycle", "/event", "/health"):
        assert len(log.messages[topic]) == len(run.log.messages[topic])
    assert log.cycles == run.log.cycles
    assert main(["replay", str(out)]) == 0
    assert main(["compare", str(out)]) == 0
    other = tmp_path / "first.mcap"
    status, told, _ = asked(capsys, "log", path, "--controller", LAMP, "--out", other, "--run", 1, "--json")
    assert (status, told["state"]) == (0, "fault")
    assert "gave no reply for 4 periods" in told["reason"]


def test_the_projects_folder_knows_what_the_recording_is_of(capsys, tmp_path, project, recorded):
    run, _, last = recorded
    assert main(["firmware", LAMP, "--board", "host", "--out", str(project)]) == 0
    path, out = tmp_path / "console.bin", tmp_path / "board.mcap"
    path.write_bytes(last)
    capsys.readouterr()
    status, told, _ = asked(capsys, "log", path, "--project", project, "--out", out, "--json")
    assert (status, told["rig"], told["cycles"]) == (0, "lamp-xc330", 50)
    assert read_log(out).cycles == run.log.cycles
    assert main(["replay", str(out)]) == 0
    capsys.readouterr()
    for arguments, sentence in (
        ((), "give the folder of the firmware's project"),
        (("--project", project, "--controller", LAMP), "one of them is needed"),
        (("--project", project, "--rig", "lamp-xc330"), "the project says which"),
        (("--project", tmp_path), "servolve.json: cannot be read"),
    ):
        status, _, err = asked(capsys, "log", path, *arguments, "--out", out)
        assert status == 2
        assert sentence in err
    (tmp_path / "servolve.json").write_text('{"rig": 3}')
    assert "is not what servolve firmware writes" in asked(capsys, "log", path, "--project", tmp_path, "--out", out)[2]


def test_a_damaged_recording_gives_what_is_left_of_it(capsys, tmp_path, recorded):
    _, _, last = recorded
    path, out = tmp_path / "console.bin", tmp_path / "board.mcap"
    data = bytearray(last)
    data[len(data) // 2] ^= 0x55
    path.write_bytes(data[:-200])
    status, told, _ = asked(capsys, "log", path, "--controller", LAMP, "--out", out, "--json")
    assert status == 0
    assert not told["complete"]
    assert (told["state"], told["done"]) == ("running", False)
    assert told["lost_cycles"] + told["damaged"] >= 1
    assert len(read_log(out).cycles) >= 30


def test_a_recorded_dry_run_says_once_how_it_ended(capsys, tmp_path):
    path = tmp_path / "console.bin"
    path.write_bytes(firmware_run(tmp_path / "dry.mcap", XC330, seconds=1.0, arm=False).console)
    assert main(["log", str(path), "--controller", LAMP, "--out", str(tmp_path / "board.mcap")]) == 0
    assert (
        capsys.readouterr().err.count("every check passed; nothing was written: give --arm (on the console: arm)") == 1
    )


def test_a_recording_without_its_boot_is_not_known_to_be_of_this_firmware(capsys, tmp_path, recorded):
    _, _, last = recorded
    path, out = tmp_path / "console.bin", tmp_path / "board.mcap"
    boot = next(i for i, piece in enumerate(last.split(b"\0")) if checked(piece) and checked(piece)[0] == 1)
    path.write_bytes(b"\0".join(last.split(b"\0")[boot + 1 :]))
    assert main(["log", str(path), "--controller", LAMP, "--out", str(out)]) == 0
    assert "its boot was not recorded, so whether it is of lamp_robust on lamp-xc330" in capsys.readouterr().err


def test_records_of_another_format_are_named(capsys, tmp_path, recorded):
    _, _, last = recorded
    path = tmp_path / "console.bin"
    pieces = last.split(b"\0")
    boot = next(i for i, piece in enumerate(pieces) if checked(piece) and checked(piece)[0] == 1)
    body = bytearray(checked(pieces[boot]))
    body[1] += 1
    data = bytes(body) + crc16(bytes(body)).to_bytes(2, "little")
    parts = data.split(b"\0")  # shorter than 254 bytes each
    pieces[boot] = b"".join(bytes([len(part) + 1]) + part for part in parts)
    path.write_bytes(b"\0".join(pieces))
    status, _, err = asked(capsys, "log", path, "--controller", LAMP, "--out", tmp_path / "board.mcap")
    assert status == 2
    assert f"records have format {body[1]}, and this servolve reads format {body[1] - 1}" in err


def test_recordings_of_something_else_are_refused(capsys, tmp_path, recorded):
    run, _, last = recorded
    path, out = tmp_path / "console.bin", tmp_path / "board.mcap"
    path.write_bytes(last)
    weak = LAMP.replace("lamp-robust", "lamp-sts")
    for arguments, sentence in (
        ((path, "--controller", LAMP, "--rig", "lamp-xl330"), "was made from another rig or controller"),
        ((path, "--controller", weak, "--rig", "lamp-sts3215"), "another rig or controller"),
        ((path, "--controller", LAMP, "--run", 7), "the recording holds 1; give 1 to 1"),
        ((tmp_path / "none.bin", "--controller", LAMP), "cannot be read"),
    ):
        status, _, err = asked(capsys, "log", *arguments, "--out", out)
        assert status == 2, arguments
        assert sentence in err
        assert len(err.splitlines()) == 1
    path.write_bytes(b"\x81\x00garbage" * 1000)
    status, _, err = asked(capsys, "log", path, "--controller", LAMP, "--out", out)
    assert status == 2
    assert "holds no run" in err
    assert dumped_runs(b"", STS3215.rig, STS3215.controller) == ([], 0)
    assert run.outcome.done


@pytest.mark.parametrize("board", ["host", "stm32f405"])
def test_an_interrupt_stops_the_run_in_its_own_order(tmp_path, project, board):
    """Ctrl-C reaches every process of a terminal's group; the firmware is to hear of it from its console alone."""
    folder = project.parent / board
    assert main(["firmware", LAMP, "--board", board, "--out", str(folder), "--build"]) == 0
    log = tmp_path / "run.mcap"
    arguments = ["firmware", LAMP, "--board", board, "--out", folder, "--run", "--seconds", 3000, "--log", log]
    run = subprocess.Popen(
        [sys.executable, "-m", "servolve", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        while not (log.exists() and log.stat().st_size > 100_000):  # it has been running for a while
            assert run.poll() is None, run.communicate()
            time.sleep(0.05)
        os.killpg(run.pid, signal.SIGINT)
        _, err = run.communicate(timeout=60)
    finally:
        run.kill()
    assert run.returncode == 1
    assert err.splitlines()[-1] == "servolve: stopped: the console was told to stop"
    assert read_log(log).events[-1]["entered"] == "off"
    assert main(["replay", str(log)]) == 0
