"""Exchange one period's data with a rig: what came over the wire, held with its age where nothing new came."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from controller.register import Register, decode_register, encode_register
from controller.registers import registers
from controller.rig import Rig
from deploy.buses.sensor_port import SensorPort
from deploy.buses.sensor_reader import SensorReader
from deploy.buses.servo_bus import Reply, ServoBus
from deploy.clock import Clock
from deploy.joint_counts import joint_angle


def raw_channels(rig: Rig) -> tuple[str, ...]:
    """Return the names of the raw channels, in the cycle's order.

    Args:
        rig: the rig
    """
    joints = [joint.name for joint in rig.joints]
    return (
        *joints,
        *(f"{name}_vel" for name in joints),
        *(f"{name}_load" for name in joints),
        *(sensor.name for sensor in rig.sensors),
    )


class RigIO:
    """Hold the newest counts of every raw channel of a rig, and exchange them with bus and sensor port.

    Args:
        rig: the rig
        bus: the servos' bus
        sensors: the sensor node's port, or None if the rig has no sensors
        clock: the run's time
    """

    def __init__(self, rig: Rig, bus: ServoBus, sensors: SensorPort | None, clock: Clock) -> None:
        self.rig = rig
        self.bus = bus
        self.reader = SensorReader(rig.sensors)
        self.raw: npt.NDArray[np.int32] = np.zeros(rig.nraw, np.int32)
        self._sensors = sensors
        self._clock = clock
        self._ids = tuple(joint.id for joint in rig.joints)
        self._tables = tuple(registers(joint.product) for joint in rig.joints)
        families = [joint.family for joint in rig.joints]
        self._state = tuple(
            tuple(table[name] for name in (family.position, family.velocity, family.load))
            for table, family in zip(self._tables, families, strict=True)
        )
        self._goals = tuple(
            table[family.goal(joint.mode)]
            for table, family, joint in zip(self._tables, families, rig.joints, strict=True)
        )
        self._answered_at = [-math.inf] * len(rig.joints)

    def read_servos(self, address: int, size: int) -> dict[int, Reply]:
        """Read position, velocity and load of every servo; hold the last counts of one that does not answer.

        Args:
            address: first byte of the block that holds them
            size: bytes
        """
        replies = self.bus.sync_read(self._ids, address, size)
        njoint = len(self.rig.joints)
        for number, servo in enumerate(self._ids):
            reply = replies[servo]
            if reply.status != "data":
                continue
            self._answered_at[number] = reply.t
            for channel, register in enumerate(self._state[number]):
                self.raw[channel * njoint + number] = _field(register, reply.data, address)
        return replies

    def read_sensors(self) -> None:
        """Take the lines that have come from the sensor node."""
        if self._sensors is None:
            return
        self.reader.feed(self._sensors.read_available(), self._clock.now())
        first = 3 * len(self.rig.joints)
        for number in range(len(self.rig.sensors)):
            raw = self.reader.raw(number)
            if raw is not None:
                self.raw[first + number] = raw

    def write_goals(self, goals: Sequence[int], address: int) -> float | None:
        """Write every servo's goal.

        Args:
            goals: of each joint's mode [counts], (njoint,)
            address: where they go

        Returns:
            when they were handed to the port [s], or None if it did not take them
        """
        values = {
            servo: encode_register(register, int(count))
            for servo, register, count in zip(self._ids, self._goals, goals, strict=True)
        }
        return self._clock.now() if self.bus.sync_write(address, values) else None

    def read_health(self, number: int, address: int, size: int) -> Mapping[str, int]:
        """Read a block of one servo's health registers.

        Args:
            number: of the joint
            address: first byte
            size: bytes

        Returns:
            register => count; empty if the reply was lost
        """
        reply = self.bus.read(self.rig.joints[number].id, address, size)
        if reply.status != "data":
            return {}
        return {
            name: _field(register, reply.data, address)
            for name, register in self._tables[number].items()
            if address <= register.address and register.address + register.size <= address + size
        }

    def ages_s(self) -> list[float]:
        """Return the age of every raw channel's counts, infinite if never read [s], (nraw,)."""
        now = self._clock.now()
        joints = [now - answered for answered in self._answered_at]
        return [*joints, *joints, *joints, *(self.reader.age(n, now) for n in range(len(self.rig.sensors)))]

    def angles_rad(self) -> list[float]:
        """Return the joints' newest angles [rad], (njoint,)."""
        return [joint_angle(joint, int(self.raw[number])) for number, joint in enumerate(self.rig.joints)]

    def position_counts(self) -> list[int]:
        """Return the joints' newest encoder counts, (njoint,)."""
        return [int(count) for count in self.raw[: len(self.rig.joints)]]

    def velocity_counts(self) -> list[int]:
        """Return the joints' newest velocities [counts], (njoint,)."""
        njoint = len(self.rig.joints)
        return [int(count) for count in self.raw[njoint : 2 * njoint]]

    def sensor_values(self) -> Mapping[str, float]:
        """Return the newest value in SI of every sensor that has sent one, by name."""
        first = 3 * len(self.rig.joints)
        return {
            sensor.name: (int(self.raw[first + number]) - sensor.zero) * sensor.scale
            for number, sensor in enumerate(self.rig.sensors)
            if self.reader.raw(number) is not None
        }


def _field(register: Register, block: bytes, first: int) -> int:
    start = register.address - first
    return decode_register(register, block[start : start + register.size])
