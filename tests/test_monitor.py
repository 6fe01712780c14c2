"""Monitoring reads what the rig is and does, counts what it misses, and writes nothing."""

import json
import os
import pty
import re
import signal
import subprocess
import sys
import time
from itertools import islice

import pytest
from served_rig import serve, servolve

from controller import load_rig
from deploy.buses.lockstep_port import LockstepPort
from deploy.buses.open_bus import open_bus
from deploy.clock import LockstepClock
from deploy.commissioning.monitor import watch
from deploy.virtual.faults import parse_fault
from deploy.virtual.lockstep import LockstepBench
from deploy.virtual.rig import VirtualRig
from servolve.cli import main

X330 = load_rig("lamp-xc330")
PERIOD_S = 0.02
PATIENCE_S = 60.0
READS = (0x01, 0x02, 0x82, 0x92)  # ping, read, sync read, bulk read: the same in all protocols
RIGS = ("lamp-xc330", "lamp-xl430", "lamp-ax12", "lamp-sts3215")


def watched(rig, cycles, faults=()):
    """Watch a virtual rig in lock step; return the last view, its truth and the instructions that were sent."""
    virtual = VirtualRig(rig, faults=[parse_fault(fault) for fault in faults])
    sent = []
    with LockstepBench(virtual) as bench:
        bus = open_bus(LockstepPort(bench, rig.bus.baud), rig)
        place = 7 if rig.bus.protocol == "dynamixel-2.0" else 4
        bus.port.tap = lambda way, _, frame: sent.append(frame[place]) if way == "tx" else None
        try:
            view = list(islice(watch(bus, rig, LockstepClock(bench), PERIOD_S), cycles))[-1]
        finally:
            bus.close()
        return view, virtual.truth(), sent


@pytest.mark.parametrize("name", RIGS)
def test_it_sees_the_rig_as_it_is_and_only_reads(name):
    rig = load_rig(name)
    view, truth, sent = watched(rig, 16)
    for servo, angle in zip(view.servos, truth.joint_rad, strict=True):
        unit = 6.3 / servo.joint.product.ticks_per_turn
        assert servo.angle_rad == pytest.approx(angle, abs=2 * unit + servo.joint.product.backlash_rad)
        assert servo.scaled(servo.family.voltage) == pytest.approx(rig.supply_v, abs=0.2)
        assert 15 < servo.scaled(servo.family.temperature) < 45
        assert servo.values[servo.family.torque_enable] == 0
        assert (servo.missed, servo.errors) == (0, ())
    assert set(sent) <= set(READS)
    assert view.cycles == 16
    assert view.rate_hz == pytest.approx(1 / PERIOD_S, rel=0.1)


def test_who_is_silent_is_counted_and_the_others_are_read_on():
    view, _, _ = watched(X330, 50, ["dead=2@0.5"])
    a0, a1, a2 = view.servos
    assert (a0.missed, a2.missed) == (0, 0)
    assert 10 < a1.missed == a1.missed_in_a_row < 50
    assert view.t - a1.read_at > 0.3 > 0.1 > view.t - a0.read_at


def test_lost_replies_are_told_from_corrupt_ones():
    view, _, _ = watched(X330, 60, ["drop=0.1"])
    assert all(0 < servo.missed < 30 and servo.corrupt == 0 for servo in view.servos)
    view, _, _ = watched(X330, 60, ["corrupt=0.1"])
    assert sum(servo.corrupt for servo in view.servos) > 5


def test_a_hardware_error_is_put_in_words():
    view, _, _ = watched(X330, 20, ["overload=3@0.1"])
    assert [servo.errors for servo in view.servos] == [(), (), ("overload",)]


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    process = serve(tmp_path_factory.mktemp("rig"), "lamp-xc330")
    yield process
    process.kill()


def test_the_command_prints_lines_where_there_is_no_terminal(served):
    until = time.monotonic() + PATIENCE_S
    status = 1
    while status == 1 and time.monotonic() < until:  # a starved machine answers nobody for a while
        monitor = servolve(
            "rig", "monitor", "lamp-xc330", "--port", str(served.bus), "--seconds", "1", "--every", "0.2"
        )
        status, lines = monitor.end()
    assert status == 0
    lines = [line.split() for line in lines if " rad/s " in line]
    assert {line[1] for line in lines} == {"a0", "a1", "a2"}
    assert [line[2] for line in lines[:3]] == ["1", "2", "3"]
    assert all(abs(float(line[3])) < 0.1 for line in lines[-3:] if line[3] != "-")


@pytest.mark.parametrize("end", ["q", "SIGINT"])
def test_in_a_terminal_it_is_one_table_that_a_key_or_a_signal_ends(served, end):
    master, slave = pty.openpty()
    command = "import sys; from servolve.cli import main; sys.exit(main())"
    arguments = ("rig", "monitor", "lamp-xc330", "--port", str(served.bus))
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "80"}
    process = subprocess.Popen(
        [sys.executable, "-c", command, *arguments], stdin=slave, stdout=slave, stderr=slave, env=environment
    )
    os.close(slave)
    shown = b""
    try:
        while b"q ends it" not in shown or b" 5.0 " not in shown:  # a voltage: somebody has answered
            shown += os.read(master, 65536)
        if end == "q":
            os.write(master, b"q")
        else:
            process.send_signal(signal.SIGINT)
        while b"replies missed" not in shown:
            shown += os.read(master, 65536)
        assert process.wait(PATIENCE_S) == 0
    finally:
        process.kill()
        os.close(master)
    lines = [re.sub(rb"\x1b\[[0-9;?]*[a-zA-Z]", b"", line).decode() for line in re.split(b"[\r\n]", shown)]
    assert max(map(len, lines)) <= 80
    assert any("a1" in line and "\u2502" in line for line in lines)


def test_the_command_prints_json_lines(served, capfd):
    arguments = [
        "rig",
        "monitor",
        "lamp-xc330",
        "--port",
        str(served.bus),
        "--seconds",
        "0.5",
        "--every",
        "0",
        "--json",
    ]
    assert main(arguments) == 0
    samples = [json.loads(line) for line in capfd.readouterr().out.splitlines()]
    assert len(samples) > 3
    assert [servo["joint"] for servo in samples[-1]["servos"]] == ["a0", "a1", "a2"]
    assert samples[-1]["servos"][0]["load_unit"] == "A"


@pytest.mark.parametrize(
    ("arguments", "status", "expected"),
    [
        (["lamp-xc330", "--port", "/no/such/port"], 2, "cannot be opened"),
        (["paper-lamp", "--port", "/dev/null"], 2, "monitoring needs a bus"),
        (["lamp-xc330", "--port", "/dev/null", "--seconds", "0"], 2, "--seconds 0: is no time to watch"),
        (["lamp-xc330", "--port", "/dev/null", "--seconds", "nan"], 2, "--seconds nan"),
        (["lamp-xc330", "--port", "/dev/null", "--hz", "0"], 2, "--hz 0: is out of range"),
        (["lamp-xc330", "--port", "/dev/null", "--every", "-1"], 2, "--every -1"),
    ],
)
def test_wrong_arguments_are_one_sentence(arguments, status, expected, capfd):
    assert main(["rig", "monitor", *arguments]) == status
    error = capfd.readouterr().err
    assert expected in error
    assert error.count("\n") == 1


def test_a_rig_that_is_not_there(served, capfd, tmp_path):
    rig = tmp_path / "other.rig.toml"
    text = X330.text.replace('body = "lamp.xml"', f'body = "{X330.body}"')
    for servo in (1, 2, 3):
        text = text.replace(f"\nid = {servo}\n", f"\nid = {servo + 100}\n")
    rig.write_text(text)
    assert main(["rig", "monitor", str(rig), "--port", str(served.bus), "--seconds", "0.2"]) == 1
    assert "no servo of rig lamp-xc330 answers at 1000000 baud" in capfd.readouterr().err
