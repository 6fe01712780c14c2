"""The suite for any rig, put to a served one: what it refuses, and that torque is off however it ends."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from dynamixel_sdk import COMM_SUCCESS, PacketHandler, PortHandler

from controller import load_rig

RIG = load_rig("lamp-xc330")
ROOT = Path(__file__).parent.parent
TORQUE_ENABLE = 64
WAIT_S = 60.0  # for a machine under load; nothing here is measured
POLITE = {**os.environ, "PYTHONUNBUFFERED": "1"}


@pytest.fixture
def serve(tmp_path):
    """Return a function that serves a rig in a process of its own and gives its bus and its sensor node."""
    processes = []

    def start(*arguments):
        bus, node = tmp_path / "bus", tmp_path / "node"
        command = "import sys; from servolve.cli import main; sys.exit(main())"
        process = subprocess.Popen(
            [sys.executable, "-c", command, "rig", "serve", RIG.name, "--link", bus, "--sensor-link", node, *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=POLITE,
        )
        processes.append(process)
        for line in process.stdout:
            if str(node) in line:
                return bus, node
        return pytest.fail("the rig is not served")

    yield start
    for process in processes:
        process.kill()
        process.wait()
        process.stdout.close()


def suite(*arguments):
    return subprocess.Popen(
        [sys.executable, "-m", "pytest", "-v", "-p", "no:cacheprovider", "hil_tests", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=ROOT,
        env=POLITE,
    )


def registers_of(path, address):
    """Read a one-byte register of every servo with the vendor's own client."""
    port, packets = PortHandler(str(path)), PacketHandler(2.0)
    assert port.setBaudRate(RIG.bus.baud)
    try:
        found = []
        for joint in RIG.joints:
            for _ in range(20):  # the SDK's own time-outs do not know a busy machine
                value, result, _ = packets.read1ByteTxRx(port, joint.id, address)
                if result == COMM_SUCCESS:
                    found.append(value)
                    break
        return found
    finally:
        port.closePort()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_in_mid_test_leaves_no_torque(serve, number):
    bus, _ = serve()
    run = suite("--port", bus, "--rig-file", RIG.name, "--arm", "-k", "step")
    try:
        told = ""
        while "test_a_step_moves" not in told:  # its line ends when it does
            told += run.stdout.read(1) or pytest.fail(told)
        time.sleep(1.5)  # it holds its joints for several seconds; a second client on the bus would disturb it
        run.send_signal(number)
        told, _ = run.communicate(timeout=WAIT_S)
    finally:
        run.kill()
    assert run.returncode == pytest.ExitCode.INTERRUPTED
    assert f"{number.name} was received" in told
    assert registers_of(bus, TORQUE_ENABLE) == [0, 0, 0]


def test_servos_are_tested_without_a_sensor_node(serve):
    bus, _ = serve()
    run = suite("--port", bus, "--rig-file", RIG.name, "--arm", "-k", "right_one or gain or locked or after_all")
    told, _ = run.communicate(timeout=WAIT_S)
    assert run.returncode == 0, told
    assert "4 passed" in told


def test_a_rig_that_is_not_the_one_is_left_alone(serve):
    bus, _ = serve()
    run = suite("--port", bus, "--rig-file", "lamp-xl330", "--arm")
    told, _ = run.communicate(timeout=WAIT_S)
    assert run.returncode == pytest.ExitCode.TESTS_FAILED
    assert "nothing was written: joint a0 (servo 1): is a model 1230, the rig says xl330-m288" in told
    assert not re.search("PASSED|FAILED|ERROR", told)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--port", "/dev/null", "--arm"), "--port: which rig is it? name it with --rig-file"),
        (("--port", "/dev/null", "--rig-file", RIG.name), "--port: the joints of the rig will move; say --arm"),
    ],
)
def test_what_is_left_out_is_asked_for(arguments, sentence):
    run = suite(*arguments)
    told, _ = run.communicate(timeout=WAIT_S)
    assert run.returncode == pytest.ExitCode.USAGE_ERROR
    assert sentence in told and "Traceback" not in told
