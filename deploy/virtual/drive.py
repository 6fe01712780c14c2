"""What a virtual servo asks of its output shaft: how to drive it and where to, whatever its family."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

from controller.servo_law import Law

__all__ = ["Drive", "Law", "Mode", "Shaft"]

Mode = Literal["position", "velocity", "voltage"]


@dataclass(frozen=True)
class Drive:
    """Say how a servo drives its shaft.

    Args:
        on: whether it does; off: the shaft turns freely, or brakes
        mode: what it is aimed at: an angle, a velocity, or a voltage
        law: from an error to a duty; in voltage mode only its limits act
        torque_max: torque that a current limit leaves over the stall torque, 1: there is none
        slope_v_s: how fast the voltage may change, 0: at once [V/s]
        brake: whether the motor is shorted while off
    """

    on: bool
    mode: Mode
    law: Law
    torque_max: float = 1.0
    slope_v_s: float = 0.0
    brake: bool = False


class Shaft(Protocol):
    """Give a servo its output shaft, counted as its encoder counts."""

    def ticks(self) -> float:
        """Return the angle, over all turns [ticks]."""
        ...

    def speed(self) -> float:
        """Return the angular velocity [rad/s]."""
        ...

    def torque(self) -> float:
        """Return the motor's torque [N m]."""
        ...

    def duty(self) -> float:
        """Return the PWM duty, -1 to 1."""
        ...

    def current(self) -> float:
        """Return the motor's current, signed as the torque [A]."""
        ...

    def supply(self) -> float:
        """Return the supply voltage at the servo [V]."""
        ...

    def drive(self, drive: Drive) -> None:
        """Change how the servo drives the shaft."""
        ...

    def aim(self, value: float) -> None:
        """Set where the servo drives the shaft to: [ticks], [rad/s] or duty, by the drive's mode."""
        ...

    def feedforward(self, duty: float) -> None:
        """Add a duty to what the law gives."""
        ...
