"""Watch a rig without touching it: read what its servos say, again and again, and write nothing to them."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

from controller.families import Family, family_of
from controller.registers import Register, decode_register, registers
from controller.rig import Joint, Rig
from deploy.buses.servo_bus import Reply, ServoBus
from deploy.clock import Clock
from deploy.joint_counts import joint_angle

RATE_WINDOW_S: Final = 1.0


@dataclass
class ServoView:
    """Hold the newest that is known of one servo.

    Args:
        joint: the joint
        family: of its servo
        values: register name => newest count
        read_at: when its position was read last, -inf: never [s]
        asked: how often its position was asked for
        missed: how often no answer came
        missed_in_a_row: since the last answer
        corrupt: how often bytes came that were no answer
        error: status error byte of its last reply
        alert: whether that reply said that something is wrong with the servo
    """

    joint: Joint
    family: Family
    values: dict[str, int] = field(default_factory=dict)
    read_at: float = -math.inf
    asked: int = 0
    missed: int = 0
    missed_in_a_row: int = 0
    corrupt: int = 0
    error: int = 0
    alert: bool = False

    @property
    def angle_rad(self) -> float | None:
        """Return the joint's angle, or None if it was never read [rad]."""
        count = self.values.get(self.family.position)
        return None if count is None else joint_angle(self.joint, count)

    @property
    def velocity_rad_s(self) -> float | None:
        """Return the joint's velocity, or None if it was never read [rad/s]."""
        value = self.scaled(self.family.velocity)
        return None if value is None else self.joint.sign * value

    @property
    def errors(self) -> tuple[str, ...]:
        """Return what is wrong with the servo, in words, as it says itself."""
        bits = self.values.get(self.family.hardware_error, 0) if self.family.hardware_error else self.error
        return self.family.errors(bits) or (("alert",) if self.alert else ())

    def scaled(self, name: str) -> float | None:
        """Return a register's newest value in its own unit, or None if it was never read.

        Args:
            name: the register
        """
        count = self.values.get(name)
        return None if count is None else count * registers(self.joint.product)[name].scale


@dataclass
class View:
    """Hold the newest that is known of a rig.

    Args:
        servos: in bus order
        t: time [s]
        cycles: how often all positions were asked for
        rate_hz: how often that happens now, nan before it is known
    """

    servos: tuple[ServoView, ...]
    t: float
    cycles: int = 0
    rate_hz: float = math.nan


def watch(bus: ServoBus, rig: Rig, clock: Clock, period_s: float) -> Iterator[View]:
    """Read every servo's position, velocity and load in every period, and one servo's health after the other.

    Args:
        bus: the bus
        rig: the rig
        clock: the bus's time
        period_s: pause between two readings; a bus that is slower is read as fast as it can be [s]

    Yields:
        the same view, after each period; it goes on for ever
    """
    servos = tuple(ServoView(joint, family_of(joint.product)) for joint in rig.joints)
    view = View(servos, clock.now())
    turns = [(servo, block) for servo in servos for block in servo.family.health]
    times: deque[float] = deque()
    due = clock.now()
    while True:
        for group in _groups(servos):
            _read(bus, group, clock)
        servo, block = turns[view.cycles % len(turns)]
        _read_health(bus, servo, block)
        view.cycles += 1
        view.t = clock.now()
        times.append(view.t)
        while times[-1] - times[0] > RATE_WINDOW_S and len(times) > 2:
            times.popleft()
        if len(times) > 1 and times[-1] > times[0]:
            view.rate_hz = (len(times) - 1) / (times[-1] - times[0])
        yield view
        due = max(due + period_s, clock.now())
        clock.sleep_until(due)


def _groups(servos: tuple[ServoView, ...]) -> list[list[ServoView]]:
    """Return servos that can be asked with one question: those whose block lies at the same place."""
    groups: dict[tuple[int, int], list[ServoView]] = {}
    for servo in servos:
        lines = _block(servo, servo.family.state)
        groups.setdefault((lines[0].address, lines[-1].address), []).append(servo)
    return list(groups.values())


def _block(servo: ServoView, names: tuple[str, str]) -> list[Register]:
    """Return the registers from the first to the last name, in order of address."""
    table = registers(servo.joint.product)
    first, last = table[names[0]].address, table[names[1]].address
    return [line for line in table.values() if first <= line.address <= last]


def _read(bus: ServoBus, servos: list[ServoView], clock: Clock) -> None:
    lines = _block(servos[0], servos[0].family.state)
    first, length = lines[0].address, lines[-1].address + lines[-1].size - lines[0].address
    replies = bus.sync_read([servo.joint.id for servo in servos], first, length)
    for servo in servos:
        reply = replies[servo.joint.id]
        servo.asked += 1
        if reply.status == "data":
            servo.missed_in_a_row = 0
            servo.read_at = clock.now()
            _take(servo, reply, lines)
        else:
            servo.missed += 1
            servo.missed_in_a_row += 1
            servo.corrupt += reply.status == "corrupt"


def _read_health(bus: ServoBus, servo: ServoView, names: tuple[str, str]) -> None:
    if servo.missed_in_a_row:
        return  # a silent servo would hold up the others
    lines = _block(servo, names)
    first, length = lines[0].address, lines[-1].address + lines[-1].size - lines[0].address
    reply = bus.read(servo.joint.id, first, length)
    if reply.status == "data":
        _take(servo, reply, lines)


def _take(servo: ServoView, reply: Reply, lines: list[Register]) -> None:
    first = lines[0].address
    for line in lines:
        data = reply.data[line.address - first : line.address - first + line.size]
        servo.values[line.name] = decode_register(line, data)
    servo.error, servo.alert = reply.error, reply.alert
