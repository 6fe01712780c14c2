"""Firmware in the loop: the native twin does what the host loop does, byte by byte, and ends where it ends."""

from dataclasses import replace

import pytest
from firmware_runs import STS3215, XC330, firmware_run, host_run, image
from rig_bench import torque_read_back

from controller.registers import registers
from deploy.firmware.twin import TwinProcess
from deploy.logs.compare import compare
from deploy.logs.replay import replay
from deploy.states import State

TASKS = pytest.mark.parametrize("task", [XC330, STS3215], ids=lambda task: task.rig.name)


@TASKS
def test_goals_bytes_and_motion_are_those_of_the_host_loop_over_ten_seconds(tmp_path, task):
    host = host_run(tmp_path / "host.mcap", task, seconds=10.0)
    twin = firmware_run(tmp_path / "twin.mcap", task, seconds=10.0)
    assert len(host.goals) == 500
    assert len(set(host.goals)) > 100  # it really moves
    assert twin.goals == host.goals
    assert twin.asked_per_cycle() == host.asked_per_cycle()
    assert twin.frames == host.frames
    assert twin.outcome.bus_sha256 == host.outcome.bus_sha256
    assert twin.log.messages["/truth"] == host.log.messages["/truth"]
    assert twin.log.messages["/health"] == host.log.messages["/health"]
    assert twin.told() == host.told()
    bits = [[(cycle["terminal_bits"], cycle["output_bits"]) for cycle in run.log.cycles] for run in (host, twin)]
    assert bits[0] == bits[1]
    for run in (host, twin):
        assert (run.outcome.state, run.outcome.done, run.outcome.faulty) == (State.OFF, True, False)
        assert run.seen["final_error_m"] <= 0.015
        assert run.seen["hops"] >= 3
        assert set(torque_read_back(run.virtual).values()) == {0}
    assert twin.seen == host.seen
    assert twin.outcome.pose == host.outcome.pose
    assert replay(tmp_path / "twin.mcap").difference is None
    sides = [compare(tmp_path / f"{name}.mcap") for name in ("host", "twin")]
    assert sides[0].rmse_deg_max == sides[1].rmse_deg_max
    assert sides[0].real_outcome == sides[1].real_outcome


def test_the_same_run_gives_the_same_bytes_however_often_the_firmware_wakes(tmp_path):
    runs = [firmware_run(tmp_path / f"{n}.mcap", XC330, seconds=2.0, restless=n == 2) for n in range(3)]
    assert len({run.outcome.bus_sha256 for run in runs}) == 1
    assert len({run.console for run in runs}) == 1
    assert len({(tmp_path / f"{n}.mcap").read_bytes() for n in range(3)}) == 1


def test_a_dry_run_reads_and_writes_nothing(tmp_path):
    host = host_run(tmp_path / "host.mcap", XC330, seconds=2.0, arm=False)
    twin = firmware_run(tmp_path / "twin.mcap", XC330, seconds=2.0, arm=False)
    assert (twin.outcome.state, twin.outcome.done, twin.outcome.touched) == (State.OFF, True, False)
    assert twin.outcome.reason == host.outcome.reason
    assert [reading.values for reading in twin.outcome.readings] == [r.values for r in host.outcome.readings]
    assert twin.frames == host.frames


def test_a_derated_run_sets_the_ceiling_that_the_host_loop_sets(tmp_path):
    host = host_run(tmp_path / "host.mcap", XC330, seconds=0.3, derate=0.37)
    twin = firmware_run(tmp_path / "twin.mcap", XC330, seconds=0.3, derate=0.37)
    ceiling = registers(XC330.rig.joints[0].product)["goal_pwm"]
    ends = [[servo.table[ceiling.name] for servo in run.virtual.servos] for run in (host, twin)]
    assert ends[0] == ends[1] == [round(885 * 0.37)] * 3
    assert twin.outcome.bus_sha256 == host.outcome.bus_sha256


@pytest.mark.parametrize("at", [0.1, 0.31, 0.5, 1.2])
def test_a_person_stops_the_run_in_any_state(tmp_path, at):
    twin = firmware_run(
        tmp_path / "twin.mcap", XC330, seconds=5.0, stop=lambda virtual: "enough" if virtual.now >= at else None
    )
    assert (twin.outcome.state, twin.outcome.done) == (State.OFF, False)
    assert twin.outcome.reason == "stopped: the console was told to stop"
    assert [event["text"] for event in twin.log.events if event["kind"] == "stop"] == [twin.outcome.reason]
    assert twin.virtual.now < at + 0.5
    assert set(torque_read_back(twin.virtual).values()) == {0}


STOP, START = 1, 2


class Pressing:
    """Stand between bench and firmware, with a finger on its inputs."""

    def __init__(self, firmware, press, hush=b""):
        self.firmware = firmware
        self.press = press
        self.hush = hush

    def resume(self, given):
        console = given.console.replace(self.hush, b"")
        return self.firmware.resume(replace(given, inputs=self.press(given.now_us * 1e-6), console=console))

    def close(self):
        self.firmware.close()


@pytest.mark.parametrize("at", [0.1, 0.32, 0.5, 1.2])
def test_the_stop_input_stops_the_run_in_any_state(tmp_path, at):
    twin = firmware_run(
        tmp_path / "twin.mcap",
        XC330,
        seconds=5.0,
        machine=lambda: Pressing(TwinProcess(image(XC330, "host")), lambda now: STOP if now >= at else 0),
    )
    assert (twin.outcome.state, twin.outcome.done) == (State.OFF, False)
    assert twin.outcome.reason == "stopped: the stop input is active"
    assert twin.virtual.now < at + 0.5
    assert set(torque_read_back(twin.virtual).values()) == {0}


def test_the_start_input_does_what_arm_and_start_do(tmp_path):
    pressed = firmware_run(
        tmp_path / "twin.mcap",
        XC330,
        seconds=1.0,
        machine=lambda: Pressing(
            TwinProcess(image(XC330, "host")), lambda now: START if now >= 0.1 else 0, b"arm\nstart\n"
        ),
    )
    assert (pressed.outcome.state, pressed.outcome.done, pressed.outcome.cycles) == (State.OFF, True, 50)
    assert 0.13 <= pressed.frames[0][1] <= 0.15  # not before it was steady
