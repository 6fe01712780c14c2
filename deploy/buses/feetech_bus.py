"""Talk to Feetech STS and SCS servos through the unmodified `feetech-servo-sdk`, with a fence around its defects.

What version 1.0 does beside `deploy.buses.protocol1_bus`'s list, and what stands instead:

- `clearPort` flushes what is sent and nothing that has come, so a late reply is the next read's value: see
  `deploy.buses.port`.
- `GroupSyncRead.isAvailable` ignores the last result, so old data look fresh: a `Reply` belongs to one question.
- The byte order is a global of the module, so STS and SCS can not share a process: no word of the SDK's is used, each
  register knows its order.
"""

from __future__ import annotations

from inspect import signature
from typing import Any, Literal

from controller.errors import InputError
from deploy.buses.port import SerialPort
from deploy.buses.protocol1_bus import Protocol1Bus

_RX_CORRUPT = -7


class FeetechBus(Protocol1Bus):
    """Read and write the registers of Feetech servos on one port.

    Args:
        port: the open port; the bus closes it
        return_delay_s: how long a servo waits before it replies [s]
        series: "sts" answers sync reads and sends the low byte first; "scs" does neither

    Raises:
        InputError: the SDK is missing, or another package stands in its place

    Source: Feetech, ST3215 memory table
    """

    rx_corrupt = _RX_CORRUPT
    model_address = 3
    alerts = 0x7F
    refusals = {}  # noqa: RUF012 (nobody writes to it; a Feetech servo says nothing of the question)

    def __init__(self, port: SerialPort, return_delay_s: float = 0.0, series: Literal["sts", "scs"] = "sts") -> None:
        super().__init__(packet_handler(), port, return_delay_s)
        self.has_sync_read = series == "sts"
        self._order: Literal["little", "big"] = "little" if series == "sts" else "big"

    def _word(self, data: bytes) -> int:
        return int.from_bytes(data, self._order)


def packet_handler() -> Any:  # noqa: ANN401 (the SDK has no types)
    """Return the SDK's packet handler.

    Raises:
        InputError: the SDK is missing, or another package stands in its place
    """
    try:
        from scservo_sdk.protocol_packet_handler import protocol_packet_handler
    except ImportError:
        raise InputError(
            "Feetech servos need the package feetech-servo-sdk; run 'pip install feetech-servo-sdk'"
        ) from None
    if signature(protocol_packet_handler).parameters:  # that one's wants a port
        raise InputError(
            "the package ftservo-python-sdk stands where feetech-servo-sdk should, for both are called scservo_sdk; "
            "run 'pip uninstall ftservo-python-sdk' and 'pip install --force-reinstall feetech-servo-sdk'"
        )
    return protocol_packet_handler()
