"""One loop of `servolve bench bus` in a process of its own: ours, a plain SDK one, or one on rustypot.

Each reads 10 bytes of state of every servo at once and writes every goal at once, a hundred times a second on an
absolute schedule. Ours also reads a health register a period, computes a controller, judges what it read and logs it.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any, Final

from controller.controller_file import parse_controller
from controller.rig import Rig
from controller.rig_file import load_rig

RIG_FILE: Final = Path(__file__).with_name("bench_bus.rig.toml")
STATE: Final = (126, 10)
"""Present current, velocity and position of an X330: address and bytes."""

GOAL: Final = (116, 4)
TORQUE: Final = 64
PLAIN_BYTES: Final = 18 + 4 * 21 + 34
"""Bytes of a plain cycle on four servos: sync read of 10 bytes, its replies, sync write of 4."""

_SWAY: Final = "(list (* 8 (osc-wave 0.5 0)) (* 5 (osc-wave 0.5 0.2)) (* 5 (osc-wave 0.5 0.4)) (* a0 0))"
_AMPLITUDE: Final = 60
_PATIENCE: Final = 50


def controller_text(rig: Rig) -> str:
    """Return a controller file that sways the rig a little.

    Args:
        rig: the rig of the bench
    """
    outputs = "".join(
        f'[[output]]\nname = "{joint.name}"\nkind = "position"\nunit = "deg"\nlow = -30\nhigh = 30\nneutral = 0\n'
        for joint in rig.joints
    )
    head = f'format = 1\nprogram = "{_SWAY}"\n[controller]\nname = "sway"\nperiod_s = {rig.period_s}\n'
    return head + '[[input]]\nname = "a0"\nunit = "rad"\nlow = -2\nhigh = 2\n' + outputs


def ours(port: str, seconds: float) -> dict[str, Any]:
    """Run the host loop.

    Args:
        port: the bus
        seconds: how long

    Returns:
        `cycle_s`: mean time from the start of a period to its goals on their way; `wire_s`: computed time on the wire
        of all its bytes; `cpu`: share of a core; `in_time`: share of the periods that were done in time
    """
    from deploy.connection import connect_ports
    from deploy.host_loop import RunOptions, run_controller
    from deploy.logs.log import RunLog, read_log
    from deploy.logs.log_topics import FORMAT
    from deploy.states import State

    rig = load_rig(RIG_FILE)
    controller = parse_controller(controller_text(rig), "bench bus")
    marks: dict[State, tuple[float, float]] = {}
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        with ExitStack() as stack:
            record = stack.enter_context(RunLog(path, time.time_ns()))
            record.write("/meta", 0.0, {"format": FORMAT})
            link = stack.enter_context(connect_ports(rig, port, None, lambda: None))
            outcome = run_controller(
                link,
                rig,
                controller,
                RunOptions(0.0, 0.0, seconds, True, 1.0),
                record,
                lambda state: marks.setdefault(state, (time.monotonic(), time.process_time())) and None,
            )
        if outcome.faulty:
            raise SystemExit(outcome.reason)
        log = read_log(path)
    cycles = log.cycles
    first, last = cycles[0]["t"], cycles[-1]["t"] + rig.period_s
    nbyte = sum(len(m["hex"]) // 2 for m in log.messages["/bus"] if first <= m["t"] < last)
    spent = [c["read_s"] + c["compute_s"] + c["write_s"] for c in cycles]
    done = [c["late_s"] + s for c, s in zip(cycles, spent, strict=True)]
    (wall, cpu), (wall_end, cpu_end) = marks[State.RUNNING], marks[State.STOPPING]
    return {
        "cycle_s": sum(spent) / len(spent),
        "wire_s": 10.0 * nbyte / rig.bus.baud / len(cycles),
        "cpu": (cpu_end - cpu) / (wall_end - wall),
        "in_time": sum(s <= rig.period_s for s in done) / len(done),
    }


def sdk(port: str, seconds: float) -> dict[str, Any]:
    """Run a loop on the vendor's SDK as its examples do; see `ours` for what is returned.

    Args:
        port: the bus
        seconds: how long
    """
    import dynamixel_sdk

    rig = load_rig(RIG_FILE)
    ids = [joint.id for joint in rig.joints]
    handler, packets = dynamixel_sdk.PortHandler(port), dynamixel_sdk.PacketHandler(2.0)
    handler.setBaudRate(rig.bus.baud)
    state = dynamixel_sdk.GroupSyncRead(handler, packets, *STATE)
    goals = dynamixel_sdk.GroupSyncWrite(handler, packets, *GOAL)
    for servo in ids:
        state.addParam(servo)
    _until(lambda: state.txRxPacket() == dynamixel_sdk.COMM_SUCCESS)
    starts = [state.getData(servo, STATE[0] + 6, 4) for servo in ids]

    def cycle(offset: int) -> None:
        state.txRxPacket()
        for servo, start in zip(ids, starts, strict=True):
            goals.changeParam(servo, list((start + offset).to_bytes(4, "little")))
        goals.txPacket()

    for servo, start in zip(ids, starts, strict=True):
        goals.addParam(servo, list(start.to_bytes(4, "little")))
    goals.txPacket()
    _switch(lambda on: [packets.write1ByteTxRx(handler, servo, TORQUE, on) for servo in ids], 1)
    found = _timed(rig, cycle, seconds)
    _switch(lambda on: [packets.write1ByteTxRx(handler, servo, TORQUE, on) for servo in ids], 0)
    return found


def rustypot(port: str, seconds: float) -> dict[str, Any]:
    """Run a loop on rustypot; see `ours` for what is returned.

    Args:
        port: the bus
        seconds: how long
    """
    import rustypot as rusty

    rig = load_rig(RIG_FILE)
    ids = [joint.id for joint in rig.joints]
    bus = rusty.Xl330PyController(port, rig.bus.baud, 0.05)
    blocks: list[list[int]] = []

    def read() -> bool:
        blocks[:] = bus.sync_read_raw_data(ids, *STATE)
        return True

    def cycle(offset: int) -> None:
        try:
            read()
        except RuntimeError:
            return
        bus.sync_write_raw_data(ids, GOAL[0], [list((start + offset).to_bytes(4, "little")) for start in starts])

    _until(read)
    starts = [int.from_bytes(bytes(block[6:10]), "little") for block in blocks]
    bus.sync_write_raw_data(ids, GOAL[0], [list(start.to_bytes(4, "little")) for start in starts])
    bus.sync_write_torque_enable(ids, [True] * len(ids))
    found = _timed(rig, cycle, seconds)
    bus.sync_write_torque_enable(ids, [False] * len(ids))
    return found


def _until(ask: Callable[[], bool]) -> None:
    for _ in range(_PATIENCE):
        try:
            if ask():
                return
        except RuntimeError:
            pass
        time.sleep(0.05)
    raise SystemExit("bench bus: the virtual rig does not answer; measure again on a quiet machine")


def _switch(write: Callable[[int], Any], on: int) -> None:
    for _ in range(3):  # a busy machine loses some
        write(on)


def _timed(rig: Rig, cycle: Callable[[int], None], seconds: float) -> dict[str, Any]:
    """Call a cycle on an absolute schedule; see `ours` for what is returned."""
    spent: list[float] = []
    done: list[float] = []
    begin, cpu = time.monotonic(), time.process_time()
    for k in range(round(seconds / rig.period_s)):
        due = begin + k * rig.period_s
        time.sleep(max(0.0, due - time.monotonic()))
        started = time.monotonic()
        cycle(round(_AMPLITUDE * min(k, 100) / 100 * (1 if k // 50 % 2 else -1)))
        ended = time.monotonic()
        spent.append(ended - started)
        done.append(ended - due)
    wall, used = time.monotonic() - begin, time.process_time() - cpu
    return {
        "cycle_s": sum(spent) / len(spent),
        "wire_s": 10.0 * PLAIN_BYTES / rig.bus.baud,
        "cpu": used / wall,
        "in_time": sum(s <= rig.period_s for s in done) / len(done),
    }


def flood(port: str, seconds: float) -> dict[str, Any]:
    """Ask as fast as the rig answers, with ready-made frames; for a rig without wire time.

    Args:
        port: the bus
        seconds: how long

    Returns:
        `cycles_per_s`: four-servo cycles a second
    """
    import select
    import termios
    import tty

    from deploy.virtual import dynamixel2 as dxl

    ids = bytes(joint.id for joint in load_rig(RIG_FILE).joints)
    read = dxl.encode(dxl.BROADCAST, dxl.SYNC_READ, bytes((STATE[0], 0, STATE[1], 0)) + ids)
    goal = b"".join(bytes((servo,)) + (2048).to_bytes(4, "little") for servo in ids)
    frames = dxl.encode(dxl.BROADCAST, dxl.SYNC_WRITE, bytes((GOAL[0], 0, GOAL[1], 0)) + goal) + read
    expected = len(ids) * (11 + STATE[1])
    line = os.open(port, os.O_RDWR | os.O_NOCTTY)
    try:
        tty.setraw(line, termios.TCSANOW)
        modes = termios.tcgetattr(line)
        modes[4] = modes[5] = termios.B1000000  # in and out
        termios.tcsetattr(line, termios.TCSANOW, modes)
        count, begin = 0, time.monotonic()
        while time.monotonic() - begin < seconds:
            os.write(line, frames)
            got = 0
            while got < expected and select.select([line], [], [], 1.0)[0]:
                got += len(os.read(line, expected))
            count += got == expected
        return {"cycles_per_s": count / (time.monotonic() - begin)}
    finally:
        os.close(line)


LOOPS: Final[Mapping[str, Callable[[str, float], dict[str, Any]]]] = MappingProxyType(
    {"servolve": ours, "dynamixel_sdk": sdk, "rustypot": rustypot, "flood": flood}
)

if __name__ == "__main__":
    print(json.dumps(LOOPS[sys.argv[1]](sys.argv[2], float(sys.argv[3]))))
