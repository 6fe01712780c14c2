"""On a quiet machine: the host loop keeps its time against a rig server in another process. Run by `make accept`."""

import sys

import pytest

from servolve.bench_bus import CYCLES_PER_S_MIN, run_loop, served

SECONDS = 20.0
IN_TIME_MIN = 0.99
CPU_MAX = 0.35
CYCLE_TO_WIRE_MAX = 1.3


@pytest.fixture(scope="module")
def loop():
    """Run the host loop at 100 Hz on four virtual servos at 1 Mbit/s without return delay."""
    with served() as port:
        return run_loop("servolve", port, SECONDS)


def say(capsys, text):
    with capsys.disabled():
        sys.stdout.write(f"\n{text}\n")


def test_99_percent_of_periods_are_in_time_at_100_hz(loop, capsys):
    say(capsys, f"{100 * loop['in_time']:.2f} % of the periods of 10 ms were done in time")
    assert loop["in_time"] >= IN_TIME_MIN


def test_the_loop_leaves_the_processor_alone(loop, capsys):
    say(capsys, f"{100 * loop['cpu']:.0f} % of a core")
    assert loop["cpu"] < CPU_MAX


def test_a_cycle_takes_little_longer_than_its_bytes(loop, capsys):
    ratio = loop["cycle_s"] / loop["wire_s"]
    say(
        capsys,
        f"mean cycle {1e3 * loop['cycle_s']:.2f} ms, {ratio:.2f} of the {1e3 * loop['wire_s']:.2f} ms of its bytes",
    )
    assert ratio <= CYCLE_TO_WIRE_MAX


def test_the_rig_serves_1000_four_servo_cycles_a_second_without_wire_time(capsys):
    with served("--no-wire-time") as port:
        rate = run_loop("flood", port, 5.0)["cycles_per_s"]
    say(capsys, f"{rate:.0f} four-servo cycles a second")
    assert rate >= CYCLES_PER_S_MIN
