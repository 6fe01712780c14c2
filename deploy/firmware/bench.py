"""Firmware on the virtual rig in lock step: the rig owns time, and moves only while the firmware waits.

The rules are those of `deploy.virtual.lockstep` and `deploy.buses.lockstep_port`, so that the same packet at the same
time meets the same rig, whoever sends it. Time is kept in whole nanoseconds; the firmware is told it in whole
microseconds since it was booted, rounded down.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Literal, TypeAlias

from controller.errors import RunError
from deploy.firmware.machine import Firmware, Given, Taken
from deploy.virtual.rig import VirtualRig

Tap: TypeAlias = Callable[[Literal["tx", "rx"], float, bytes], None]
"""Called with each packet sent, and with all that came before the next one, and the time of it [s]."""

_IDLE_MAX: Final = 10_000
"""So often may the firmware wake without letting time pass."""


class FirmwareBench:
    """Carry bytes between a virtual rig and firmware that waits for them.

    A wait ends when servos have answered, or when its time is over. Sensor lines, a person's words and inputs are
    handed over with that; `restless` firmware is woken for every sensor line as well, as a board is by interrupts.

    A rig at time 0 has been switched on together with its board. Its clock begins when the board waits for the first
    time: what that has sent before met servos that were booting, and is no part of the run. On a rig whose time has
    begun only the board boots, and the servos hear all of it.

    Args:
        rig: the virtual rig
        firmware: the image; the caller closes it
        tap: told what passes on the bus, or None
        restless: whether sensor lines end a wait
    """

    def __init__(self, rig: VirtualRig, firmware: Firmware, tap: Tap | None = None, *, restless: bool = False) -> None:
        self.rig = rig
        self.inputs = 0
        self._firmware = firmware
        self._tap = tap
        self._restless = restless
        self._now_ns = self._boot_ns = round(rig.now * 1e9)
        self._bus = b""
        self._sensors = b""
        self._console = b""
        self._received = b""
        self._received_ns = 0
        self._idle = 0

    @property
    def now(self) -> float:
        """Return the firmware's time [s]; the rig is there too, or ahead by the bytes that are still on the line."""
        return self._now_ns * 1e-9

    def say(self, line: str) -> None:
        """Type a line at the console; the firmware gets it when it wakes next.

        Args:
            line: without its end
        """
        self._console += line.encode() + b"\n"

    def wake(self) -> tuple[Given, Taken]:
        """Let the firmware work until it waits; nothing that it sends has left yet.

        Returns:
            what it was given, and what it has done

        Raises:
            RunError: the firmware has died, or does not come to wait
        """
        given = Given((self._now_ns - self._boot_ns) // 1000, self.inputs, self._bus, self._sensors, self._console)
        self._bus = self._sensors = self._console = b""
        return given, self._firmware.resume(given)

    def send(self, taken: Taken) -> None:
        """Put what the firmware has sent onto the line, now.

        Args:
            taken: from `wake`
        """
        heard = taken.boot + taken.bus if self._boot_ns > 0 else taken.bus
        for frame in heard:
            self.flush()
            if self._tap:
                self._tap("tx", self.now, frame)
            self.rig.set_baud(self.rig.rig.bus.baud)
            self.rig.transmit(frame, self.now)
            self._pump(self._now_ns)

    def wait(self, taken: Taken) -> None:
        """Move the rig until something comes for the firmware, or to the time at which it wants to wake.

        Args:
            taken: from `wake`

        Raises:
            RunError: the firmware wakes again and again without letting time pass
        """
        before_ns = self._now_ns
        until_ns = self._boot_ns + taken.until_us * 1000
        while not (self._bus or (self._restless and self._sensors)) and self._now_ns < until_ns:
            events = [self.rig.next_event(), self.rig.next_line() if self._restless else None]
            self._pump(min([until_ns, *(round(at * 1e9) for at in events if at is not None)]))
        self._idle = 0 if self._now_ns > before_ns else self._idle + 1
        if self._idle > _IDLE_MAX:
            raise RunError(
                f"the firmware has woken {self._idle} times at {self.now:.6f} s and lets no time pass; this is a "
                "defect in it"
            )

    def flush(self) -> None:
        """Tell the tap what has come since the last packet was sent."""
        if self._received and self._tap:
            self._tap("rx", self._received_ns * 1e-9, self._received)
        self._received = b""

    def _pump(self, until_ns: int) -> None:
        """Move the rig to a time; one that has passed is now."""
        until_ns = max(until_ns, self._now_ns)
        until = until_ns * 1e-9
        self.rig.advance(until)
        for _, reply in self.rig.replies_until(until):
            self._bus += reply
            self._received += reply
            self._received_ns = until_ns
        self._sensors += self.rig.sensor_until(until)
        self._now_ns = until_ns
