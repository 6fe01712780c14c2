"""The image that one would flash, under QEMU in lock step: what twin and host loop do, it does, byte by byte."""

import pytest
from firmware_runs import XC330, firmware_run, host_run, image
from rig_bench import torque_read_back

from deploy.firmware.qemu import Qemu
from deploy.logs.compare import compare
from deploy.logs.replay import replay
from deploy.states import State


def emulated(path, task, faults=(), **options):
    return firmware_run(path, task, faults, machine=lambda: Qemu(image(task, "stm32f405"), "netduinoplus2"), **options)


def test_host_loop_twin_and_emulated_board_write_the_same_goals_over_ten_seconds(tmp_path):
    host = host_run(tmp_path / "host.mcap", XC330, seconds=10.0)
    twin = firmware_run(tmp_path / "twin.mcap", XC330, seconds=10.0)
    board = emulated(tmp_path / "board.mcap", XC330, seconds=10.0)
    assert len(host.goals) == 500
    assert len(set(host.goals)) > 100
    assert board.goals == twin.goals == host.goals
    assert board.frames == twin.frames == host.frames
    assert board.outcome.bus_sha256 == twin.outcome.bus_sha256 == host.outcome.bus_sha256
    assert board.asked_per_cycle() == host.asked_per_cycle()
    assert board.console == twin.console  # every record of the log, and every word
    for name, run in (("host", host), ("twin", twin), ("board", board)):
        assert (run.outcome.state, run.outcome.done) == (State.OFF, True)
        assert run.seen["final_error_m"] <= 0.015
        assert compare(tmp_path / f"{name}.mcap").real_outcome.distance_m <= 0.015
    assert replay(tmp_path / "board.mcap").difference is None
    assert (tmp_path / "board.mcap").read_bytes() == (tmp_path / "twin.mcap").read_bytes()


def test_the_same_run_gives_the_same_bytes_twice(tmp_path):
    runs = [emulated(tmp_path / f"{n}.mcap", XC330, seconds=1.0) for n in range(2)]
    assert runs[0].outcome.bus_sha256 == runs[1].outcome.bus_sha256
    assert runs[0].console == runs[1].console


@pytest.mark.parametrize(
    "faults", [["dead=2@1.0"], ["overload=1@1.0"], ["sensor-silent@1.0"], ["drop=0.05", "corrupt=0.03"]], ids=str
)
def test_faults_end_as_under_the_twin(tmp_path, faults):
    twin = firmware_run(tmp_path / "twin.mcap", XC330, faults, seconds=0.8)
    board = emulated(tmp_path / "board.mcap", XC330, faults, seconds=0.8)
    assert board.outcome == twin.outcome
    assert board.console == twin.console
    assert board.outcome.bus_sha256 == twin.outcome.bus_sha256
    assert board.outcome.done is (len(faults) == 2)
    assert set(torque_read_back(board.virtual).values()) == {0}
