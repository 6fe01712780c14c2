"""Servo physics: a datasheet and the servo's own registers as the parameters of MuJoCo's ``dcmotor``.

The servo is a position loop around PWM: ``duty = P * error - D * rate``, limited, and the motor turns the voltage
``duty * supply`` into torque against its own back-EMF, ``torque = K / R * (voltage - K * rate)``. MuJoCo's motor has a
current-mode driver that cancels the back-EMF; the ``K**2 / R`` inside `ServoParameters.kd` undoes the cancellation.

In velocity mode ``duty = P * (goal rate - rate)``; `ServoParameters.input_scale` of the goal rate goes into the motor,
because its ``kd`` holds the back-EMF's share too.

The gains of other families than the X series come from `controller.servo_law`, whose dead zone and punch become part of
the slope here.

The simulated body and the virtual servo both get their numbers here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import mujoco
import numpy as np
import numpy.typing as npt

from controller.products import Product
from controller.rig import Joint
from controller.servo_law import Law, joint_law, straight_law

# where MuJoCo's dcmotor keeps its parameters in a row of actuator_gainprm
_RESISTANCE, _MOTOR_CONSTANT, _KP, _KI, _KD, _VOLTAGE_MAX = 0, 1, 4, 5, 6, 7


@dataclass(frozen=True)
class ServoParameters:
    """Hold the parameters of one ``dcmotor``, seen at the output shaft.

    Args:
        resistance: effective resistance R [V2 s2/(N m)]
        motor_constant: effective motor constant K [V s/rad]
        kp: torque per error [N m/rad]
        kd: torque per rate, with the K**2 / R that restores the back-EMF [N m s/rad]
        voltage_max: drive voltage at the PWM limit [V]
        torque_max: largest torque either way, the stall torque at this supply [N m]
        input_scale: what the motor's input is over the servo's goal
    """

    resistance: float
    motor_constant: float
    kp: float
    kd: float
    voltage_max: float
    torque_max: float
    input_scale: float = 1.0


def servo_parameters(
    product: Product, p_gain: int, d_gain: int, pwm_limit: int, voltage_v: float, torque_scale: float = 1.0
) -> ServoParameters:
    """Return the motor of a servo whose registers hold these values.

    The D term brakes the joint's own rate; it does not kick when the goal steps. The integral gain must be 0: the
    model has no integrator.

    Args:
        product: the servo
        p_gain: position P gain register
        d_gain: position D gain register
        pwm_limit: PWM limit register, 0 to `product.duty_full`
        voltage_v: supply voltage [V]
        torque_scale: the servo's stall torque over the datasheet's, at the same no-load speed

    Returns:
        The parameters for `set_servo`.
    """
    k = product.voltage_v / product.no_load_speed_rad_s
    r = k * product.voltage_v / (product.stall_torque_nm * torque_scale)
    ticks_per_rad = product.ticks_per_turn / (2.0 * math.pi)
    # as `controller.servo_law` has it, in an order of rounding that gives every bred controller its own bits again
    duty_per_tick = p_gain / product.p_divisor / product.duty_full if p_gain else 0.0
    duty_per_tick_s = d_gain / product.d_divisor / product.duty_full if d_gain else 0.0
    limit = pwm_limit / product.duty_full
    # MuJoCo reads a limit of 0 as none: no PWM at all is a gain of 0 instead
    drive = k / r * voltage_v * ticks_per_rad if pwm_limit > 0 else 0.0
    return ServoParameters(
        resistance=r,
        motor_constant=k,
        kp=drive * duty_per_tick,
        kd=drive * duty_per_tick_s + k * k / r,
        voltage_max=limit * voltage_v,
        torque_max=product.stall_torque_nm * torque_scale * voltage_v / product.voltage_v,
    )


def velocity_parameters(
    product: Product, p_gain: int, pwm_limit: int, voltage_v: float, torque_scale: float = 1.0
) -> ServoParameters:
    """Return the motor of a servo in velocity mode whose registers hold these values.

    The integral gain must be 0: the model has no integrator.

    Args:
        product: the servo
        p_gain: velocity P gain register
        pwm_limit: PWM limit register, 0 to `product.duty_full`
        voltage_v: supply voltage [V]
        torque_scale: the servo's stall torque over the datasheet's, at the same no-load speed

    Returns:
        The parameters for `set_servo`.
    """
    motor = servo_parameters(product, 0, 0, pwm_limit, voltage_v, torque_scale)
    k, r = motor.motor_constant, motor.resistance
    volts = p_gain / product.velocity_p_divisor / product.duty_full / product.velocity_unit_rad_s * voltage_v
    volts = volts if pwm_limit > 0 else 0.0
    return replace(motor, kd=k / r * (volts + k), input_scale=volts / (volts + k))


def law_parameters(product: Product, law: Law, voltage_v: float, torque_scale: float = 1.0) -> ServoParameters:
    """Return the motor of a servo with a position law. The integral gain must be 0: the model has no integrator.

    Args:
        product: the servo
        law: its law, with neither dead zone nor punch
        voltage_v: supply voltage [V]
        torque_scale: the servo's stall torque over the datasheet's, at the same no-load speed

    Returns:
        The parameters for `set_servo`.
    """
    # MuJoCo reads a limit of 0 as none: no PWM at all is a gain of 0 instead
    motor = servo_parameters(product, 0, 0, product.duty_full, voltage_v, torque_scale)
    k, r = motor.motor_constant, motor.resistance
    drive = k / r * voltage_v if law.duty_max > 0.0 else 0.0
    return replace(motor, kp=drive * law.kp, kd=motor.kd + drive * law.kd, voltage_max=law.duty_max * voltage_v)


def joint_parameters(joint: Joint, voltage_v: float, torque_scale: float = 1.0) -> ServoParameters:
    """Return the motor of a rig's servo joint.

    Args:
        joint: the joint, with its registers
        voltage_v: supply voltage [V]
        torque_scale: the servo's stall torque over the datasheet's, at the same no-load speed

    Returns:
        The parameters for `set_servo`.
    """
    product = joint.product
    if not product.family.startswith("dynamixel-x") and joint.mode == "position":
        return law_parameters(product, straight_law(joint_law(joint)), voltage_v, torque_scale)
    if joint.mode == "velocity":
        return velocity_parameters(product, joint.velocity_p_gain, joint.pwm_limit, voltage_v, torque_scale)
    return servo_parameters(product, joint.p_gain, joint.d_gain, joint.pwm_limit, voltage_v, torque_scale)


def set_servo(model: mujoco.MjModel, actuator_id: int, parameters: ServoParameters) -> None:
    """Write a servo's parameters into a compiled model.

    Args:
        model: a model from `sim_models.body.build_model`, changed in place
        actuator_id: the servo's actuator
        parameters: from `servo_parameters`
    """
    write_servo(model.actuator_gainprm[actuator_id], model.actuator_forcerange[actuator_id], parameters)


def write_servo(
    gainprm: npt.NDArray[np.float64], forcerange: npt.NDArray[np.float64], parameters: ServoParameters
) -> None:
    """Write a servo's parameters where MuJoCo keeps those of one actuator.

    Args:
        gainprm: row of ``actuator_gainprm``, changed in place, (10,)
        forcerange: row of ``actuator_forcerange``, changed in place, (2,)
        parameters: from `servo_parameters`
    """
    gainprm[_RESISTANCE] = parameters.resistance
    gainprm[_MOTOR_CONSTANT] = parameters.motor_constant
    gainprm[_KP] = parameters.kp
    gainprm[_KI] = 0.0
    gainprm[_KD] = parameters.kd
    gainprm[_VOLTAGE_MAX] = parameters.voltage_max
    forcerange[:] = (-parameters.torque_max, parameters.torque_max)


def set_torque(model: mujoco.MjModel, actuator_id: int, on: bool) -> None:
    """Switch a servo's torque: off leaves the joint to its friction, as an open bridge does.

    Args:
        model: a model from `sim_models.body.build_model`, changed in place
        actuator_id: the servo's actuator, which has a group of its own
        on: whether the servo drives its joint
    """
    bit = 1 << int(model.actuator_group[actuator_id])
    if on:
        model.opt.disableactuator &= ~bit
    else:
        model.opt.disableactuator |= bit
