"""Servo products: one entry each, datasheet numbers with their source, used by simulation and virtual servo alike."""

from __future__ import annotations

from dataclasses import dataclass


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
    armature_kg_m2: float
    friction_loss_nm: float
    damping_nms_rad: float
    source: str
