"""Talk Dynamixel 2.0 through the unmodified vendor SDK, with a fence around each of its defects.

What SDK 4.1 does, and what stands here and in `deploy.buses.servo_bus` instead:

- It never stuffs what it sends: `_Protocol2.addStuffing` changes the packet that it was given.
- It drops a byte when it un-stuffs data with FF FF FD in it: `_Protocol2.removeStuffing` looks at what was received.
- It takes the CRC for data where an error reply has none: the length field decides, and `Reply.status` is "refused".
"""

# The SDK chose some method names.
# ruff: noqa: N802

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, Literal

from dynamixel_sdk.protocol2_packet_handler import Protocol2PacketHandler
from dynamixel_sdk.robotis_def import COMM_RX_CORRUPT, COMM_SUCCESS

from controller.register import decode_register as decode
from controller.register import encode_register as encode
from deploy.buses.port import SerialPort
from deploy.buses.servo_bus import BusError, Reply, ServoBus

__all__ = ["ALERT", "ERROR_NUMBERS", "BusError", "DynamixelBus", "Reply", "decode", "encode"]

ALERT: Final = 0x80
"""Bit of a status error that says: look at the hardware error status."""

ERROR_NUMBERS: Final = (
    "no error",
    "the servo could not carry it out",
    "unknown instruction",
    "CRC error",
    "value out of range",
    "wrong data length",
    "value beyond a limit",
    "register is read-only or locked",
)
"""What the number in a status error's low bits says. Source: e-Manual, protocol2.md, Error."""

_PING, _REBOOT = 0x01, 0x08


class _Protocol2(Protocol2PacketHandler):
    """The SDK's packets with their byte stuffing put right."""

    def addStuffing(self, packet: list[int]) -> list[int]:
        length = packet[5] | packet[6] << 8
        stuffed: list[int] = []
        for byte in packet[7 : 7 + length - 2]:
            stuffed.append(byte)
            if stuffed[-3:] == [0xFF, 0xFF, 0xFD]:
                stuffed.append(0xFD)
        packet[7:] = [*stuffed, 0, 0]
        packet[5], packet[6] = (len(stuffed) + 2) & 0xFF, (len(stuffed) + 2) >> 8
        return packet

    def removeStuffing(self, packet: list[int]) -> list[int]:
        length = packet[5] | packet[6] << 8
        body, crc = packet[7 : 7 + length - 2], packet[7 + length - 2 : 7 + length]
        plain: list[int] = []
        index = 0
        while index < len(body):
            plain.append(body[index])
            stuffed = body[index : index + 2] == [0xFD, 0xFD] and body[max(0, index - 2) : index] == [0xFF, 0xFF]
            index += 2 if stuffed else 1
        packet[7:] = [*plain, *crc]
        packet[5], packet[6] = (len(plain) + 2) & 0xFF, (len(plain) + 2) >> 8
        return packet


class DynamixelBus(ServoBus):
    """Read and write the registers of Dynamixel 2.0 servos on one port.

    Args:
        port: the open port; the bus closes it
        return_delay_s: how long a servo waits before it replies [s]
    """

    status_bytes = 11
    stuffing_bytes = 2
    has_sync_read = True

    def __init__(self, port: SerialPort, return_delay_s: float = 0.0) -> None:
        super().__init__(port, return_delay_s)
        self._sdk: Protocol2PacketHandler = _Protocol2()

    def ping(self, servo: int) -> tuple[Reply, int]:
        """Ask a servo whether it is there.

        Args:
            servo: id

        Returns:
            its reply and its model number, 0 if there is no reply
        """
        reply = self._ask(servo, 3, lambda: self._send_bare(servo, _PING))
        return reply, int.from_bytes(reply.data[:2], "little")

    def reboot(self, servo: int) -> Reply:
        """Reboot a servo: the only way out of a hardware error.

        Args:
            servo: id
        """
        return self._ask(servo, 0, lambda: self._send_bare(servo, _REBOOT))

    def _send_bare(self, servo: int, instruction: int) -> bool:
        packet = [0] * 10
        packet[4:8] = [servo, 3, 0, instruction]
        return bool(self._sdk.txPacket(self.port, packet) == COMM_SUCCESS)

    def _send_read(self, servo: int, address: int, length: int) -> bool:
        return bool(self._sdk.readTx(self.port, servo, address, length) == COMM_SUCCESS)

    def _send_write(self, servo: int, address: int, data: bytes) -> bool:
        return bool(self._sdk.writeTxOnly(self.port, servo, address, len(data), list(data)) == COMM_SUCCESS)

    def _send_sync_read(self, servos: Sequence[int], address: int, length: int) -> bool:
        sent = self._sdk.syncReadTx(self.port, address, length, list(servos), len(servos), False)
        return bool(sent == COMM_SUCCESS)

    def _send_sync_write(self, address: int, values: Mapping[int, bytes]) -> bool:
        length = len(next(iter(values.values())))
        parameters = [byte for servo, data in values.items() for byte in (servo, *data)]
        sent = self._sdk.syncWriteTxOnly(self.port, address, length, parameters, len(parameters))
        return bool(sent == COMM_SUCCESS)

    def _next_packet(self) -> tuple[Literal["packet", "corrupt", "none"], list[int]]:
        packet, result = self._sdk.rxPacket(self.port, False)
        if result == COMM_SUCCESS:
            return "packet", packet
        return "corrupt" if result == COMM_RX_CORRUPT else "none", packet

    def _parse(self, packet: list[int], length: int, t: float) -> Reply | None:
        ndata = (packet[5] | packet[6] << 8) - 4
        if ndata < 0:
            return None
        servo, error = packet[4], packet[8]
        alert, number = bool(error & ALERT), error & ~ALERT
        if number:
            said = ERROR_NUMBERS[number] if number < len(ERROR_NUMBERS) else f"error {number}"
            return Reply(servo, "refused", b"", error, t, alert, said)
        return Reply(servo, "data", bytes(packet[9 : 9 + ndata]), error, t, alert) if ndata == length else None
