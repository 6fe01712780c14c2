"""`servolve deploy` against `servolve rig serve`, each a process of its own: signals, and a server that dies."""

import json
import os
import signal
import subprocess
import termios

import pytest
from lamp_controllers import SWAY
from served_rig import read_bytes, servolve

from controller import load_rig
from deploy.logs.log import read_log
from deploy.logs.replay import replay

RIG = load_rig("lamp-xc330")
TRIES = 8
STARVED = ("answered too late", "no servo has answered", "gave no reply", "host was silent", "took longer than")
"""How a run ends that the machine, busy with other tests, kept from its processor: rightly, and not what is asked."""


@pytest.fixture
def server(serve_rig):
    return serve_rig(RIG.name)


def deploy(tmp_path, port, *arguments, seconds="60", log="run.mcap", stdin=subprocess.DEVNULL):
    (tmp_path / "sway.controller.toml").write_text(SWAY)
    return servolve(
        *("deploy", f"{tmp_path}/sway.controller.toml", "--rig", "lamp-xc330", "--port", port),
        *("--sensor-port", f"{tmp_path}/sensors", "--log", f"{tmp_path}/{log}", "--seconds", seconds, *arguments),
        stdin=stdin,
    )


def json_object(told):
    """Return the one JSON object among the lines of both streams, whose order among each other is chance."""
    (line,) = (line for line in told if line.startswith("{"))
    return json.loads(line)


def torque(path):
    return read_bytes(path, RIG)


def sentences(told):
    return [line for line in told if line.startswith("servolve: ") and "warning" not in line]


@pytest.mark.parametrize(
    ("number", "by_tcp", "as_json"),
    [
        (signal.SIGINT, False, False),
        (signal.SIGTERM, True, True),
        (signal.SIGHUP, False, False),
        (signal.SIGQUIT, False, True),
    ],
)
def test_a_signal_ends_the_run_with_torque_off(tmp_path, server, number, by_tcp, as_json):
    run = deploy(tmp_path, server.tcp if by_tcp else f"{tmp_path}/bus", "--arm", *(["--json"] if as_json else []))
    try:
        run.wait_for("lamp-xc330: running")
        run.process.send_signal(number)
        status, told = run.end()
    finally:
        run.kill()
    assert status == 1
    assert sentences(told) == [f"servolve: stopped: {number.name} was received"]
    assert not any("Traceback" in line for line in told)
    assert torque(tmp_path / "bus") == [0, 0, 0]
    log = read_log(tmp_path / "run.mcap")
    assert log.complete
    assert log.events[-1]["entered"] == "off"
    if log.cycles:
        assert replay(tmp_path / "run.mcap").difference is None
    if as_json:
        said = json.loads(next(line for line in reversed(told) if line.startswith("{")))
        assert (said["state"], said["done"], said["fault"]) == ("off", False, None)


def test_a_key_at_the_terminal_ends_the_run(tmp_path, server):
    master, slave = os.openpty()
    try:
        run = deploy(tmp_path, f"{tmp_path}/bus", "--arm", stdin=slave)
        try:
            run.wait_for("lamp-xc330: running")
            os.write(master, b"x")
            os.write(master, b"q")
            status, told = run.end()
        finally:
            run.kill()
        assert termios.tcgetattr(slave)[3] & termios.ICANON  # the terminal is as it was
    finally:
        os.close(master)
        os.close(slave)
    assert status == 1
    assert sentences(told) == ["servolve: stopped: a key was pressed"]
    assert torque(tmp_path / "bus") == [0, 0, 0]


def test_a_server_that_dies_is_one_sentence(tmp_path, server):
    run = deploy(tmp_path, f"{tmp_path}/bus", "--arm")
    try:
        run.wait_for("lamp-xc330: running")
        server.kill()
        status, told = run.end()
    finally:
        run.kill()
    assert status == 1
    assert len(sentences(told)) == 1
    assert "port is gone" in sentences(told)[0]
    assert (
        "torque could not be switched off for certain on a0 (servo 1), a1 (servo 2), a2 (servo 3)" in sentences(told)[0]
    )
    assert not any("Traceback" in line for line in told)
    log = read_log(tmp_path / "run.mcap")
    assert log.complete and log.events[-1]["kind"] == "torque"


def test_a_port_is_locked_while_a_run_uses_it(tmp_path, server):
    run = deploy(tmp_path, f"{tmp_path}/bus", "--arm")
    try:
        run.wait_for("lamp-xc330: homing")
        status, told = deploy(tmp_path, f"{tmp_path}/bus", log="second.mcap").end()
        assert status == 2
        assert sentences(told) == [f"servolve: {tmp_path}/bus: is in use by another program; end that one first"]
        run.process.send_signal(signal.SIGINT)
        assert run.end()[0] == 1
    finally:
        run.kill()


def test_a_run_in_real_time_ends_well(tmp_path, server):
    for _ in range(TRIES):
        run = deploy(tmp_path, f"{tmp_path}/bus", "--arm", "--json", seconds="1")
        try:
            status, told = run.end()
        finally:
            run.kill()
        if not any(words in line for line in sentences(told) for words in STARVED):
            break
    assert status == 0, told
    said = json_object(told)
    assert (said["state"], said["cycles"], said["torque_unsure"]) == ("off", 50, [])
    assert torque(tmp_path / "bus") == [0, 0, 0]
    assert replay(tmp_path / "run.mcap").difference is None


def test_without_arm_nothing_is_written(tmp_path, server):
    run = deploy(tmp_path, f"{tmp_path}/bus")
    status, told = run.end()
    assert status == 0
    assert any("nothing was written" in line for line in told)
    assert any("a2" in line and "off" in line for line in told)
    frames = [
        bytes.fromhex(m["hex"]) for m in read_log(tmp_path / "run.mcap").messages["/bus"] if m["direction"] == "tx"
    ]
    assert {frame[7] for frame in frames} == {0x01, 0x02}
