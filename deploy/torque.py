"""Give torque and take it: settings first, goals where the joints stand, and off for every servo whatever happens."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from controller.registers import registers
from controller.rig import Joint, Rig
from deploy.clock import Clock
from deploy.joint_counts import count_limits
from deploy.port import PortLostError
from deploy.servo_bus import BusError, ServoBus, encode

_RELEASE_S_MAX: Final = 1.0
_RELEASE_PAUSE_S: Final = 0.05
_WATCHDOG_UNIT_S: Final = 0.02


def write_settings(bus: ServoBus, rig: Rig, derate: float) -> None:
    """Write gains and torque ceiling of every servo and read them back. RAM only.

    Args:
        bus: the bus
        rig: the rig
        derate: part of the torque ceiling that is allowed, in (0, 1]

    Raises:
        BusError: if a servo does not take a setting
    """
    for joint in rig.joints:
        table = registers(joint.product)
        # in position mode Goal PWM is the ceiling of the duty, and lives in RAM
        for name, value in (
            ("status_return_level", 2),
            ("bus_watchdog", 0),
            ("position_p_gain", joint.p_gain),
            ("position_i_gain", joint.i_gain),
            ("position_d_gain", joint.d_gain),
            ("feedforward_1st_gain", 0),
            ("feedforward_2nd_gain", 0),
            ("profile_acceleration", 0),
            ("profile_velocity", 0),
            ("goal_pwm", round(joint.pwm_limit * derate)),
        ):
            bus.write_register(joint.id, table[name], value)


def seed_goals(bus: ServoBus, rig: Rig) -> tuple[int, ...]:
    """Set every goal to where its joint stands, so that torque moves nothing.

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
        table = registers(joint.product)
        low, high = count_limits(joint)
        goal = min(max(bus.read_register(joint.id, table["present_position"]), low), high)
        bus.write_register(joint.id, table["goal_position"], goal)
        goals.append(goal)
    return tuple(goals)


def torque_on(bus: ServoBus, rig: Rig) -> None:
    """Switch every servo's torque on, then arm its bus watchdog.

    Args:
        bus: the bus
        rig: the rig

    Raises:
        BusError: if a servo refuses
    """
    for joint in rig.joints:
        bus.write_register(joint.id, registers(joint.product)["torque_enable"], 1)
    if rig.safety.watchdog_s > 0.0:
        for joint in rig.joints:
            counts = round(rig.safety.watchdog_s / _WATCHDOG_UNIT_S)
            bus.write_register(joint.id, registers(joint.product)["bus_watchdog"], counts)


def release(bus: ServoBus, rig: Rig, clock: Clock) -> list[Joint]:
    """Switch every servo's torque off and read it back; a servo that does not answer keeps none of the others waiting.

    All are told at once, then each in turn; those that can not be read back are tried again for a second.

    Args:
        bus: the bus
        rig: the rig
        clock: the bus's time

    Returns:
        the joints whose torque is not known to be off
    """
    table = registers(rig.joints[0].product)["torque_enable"]
    left = list(rig.joints)
    until = clock.now() + _RELEASE_S_MAX
    try:
        bus.sync_write(table.address, {joint.id: encode(table, 0) for joint in rig.joints})
        left = [joint for joint in left if not _switch_off(bus, joint)]
        while left and clock.now() < until:
            clock.sleep_until(clock.now() + _RELEASE_PAUSE_S)
            left = [joint for joint in left if not _switch_off(bus, joint)]
    except PortLostError:
        pass  # who is left is told
    return left


def unsure_sentence(joints: Sequence[Joint]) -> str:
    """Say which joints may still have torque.

    Args:
        joints: as `release` returns them, not empty
    """
    named = ", ".join(f"{joint.name} (servo {joint.id})" for joint in joints)
    return f"torque could not be switched off for certain on {named}; cut the power"


def hold(bus: ServoBus, rig: Rig) -> None:
    """Leave every servo holding its last goal with nobody on the bus: disarm the bus watchdogs.

    Args:
        bus: the bus
        rig: the rig

    Raises:
        BusError: if a servo does not take it, or has no torque
    """
    for joint in rig.joints:
        table = registers(joint.product)
        bus.write_register(joint.id, table["bus_watchdog"], 0)
        if bus.read_register(joint.id, table["torque_enable"]) != 1:
            raise BusError(f"joint {joint.name} (servo {joint.id}) was to hold, but its torque is off")


def _switch_off(bus: ServoBus, joint: Joint) -> bool:
    """Switch one servo's torque and watchdog off; return whether it reads so."""
    table = registers(joint.product)
    try:
        bus.write_register(joint.id, table["torque_enable"], 0, attempts=1)
        bus.write_register(joint.id, table["bus_watchdog"], 0, attempts=1)
    except BusError:
        return False
    return True
