"""Talk Dynamixel 1.0, as AX servos do, through the unmodified vendor SDK; see `deploy.buses.protocol1_bus`."""

from __future__ import annotations

from typing import Final

from dynamixel_sdk.protocol1_packet_handler import Protocol1PacketHandler
from dynamixel_sdk.robotis_def import COMM_RX_CORRUPT

from deploy.buses.port import SerialPort
from deploy.buses.protocol1_bus import Protocol1Bus

_ALERTS: Final = 0x25  # voltage, heat, overload


class Dynamixel1Bus(Protocol1Bus):
    """Read and write the registers of Dynamixel 1.0 servos on one port; they are asked one by one.

    Args:
        port: the open port; the bus closes it
        return_delay_s: how long a servo waits before it replies [s]

    Source: e-Manual, protocol1.md, Status Packet, Error
    """

    has_sync_read = False
    rx_corrupt = COMM_RX_CORRUPT
    model_address = 0
    alerts = _ALERTS
    refusals = {  # noqa: RUF012 (nobody writes to it)
        1: "goal position beyond the angle limits",
        3: "value out of range",
        4: "checksum error",
        6: "unknown instruction",
    }

    def __init__(self, port: SerialPort, return_delay_s: float = 0.0) -> None:
        super().__init__(Protocol1PacketHandler(), port, return_delay_s)
