"""A host loop that is killed: what its servos do when nobody talks to them any more, in the rig's own time.

The loop runs in a process of its own until it is killed. What it had sent by then is in its log; the same bytes at the
same times bring a second rig to the same moment, and then there is silence.
"""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from controller import load_rig
from controller.terminals import joint_scale
from deploy.logs.log import read_log
from deploy.virtual.rig import VirtualRig

RIGS = {name: load_rig(name) for name in ("lamp-xl430", "lamp-sts3215")}
TESTS = Path(__file__).parent

# square waves without a slew limit: after each step a joint has far to go
LOOP = """
import sys
from pathlib import Path
from dataclasses import replace
from rig_bench import Bench, SWAY
from controller import load_rig, parse_controller
text = SWAY.replace("slew_rad_s = 1.5", "")
head, tail = text.index("program"), text.index("[controller]")
text = 'program = "(list 0 (* 0 (+ px s0)) (* 30 (sign (osc-wave 1 0))))"\\n' + text[tail:]
Bench(Path(sys.argv[2]), rig=load_rig(sys.argv[1])).run(600.0, controller=parse_controller(text, "square"))
"""


def killed_run(name, folder):
    """Return the log of a loop that was killed in the midst of its run."""
    loop = subprocess.Popen(
        [sys.executable, "-c", LOOP, name, str(folder)], env={**os.environ, "PYTHONPATH": str(TESTS)}
    )
    path = folder / "run.mcap"
    try:
        while loop.poll() is None:
            if path.exists() and path.stat().st_size > 20_000 and read_log(path).cycles[60:]:
                break
            time.sleep(0.1)
        assert loop.poll() is None, "the loop ended by itself"
    finally:
        loop.send_signal(signal.SIGKILL)
        loop.wait()
    return read_log(path)


def silent_rig(rig, log):
    """Return a rig at the moment when a loop fell silent that had just sent a joint far away, and that moment."""
    goals = [cycle["goal_counts"]["a2"] for cycle in log.cycles]
    k = next(k for k in range(40, len(goals)) if abs(goals[k] - goals[k - 1]) > 100)
    end = log.cycles[k + 1]["t"] - 0.001
    virtual = VirtualRig(rig)
    sent = [frame for frame in log.messages["/bus"] if frame["direction"] == "tx" and frame["t"] < end]
    for frame in sent:
        last = virtual.transmit(bytes.fromhex(frame["hex"]), frame["t"])
        virtual.replies_until(last)
    return virtual, last, goals[k]


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    return {name: killed_run(name, tmp_path_factory.mktemp(name)) for name in RIGS}


def test_a_log_of_a_killed_loop_can_be_read(logs):
    for log in logs.values():
        assert not log.complete and len(log.cycles) > 60


def test_the_watchdog_of_an_xl430_stops_motion_within_its_time(logs):
    rig = RIGS["lamp-xl430"]
    virtual, silence, goal = silent_rig(rig, logs["lamp-xl430"])
    joint, servo = rig.joints[2], virtual.servos[2]
    assert servo.table["torque_enable"] == 1
    virtual.advance(silence + rig.safety.watchdog_s - 0.001)
    assert servo.table["bus_watchdog"] == round(rig.safety.watchdog_s / 0.02)
    virtual.advance(silence + rig.safety.watchdog_s + 0.001)
    assert servo.table["bus_watchdog"] == 255
    tripped = virtual.truth().joint_rad[2]
    far = abs((goal - joint.zero_tick) * joint_scale(joint) - tripped)
    assert far > 0.2  # it was on its way
    virtual.advance(silence + rig.safety.watchdog_s + 0.3)
    assert abs(virtual.truth().joint_vel[2]) < 0.05
    assert abs(virtual.truth().joint_rad[2] - tripped) < 0.5 * far


def test_a_servo_without_a_watchdog_goes_on_to_its_last_goal(logs):
    rig = RIGS["lamp-sts3215"]
    virtual, silence, goal = silent_rig(rig, logs["lamp-sts3215"])
    joint = rig.joints[2]
    virtual.advance(silence + 1.0)
    assert abs((goal - joint.zero_tick) * joint_scale(joint) - virtual.truth().joint_rad[2]) < 0.15
    assert virtual.servos[2].table["torque_enable"] == 1  # so the start says that there is none
