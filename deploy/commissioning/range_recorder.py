"""Record how far joints travel while a person moves them: read only, never lost count of a turn."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final

from controller.errors import RunError
from controller.families import family_of
from controller.registers import decode_register, registers
from controller.rig import Joint
from deploy.buses.servo_bus import ServoBus
from deploy.clock import Clock
from deploy.commissioning.calibration import Travel, begin_travel, extend_travel

PERIOD_S: Final = 0.02
GAP_S_MAX: Final = 0.5
"""A hand turns a joint by less than half a turn in this time [s]."""


def read_counts(bus: ServoBus, joints: Sequence[Joint]) -> dict[str, int]:
    """Read where joints stand.

    Args:
        bus: the bus
        joints: which

    Returns:
        joint name => position as its servo reports it [counts]

    Raises:
        BusError: a servo does not answer
    """
    return {
        joint.name: bus.read_register(joint.id, registers(joint.product)[family_of(joint.product).position])
        for joint in joints
    }


def record_travel(
    bus: ServoBus,
    joints: Sequence[Joint],
    clock: Clock,
    start: Mapping[str, int],
    seconds: float,
    watch: Callable[[Mapping[str, Travel], float], bool],
) -> dict[str, Travel]:
    """Follow joints for a time.

    Args:
        bus: the bus
        joints: which
        clock: the bus's time
        start: joint name => where it stands, just read [counts]
        seconds: for how long [s]
        watch: told the travel so far and the time that is left [s] after each reading; False ends it early

    Returns:
        joint name => how far it has been

    Raises:
        RunError: a servo was silent for so long that its turns may have been miscounted
    """
    travels = {name: begin_travel(count) for name, count in start.items()}
    began = due = clock.now()
    heard = dict.fromkeys(travels, began)
    while clock.now() - began < seconds:
        for joint in joints:
            count = _position(bus, joint)
            if count is not None:
                travels[joint.name] = extend_travel(travels[joint.name], count, joint.product.ticks_per_turn)
                heard[joint.name] = clock.now()
            elif clock.now() - heard[joint.name] > GAP_S_MAX:
                raise RunError(
                    f"joint {joint.name} (servo {joint.id}): did not answer for {GAP_S_MAX:g} s while it was followed, "
                    "so its turns can not be told; check its cable and record again"
                )
        if not watch(travels, max(0.0, began + seconds - clock.now())):
            break
        due = max(due + PERIOD_S, clock.now())
        clock.sleep_until(due)
    return travels


def _position(bus: ServoBus, joint: Joint) -> int | None:
    register = registers(joint.product)[family_of(joint.product).position]
    reply = bus.read(joint.id, register.address, register.size)
    return decode_register(register, reply.data) if reply.status == "data" else None
