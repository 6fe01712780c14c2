"""Open the servo bus of a rig for the commands that look after it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from controller.rig import Rig
from controller.rig_file import require_bus
from deploy.buses.open_bus import open_bus
from deploy.buses.port import SerialPort
from deploy.buses.servo_bus import ServoBus

PATIENCE_S: Final = 0.1
"""For what is done once, and must not fail because the machine is busy [s]."""


@contextmanager
def rig_bus(rig: Rig, port: str, purpose: str, patience_s: float = 0.0) -> Iterator[ServoBus]:
    """Open a rig's bus in real time.

    Args:
        rig: the rig
        port: device path or ``socket://HOST:PORT``
        purpose: what needs the bus, as an error names it
        patience_s: how late a reply may come at least, where nothing depends on time [s]

    Yields:
        the bus

    Raises:
        InputError: the rig has no bus, or the port can not be opened
    """
    require_bus(rig, purpose)
    line = SerialPort(port, rig.bus.baud)
    line.latency_s = max(line.latency_s, patience_s)
    try:
        yield open_bus(line, rig)
    finally:
        line.closePort()
