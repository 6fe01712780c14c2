"""Give torque and take it: settings first, goals where the joints stand, and off for every servo whatever happens."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from controller.homing import derated
from controller.register import Register, encode_register
from controller.registers import registers
from controller.rig import Joint, Rig
from deploy.buses.port import PortLostError
from deploy.buses.servo_bus import BusError, ServoBus
from deploy.clock import Clock
from deploy.joint_counts import count_limits

_RELEASE_S_MAX: Final = 1.0
_RELEASE_PAUSE_S: Final = 0.05
_PATIENCE_S: Final = 0.06
_WATCHDOG_UNIT_S: Final = 0.02


def write_settings(bus: ServoBus, rig: Rig, derate: float) -> None:
    """Write gains, torque ceiling and what else the loop needs of every servo and read it back. RAM only.

    Args:
        bus: the bus
        rig: the rig
        derate: part of the torque ceiling that is allowed, in (0, 1]

    Raises:
        BusError: if a servo does not take a setting
    """
    for joint in rig.joints:
        for register, value in settings_in_ram(joint, derate):
            bus.write_register(joint.id, register, value)


def settings_in_ram(joint: Joint, derate: float) -> Iterator[tuple[Register, int]]:
    """Yield what is written to a servo before it gets torque, in order: register, count.

    Args:
        joint: the servo's joint
        derate: part of the torque ceiling that is allowed, in (0, 1]
    """
    family, table = joint.family, registers(joint.product)
    in_ram = [(table[name], value) for name, value in family.settings if not table[name].eeprom]
    first = [pair for pair in in_ram if pair[0].name in (family.status_level, family.watchdog)]
    if family.protocol == "feetech":
        # its lock lets EEPROM forget what is written there by mistake; a Dynamixel's own would last until power is cut
        yield table[str(family.lock)], 1
    yield from first
    yield from ((table[name], count) for name, count in joint.gains.items() if not table[name].eeprom)
    yield from (pair for pair in in_ram if pair not in first)
    if family.torque_ceiling is not None:
        yield table[family.torque_ceiling], derated(joint.ceiling, derate)


def seed_goals(bus: ServoBus, rig: Rig) -> tuple[int, ...]:
    """Set every goal to where its joint stands, or to rest, so that torque moves nothing.

    A goal gives some servos torque, so this comes after the settings and right before `torque_on`.

    Args:
        bus: the bus
        rig: the rig

    Returns:
        the goals [counts], (njoint,)

    Raises:
        BusError: if a servo does not take its goal
    """
    goals = []
    for joint in rig.joints:
        family, table = joint.family, registers(joint.product)
        goal = 0
        if joint.mode == "position":
            low, high = count_limits(joint)
            goal = min(max(bus.read_register(joint.id, table[family.position]), low), high)
        bus.write_register(joint.id, table[family.goal(joint.mode)], goal)
        goals.append(goal)
    return tuple(goals)


def torque_on(bus: ServoBus, rig: Rig) -> None:
    """Switch every servo's torque on, then arm its bus watchdog if it has one.

    Args:
        bus: the bus
        rig: the rig

    Raises:
        BusError: if a servo refuses
    """
    for joint in rig.joints:
        bus.write_register(joint.id, _torque(joint), 1)
    if rig.safety.watchdog_s > 0.0:
        counts = round(rig.safety.watchdog_s / _WATCHDOG_UNIT_S)
        for joint in rig.joints:
            watchdog = _watchdog(joint)
            if watchdog is not None:
                bus.write_register(joint.id, watchdog, counts)


def release(bus: ServoBus, rig: Rig, clock: Clock) -> list[Joint]:
    """Switch every servo's torque off and read it back; a servo that does not answer keeps none of the others waiting.

    All are told at once, then each in turn; those that can not be read back are tried again for a second, with more
    patience for late replies. A port that is gone is opened again if it comes back meanwhile.

    Args:
        bus: the bus
        rig: the rig
        clock: the bus's time

    Returns:
        the joints whose torque is not known to be off
    """
    left = list(rig.joints)
    until = clock.now() + _RELEASE_S_MAX
    usual_s = bus.port.latency_s
    told = False
    try:
        while left:
            try:
                if not told:
                    _tell_all(bus, rig)
                    told = True
                left = [joint for joint in left if not _switch_off(bus, joint)]
            except PortLostError:
                told = False
            if not left or clock.now() >= until:
                break
            clock.sleep_until(clock.now() + _RELEASE_PAUSE_S)
            bus.port.latency_s = max(usual_s, _PATIENCE_S)
            if not told:
                bus.port.reopen()
    finally:
        bus.port.latency_s = usual_s
    return left


def unsure_sentence(joints: Sequence[Joint]) -> str:
    """Say which joints may still have torque.

    Args:
        joints: as `release` returns them, not empty
    """
    named = ", ".join(f"{joint.name} (servo {joint.id})" for joint in joints)
    return f"torque could not be switched off for certain on {named}; cut the power"


def hold(bus: ServoBus, rig: Rig) -> None:
    """Leave every servo holding its last goal, or at rest, with nobody on the bus: disarm the bus watchdogs.

    Args:
        bus: the bus
        rig: the rig

    Raises:
        BusError: if a servo does not take it, or has no torque
    """
    for joint in rig.joints:
        watchdog = _watchdog(joint)
        if joint.mode == "velocity":
            bus.write_register(joint.id, _goal(joint), 0)
        if watchdog is not None:
            bus.write_register(joint.id, watchdog, 0)
        if bus.read_register(joint.id, _torque(joint)) != 1:
            raise BusError(f"joint {joint.name} (servo {joint.id}) was to hold, but its torque is off")


def _tell_all(bus: ServoBus, rig: Rig) -> None:
    """Tell all servos at once to stop, without waiting for anybody."""
    moving = [joint for joint in rig.joints if joint.mode == "velocity"]
    if moving:
        bus.sync_write(_goal(moving[0]).address, {joint.id: encode_register(_goal(joint), 0) for joint in moving})
    bus.sync_write(
        _torque(rig.joints[0]).address, {joint.id: encode_register(_torque(joint), 0) for joint in rig.joints}
    )


def _switch_off(bus: ServoBus, joint: Joint) -> bool:
    """Switch one servo's torque and watchdog off and let its velocity be 0; return whether it reads so."""
    watchdog = _watchdog(joint)
    try:
        bus.write_register(joint.id, _torque(joint), 0, attempts=1)
        if watchdog is not None:
            bus.write_register(joint.id, watchdog, 0, attempts=1)
        if joint.mode == "velocity":
            bus.write_register(joint.id, _goal(joint), 0, attempts=1)
            return bus.read_register(joint.id, _torque(joint), attempts=1) == 0  # a goal may have switched it on
    except BusError:
        return False
    return True


def _torque(joint: Joint) -> Register:
    return registers(joint.product)[joint.family.torque_enable]


def _goal(joint: Joint) -> Register:
    return registers(joint.product)[joint.family.goal(joint.mode)]


def _watchdog(joint: Joint) -> Register | None:
    name = joint.family.watchdog
    return None if name is None else registers(joint.product)[name]
