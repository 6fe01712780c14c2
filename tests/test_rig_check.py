"""`servolve rig check` at the command line: what it tells, what it writes with consent, and how that is undone."""

import json
import os
import pty
import time

import pytest
from served_rig import servolve

from controller import load_rig
from controller.registers import registers
from deploy.buses.open_bus import open_bus
from deploy.buses.port import SerialPort
from servolve.cli import main

RIG = load_rig("lamp-xc330")
TABLE = registers(RIG.joints[0].product)
PATIENCE_S = 120.0


def register(served, servo, name, value=None):
    """Read, or write, a register as another client."""
    bus = open_bus(SerialPort(str(served.bus), RIG.bus.baud), RIG)
    try:
        if value is not None:
            bus.write_register(servo, TABLE[name], value, attempts=20)
        return bus.read_register(servo, TABLE[name], attempts=20)
    finally:
        bus.close()


@pytest.fixture
def served(serve_rig):
    return serve_rig("lamp-xc330", "--no-wire-time")


def told(capfd, *arguments):
    """Run a check until a busy machine lets it see every servo; return its status and what it told."""
    until = time.monotonic() + PATIENCE_S
    while True:
        status = main(["rig", "check", "lamp-xc330", *arguments, "--json"])
        captured = capfd.readouterr()
        found = json.loads(captured.out)
        if time.monotonic() > until or not any("answer" in finding["text"] for finding in found["findings"]):
            return status, found, captured.err


def test_a_sound_rig_is_ready_and_a_wrong_register_is_put_right_and_back(served, capfd, tmp_path):
    port = ("--port", str(served.bus))
    main(["rig", "check", "lamp-xc330", *port, "--sensor-port", str(served.sensors), "--json"])
    assert "no line has come" not in capfd.readouterr().out
    status, found, _ = told(capfd, *port)
    assert (status, found["ready"], [f for f in found["findings"] if f["level"] == "error"]) == (0, True, [])
    assert [servo["registers"]["id"] for servo in found["servos"]] == [1, 2, 3]

    register(served, 2, "return_delay_time", 250)
    status, found, error = told(capfd, *port)
    assert status == 1
    assert "is not ready: 1 error; change what the table says, or let --fix write the registers" in error
    fixes = [finding["fix"] for finding in found["findings"] if finding["fix"]]
    assert [(fix["servo"], fix["register"], fix["from"], fix["to"]) for fix in fixes] == [
        (2, "return_delay_time", 250, 0)
    ]
    assert register(served, 2, "return_delay_time") == 250, "a check writes nothing"

    backup = tmp_path / "backup.json"
    status, found, _ = told(capfd, *port, "--fix", "--yes", "--backup", str(backup))
    assert (status, found["ready"], len(found["changed"])) == (0, True, 1)
    assert register(served, 2, "return_delay_time") == 0
    status, found, _ = told(capfd, *port, "--restore", str(backup), "--yes", "--backup", str(tmp_path / "second.json"))
    assert (status, found["ready"], len(found["changed"])) == (0, False, 1)
    assert register(served, 2, "return_delay_time") == 250


@pytest.mark.parametrize(("answer", "after"), [(b"n\n", 250), (b"y\n", 0)])
def test_it_asks_before_it_writes(served, tmp_path, answer, after):
    register(served, 1, "return_delay_time", 250)
    master, slave = pty.openpty()
    arguments = ("lamp-xc330", "--port", str(served.bus), "--fix", "--backup", str(tmp_path / "backup.json"))
    process = servolve("rig", "check", *arguments, stdin=slave)
    os.close(slave)
    process.wait_for("to be changed")
    os.write(master, answer)
    process.end()
    os.close(master)
    assert register(served, 1, "return_delay_time") == after
    assert (tmp_path / "backup.json").exists() == (after == 0)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["lamp-xc330", "--port", "/dev/null", "--fix"], "there is nobody to ask; add --yes to agree"),
        (["lamp-xc330", "--port", "/dev/null", "--fix", "--restore", "x", "--yes"], "choose one of them"),
        (["lamp-xc330", "--port", "/dev/null", "--yes"], "--yes: means nothing without --fix or --restore"),
        (["lamp-xc330", "--port", "/dev/null", "--restore", "/no/such", "--yes"], "can not be read (No such file"),
        (["paper-lamp", "--port", "/dev/null"], "a check needs a bus"),
        (["lamp-xc330", "--port", "/no/such"], "cannot be opened"),
        (["lamp-xc330"], "rig check: give a value for --port; `servolve rig check --help` lists what it takes"),
    ],
)
def test_wrong_arguments_are_one_sentence(arguments, expected, capfd, monkeypatch):
    monkeypatch.setattr("sys.stdin", open(os.devnull))  # noqa: SIM115, PTH123
    assert main(["rig", "check", *arguments]) == 2
    error = capfd.readouterr().err
    assert expected in error
    assert error.count("\n") == 1
