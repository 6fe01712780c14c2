"""Serve a bus in lock step: the same port over a real pseudo terminal, but the virtual rig owns time."""

# The SDK chose the method names.
# ruff: noqa: N802

from __future__ import annotations

from typing import Final

from deploy.buses.port import SerialPort
from deploy.virtual.lockstep import LockstepBench

_LATENCY_S: Final = 0.001


class LockstepPort(SerialPort):
    """Serve the bus of a lock-step bench: sending moves bytes, waiting moves the rig.

    Args:
        bench: the rig and its ports
        baud: [bits/s]
    """

    def __init__(self, bench: LockstepBench, baud: int) -> None:
        self._bench = bench
        super().__init__(bench.bus_path, baud)
        self.label = f"virtual {bench.rig.rig.name}"  # a terminal's number differs from run to run
        self.latency_s = _LATENCY_S

    def now(self) -> float:
        """Return the rig's time [s]."""
        return self._bench.now

    def wait(self, deadline: float) -> bool:
        """Move the rig until a byte comes, or to the deadline.

        Args:
            deadline: until when [s]

        Returns:
            whether a byte is waiting
        """
        while not self.waiting():
            if self._bench.now >= deadline:
                return False
            event = self._bench.next_event()
            self._bench.pump(deadline if event is None else min(event, deadline))
        return True

    def reopen(self) -> bool:
        """Open the port anew after it was lost, under the name that it has now; return whether it is back."""
        self.port_name = self._bench.bus_path
        return super().reopen()

    def writePort(self, packet: list[int] | bytes) -> int:
        """Send a packet to the rig; return how many bytes went out."""
        sent = super().writePort(packet)
        self._bench.pump(self._bench.now, sent)
        return sent
