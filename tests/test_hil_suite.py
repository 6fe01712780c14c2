"""The suite for any rig, put to a served one: what it refuses, and that torque is off however it ends."""

import re
import signal
import subprocess
import sys
import time

import pytest
from served_rig import POLITE, ROOT, WAIT_S, read_bytes

from controller import load_rig

RIG = load_rig("lamp-xc330")


def suite(*arguments):
    return subprocess.Popen(
        [sys.executable, "-m", "pytest", "-v", "-p", "no:cacheprovider", "hil_tests", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=ROOT,
        env=POLITE,
    )


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_in_mid_test_leaves_no_torque(serve_rig, number):
    bus = serve_rig(RIG.name).bus
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
    assert read_bytes(bus, RIG) == [0, 0, 0]


def test_servos_are_tested_without_a_sensor_node(serve_rig):
    bus = serve_rig(RIG.name).bus
    run = suite("--port", bus, "--rig-file", RIG.name, "--arm", "-k", "right_one or gain or locked or after_all")
    told, _ = run.communicate(timeout=WAIT_S)
    assert run.returncode == 0, told
    assert "4 passed" in told


def test_a_rig_that_is_not_the_one_is_left_alone(serve_rig):
    bus = serve_rig(RIG.name).bus
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
