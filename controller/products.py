"""Servo products: one entry each, datasheet numbers with their source, used by simulation and virtual servo alike."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType


@dataclass(frozen=True)
class Product:
    """Hold the datasheet of one servo.

    Args:
        name: as rig files name it, as "xc330-m181"
        model_number: as its first register says
        family: its register map and protocol, as "dynamixel-x330"
        voltage_v: voltage of the numbers below [V]
        stall_torque_nm: [N m]
        no_load_speed_rad_s: [rad/s]
        stall_current_a: [A]
        mass_kg: [kg]
        ticks_per_turn: encoder counts a turn
        center_tick: encoder count at mid travel
        velocity_unit_rad_s: one count of present velocity [rad/s]
        duty_full: PWM limit register value that means full duty
        p_divisor: position P gain register value / p_divisor = PWM counts per tick of error
        d_divisor: position D gain register value / d_divisor = PWM counts per tick/s of error rate
        velocity_p_divisor: velocity P gain register value / velocity_p_divisor = PWM counts per velocity count of error
        armature_kg_m2: rotor inertia at the output [kg m2]
        friction_loss_nm: dry friction at the output [N m]
        damping_nms_rad: viscous friction at the output [N m s/rad]
        source: where the numbers come from
    """

    name: str
    model_number: int
    family: str
    voltage_v: float
    stall_torque_nm: float
    no_load_speed_rad_s: float
    stall_current_a: float
    mass_kg: float
    ticks_per_turn: int
    center_tick: int
    velocity_unit_rad_s: float
    duty_full: int
    p_divisor: float
    d_divisor: float
    velocity_p_divisor: float
    armature_kg_m2: float
    friction_loss_nm: float
    damping_nms_rad: float
    source: str


def _rad_s(rev_min: float) -> float:
    return rev_min * 2.0 * math.pi / 60.0


_E_MANUAL = "ROBOTIS e-Manual: _data/dxl_x_info.yml@0028038 (specifications at 5 V), docs/en/dxl/x/"
_X330_LAW = (
    "; P / 128 and D / 16 a control tick from _includes/en/dxl/control_table_position_pid_gain.md@01a2df1, the"
    " tick taken as 1 ms (not published); velocity P / 128 from _includes/en/dxl/control_table_velocity_pi_gain.md;"
    " velocity unit from the SDK's .model file (the manual's 0.229 rev/min is"
    " its rounding); armature, friction and damping are estimates until identified on hardware"
)

PRODUCTS: Mapping[str, Product] = MappingProxyType(
    {
        product.name: product
        for product in (
            Product(
                name="xc330-m181",
                model_number=1230,
                family="dynamixel-x330",
                voltage_v=5.0,
                stall_torque_nm=0.60,
                no_load_speed_rad_s=_rad_s(129.0),
                stall_current_a=1.80,
                mass_kg=0.023,
                ticks_per_turn=4096,
                center_tick=2048,
                velocity_unit_rad_s=0.0239691227,
                duty_full=885,
                p_divisor=128.0,
                d_divisor=16000.0,
                velocity_p_divisor=128.0,
                armature_kg_m2=0.0005,
                friction_loss_nm=0.015,
                damping_nms_rad=0.002,
                source=_E_MANUAL + "xc330-m181.md@01ba971" + _X330_LAW,
            ),
            Product(
                name="xl330-m288",
                model_number=1200,
                family="dynamixel-x330",
                voltage_v=5.0,
                stall_torque_nm=0.52,
                no_load_speed_rad_s=_rad_s(103.0),
                stall_current_a=1.47,
                mass_kg=0.018,
                ticks_per_turn=4096,
                center_tick=2048,
                velocity_unit_rad_s=0.0239691227,
                duty_full=885,
                p_divisor=128.0,
                d_divisor=16000.0,
                velocity_p_divisor=128.0,
                armature_kg_m2=0.0005,
                friction_loss_nm=0.015,
                damping_nms_rad=0.002,
                source=_E_MANUAL + "xl330-m288.md@028a13d" + _X330_LAW,
            ),
        )
    }
)
"""The servos that rigs with a bus can name."""

IDEAL = Product(
    name="ideal",
    model_number=0,
    family="none",
    voltage_v=0.0,
    stall_torque_nm=0.0,
    no_load_speed_rad_s=0.0,
    stall_current_a=0.0,
    mass_kg=0.0,
    ticks_per_turn=1 << 22,
    center_tick=0,
    velocity_unit_rad_s=1e-5,
    duty_full=0,
    p_divisor=1.0,
    d_divisor=1.0,
    velocity_p_divisor=1.0,
    armature_kg_m2=0.0,
    friction_loss_nm=0.0,
    damping_nms_rad=0.0,
    source="no servo: the joint's motor is the actuator of the body's MJCF; its counts are too fine to matter",
)
"""The joint of a rig that exists in simulation only."""
