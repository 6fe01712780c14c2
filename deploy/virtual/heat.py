"""How warm a servo's motor gets, and what counts as a stall: estimates, for no manual tells."""

from __future__ import annotations

from typing import Final

from controller.products import Product

AMBIENT_C: Final = 25.0
THERMAL_RESISTANCE_K_W: Final = 40.0
THERMAL_TIME_S: Final = 120.0
STALL_SPEED: Final = 0.05
"""A motor that is slower than this share of its no-load speed stands."""


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
    return temperature_c + (AMBIENT_C + heat_w * THERMAL_RESISTANCE_K_W - temperature_c) * dt / THERMAL_TIME_S


def stands(product: Product, speed_rad_s: float) -> bool:
    """Return whether a shaft is as slow as a stalled motor's.

    Args:
        product: whose motor
        speed_rad_s: [rad/s]
    """
    return abs(speed_rad_s) < STALL_SPEED * product.no_load_speed_rad_s
