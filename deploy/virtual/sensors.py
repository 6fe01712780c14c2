"""The virtual rig's sensor node: samples the body at its rates and sends checked lines.

A line is ``$F,<seq>,<t_us>,<raw…>*HH`` and a line end: letter, counter, the node's time of the sample, one integer a
field, and the exclusive or of the bytes between ``$`` and ``*``. Samples are taken at whole multiples of 1 / rate; the
last byte of a line arrives `latency_s` after its sample.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import reduce
from operator import xor
from typing import Final

import numpy as np

from controller.errors import InputError
from controller.rig import Rig, Sensor
from deploy.virtual.twin import Twin

QUANTITIES: Final = ("x", "y", "z", "heading", "roll", "pitch", "force")
"""What the virtual rig can measure."""

_COUNT_MAX: Final = 2**31 - 1


@dataclass
class _Message:
    """Hold the state of one letter's lines."""

    letter: str
    fields: tuple[Sensor | None, ...]
    rate_hz: float
    latency_ns: int
    seq: int = 0

    def sample_ns(self) -> int:
        """Return when the next sample is taken [ns]."""
        return round(self.seq * 1e9 / self.rate_hz)


class VirtualSensors:
    """Sample and send.

    Args:
        rng: for the noise
        rig: the rig whose sensors these are
        twin: how noisy they are
        lose: what the line does to a line: given its letter and bytes, returns them, changed or not, or None

    Raises:
        InputError: the rig names a sensor that the virtual rig does not have
    """

    def __init__(
        self, rng: np.random.Generator, rig: Rig, twin: Twin, lose: Callable[[str, bytes], bytes | None]
    ) -> None:
        for sensor in rig.sensors:
            if sensor.name not in QUANTITIES:
                known = ", ".join(QUANTITIES)
                raise InputError(
                    f"{rig.path}: sensor {sensor.name}: the virtual rig can not measure it; it has {known}"
                )
        self._rng = rng
        self._lose = lose
        self._noise = _of_each(twin.position_noise_m, twin.angle_noise_rad, twin.force_noise_n)
        self._bias = _of_each(twin.position_bias_m, twin.angle_bias_rad, twin.force_bias_n)
        letters = dict.fromkeys(sensor.message for sensor in rig.sensors)
        self._messages = [_message(letter, rig, twin.sensor_latency_s) for letter in letters]
        self._lines: deque[tuple[int, bytes]] = deque()

    def next_sample_ns(self) -> int | None:
        """Return when the next sample is due, or None if there are no sensors [ns]."""
        return min((message.sample_ns() for message in self._messages), default=None)

    def next_line_ns(self) -> int | None:
        """Return when the next line arrives, or None if none is on its way [ns]."""
        return self._lines[0][0] if self._lines else None

    def sample(self, now_ns: int, measure: Callable[[str], float]) -> None:
        """Take the samples that are due.

        Args:
            now_ns: time of the body [ns]
            measure: gives a quantity, SI
        """
        for message in self._messages:
            while message.sample_ns() <= now_ns:
                line = self._line(message, measure)
                arrives_ns = message.sample_ns() + message.latency_ns
                message.seq += 1
                sent = self._lose(message.letter, line)
                if sent:
                    self._queue(arrives_ns, sent)

    def send_stop(self, now_ns: int) -> None:
        """Send the emergency stop line, as the node does when its button is pressed.

        Args:
            now_ns: time [ns]
        """
        self._queue(now_ns, _checked(b"E"))

    def take(self, until_ns: int) -> bytes:
        """Return the lines that have arrived by a time.

        Args:
            until_ns: time [ns]
        """
        taken = bytearray()
        while self._lines and self._lines[0][0] <= until_ns:
            taken += self._lines.popleft()[1]
        return bytes(taken)

    def _queue(self, at_ns: int, line: bytes) -> None:
        """Let a line arrive, after those that arrive no later."""
        late: list[tuple[int, bytes]] = []
        while self._lines and self._lines[-1][0] > at_ns:
            late.append(self._lines.pop())
        self._lines.append((at_ns, line))
        self._lines.extend(reversed(late))

    def _line(self, message: _Message, measure: Callable[[str], float]) -> bytes:
        counts = [0 if sensor is None else self._counts(sensor, measure(sensor.name)) for sensor in message.fields]
        t_us = message.sample_ns() // 1000
        body = ",".join((message.letter, str(message.seq % 2**32), str(t_us), *map(str, counts))).encode()
        return _checked(body)

    def _counts(self, sensor: Sensor, value: float) -> int:
        value += self._bias[sensor.name]
        noise = self._noise[sensor.name]
        if noise > 0.0:
            value += noise * float(self._rng.standard_normal())
        counts = round(value / sensor.scale) + sensor.zero
        return min(_COUNT_MAX, max(-_COUNT_MAX, counts))


def _checked(body: bytes) -> bytes:
    return b"$%b*%02X\r\n" % (body, reduce(xor, body))


def _message(letter: str, rig: Rig, later_s: float) -> _Message:
    sensors = [sensor for sensor in rig.sensors if sensor.message == letter]
    fields: list[Sensor | None] = [None] * (1 + max(sensor.field for sensor in sensors))
    for sensor in sensors:
        fields[sensor.field] = sensor
    return _Message(letter, tuple(fields), sensors[0].rate_hz, round((sensors[0].latency_s + later_s) * 1e9))


def _of_each(position_m: float, angle_rad: float, force_n: float) -> Mapping[str, float]:
    """Return what belongs to each quantity."""
    values = dict.fromkeys(("x", "y", "z"), position_m)
    values |= dict.fromkeys(("heading", "roll", "pitch"), angle_rad)
    return values | {"force": force_n}
