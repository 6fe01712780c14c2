"""servolve commands in processes of their own, and the vendor's client as a second master: shared by several tests."""

from __future__ import annotations

import os
import queue
import re
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from dynamixel_sdk import COMM_SUCCESS, PacketHandler, PortHandler

ROOT = Path(__file__).parent.parent
WAIT_S = 60.0  # for a machine under load; nothing here is measured
POLITE = {**os.environ, "PYTHONUNBUFFERED": "1"}
TORQUE_ENABLE = 64
TRIES = 20  # the SDK's own time-outs do not know a busy machine


class Process:
    """A program in a process of its own, with its output line by line."""

    def __init__(self, *command, stdin=subprocess.DEVNULL):
        self.process = subprocess.Popen(
            [str(word) for word in command],
            stdin=stdin,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=POLITE,
            cwd=ROOT,
        )
        self.lines = queue.Queue()
        self.told = []
        self.readers = [
            threading.Thread(target=self._read, args=(stream,), daemon=True)
            for stream in (self.process.stdout, self.process.stderr)
        ]
        for reader in self.readers:
            reader.start()

    def _read(self, stream):
        for line in stream:
            self.lines.put(line.rstrip())
        self.lines.put(None)

    def wait_for(self, pattern):
        """Return the match of the first line that has the pattern."""
        while True:
            line = self.lines.get(timeout=WAIT_S)
            if line is None:
                pytest.fail(f"no line with '{pattern}' among {self.told}")
            self.told.append(line)
            found = re.search(pattern, line)
            if found:
                return found

    def end(self):
        """Wait for the end; return the exit status and all lines."""
        status = self.process.wait(WAIT_S)
        for reader in self.readers:
            reader.join(WAIT_S)
        while not self.lines.empty():
            self.told.append(self.lines.get())
        return status, [line for line in self.told if line is not None]

    def kill(self):
        self.process.kill()
        self.process.wait()


def servolve(*arguments, stdin=subprocess.DEVNULL):
    """Run a servolve command."""
    command = (sys.executable, "-c", "import sys; from servolve.cli import main; sys.exit(main())")
    return Process(*command, *arguments, stdin=stdin)


def serve(folder, rig, *arguments):
    """Serve a rig; its bus is `bus` in the folder, its sensor node `sensors`, its TCP address `.tcp`."""
    links = ("--link", folder / "bus", "--sensor-link", folder / "sensors", "--tcp", "0")
    process = servolve("rig", "serve", rig, *links, *arguments)
    process.bus, process.sensors = folder / "bus", folder / "sensors"
    try:
        process.tcp = process.wait_for(r"socket://\S+")[0]
    except BaseException:
        process.kill()
        raise
    return process


def read_bytes(path, rig, address=TORQUE_ENABLE):
    """Read a one-byte register of every servo of a Dynamixel 2.0 rig with the vendor's own client."""
    port, packets = PortHandler(str(path)), PacketHandler(2.0)
    assert port.setBaudRate(rig.bus.baud)
    try:
        found = []
        for joint in rig.joints:
            for _ in range(TRIES):
                value, result, _ = packets.read1ByteTxRx(port, joint.id, address)
                if result == COMM_SUCCESS:
                    found.append(value)
                    break
        return found
    finally:
        port.closePort()
