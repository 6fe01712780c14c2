"""Open what a run talks through: a virtual rig in lock step, or real ports."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from typing import TYPE_CHECKING

from controller.errors import InputError
from controller.rig import Rig
from deploy.buses.open_bus import open_bus
from deploy.buses.port import SerialPort
from deploy.buses.sensor_port import SensorPort
from deploy.clock import LockstepClock, RealClock
from deploy.drivable import require_drivable
from deploy.period import Connection
from deploy.witness import Witness

if TYPE_CHECKING:
    from deploy.virtual.rig import VirtualRig


@contextmanager
def connect_virtual(virtual: VirtualRig, stop: Callable[[], str | None]) -> Iterator[Connection]:
    """Connect to a virtual rig in this process, in lock step: the rig owns time.

    Args:
        virtual: the rig
        stop: gives the reason why a person wants to stop, or None

    Yields:
        the connection
    """
    from deploy.buses.lockstep_port import LockstepPort
    from deploy.virtual.lockstep import LockstepBench

    rig = virtual.rig

    with ExitStack() as stack:
        bench = stack.enter_context(LockstepBench(virtual))
        bus = stack.enter_context(closing(open_bus(LockstepPort(bench, rig.bus.baud), rig)))
        sensors = stack.enter_context(closing(SensorPort(bench.sensor_path))) if rig.sensors else None
        yield Connection(bus, sensors, LockstepClock(bench), Witness(virtual), stop)


@contextmanager
def connect_ports(rig: Rig, port: str, sensor_port: str | None, stop: Callable[[], str | None]) -> Iterator[Connection]:
    """Connect to a rig in real time.

    Args:
        rig: the rig
        port: device path or ``socket://HOST:PORT`` of the servo bus
        sensor_port: the same of the sensor node, or None
        stop: gives the reason why a person wants to stop, or None

    Yields:
        the connection

    Raises:
        InputError: the rig has no bus that can be driven, or a port is missing, can not be opened or is in use
    """
    require_drivable(rig)
    if rig.sensors and sensor_port is None:
        raise InputError(f"rig {rig.name}: it has a sensor node; name its port with --sensor-port")
    with ExitStack() as stack:
        bus = stack.enter_context(closing(open_bus(SerialPort(port, rig.bus.baud), rig)))
        sensors = stack.enter_context(closing(SensorPort(sensor_port))) if sensor_port else None
        yield Connection(bus, sensors, RealClock(), None, stop)
