"""Raw channels in simulation: how each counts, and which past state a line of the sensor node shows.

The node samples at multiples of ``1 / rate_hz`` from t = 0 and a line's last byte has arrived ``latency_s`` later. At
control instant t_k the loop therefore holds the sample of ``floor((t_k - latency_s) * rate_hz) / rate_hz``, and that of
t = 0 before the first one has arrived. A virtual rig that sends the same lines gives the same counts. Steps that do not
divide the sampling time show the last state before it.
"""

from __future__ import annotations

import math
from ctypes import Array

import numpy as np
import numpy.typing as npt

from controller.library import SvTerminal
from controller.registers import registers
from controller.rig import Joint, Rig
from controller.terminals import TerminalKind, terminals_of
from sim_models.body import substeps

_SLACK = 1e-6  # a share of a sample or step: times that should meet exactly do


def raw_encoders(rig: Rig) -> Array[SvTerminal]:
    """Return how every raw channel of a rig counts.

    Args:
        rig: the rig

    Returns:
        Structures for `sv_encode`, in raw-channel order, (nraw,).
    """
    specs = terminals_of(rig)
    scales = [
        (specs[joint.name + suffix].zero, specs[joint.name + suffix].scale)
        for suffix in ("", "_vel", "_load")
        for joint in rig.joints
    ]
    scales += [(sensor.zero, sensor.scale) for sensor in rig.sensors]
    kind = int(TerminalKind.RAW)
    return (SvTerminal * rig.nraw)(*(SvTerminal(kind, i, zero, scale) for i, (zero, scale) in enumerate(scales)))


def full_load_torque(joint: Joint, motor_limit_nm: float) -> float:
    """Return the torque that reads as a load of 1: a servo's at its current limit, an ideal motor's own limit.

    A servo whose load is its duty has the torque that full duty makes at rest; see `load_per_speed`.

    Args:
        joint: the joint
        motor_limit_nm: largest torque of its motor in the model [N m]

    Returns:
        The torque [N m].
    """
    if joint.ideal:
        return motor_limit_nm
    table = registers(joint.product)
    if table[joint.family.load].unit != "A":
        return motor_limit_nm
    limit = table["current_limit"]
    return joint.product.stall_torque_nm * limit.high * limit.scale / joint.product.stall_current_a


def load_per_speed(joint: Joint, supply_v: float) -> float:
    """Return what a joint's speed adds to its load, 0 but for a servo that reports its PWM duty as a load.

    Args:
        joint: the joint
        supply_v: supply of the servos [V]

    Returns:
        The load per speed [s/rad].
    """
    product = joint.product
    if joint.ideal or registers(product)[joint.family.load].unit == "A":
        return 0.0
    return product.voltage_v / (supply_v * product.no_load_speed_rad_s)


def samples_at_instants(rig: Rig, timestep_s: float, nstep: int) -> npt.NDArray[np.int32]:
    """Return which state each sensor channel shows at each control instant.

    Args:
        rig: the rig
        timestep_s: MuJoCo's step [s]
        nstep: control periods

    Returns:
        Substeps done when the newest line was sampled, (nstep, nsensor).
    """
    table = np.zeros((nstep, len(rig.sensors)), np.int32)
    nsub = substeps(rig, timestep_s)
    for channel, sensor in enumerate(rig.sensors):
        for k in range(nstep):
            newest = math.floor((k * rig.period_s - sensor.latency_s) * sensor.rate_hz + _SLACK)
            substep = math.floor(max(newest, 0) / sensor.rate_hz / timestep_s + _SLACK)
            table[k, channel] = min(substep, k * nsub)
    return table


def sampled_substeps(samples: npt.NDArray[np.int32], nsubstep: int) -> npt.NDArray[np.uint8]:
    """Mark the states that some channel shows.

    Args:
        samples: from `samples_at_instants`
        nsubstep: substeps of a whole rollout

    Returns:
        1 where the state after so many substeps is sampled, else 0, (nsubstep + 1,).
    """
    marks = np.zeros(nsubstep + 1, np.uint8)
    marks[samples.ravel()] = 1
    return marks
