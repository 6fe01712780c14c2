"""Read the sensor node's lines: ``$F,<seq>,<t_us>,<raw…>*HH``, checked, dated, and held with their age.

Whatever arrives, reading goes on: a line starts at a ``$`` wherever one stands, ends at a line end, and counts only if
its check matches. HH is the exclusive or of the bytes between ``$`` and ``*``, in hexadecimal.
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from controller.rig import Sensor

LINE_BYTES_MAX: Final = 200
EMERGENCY_STOP: Final = "E"
"""A checked line with this letter stops the run, whatever else it carries."""

_LINE: Final = re.compile(rb"([A-Z]),(\d{1,10}),(\d{1,16})((?:,-?\d{1,10})*)\*([0-9A-Fa-f]{2})")
_STOP: Final = re.compile(rb"(E(?:,[ -)+-~]*)?)\*([0-9A-Fa-f]{2})")
_COUNT_MAX: Final = 2**31
_CLOCK_DRIFT: Final = 1e-2
"""The node's clock may run this much slower or faster than ours: a microcontroller's RC oscillator is within 1e-2."""

_MEMORY_S: Final = 1.0
"""How long a line that was read without delay tells how the node's clock stands to ours."""


@dataclass(frozen=True)
class Line:
    """Hold one checked line.

    Args:
        message: its letter
        seq: the node's line counter
        t_us: the node's time of the sample [us]
        raw: counts
    """

    message: str
    seq: int
    t_us: int
    raw: tuple[int, ...]


def checksum(body: bytes) -> int:
    """Return the exclusive or of bytes.

    Args:
        body: what stands between ``$`` and ``*``
    """
    check = 0
    for byte in body:
        check ^= byte
    return check


def parse_line(line: bytes) -> Line | None:
    """Return a line's content, or None if it is not one whose check matches.

    Args:
        line: from after ``$`` to before the line end
    """
    stop = _STOP.fullmatch(line)
    if stop and checksum(stop[1]) == int(stop[2], 16):
        return Line(EMERGENCY_STOP, 0, 0, ())
    match = _LINE.fullmatch(line)
    if not match or checksum(line[: line.rindex(b"*")]) != int(match[5], 16):
        return None
    raw = tuple(int(count) for count in match[4].split(b",")[1:])
    if any(not -_COUNT_MAX <= count < _COUNT_MAX for count in raw):
        return None
    return Line(match[1].decode(), int(match[2]), int(match[3]), raw)


class LineSplitter:
    """Cut a stream of bytes into checked lines; hold no more than one line."""

    def __init__(self) -> None:
        self._open: bytearray | None = None

    def feed(self, data: bytes) -> list[Line]:
        """Take what has arrived; return the good lines that ended in it.

        Args:
            data: any bytes
        """
        lines: list[Line] = []
        for byte in data:
            if byte == ord("$"):
                self._open = bytearray()
            elif byte in b"\r\n":
                line = parse_line(bytes(self._open)) if self._open else None
                if line:
                    lines.append(line)
                self._open = None
            elif self._open is not None:
                self._open.append(byte)
                if len(self._open) > LINE_BYTES_MAX:
                    self._open = None
        return lines


@dataclass
class _Channel:
    """Hold the newest line of one letter, and how the node's clock stands to ours.

    Args:
        line: the newest
        sampled_at: when it was sampled [s]
        offset: our time less the node's [s]
        updated_at: when the line was read [s]
        recent: (when a line was read, offset it shows) of the last `_MEMORY_S`, both rising: each the least since
    """

    line: Line
    sampled_at: float
    offset: float
    updated_at: float
    recent: deque[tuple[float, float]]


class SensorReader:
    """Hold the newest counts of every channel, with the time of their sample on our clock.

    A line arrives some time after its sample, and is read some time after that. The smallest difference seen in the
    last second between our time and the node's, less the latency that the rig states, dates every sample; reading late
    does not make a sample look young. If one line a second is read without delay, an age is wrong by no more than what
    the clocks drift apart in a second: 10 ms at 1 %, 0.1 ms with a quartz. If none is, the difference may grow by 1 %
    of the time.

    Args:
        sensors: the rig's channels
    """

    def __init__(self, sensors: Sequence[Sensor]) -> None:
        self._sensors = tuple(sensors)
        self._latency_s = {sensor.message: sensor.latency_s for sensor in sensors}
        self._width = {
            letter: 1 + max(sensor.field for sensor in sensors if sensor.message == letter)
            for letter in self._latency_s
        }
        self._splitter = LineSplitter()
        self._channels: dict[str, _Channel] = {}
        self.emergency_stop = False
        self.lost_lines = 0

    def feed(self, data: bytes, now: float) -> None:
        """Take what the sensor port gave.

        Args:
            data: any bytes
            now: our time [s]
        """
        for line in self._splitter.feed(data):
            if line.message == EMERGENCY_STOP:
                self.emergency_stop = True
            elif len(line.raw) >= self._width.get(line.message, len(line.raw) + 1):
                self._take(line, now)

    def raw(self, sensor: int) -> int | None:
        """Return a channel's newest counts, or None before its first line.

        Args:
            sensor: its number in the rig
        """
        channel = self._channels.get(self._sensors[sensor].message)
        return channel.line.raw[self._sensors[sensor].field] if channel else None

    def age(self, sensor: int, now: float) -> float:
        """Return how old a channel's counts are, infinite before its first line [s].

        Args:
            sensor: its number in the rig
            now: our time [s]
        """
        channel = self._channels.get(self._sensors[sensor].message)
        return now - channel.sampled_at if channel else math.inf

    def _take(self, line: Line, now: float) -> None:
        sample_s = 1e-6 * line.t_us
        offset = now - sample_s - self._latency_s[line.message]
        channel = self._channels.get(line.message)
        if channel and line.t_us == channel.line.t_us:
            return  # the same sample again is not a newer one
        recent: deque[tuple[float, float]] = deque()
        offset_max = math.inf
        if channel and line.t_us > channel.line.t_us:
            self.lost_lines += max(0, line.seq - channel.line.seq - 1)
            recent = channel.recent
            offset_max = channel.offset + _CLOCK_DRIFT * (now - channel.updated_at)
        while recent and recent[-1][1] >= offset:
            recent.pop()
        recent.append((now, offset))
        while recent[0][0] < now - _MEMORY_S:
            recent.popleft()
        offset = min(recent[0][1], offset_max)
        self._channels[line.message] = _Channel(line, sample_s + offset, offset, now, recent)
