"""Hold what a check reads from one servo, in units, whatever its family calls its registers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from controller.registers import registers
from controller.rig import Joint
from deploy.joint_counts import joint_angle


@dataclass(frozen=True)
class Reading:
    """Hold what a check read from one servo, for people to look at.

    Args:
        joint: the joint
        values: register => count; empty if the servo is not there
        error: error byte of its answers, which alone says what is wrong with some servos
    """

    joint: Joint
    values: Mapping[str, int]
    error: int = 0

    @property
    def angle_rad(self) -> float:
        """Return the joint's angle [rad], NaN if the servo is not there."""
        position = self.values.get(self.joint.family.position)
        return math.nan if position is None else joint_angle(self.joint, position)

    @property
    def supply_v(self) -> float:
        """Return the servo's supply [V], NaN if it was not read."""
        return self._scaled(self.joint.family.voltage)

    @property
    def temperature_c(self) -> float:
        """Return the servo's temperature [°C], NaN if it was not read."""
        return self._scaled(self.joint.family.temperature)

    @property
    def torque(self) -> str:
        """Return "on" or "off", "-" if it was not read."""
        torque = self.values.get(self.joint.family.torque_enable)
        return "-" if torque is None else "on" if torque else "off"

    @property
    def errors(self) -> tuple[str, ...]:
        """Return what is wrong with the servo, in words, as it says itself."""
        family = self.joint.family
        bits = self.error if family.hardware_error is None else self.values.get(family.hardware_error, 0)
        return family.errors(bits)

    def _scaled(self, name: str) -> float:
        count = self.values.get(name)
        return math.nan if count is None else count * registers(self.joint.product)[name].scale
