"""Firmware's bench: whoever asks the same at the same time meets the same rig as the host loop's lock step gives it."""

import hashlib
import itertools

import pytest
from host_as_firmware import HostAsFirmware
from rig_bench import RIG, Bench, sway

from controller.errors import RunError
from controller.rig_file import load_rig
from deploy.firmware.bench import FirmwareBench
from deploy.firmware.machine import Taken
from deploy.host_loop import RunOptions
from deploy.states import State
from deploy.virtual import dynamixel2 as dxl
from deploy.virtual.faults import parse_fault
from deploy.virtual.rig import VirtualRig

FAULTS = ("drop=0.03", "corrupt=0.03", "late=0.02:5", "sensor-drop=0.2", "dead=2@1.1", "overload=1@1.0")


def run_on_bench(tmp_path, rig, controller, faults, restless=False):
    """Run the host loop as firmware; return its outcome, its log's bytes, and the digest of what passed."""
    digest = hashlib.sha256()
    virtual = VirtualRig(rig, faults=[parse_fault(fault) for fault in faults])
    path = tmp_path / f"{restless}.mcap"
    firmware = HostAsFirmware(rig, controller, RunOptions(0.4, 0.0, 0.6, True, 1.0), path)
    bench = FirmwareBench(virtual, firmware, lambda _, t, data: digest.update(data), restless=restless)
    try:
        while True:
            _, taken = bench.wake()
            bench.send(taken)
            if taken.console == b"over":
                break
            bench.wait(taken)
    finally:
        firmware.close()
    bench.flush()
    return firmware.outcome, path.read_bytes(), digest.hexdigest(), virtual


@pytest.mark.parametrize("faults", [(), FAULTS[:1], FAULTS[:4], FAULTS[4:5]], ids=" ".join)
def test_the_host_loop_meets_the_same_rig_on_both_benches(tmp_path, faults):
    on = Bench(tmp_path, *faults)
    expected = on.run(0.6)
    outcome, log, digest, virtual = run_on_bench(tmp_path, RIG, sway(), faults)
    assert digest == outcome.bus_sha256
    assert (outcome.state, outcome.cycles, outcome.missed_replies) == (
        expected.state,
        expected.cycles,
        expected.missed_replies,
    )
    assert (outcome.bus_bytes, outcome.bus_sha256) == (expected.bus_bytes, expected.bus_sha256)
    assert virtual.truth().base_pos == pytest.approx(on.virtual.truth().base_pos, abs=1e-12)
    restless = run_on_bench(tmp_path, RIG, sway(), faults, restless=True)
    assert restless[1:3] == (log, digest)  # a wait that ends early changes nothing


def test_an_unplugged_adapter_neither_hears_nor_speaks_and_comes_back(tmp_path):
    outcome, *_, virtual = run_on_bench(tmp_path, RIG, sway(), ["unplug@0.9-1.5"])
    assert outcome.state is State.FAULT
    assert outcome.reason.startswith("no servo has answered for 4 periods")
    assert outcome.unsure == []
    assert [servo.table["torque_enable"] for servo in virtual.servos] == [0, 0, 0]


def test_a_slow_line_ends_between_microseconds_and_is_told_rounded_down():
    rig = load_rig("lamp-xl330")
    virtual = VirtualRig(rig)
    ping = dxl.encode(1, dxl.PING)
    asked = virtual.rig.bus.baud

    handed = []

    class Pinger:
        def resume(self, given):
            handed.append(given)
            return Taken(given.now_us + 100_000, () if given.bus else (ping,))

        def close(self):
            pass

    bench = FirmwareBench(virtual, Pinger())
    for _ in range(2):
        _, taken = bench.wake()
        bench.send(taken)
        bench.wait(taken)
    bench.wake()
    answered = handed[1]
    # ten bits a byte, both ways, and the delay that the rig states
    end_ns = (len(ping) + 14) * 10 * 10**9 // asked + rig.bus.return_delay_us * 1000
    assert dxl.PacketParser().feed(answered.bus)[0].id == 1
    assert abs(answered.now_us * 1000 - end_ns) <= 2000
    assert handed[2].now_us == answered.now_us + 100_000


def test_firmware_that_lets_no_time_pass_is_stopped():
    class Busy:
        def resume(self, given):
            return Taken(given.now_us)

        def close(self):
            pass

    bench = FirmwareBench(VirtualRig(RIG), Busy())
    with pytest.raises(RunError, match="lets no time pass"):
        for _ in itertools.count():
            bench.wait(bench.wake()[1])
