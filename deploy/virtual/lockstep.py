"""The virtual rig in lock step: real pseudo terminals, one thread, and the rig's own time.

The client's port moves the rig: it says what it has sent, and to what time it is willing to wait. Nothing happens in
between, so a run is the same on every machine at any load.
"""

from __future__ import annotations

from types import TracebackType
from typing import Final

from deploy.virtual.pty_line import PtyLine
from deploy.virtual.rig import VirtualRig

UNREAD_MAX: Final = 65536
"""Bytes of sensor lines that are kept for a client that does not read."""


class LockstepBench:
    """Carry bytes between a virtual rig and the pseudo terminals that a client in this thread has opened.

    Args:
        rig: the virtual rig
    """

    def __init__(self, rig: VirtualRig) -> None:
        self.rig = rig
        self._bus = PtyLine()
        self._sensors = PtyLine()
        self._plugged = True
        self._unread = bytearray()
        self._now = rig.now

    def __enter__(self) -> LockstepBench:
        """Return the bench."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the terminals."""
        self.close()

    def close(self) -> None:
        """Close the terminals."""
        self._bus.close()
        self._sensors.close()

    @property
    def bus_path(self) -> str:
        """Return the device that the servo bus is; another one after the adapter has been unplugged."""
        return self._bus.path

    @property
    def sensor_path(self) -> str:
        """Return the device that the sensor node is."""
        return self._sensors.path

    @property
    def now(self) -> float:
        """Return the client's time [s]; the rig is there too, or ahead by the bytes that are still on the line."""
        return self._now

    def pump(self, until: float, sent: int = 0) -> None:
        """Carry bytes both ways up to a time.

        Bytes that the client sent start on the line at `now`; replies and sensor lines that have ended by `until` can
        be read when this returns.

        Args:
            until: the client's time afterwards; a time that has passed is `now` [s]
            sent: how many bytes the client has written to the bus since the last call
        """
        until = max(until, self._now)
        asked = self._bus.read(sent) if self._plugged else b""
        if asked:
            self.rig.set_baud(self._bus.baud() or self.rig.rig.bus.baud)
            self.rig.transmit(asked, self._now)
        self.rig.advance(until)
        self._plug()
        for _, reply in self.rig.replies_until(until):
            self._bus.write_through(reply)
        self._pass_lines(self.rig.sensor_until(until))
        self._now = until

    def next_event(self) -> float | None:
        """Return when the next bytes can be read from the bus, or None while no reply is on its way [s]."""
        return self.rig.next_event()

    def _plug(self) -> None:
        """Let the bus's port die or return, as the rig's faults say."""
        if self._plugged and self.rig.unplugged:
            self._plugged = False
            self._bus.close()
        elif not self._plugged and not self.rig.unplugged:
            self._plugged = True
            self._bus = PtyLine()

    def _pass_lines(self, lines: bytes) -> None:
        """Put sensor lines where the client reads them; of what it leaves unread, the oldest go first."""
        self._unread += lines
        if not self._unread:
            return
        taken = self._sensors.write_through(bytes(self._unread))
        del self._unread[:taken]
        if len(self._unread) > UNREAD_MAX:
            del self._unread[: self._unread.index(b"\n", len(self._unread) - UNREAD_MAX) + 1]
