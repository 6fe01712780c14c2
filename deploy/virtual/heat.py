"""How warm a servo's motor gets, and what counts as a stall: estimates, for hardly a manual tells.

A servo of the X330 series that stalls is 70 degrees hot in 16 s; a load of a fifth of its stall torque, which ROBOTIS
calls continuous, warms it by 14 degrees. Heavier servos have more surface and more to warm, as their size has it. An
STS3215 that held 1 kg at 15 cm was 48 degrees warm after 10 minutes, measured (users of SO-ARM100, issue 134).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from controller.products import Product

AMBIENT_C: Final = 25.0
STALL_SPEED: Final = 0.05
"""A motor that is slower than this share of its no-load speed stands."""

_RESISTANCE_K_W: Final = 40.0
_TIME_S: Final = 120.0
_MASS_KG: Final = 0.023  # of the servo that has these two
_MEASURED_K_W: Final[Mapping[str, float]] = {"feetech-sts": 2.9}
_AS_THEY_ARE: Final = "dynamixel-x330"


def warmed(product: Product, temperature_c: float, torque_nm: float, dt: float) -> float:
    """Return how warm a motor is after its windings have been heated by what a torque takes.

    Args:
        product: whose motor
        temperature_c: how warm it was [degC]
        torque_nm: its torque [N m]
        dt: for how long [s]
    """
    current_a = product.stall_current_a * torque_nm / product.stall_torque_nm
    heat_w = current_a**2 * product.voltage_v / product.stall_current_a
    size = 1.0 if product.family == _AS_THEY_ARE else (product.mass_kg / _MASS_KG) ** (1.0 / 3.0)
    resistance_k_w = _MEASURED_K_W.get(product.family, _RESISTANCE_K_W / size**2)
    return temperature_c + (AMBIENT_C + heat_w * resistance_k_w - temperature_c) * dt / (_TIME_S * size)


def stands(product: Product, speed_rad_s: float) -> bool:
    """Return whether a shaft is as slow as a stalled motor's.

    Args:
        product: whose motor
        speed_rad_s: [rad/s]
    """
    return abs(speed_rad_s) < STALL_SPEED * product.no_load_speed_rad_s
