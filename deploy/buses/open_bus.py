"""Open the bus that speaks a rig's protocol."""

from __future__ import annotations

from controller.rig import Rig
from deploy.buses.port import SerialPort
from deploy.buses.servo_bus import ServoBus


def open_bus(port: SerialPort, rig: Rig) -> ServoBus:
    """Return the bus that speaks a rig's protocol.

    Args:
        port: the open port; the bus closes it
        rig: the rig

    Returns:
        the bus

    Raises:
        InputError: the vendor's SDK is missing, or another package stands in its place
    """
    return open_protocol(port, rig.bus.protocol, 1e-6 * rig.bus.return_delay_us)


def open_protocol(port: SerialPort, protocol: str, delay_s: float) -> ServoBus:
    """Return the bus that speaks a protocol.

    Args:
        port: the open port; the bus closes it
        protocol: as rig files name it
        delay_s: how long a servo waits before it answers [s]

    Returns:
        the bus

    Raises:
        InputError: the vendor's SDK is missing, or another package stands in its place
    """
    # each SDK is imported where it is needed, for nobody needs all of them
    if protocol == "dynamixel-1.0":
        from deploy.buses.dynamixel1_bus import Dynamixel1Bus

        return Dynamixel1Bus(port, delay_s)
    if protocol.startswith("feetech-"):
        from deploy.buses.feetech_bus import FeetechBus

        return FeetechBus(port, delay_s, "sts" if protocol == "feetech-sts" else "scs")
    from deploy.buses.dynamixel_bus import DynamixelBus

    return DynamixelBus(port, delay_s)
