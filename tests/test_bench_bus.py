"""The bus bench's parts: every loop runs on the served rig and counts what it says. No test here judges a rate."""

import pytest

from controller.controller_file import parse_controller
from controller.rig_file import load_rig
from deploy.virtual import dynamixel2 as dxl
from servolve.bench_bus import run_loop, served
from servolve.bench_bus_loop import GOAL, PLAIN_BYTES, RIG_FILE, STATE, controller_text


def test_the_bench_drives_four_servos_at_100_hz():
    rig = load_rig(RIG_FILE)
    assert (len(rig.joints), rig.period_s, rig.bus.baud, rig.bus.return_delay_us) == (4, 0.01, 1_000_000, 0)
    assert len(parse_controller(controller_text(rig), "here").outputs) == 4


def test_a_plain_cycle_has_as_many_bytes_as_is_said():
    ids = bytes(range(1, 5))
    read = dxl.encode(dxl.BROADCAST, dxl.SYNC_READ, bytes((STATE[0], 0, STATE[1], 0)) + ids)
    write = dxl.encode(dxl.BROADCAST, dxl.SYNC_WRITE, bytes((GOAL[0], 0, GOAL[1], 0)) + bytes(4 * 5))
    replies = 4 * len(dxl.encode_status(1, 0, bytes(STATE[1])))
    assert len(read) + len(write) + replies == PLAIN_BYTES


@pytest.mark.parametrize("name", ["servolve", "dynamixel_sdk", "rustypot"])
def test_a_loop_measures_itself(name):
    with served() as port:
        found = run_loop(name, port, 0.5)
    assert set(found) == {"cycle_s", "wire_s", "cpu", "in_time"}
    assert found["wire_s"] >= 10e-6 * PLAIN_BYTES
    assert 0.0 <= found["in_time"] <= 1.0 and found["cycle_s"] > 0.0 and found["cpu"] > 0.0


def test_the_rig_without_wire_time_is_counted():
    with served("--no-wire-time") as port:
        assert run_loop("flood", port, 0.3)["cycles_per_s"] > 0.0
