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

from controller.registers import X330_BAUD
from controller.rig import Joint, Rig
from deploy.drivable import require_drivable
from deploy.virtual.bus import VirtualBus
from deploy.virtual.dynamixel2_line import DYNAMIXEL2
from deploy.virtual.eeprom_file import load_eeprom, save_eeprom
from deploy.virtual.faults import Fault, check_faults
from deploy.virtual.plant import Plant, Start, Truth
from deploy.virtual.sensors import VirtualSensors
from deploy.virtual.twin import Twin
from deploy.virtual.x_servo import ERROR_HEAT, ERROR_OVERLOAD, XServo

_HARDWARE_ERRORS: Final = {"overload": ERROR_OVERLOAD, "overheat": ERROR_HEAT}

PROTECT_NS: Final = 5_000_000
"""How often the servos look after their temperature, load and supply [ns]."""


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
        self._line_rng, self._sensor_rng, noise_rng = (
            np.random.Generator(np.random.Philox(key)) for key in np.random.SeedSequence(seed).spawn(3)
        )
        self._now_ns = 0
        require_drivable(rig)
        self._plant = Plant(rig, self.twin, start)
        self._supply_v = self._plant.supply_v
        self._eeprom_path = eeprom_path
        eeprom = load_eeprom(eeprom_path, rig) if eeprom_path else {}
        self.servos = tuple(
            XServo(joint.product, shaft, eeprom.get(joint.name) or commissioned(joint, rig))
            for joint, shaft in zip(rig.joints, self._plant.shafts, strict=True)
        )
        self._bus = VirtualBus(
            self.servos,
            rig.bus.baud,
            self._is_silent,
            self._lose_status,
            DYNAMIXEL2,
            wire_time=wire_time,
            echo=echo,
        )
        self._sensors = VirtualSensors(noise_rng, rig, self.twin, self._lose_line)
        self._protect_ns = PROTECT_NS
        self._faults: tuple[Fault, ...] = ()
        self._struck: set[Fault] = set()
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
        if self._chance(self._line_rng, "deaf"):
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
        return [(end_ns * 1e-9, reply) for end_ns, reply in self._bus.take_replies(_ns(t))]

    def next_event(self) -> float | None:
        """Return when the next status packet ends, or None if none is on its way [s]."""
        end_ns = self._bus.next_ns()
        return None if end_ns is None else end_ns * 1e-9

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

    def set_faults(self, faults: Sequence[Fault]) -> None:
        """Replace what goes wrong from now on.

        Args:
            faults: all faults; those that are over or to come included

        Raises:
            InputError: the rig has no such servo or message
        """
        check_faults(faults, self.rig)
        for fault in self._struck.difference(faults):
            self._end(fault)
        self._struck.intersection_update(faults)
        self._faults = tuple(faults)
        self._strike()

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
        for fault in self._faults:
            at_s = fault.end_s if fault in self._struck else fault.start_s
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
            if not self._acts("dead", index):
                servo.protect(PROTECT_NS * 1e-9)

    def _keep_eeprom(self) -> None:
        if not any(servo.eeprom_changed for servo in self.servos):
            return
        for servo in self.servos:
            servo.eeprom_changed = False
        if self._eeprom_path:
            save_eeprom(self._eeprom_path, self.rig, [servo.table.eeprom() for servo in self.servos])

    # faults

    def _strike(self) -> None:
        """Begin and end what has a beginning and an end."""
        for fault in self._faults:
            active = fault.active(self.now)
            if active and fault not in self._struck:
                self._struck.add(fault)
                self._begin(fault)
            elif not active and fault in self._struck:
                self._struck.remove(fault)
                self._end(fault)

    def _begin(self, fault: Fault) -> None:
        if fault.kind == "estop":
            self._sensors.send_stop(self._now_ns)
        for servo, joint in zip(self.servos, self.rig.joints, strict=True):
            if fault.kind == "supply":
                self._plant.supply_v = fault.value
                servo.supply_changed()
            elif joint.id == fault.value and fault.kind == "dead":
                servo.power_off()
            elif joint.id == fault.value and fault.kind in _HARDWARE_ERRORS:
                servo.fail(_HARDWARE_ERRORS[fault.kind])

    def _end(self, fault: Fault) -> None:
        for servo, joint in zip(self.servos, self.rig.joints, strict=True):
            if fault.kind == "supply":
                self._plant.supply_v = self._supply_v
                servo.supply_changed()
            elif joint.id == fault.value and fault.kind == "dead":
                servo.reboot(self._now_ns)

    def _acts(self, kind: str, index: int) -> bool:
        return any(fault.kind == kind and fault.value == self.rig.joints[index].id for fault in self._struck)

    def _is_silent(self, index: int) -> bool:
        return bool(self._struck) and (self._acts("dead", index) or self._acts("mute", index))

    def _chance(self, rng: np.random.Generator, kind: str) -> bool:
        """Draw whether a fault that has a probability happens; draw only where it is configured."""
        for fault in self._faults:
            if fault.kind == kind and fault in self._struck and rng.random() < fault.value:
                return True
        return False

    def _lose_status(self, status: bytes) -> bytes | None:
        if self._chance(self._line_rng, "drop"):
            return None
        return _flip_bit(self._line_rng, status) if self._chance(self._line_rng, "corrupt") else status

    def _lose_line(self, letter: str, line: bytes) -> bytes | None:
        if any(fault.kind == "sensor-dead" and fault.letter == letter for fault in self._struck):
            return None
        if self._chance(self._sensor_rng, "sensor-drop"):
            return None
        return _flip_bit(self._sensor_rng, line) if self._chance(self._sensor_rng, "sensor-corrupt") else line


def commissioned(joint: Joint, rig: Rig) -> dict[str, int]:
    """Return what a servo's EEPROM holds once it has been set up for its rig, where that is not the factory's.

    Args:
        joint: the servo's joint
        rig: the rig

    Returns:
        register name => count
    """
    baud = next(value for value, rate in X330_BAUD.items() if rate == rig.bus.baud)
    return {
        "id": joint.id,
        "baud_rate": baud,
        "return_delay_time": rig.bus.return_delay_us // 2,
        "pwm_limit": joint.pwm_limit,
    }


def _flip_bit(rng: np.random.Generator, data: bytes) -> bytes:
    place = int(rng.integers(8 * len(data)))
    flipped = bytearray(data)
    flipped[place // 8] ^= 1 << place % 8
    return bytes(flipped)


def _ns(t: float) -> int:
    return round(t * 1e9)
