"""The suite for any rig, put to a served one: what it refuses, and that torque is off however it ends."""

import json
import re
import signal
import subprocess
import sys
import time

import pytest
from lab_report import LabReport, Measurement
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


@pytest.mark.parametrize("name", ["lamp-sts3215", "lamp-ax12"])
def test_servos_of_other_families_are_tested_and_reported_on(serve_rig, tmp_path, name):
    bus, told = serve_rig(name).bus, tmp_path / "report.json"
    run = suite("--port", bus, "--rig-file", name, "--arm", "--report", told, "-k", "right_one or health or after_all")
    said, _ = run.communicate(timeout=WAIT_S)
    assert run.returncode == 0, said
    report = json.loads(told.read_text())
    assert (report["rig"]["rig"], report["torque_off"]) == (name, True)
    assert [servo["id"] for servo in report["servos"]] == [1, 2, 3]
    assert set(report["tests"].values()) == {"passed"} and len(report["tests"]) == 3
    assert {measured["what"] for measured in report["measured"]} == {"supply", "temperature"}
    assert any("no bus watchdog" in finding for finding in report["findings"])


def test_the_plug_of_a_served_rig_is_pulled_through_its_control_socket(serve_rig, tmp_path):
    bus = serve_rig(RIG.name, "--control", tmp_path / "control").bus
    arguments = ("--port", bus, "--rig-file", RIG.name, "--arm", "-k", "unplugged or after_all", "-rs")
    run = suite(*arguments, "--control", tmp_path / "control")
    told, _ = run.communicate(timeout=WAIT_S)
    assert run.returncode == 0, told
    assert "2 passed" in told
    run = suite(*arguments)
    told, _ = run.communicate(timeout=WAIT_S)
    assert "1 passed, 1 skipped" in told and "nobody is there to pull the plug; say --hands" in told
    assert read_bytes(bus, RIG) == [0, 0, 0]


def test_a_report_as_html_says_what_was_measured_and_quotes_what_it_must(tmp_path):
    report = LabReport({"rig": "a<b>"}, [{"joint": "a0", "id": 1}], ["warning: x & y"], {"test_x": "passed"})
    report.measured.append(Measurement("test_x", "round trip", "ms", {"p50": 0.81234}, "at most 20"))
    report.torque_off = True
    report.save(tmp_path / "r.html")
    text = (tmp_path / "r.html").read_text()
    for said in ("a&lt;b&gt;", "x &amp; y", "p50 0.8123", "at most 20", "off, as read back", "test_x"):
        assert said in text
    assert "<b>not known" not in text


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
        (("--rig", "lamp-xl330", "--rig-file", RIG.name), "--rig: lamp-xl330 and lamp-xc330 are two rigs; name one"),
        (("--rig", "firmware", "--rig-file", "lamp-ax12"), "ax-12a servos speak dynamixel-1.0, and firmware speaks"),
    ],
)
def test_what_is_left_out_is_asked_for(arguments, sentence):
    run = suite(*arguments)
    told, _ = run.communicate(timeout=WAIT_S)
    assert run.returncode == pytest.ExitCode.USAGE_ERROR
    assert sentence in told and "Traceback" not in told


@pytest.mark.parametrize("rig", ["virtual", "firmware", "firmware:lamp-sts3215"])
def test_whole_runs_are_tested_by_host_loop_and_by_firmware(rig):
    run = suite("--rig", rig, "-k", "test_run or after_all")
    told, _ = run.communicate(timeout=WAIT_S)
    assert run.returncode == 0, told
    assert re.search(r"\b8 passed|\b7 passed, 1 skipped", told)
    assert "test_a_run_moves_every_joint_and_ends_with_torque_off PASSED" in told
