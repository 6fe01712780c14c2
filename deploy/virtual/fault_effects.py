"""What faults do to servos, body and sensor node when they begin, and how it is undone when they end."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from controller.rig import Rig
from deploy.virtual.faults import Fault
from deploy.virtual.plant import Plant
from deploy.virtual.sensors import VirtualSensors
from deploy.virtual.servo_kinds import VirtualServo

_HARDWARE_ERRORS: Final = {"overload": 0x20, "overheat": 0x04}
"""Bits of the hardware error, which all families share."""


class FaultEffects:
    """Begin and end faults.

    Args:
        rig: the rig
        plant: its body
        servos: its servos
        sensors: its sensor node
    """

    def __init__(self, rig: Rig, plant: Plant, servos: Sequence[VirtualServo], sensors: VirtualSensors) -> None:
        self._rig = rig
        self._plant = plant
        self._servos = servos
        self._sensors = sensors
        self._slipped: dict[Fault, float] = {}

    def begin(self, fault: Fault, now_ns: int) -> None:
        """Let a fault begin.

        Args:
            fault: which
            now_ns: time [ns]
        """
        if fault.kind == "estop":
            self._sensors.send_stop(now_ns)
        elif fault.kind == "supply":
            self._plant.set_supply(fault.value)
        elif fault.kind == "brownout":
            for servo in self._servos:
                servo.power_off()
        for index in self._named(fault):
            servo, joint = self._servos[index], self._rig.joints[index]
            if fault.kind == "dead":
                servo.power_off()
            elif fault.kind in _HARDWARE_ERRORS:
                servo.fail(_HARDWARE_ERRORS[fault.kind])
            elif fault.kind == "stuck":
                self._plant.jam(index, True)
            elif fault.kind == "wrap":
                self._slipped[fault] = fault.more or round(joint.product.ticks_per_turn)
                self._plant.shafts[index].slip(self._slipped[fault])
            elif fault.kind == "duplicate-id":
                self._servos[(index + 1) % len(self._servos)].id = joint.id

    def end(self, fault: Fault, now_ns: int) -> None:
        """Let a fault end.

        Args:
            fault: which
            now_ns: time [ns]
        """
        if fault.kind == "supply":
            self._plant.set_supply(None)
        elif fault.kind == "brownout":
            for servo in self._servos:
                servo.reboot(now_ns)
        for index in self._named(fault):
            servo = self._servos[index]
            if fault.kind == "dead":
                servo.reboot(now_ns)
            elif fault.kind == "stuck":
                self._plant.jam(index, False)
            elif fault.kind == "wrap":
                self._plant.shafts[index].slip(-self._slipped.pop(fault))
            elif fault.kind == "duplicate-id":
                other = (index + 1) % len(self._servos)
                self._servos[other].id = self._servos[other].table["id"]

    def _named(self, fault: Fault) -> list[int]:
        """Return the places of the servo that a fault names."""
        return [index for index, joint in enumerate(self._rig.joints) if joint.id == fault.value]
