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
        family: its register map and protocol, as `controller.families` has it: "dynamixel-x330", "dynamixel-x430",
            "dynamixel-ax", "feetech-sts" or "feetech-scs"
        voltage_v: voltage of the numbers below [V]
        stall_torque_nm: [N m]
        no_load_speed_rad_s: [rad/s]
        stall_current_a: [A]
        mass_kg: [kg]
        ticks_per_turn: encoder counts a turn
        count_max: largest encoder count; a potentiometer counts less than a turn
        center_tick: encoder count at mid travel
        velocity_unit_rad_s: one count of present velocity [rad/s]
        duty_full: value of the torque ceiling's register that means full duty, "PWM counts" below
        p_divisor: position P gain register value / p_divisor = PWM counts per tick of error; 0: it has no P gain
        d_divisor: position D gain register value / d_divisor = PWM counts per tick/s of error rate; 0: no D gain
        velocity_p_divisor: velocity P gain register value / velocity_p_divisor = PWM counts per velocity count of
            error; 0: it has no velocity P gain
        backlash_rad: play of the gears at the output, all of it [rad]
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
    ticks_per_turn: float
    count_max: int
    center_tick: int
    velocity_unit_rad_s: float
    duty_full: int
    p_divisor: float
    d_divisor: float
    velocity_p_divisor: float
    backlash_rad: float
    armature_kg_m2: float
    friction_loss_nm: float
    damping_nms_rad: float
    source: str


def _rad_s(rev_min: float) -> float:
    return rev_min * 2.0 * math.pi / 60.0


_E_MANUAL = "ROBOTIS e-Manual: _data/dxl_x_info.yml@0028038 (specifications at 5 V), docs/en/dxl/x/"
_X_LAW = (
    "; P / 128 and D / 16 a control tick from _includes/en/dxl/control_table_position_pid_gain.md@01a2df1, the"
    " tick taken as 1 ms (not published); velocity P / 128 from _includes/en/dxl/control_table_velocity_pi_gain.md;"
    " velocity unit from the SDK's .model file (the manual's 0.229 rev/min is"
    " its rounding); armature, friction and damping are estimates until identified on hardware"
)
_X330_BACKLASH = math.radians(0.25)  # the manual gives none: taken as the XM430's, an estimate
_POT_TURN = 1024 * 360.0 / 300.0  # counts of a potentiometer that shows 300 degrees as 0 to 1023
_STS_P_DIVISOR = 4096.0 / (2.0 * math.pi) / (0.1649 * 1000.0)
_SCS_P_DIVISOR = _STS_P_DIVISOR / 4.0
_STS_LAW = (
    "; duty = P * 0.1649 per rad of error measured with the motor leads apart (kscalelabs/sysid,"
    " data/feetech/STS_3215_12V), 1.5 % from P / 4 PWM counts per tick; D (as P, a control tick of 1 ms) and"
    " velocity P are estimates: no source says what they mean; speed unit 1 step/s (register table); armature and dry"
    " friction as TheRobotStudio/SO-ARM100's SO-101 MJCF has them for the C001; damping is an estimate (its 0.60 is"
    " back-EMF)"
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
                count_max=4095,
                center_tick=2048,
                velocity_unit_rad_s=0.0239691227,
                duty_full=885,
                p_divisor=128.0,
                d_divisor=16000.0,
                velocity_p_divisor=128.0,
                backlash_rad=_X330_BACKLASH,
                armature_kg_m2=0.0005,
                friction_loss_nm=0.015,
                damping_nms_rad=0.002,
                source=_E_MANUAL + "xc330-m181.md@01ba971" + _X_LAW,
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
                count_max=4095,
                center_tick=2048,
                velocity_unit_rad_s=0.0239691227,
                duty_full=885,
                p_divisor=128.0,
                d_divisor=16000.0,
                velocity_p_divisor=128.0,
                backlash_rad=_X330_BACKLASH,
                armature_kg_m2=0.0005,
                friction_loss_nm=0.015,
                damping_nms_rad=0.002,
                source=_E_MANUAL + "xl330-m288.md@028a13d" + _X_LAW,
            ),
            Product(
                name="xl430-w250",
                model_number=1060,
                family="dynamixel-x430",
                voltage_v=11.1,
                stall_torque_nm=1.4,
                no_load_speed_rad_s=_rad_s(57.0),
                stall_current_a=1.3,
                mass_kg=0.0572,
                ticks_per_turn=4096,
                count_max=4095,
                center_tick=2048,
                velocity_unit_rad_s=0.0239691227,
                duty_full=885,
                p_divisor=128.0,
                d_divisor=16000.0,
                velocity_p_divisor=128.0,
                backlash_rad=math.radians(0.25),
                armature_kg_m2=0.008,
                friction_loss_nm=0.03,
                damping_nms_rad=0.005,
                source=_E_MANUAL.replace("5 V", "11.1 V")
                + "xl430-w250.md@00a4b78; backlash taken as the XM430's, an estimate"
                + _X_LAW,
            ),
            Product(
                name="xm430-w350",
                model_number=1020,
                family="dynamixel-x430",
                voltage_v=12.0,
                stall_torque_nm=4.1,
                no_load_speed_rad_s=_rad_s(46.0),
                stall_current_a=2.3,
                mass_kg=0.082,
                ticks_per_turn=4096,
                count_max=4095,
                center_tick=2048,
                velocity_unit_rad_s=0.0239691227,
                duty_full=885,
                p_divisor=128.0,
                d_divisor=16000.0,
                velocity_p_divisor=128.0,
                backlash_rad=math.radians(0.25),
                armature_kg_m2=0.010,
                friction_loss_nm=0.05,
                damping_nms_rad=0.01,
                source=_E_MANUAL.replace("5 V", "12 V") + "xm430-w350.md@07fe860; backlash 15'" + _X_LAW,
            ),
            Product(
                name="ax-12a",
                model_number=12,
                family="dynamixel-ax",
                voltage_v=12.0,
                stall_torque_nm=1.5,
                no_load_speed_rad_s=_rad_s(59.0),
                stall_current_a=1.5,
                mass_kg=0.0546,
                ticks_per_turn=_POT_TURN,
                count_max=1023,
                center_tick=512,
                velocity_unit_rad_s=_rad_s(0.111),
                duty_full=1023,
                p_divisor=0.0,
                d_divisor=0.0,
                velocity_p_divisor=0.0,
                backlash_rad=math.radians(0.5),
                armature_kg_m2=0.008,
                friction_loss_nm=0.04,
                damping_nms_rad=0.01,
                source="ROBOTIS e-Manual: docs/en/dxl/ax/ax-12a.md@07fe860 (at 12 V); a count is 300/1024"
                " degrees, which it rounds to 0.29; backlash, armature, friction and damping are estimates",
            ),
            Product(
                name="sts3215",
                model_number=777,
                family="feetech-sts",
                voltage_v=12.0,
                stall_torque_nm=2.94,
                no_load_speed_rad_s=_rad_s(45.0),
                stall_current_a=2.7,
                mass_kg=0.055,
                ticks_per_turn=4096,
                count_max=4095,
                center_tick=2048,
                velocity_unit_rad_s=2.0 * math.pi / 4096.0,
                duty_full=1000,
                p_divisor=_STS_P_DIVISOR,
                d_divisor=1000.0 * _STS_P_DIVISOR,
                velocity_p_divisor=10.0,
                backlash_rad=math.radians(0.5),
                armature_kg_m2=0.028,
                friction_loss_nm=0.052,
                damping_nms_rad=0.01,
                source="STS3215-C018 (gears 1:345), 30 kg cm and 0.222 s / 60 degrees at 12 V: seller's pages; stall"
                " current from memory; backlash as specified, at most 0.5 degrees (0.87 to 1.0 measured by users)"
                + _STS_LAW,
            ),
            Product(
                name="sts3215-7v4",
                model_number=777,
                family="feetech-sts",
                voltage_v=7.4,
                stall_torque_nm=1.91,
                no_load_speed_rad_s=_rad_s(52.0),
                stall_current_a=2.7,
                mass_kg=0.055,
                ticks_per_turn=4096,
                count_max=4095,
                center_tick=2048,
                velocity_unit_rad_s=2.0 * math.pi / 4096.0,
                duty_full=1000,
                p_divisor=_STS_P_DIVISOR,
                d_divisor=1000.0 * _STS_P_DIVISOR,
                velocity_p_divisor=10.0,
                backlash_rad=math.radians(0.5),
                armature_kg_m2=0.028,
                friction_loss_nm=0.052,
                damping_nms_rad=0.01,
                source="STS3215-C001 (gears 1:345), 19.5 kg cm and 52 rev/min at 7.4 V: seller's pages; stall current"
                " taken as the C018's, an estimate; its model number is the C018's; backlash as the C018's" + _STS_LAW,
            ),
            Product(
                name="scs0009",
                model_number=1284,
                family="feetech-scs",
                voltage_v=6.0,
                stall_torque_nm=0.226,
                no_load_speed_rad_s=_rad_s(100.0),
                stall_current_a=1.0,
                mass_kg=0.013,
                ticks_per_turn=_POT_TURN,
                count_max=1023,
                center_tick=512,
                velocity_unit_rad_s=2.0 * math.pi / _POT_TURN,
                duty_full=1000,
                p_divisor=_SCS_P_DIVISOR,
                d_divisor=1000.0 * _SCS_P_DIVISOR,
                velocity_p_divisor=0.0,
                backlash_rad=math.radians(1.0),
                armature_kg_m2=0.0005,
                friction_loss_nm=0.01,
                damping_nms_rad=0.001,
                source="SCS0009 specification: 2.3 kg cm, 100 rev/min, 1 A at 6 V, 300 degrees as 0 to 1023; mass from"
                " memory; P and D are estimates (the STS3215's, a count of error being four of its ticks), as are"
                " backlash, armature, friction and damping",
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
    count_max=(1 << 22) - 1,
    center_tick=0,
    velocity_unit_rad_s=1e-5,
    duty_full=0,
    p_divisor=1.0,
    d_divisor=1.0,
    velocity_p_divisor=1.0,
    backlash_rad=0.0,
    armature_kg_m2=0.0,
    friction_loss_nm=0.0,
    damping_nms_rad=0.0,
    source="no servo: the joint's motor is the actuator of the body's MJCF; its counts are too fine to matter",
)
"""The joint of a rig that exists in simulation only."""
