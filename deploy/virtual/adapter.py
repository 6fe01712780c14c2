"""The USB adapter between line and master: what it hands over late, twice, unasked, or only now and then."""

from __future__ import annotations

from collections.abc import Iterable
from heapq import heappop, heappush
from typing import Final

import numpy as np

from deploy.virtual.active_faults import ActiveFaults

UNSOLICITED_NS: Final = 1_000_000
"""How long after an answer a packet comes that nobody asked for [ns]."""


class UsbAdapter:
    """Hand over what has ended on the line, as the faults let it.

    Args:
        rng: to draw faults from
        faults: which act
    """

    def __init__(self, rng: np.random.Generator, faults: ActiveFaults) -> None:
        self._rng = rng
        self._faults = faults
        self._waiting: list[tuple[int, int, bytes]] = []  # (when [ns], in which order, bytes)
        self._count = 0
        self._last = b""

    def carry(self, packets: Iterable[tuple[int, bytes]]) -> None:
        """Take packets from the line.

        Args:
            packets: (end on the line [ns], bytes)
        """
        for end_ns, packet in packets:
            t_s = end_ns * 1e-9
            late = self._faults.happens(self._rng, "late", t_s)
            at_ns = end_ns + (round(late.more * 1e6) if late else 0)
            self._put(at_ns, packet)
            if self._faults.happens(self._rng, "duplicate", t_s):
                self._put(at_ns, packet)
            if self._last and self._faults.happens(self._rng, "unsolicited", t_s):
                self._put(at_ns + UNSOLICITED_NS, self._last)
            self._last = packet

    def take(self, until_ns: int) -> list[tuple[int, bytes]]:
        """Return what the master can read by a time: (when [ns], bytes), in order.

        Args:
            until_ns: time [ns]
        """
        taken: list[tuple[int, bytes]] = []
        while self._waiting and self._waiting[0][0] <= until_ns:
            at_ns, _, packet = heappop(self._waiting)
            taken.append((at_ns, packet))
        return taken

    def next_ns(self) -> int | None:
        """Return when the master can read next, or None while nothing waits [ns]."""
        return self._waiting[0][0] if self._waiting else None

    def forget(self) -> None:
        """Lose what waits, as an adapter does that is unplugged."""
        self._waiting.clear()
        self._last = b""

    def _put(self, at_ns: int, packet: bytes) -> None:
        for fault in self._faults.all:
            if fault.kind == "latency-timer" and fault.active(at_ns * 1e-9):
                period_ns = round(fault.value * 1e6)
                at_ns = -(-at_ns // period_ns) * period_ns
        heappush(self._waiting, (at_ns, self._count, packet))
        self._count += 1
