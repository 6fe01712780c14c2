"""The virtual rig: servos, body and sensor node behind two lines of bytes; pure, single-threaded, repeatable.

Time is the rig's own and only moves forward. It comes and goes as float seconds and is kept as whole nanoseconds: the
same bytes at the same times give the same bytes at the same times, and the same motion, on every run. The body moves
in whole physics steps; what arrives within a step acts from the beginning of that step.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from controller.rig import Rig
from controller.rig_file import require_bus
from deploy.virtual.active_faults import ActiveFaults
from deploy.virtual.adapter import UsbAdapter
from deploy.virtual.bus import VirtualBus
from deploy.virtual.drive import Shaft
from deploy.virtual.eeprom_file import Kept, load_eeprom, save_eeprom
from deploy.virtual.fault_effects import FaultEffects
from deploy.virtual.faults import Fault, check_faults
from deploy.virtual.plant import Plant, Start, Truth
from deploy.virtual.sensors import VirtualSensors
from deploy.virtual.servo_kinds import commissioned, framing_of, virtual_servo
from deploy.virtual.twin import Twin

PROTECT_NS: Final = 5_000_000
"""How often the servos look after their temperature, load and supply [ns]."""

BABBLE_BYTES_MAX: Final = 60
"""Bytes of garbage that a babbling sensor node puts before a line, at most."""


class VirtualRig:
    """Stand in for a rig: feed it a master's bytes, take the servos' and the sensor node's.

    Args:
        rig: which rig
        seed: of faults and noise
        twin: how its physics differ from the simulation's; None: not
        faults: what goes wrong
        start: "settled" or "limp", see `deploy.virtual.plant.Plant`
        eeprom_path: where the servos' EEPROM is kept between runs; None: it starts as the rig file says
        wire_time: whether bytes take time on the line
        echo: whether the master hears its own bytes

    Raises:
        InputError: the rig, the twin, a fault or the EEPROM file asks for what can not be
    """

    def __init__(
        self,
        rig: Rig,
        *,
        seed: int = 0,
        twin: Twin | None = None,
        faults: Sequence[Fault] = (),
        start: Start = "settled",
        eeprom_path: Path | None = None,
        wire_time: bool = True,
        echo: bool = False,
    ) -> None:
        self.rig = rig
        self.twin = twin or Twin()
        self._line_rng, self._sensor_rng, noise_rng, adapter_rng = (
            np.random.Generator(np.random.Philox(key)) for key in np.random.SeedSequence(seed).spawn(4)
        )
        self._now_ns = 0
        require_bus(rig, "a virtual rig")
        self._plant = Plant(rig, self.twin, start)
        self._eeprom_path = eeprom_path
        kept = load_eeprom(eeprom_path, rig) if eeprom_path else {}
        self.servos = tuple(
            virtual_servo(joint.product, shaft, kept.get(joint.name) or Kept(commissioned(joint, rig)))
            for joint, shaft in zip(rig.joints, self._plant.shafts, strict=True)
        )
        self._bus = VirtualBus(
            self.servos,
            rig.bus.baud,
            self._is_silent,
            self._lose_status,
            framing_of(rig),
            wire_time=wire_time,
            echo=echo,
        )
        self._sensors = VirtualSensors(noise_rng, rig, self.twin, self._lose_line)
        self._faults = ActiveFaults()
        self._effects = FaultEffects(rig, self._plant, self.servos, self._sensors)
        self._adapter = UsbAdapter(adapter_rng, self._faults)
        self._protect_ns = PROTECT_NS
        self.set_faults(faults)
        self._advance(0)

    # time

    @property
    def now(self) -> float:
        """Return the rig's time [s]."""
        return self._now_ns * 1e-9

    def advance(self, t: float) -> None:
        """Move the rig to a time; a time that has passed is none.

        Args:
            t: rig time [s]
        """
        self._advance(_ns(t))

    # the bus

    def set_baud(self, baud: int) -> None:
        """Set the master's bit rate: servos with another rate do not hear it.

        Args:
            baud: [bits/s]
        """
        self._bus.baud = baud

    def feed(self, data: bytes, t: float) -> None:
        """Take bytes from the master.

        Args:
            data: any bytes
            t: when the last one has ended on the line [s]
        """
        self._advance(_ns(t))
        if self.unplugged or self._faults.happens(self._line_rng, "deaf", self.now):
            return
        self._bus.feed(data, self._now_ns)
        self._keep_eeprom()

    def transmit(self, data: bytes, t: float) -> float:
        """Take bytes that the master begins to send; return when the last one has ended [s].

        Args:
            data: any bytes
            t: when the first one starts [s]
        """
        end = max(_ns(t), self._now_ns) + self._bus.duration_ns(len(data))
        self.feed(data, end * 1e-9)
        return end * 1e-9

    def replies_until(self, t: float) -> list[tuple[float, bytes]]:
        """Return the status packets that have ended by a time, each with the time of its end [s].

        Args:
            t: rig time [s]
        """
        packets = self._bus.take_replies(_ns(t))
        if self.unplugged:
            self._adapter.forget()
            return []
        self._adapter.carry(packets)
        return [(at_ns * 1e-9, packet) for at_ns, packet in self._adapter.take(_ns(t))]

    def next_event(self) -> float | None:
        """Return when the next status packet may be read, or None if none is on its way [s]."""
        times = [at for at in (self._bus.next_ns(), self._adapter.next_ns()) if at is not None]
        return min(times) * 1e-9 if times else None

    @property
    def unplugged(self) -> bool:
        """Return whether a fault has unplugged the bus's adapter."""
        return self._faults.acts("unplug")

    # the sensor node

    def sensor_until(self, t: float) -> bytes:
        """Return the sensor lines that have arrived by a time.

        Args:
            t: rig time [s]
        """
        self._advance(_ns(t))
        return self._sensors.take(_ns(t))

    def next_line(self) -> float | None:
        """Return when the next sensor line may arrive, or None if there are no sensors [s]."""
        times = [at for at in (self._sensors.next_line_ns(), self._sensors.next_sample_ns()) if at is not None]
        return min(times) * 1e-9 if times else None

    # judges and demonstrators

    def truth(self) -> Truth:
        """Return the state of the body, for judges only: no controller may see it."""
        return self._plant.truth()

    @property
    def shafts(self) -> Sequence[Shaft]:
        """Return what the servos turn, in the rig's order: for judges only."""
        return self._plant.shafts

    def set_upright(self) -> None:
        """Put the body back where it stood at the start, at rest, as a person would."""
        self._plant.set_upright()

    def set_faults(self, faults: Sequence[Fault]) -> None:
        """Replace what goes wrong from now on.

        Args:
            faults: all faults; those that are over or to come included

        Raises:
            InputError: the rig has no such servo or message
        """
        check_faults(faults, self.rig)
        for fault in self._faults.replace(faults):
            self._effects.end(fault, self._now_ns)
        self._strike()

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Return all faults, those that are over or to come included."""
        return self._faults.all

    # inside

    def _advance(self, to_ns: int) -> None:
        while True:
            stop_ns = min((at for at in self._events_ns() if at < to_ns), default=to_ns)
            self._move((stop_ns - self._plant.time_ns) // self._plant.step_ns)
            self._now_ns = max(self._now_ns, stop_ns)
            self._sensors.sample(self._now_ns, self._plant.measure)
            for servo in self.servos:
                at = servo.watchdog_ns()
                if at is not None and at <= self._now_ns:
                    servo.trip_watchdog()
            if self._protect_ns <= self._now_ns:
                self._protect_ns += PROTECT_NS
                self._protect()
            self._strike()
            if stop_ns >= to_ns:
                return

    def _events_ns(self) -> Iterator[int]:
        """Yield when the body must stop on its way, for something that happens at that very time."""
        yield self._protect_ns
        sample_ns = self._sensors.next_sample_ns()
        if sample_ns is not None:
            yield sample_ns
        for servo in self.servos:
            at = servo.watchdog_ns()
            if at is not None:
                yield at
        for at_s in self._faults.times_s():
            if at_s < math.inf and _ns(at_s) > self._now_ns:
                yield _ns(at_s)

    def _move(self, steps: int) -> None:
        """Move the body; step by step only where a servo's own profile moves its goal."""
        plant = self._plant
        while steps > 0:
            moving = [servo for servo in self.servos if servo.moving]
            for servo in moving:
                servo.step(plant.step_ns * 1e-9)
            block = 1 if moving else steps
            plant.step(block)
            steps -= block

    def _protect(self) -> None:
        for index, servo in enumerate(self.servos):
            if not self._is_powerless(index):
                servo.protect(PROTECT_NS * 1e-9)

    def _keep_eeprom(self) -> None:
        if not any(servo.eeprom_changed for servo in self.servos):
            return
        for servo in self.servos:
            servo.eeprom_changed = False
        if self._eeprom_path:
            kept = [Kept(servo.table.eeprom(), getattr(servo, "backup", None)) for servo in self.servos]
            save_eeprom(self._eeprom_path, self.rig, kept)

    # faults

    def _strike(self) -> None:
        """Begin and end what has a beginning and an end."""
        begun, ended = self._faults.turn(self.now)
        for fault in ended:
            self._effects.end(fault, self._now_ns)
        for fault in begun:
            self._effects.begin(fault, self._now_ns)

    def _is_powerless(self, index: int) -> bool:
        return self._faults.acts("dead", self.rig.joints[index].id) or self._faults.acts("brownout")

    def _is_silent(self, index: int) -> bool:
        return self._is_powerless(index) or self._faults.acts("mute", self.rig.joints[index].id)

    def _lose_status(self, status: bytes) -> bytes | None:
        rng, now, happens = self._line_rng, self.now, self._faults.happens
        if happens(rng, "drop", now):
            return None
        if happens(rng, "corrupt", now):
            status = _flip_bit(rng, status)
        return status[: int(rng.integers(1, len(status)))] if happens(rng, "truncate", now) else status

    def _lose_line(self, letter: str, line: bytes) -> bytes | None:
        rng, now, faults = self._sensor_rng, self.now, self._faults
        babble = b""
        if faults.acts("sensor-babble"):
            babble = rng.integers(0, 256, int(rng.integers(1, BABBLE_BYTES_MAX)), dtype=np.uint8).tobytes()
        silent = faults.acts("sensor-silent") or any(fault.letter == letter for fault in faults.acting("sensor-dead"))
        if silent or faults.happens(rng, "sensor-drop", now):
            return babble or None
        return babble + (_flip_bit(rng, line) if faults.happens(rng, "sensor-corrupt", now) else line)


def _flip_bit(rng: np.random.Generator, data: bytes) -> bytes:
    place = int(rng.integers(8 * len(data)))
    flipped = bytearray(data)
    flipped[place // 8] ^= 1 << place % 8
    return bytes(flipped)


def _ns(t: float) -> int:
    return round(t * 1e9)
