"""Lock step over real pseudo terminals: the core's bytes, the client's bit rate, and clients that do not read."""

import pytest
import serial

from controller.rig_file import load_rig
from deploy.virtual import dynamixel2 as dxl
from deploy.virtual.lockstep import LockstepBench
from deploy.virtual.rig import VirtualRig

RIG = load_rig("lamp-xc330")
READ_BLOCK = dxl.encode(dxl.BROADCAST, dxl.SYNC_READ, bytes([126, 0, 10, 0]) + bytes(joint.id for joint in RIG.joints))


def exchange(port, bench, frame, until):
    bench.pump(bench.now, sent=port.write(frame))
    heard = b""
    while (event := bench.next_event()) is not None and event <= until:
        bench.pump(event)
        heard += port.read(4096)
    bench.pump(until)
    return heard + port.read(4096)


def test_lock_step_carries_the_same_bytes_as_the_core():
    frames = [dxl.encode(dxl.BROADCAST, dxl.PING), dxl.encode(1, dxl.WRITE, bytes([65, 0, 1])), READ_BLOCK]
    core = VirtualRig(RIG)
    expected, lines = [], b""
    for k in range(60):
        core.transmit(frames[k % 3], k * 0.005)
        expected.append(b"".join(frame for _, frame in core.replies_until((k + 1) * 0.005)))
        core.advance((k + 1) * 0.005)
        lines += core.sensor_until((k + 1) * 0.005)
    with (
        LockstepBench(VirtualRig(RIG)) as bench,
        serial.Serial(bench.bus_path, RIG.bus.baud, timeout=0) as port,
        serial.Serial(bench.sensor_path, timeout=0) as node,
    ):
        heard = [exchange(port, bench, frames[k % 3], (k + 1) * 0.005) for k in range(60)]
        assert heard == expected
        assert node.read(65536) == lines
        assert bench.now == pytest.approx(0.3)


def test_lock_step_hears_no_client_at_another_rate():
    with (
        LockstepBench(VirtualRig(RIG)) as bench,
        serial.Serial(bench.bus_path, 57600, timeout=0) as port,
    ):
        assert exchange(port, bench, dxl.encode(1, dxl.PING), 0.1) == b""
        port.baudrate = RIG.bus.baud
        assert exchange(port, bench, dxl.encode(1, dxl.PING), 0.2) != b""


def test_lines_that_nobody_reads_do_not_stop_the_rig():
    with LockstepBench(VirtualRig(RIG)) as bench:
        bench.pump(30.0)
        with serial.Serial(bench.sensor_path, timeout=0) as node:
            bench.pump(30.1)
            data = b""
            while chunk := node.read(65536):
                data += chunk
                bench.pump(bench.now)
        assert int(data.splitlines()[-1].split(b",")[2]) == pytest.approx(30.09e6, abs=1e4), "the newest are kept"
        assert len(data) < 100_000
