"""What the gains of a servo mean in SI: how it turns an error into PWM duty, the same in rollouts and virtual servos.

X series: duty = P / 128 / 885 per tick of error, less D / 16000 / 885 per tick/s (e-Manual, position PID gains; the
control tick of 1 ms is an estimate), and I / 65536 / 885 per tick and control tick. Velocity mode: P / 128 / 885 and
I / 65536 / 885 per velocity count.

AX: no duty within the compliance margin, the punch at its edge, all of the torque limit where the compliance slope
ends (e-Manual, compliance). The slope acts in powers of 2.

STS: duty = P * 0.1649 per rad, measured (see `controller.products`); D and I are estimates, as if the firmware did with
them what the X series does with its own, in steps of 1 ms. Dead zone and startup force as AX margin and punch. Velocity
P and I are estimates: a tenth of P is the duty in 0.1 % per step/s.

SCS: as STS with a count of error that is four of its ticks: an estimate, nothing says what its gains mean.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

from controller.products import Product
from controller.registers import registers
from controller.rig import Joint

_CONTROL_HZ: Final = 1000.0
_INTEGRAL_DIVISOR: Final = 65536.0


@dataclass(frozen=True)
class Law:
    """Hold how a servo turns an error into PWM duty, -1 to 1.

    In velocity mode the error is one of velocity: kp is then in duty per rad/s and ki in duty per rad.

    Args:
        kp: duty per error [1/rad]
        ki: duty per error and time [1/(rad s)]
        kd: duty per velocity, which it brakes [s/rad]
        duty_max: largest duty either way
        dead_zone_rad: largest error that counts as none; what is beyond counts [rad]
        torque_share_max: largest torque over the stall torque
        punch: duty added as soon as an error counts
    """

    kp: float = 0.0
    ki: float = 0.0
    kd: float = 0.0
    duty_max: float = 1.0
    dead_zone_rad: float = 0.0
    torque_share_max: float = 1.0
    punch: float = 0.0


def position_law(product: Product, counts: Mapping[str, int]) -> Law:
    """Return the law of a servo in position mode.

    Args:
        product: the servo
        counts: register name => count of its gains and limits; what is missing is 0, a missing limit is none

    Returns:
        the law
    """
    if product.family == "dynamixel-ax":
        return _compliance_law(product, counts)
    feetech = product.family.startswith("feetech")
    p, i, d = ("p_coefficient", "i_coefficient", "d_coefficient") if feetech else _X_GAINS
    ticks_per_rad = product.ticks_per_turn / (2.0 * math.pi)
    return Law(
        kp=counts.get(p, 0) / product.p_divisor / product.duty_full * ticks_per_rad,
        ki=counts.get(i, 0) / _integral_divisor(product) * _CONTROL_HZ / product.duty_full * ticks_per_rad,
        kd=counts.get(d, 0) / product.d_divisor / product.duty_full * ticks_per_rad,
        duty_max=_duty_max(product, counts),
        dead_zone_rad=max(counts.get("cw_dead_zone", 0), counts.get("ccw_dead_zone", 0)) / ticks_per_rad,
        punch=counts.get("minimum_startup_force", 0) / product.duty_full,
    )


def velocity_law(product: Product, counts: Mapping[str, int]) -> Law:
    """Return the law of a servo in velocity mode.

    Args:
        product: the servo
        counts: register name => count of its gains and limits; what is missing is 0, a missing limit is none

    Returns:
        the law

    Raises:
        ValueError: the servo has no such mode
    """
    if product.velocity_p_divisor == 0.0:
        raise ValueError(f"{product.name} has no velocity mode")
    feetech = product.family.startswith("feetech")
    p, i = ("velocity_p", "velocity_i") if feetech else ("velocity_p_gain", "velocity_i_gain")
    per_rad_s = 1.0 / product.duty_full / product.velocity_unit_rad_s
    divisor = product.velocity_p_divisor * _INTEGRAL_DIVISOR / 128.0
    return Law(
        kp=counts.get(p, 0) / product.velocity_p_divisor * per_rad_s,
        ki=counts.get(i, 0) / divisor * _CONTROL_HZ * per_rad_s,
        duty_max=_duty_max(product, counts),
    )


def joint_law(joint: Joint) -> Law:
    """Return the law of a rig's servo joint, its mode's: with the rig's gains, and else with the factory's settings.

    Args:
        joint: the joint, not an ideal one

    Returns:
        the law
    """
    counts = {name: line.initial for name, line in registers(joint.product).items()} | dict(joint.gains)
    if joint.family.torque_ceiling is not None:
        counts[joint.family.torque_ceiling] = joint.ceiling
    return (velocity_law if joint.mode == "velocity" else position_law)(joint.product, counts)


def straight_law(law: Law) -> Law:
    """Return a law without dead zone and punch that has full duty at the same error, as simulated motors have it.

    Args:
        law: a position law

    Returns:
        the law
    """
    if law.kp <= 0.0 or (law.dead_zone_rad == 0.0 and law.punch == 0.0):
        return law
    kp = 1.0 / (law.dead_zone_rad + max(0.0, 1.0 - law.punch) / law.kp)
    return replace(law, kp=kp, dead_zone_rad=0.0, punch=0.0)


def full_duty_error(law: Law) -> float:
    """Return the error at which a position law reaches its largest duty [rad].

    Args:
        law: the law
    """
    return law.dead_zone_rad + max(0.0, law.duty_max - law.punch) / law.kp if law.kp > 0.0 else math.inf


_X_GAINS: Final = ("position_p_gain", "position_i_gain", "position_d_gain")
_LIMITS: Final = ("pwm_limit", "goal_pwm", "max_torque", "torque_limit")


def _duty_max(product: Product, counts: Mapping[str, int]) -> float:
    limits = [abs(counts[name]) / product.duty_full for name in _LIMITS if name in counts]
    return min([1.0, *limits])


def _integral_divisor(product: Product) -> float:
    """Return what divides an I gain, as the P gain's divisor is to the X series' 128."""
    return _INTEGRAL_DIVISOR * product.p_divisor / 128.0


def _compliance_law(product: Product, counts: Mapping[str, int]) -> Law:
    """Return an AX's law: margin, slope and punch of its weaker side."""
    margin = max(counts.get("cw_compliance_margin", 0), counts.get("ccw_compliance_margin", 0))
    slope = max(counts.get("cw_compliance_slope", 32), counts.get("ccw_compliance_slope", 32))
    acts = 2.0 ** min(7, max(1, math.floor(math.log2(max(slope, 1)))))
    ticks_per_rad = product.ticks_per_turn / (2.0 * math.pi)
    punch = min(1.0, counts.get("punch", 32) / product.duty_full)
    return Law(
        kp=(1.0 - punch) * ticks_per_rad / acts,
        duty_max=_duty_max(product, counts),
        dead_zone_rad=margin / ticks_per_rad,
        punch=punch,
    )
