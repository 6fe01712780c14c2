"""Talk protocol 1 framing, as Dynamixel 1.0 and Feetech servos do, through either vendor's unmodified packet handler.

Both vendors ship the same handler. What it does, and what stands here and in `deploy.buses.servo_bus` instead:

- A reply that is shorter than asked raises IndexError in its `read2ByteTxRx`: the length field decides.
- A packet of impossible length takes bytes of the next one with it: they are read again.
- An adapter that echoes makes the question its own answer, for both have one form: what was sent is not heard.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Final, Literal

from deploy.buses.port import SerialPort
from deploy.buses.servo_bus import Reply, ServoBus

_PING: Final = 0x01
_SUCCESS: Final = 0
_BYTES_AROUND: Final = 4  # header, id and length are not counted by the length


class Protocol1Bus(ServoBus):
    """Read and write the registers of servos that use protocol 1 framing on one port.

    Args:
        sdk: the vendor's packet handler
        port: the open port; the bus closes it
        return_delay_s: how long a servo waits before it replies [s]
    """

    status_bytes = 6
    stuffing_bytes = 0
    rx_corrupt: ClassVar[int]
    """What the handler returns for bytes that hold no packet."""
    model_address: ClassVar[int]
    """Where the model number is, which a ping does not bring."""
    alerts: ClassVar[int]
    """Bits of the status error that say how the servo is."""
    refusals: ClassVar[Mapping[int, str]]
    """Bit of the status error => what it says of the question."""

    def __init__(self, sdk: Any, port: SerialPort, return_delay_s: float = 0.0) -> None:  # noqa: ANN401 (either's)
        super().__init__(port, return_delay_s)
        self._sdk = sdk
        self._echoed = False

    def ping(self, servo: int) -> tuple[Reply, int]:
        """Ask a servo whether it is there, and then for its model number.

        Args:
            servo: id

        Returns:
            its reply and its model number, 0 if there is no reply
        """
        self._echoed = False
        reply = self._ask(servo, 0, lambda: self._send_ping(servo))
        if reply.status == "missing" and not self._echoed:
            return reply, 0
        # the answer of a servo whose only error is its voltage equals the question: what it says next is no echo
        reply = self.read(servo, self.model_address, 2)
        return reply, self._word(reply.data)

    def reboot(self, servo: int) -> Reply | None:
        """Return None: the protocol knows no reboot.

        Args:
            servo: id
        """
        return None

    def _word(self, data: bytes) -> int:
        return int.from_bytes(data, "little")

    def _send_ping(self, servo: int) -> bool:
        return bool(self._sdk.txPacket(self.port, [0, 0, servo, 2, _PING, 0]) == _SUCCESS)

    def _send_read(self, servo: int, address: int, length: int) -> bool:
        return bool(self._sdk.readTx(self.port, servo, address, length) == _SUCCESS)

    def _send_write(self, servo: int, address: int, data: bytes) -> bool:
        return bool(self._sdk.writeTxOnly(self.port, servo, address, len(data), list(data)) == _SUCCESS)

    def _send_sync_read(self, servos: Sequence[int], address: int, length: int) -> bool:
        return bool(self._sdk.syncReadTx(self.port, address, length, list(servos), len(servos)) == _SUCCESS)

    def _send_sync_write(self, address: int, values: Mapping[int, bytes]) -> bool:
        length = len(next(iter(values.values())))
        parameters = [byte for servo, data in values.items() for byte in (servo, *data)]
        return bool(self._sdk.syncWriteTxOnly(self.port, address, length, parameters, len(parameters)) == _SUCCESS)

    def _next_packet(self) -> tuple[Literal["packet", "corrupt", "none"], list[int]]:
        while True:
            packet, result = self._sdk.rxPacket(self.port)
            if result != _SUCCESS:
                return "corrupt" if result == self.rx_corrupt else "none", packet
            end = packet[3] + _BYTES_AROUND
            self.port.put_back(bytes(packet[end:]))
            if self._echoed or bytes(packet[:end]) != self.port.sent:
                return "packet", packet[:end]
            self._echoed = True

    def _receive(self, servos: Sequence[int], length: int) -> dict[int, Reply]:
        self._echoed = False
        return super()._receive(servos, length)

    def _parse(self, packet: list[int], length: int, t: float) -> Reply | None:
        servo, ndata, error = packet[2], packet[3] - 2, packet[4]
        alert = bool(error & self.alerts)
        said = "; ".join(words for bit, words in self.refusals.items() if error >> bit & 1)
        if said and (ndata == 0 or ndata != length):
            return Reply(servo, "refused", b"", error, t, alert, said)
        return Reply(servo, "data", bytes(packet[5 : 5 + ndata]), error, t, alert) if ndata == length else None
