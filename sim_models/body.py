"""Bodies: an MJCF file and the servos of its rig, compiled to a MuJoCo model.

What a body's MJCF must name: the body ``base`` with the free joint ``root``; the joints of the rig; geoms ``foot…``
(spheres, part of the base), ``head…`` and ``servo_<joint>``; and, for films, the mocap body ``goal``. A body of ideal
joints also has an actuator with the name of each: ``<position>`` or ``<velocity>`` with its ``forcerange``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

import mujoco
import numpy as np
import numpy.typing as npt

from controller.errors import InputError
from controller.rig import Joint, Rig
from sim_models.servo import joint_parameters, set_servo

Form: TypeAlias = Literal["free", "planar"]
Scene: TypeAlias = Callable[[mujoco.MjSpec], None]
FloatArray: TypeAlias = npt.NDArray[np.float64]

SETTLE_S = 1.0
"""How long a body stands at its neutral pose before a run [s]."""

_HOLD_S = 0.1  # in which a joint in velocity mode is moved back to its neutral angle while the body settles


@dataclass(frozen=True, eq=False)
class Layout:
    """Say where a model keeps what the rig knows by name.

    Args:
        form: "free" or "planar"
        base: id of the base body
        foot_position: centres of the feet in the base's frame [m], (nfoot, 3)
        foot_radius: [m]
        head_geoms: ids of the head's geoms, (nhead,)
        qpos: address of each rig joint in qpos, (njoint,)
        dof: address of each rig joint in qvel, (njoint,)
        actuator: id of each rig joint's servo, (njoint,)
    """

    form: Form
    base: int
    foot_position: FloatArray
    foot_radius: float
    head_geoms: npt.NDArray[np.int32]
    qpos: npt.NDArray[np.int32]
    dof: npt.NDArray[np.int32]
    actuator: npt.NDArray[np.int32]


@dataclass(frozen=True)
class Pose:
    """Hold the pose of the base's centre: position [m] and angles about z, y, x in this order [rad]."""

    x: float
    y: float
    z: float
    heading: float
    roll: float
    pitch: float


def build_model(
    rig: Rig, *, form: Form = "free", timestep_s: float = 0.002, lean: bool = False, scene: Scene | None = None
) -> mujoco.MjModel:
    """Compile the body of a rig with the rig's servos.

    Args:
        rig: the rig
        form: "free" for a free base; "planar" for a base that slides along x and z and pitches about y
        timestep_s: MuJoCo's step, which must divide the rig's period [s]
        lean: keep only what rollouts read: no sensors, cameras, lights or visual geoms
        scene: adds to the body's world what stands in its way, before the model is compiled

    Returns:
        The model; its actuators have the names of the rig's joints, driven by goal angles [rad] or rates [rad/s].

    Raises:
        InputError: the body's MJCF cannot be read or lacks what the rig names.
    """
    substeps(rig, timestep_s)
    try:
        spec = mujoco.MjSpec.from_file(str(rig.body))
    except (ValueError, OSError) as error:
        raise InputError(f"{rig.body}: MuJoCo cannot read this body ({_one_line(error)}); correct the MJCF") from error
    if spec.body("base") is None or spec.joint("root") is None:
        raise InputError(
            f"{rig.body}: there is no body 'base' with a free joint 'root'; name the base and its joint so"
        )
    _add_motors(spec, rig)
    if form == "planar":
        _make_planar(spec)
    if scene is not None:
        scene(spec)
    if lean:
        _make_lean(spec)
    spec.option.timestep = timestep_s
    # a step that diverges must be seen, not silently start anew
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    try:
        model = spec.compile()
    except ValueError as error:
        raise InputError(f"{rig.body}: MuJoCo cannot compile this body ({_one_line(error)}); correct it") from error
    for joint in rig.joints:
        motor = model.actuator(joint.name).id
        if joint.ideal:
            _check_ideal(model, motor, rig, joint)
        else:
            set_servo(model, motor, joint_parameters(joint, rig.supply_v))
    return model


def substeps(rig: Rig, timestep_s: float, given: str = "timestep_s") -> int:
    """Return how many MuJoCo steps make one control period.

    Args:
        rig: the rig
        timestep_s: MuJoCo's step [s]
        given: what set the step, as the error names it

    Returns:
        The whole number of steps.

    Raises:
        InputError: the step does not divide the period.
    """
    count = round(rig.period_s / timestep_s) if timestep_s > 0.0 else 0
    if count < 1 or abs(count * timestep_s - rig.period_s) > 1e-9:
        raise InputError(
            f"{given} {timestep_s:g}: a simulation step of {timestep_s:g} s does not divide the period of "
            f"{rig.period_s:g} s of rig {rig.name}; give a step such as {rig.period_s / 10:g}"
        )
    return count


def body_layout(model: mujoco.MjModel, rig: Rig) -> Layout:
    """Return where a model keeps the rig's joints, feet and head.

    Args:
        model: from `build_model`
        rig: the rig it was built for

    Returns:
        The layout.

    Raises:
        InputError: the body has no feet
    """
    names = [model.geom(i).name for i in range(model.ngeom)]
    feet = [i for i, name in enumerate(names) if name.startswith("foot")]
    if not feet:
        raise InputError(f"{rig.body}: no geom's name begins with 'foot'; name the feet of the base so")
    joints = [model.joint(joint.mjcf_joint) for joint in rig.joints]
    free = model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE
    return Layout(
        form="free" if free else "planar",
        base=model.body("base").id,
        foot_position=np.array(model.geom_pos[feet]),
        foot_radius=float(model.geom_size[feet[0], 0]),
        head_geoms=np.array([i for i, name in enumerate(names) if name.startswith("head")], np.int32),
        qpos=np.array([joint.qposadr[0] for joint in joints], np.int32),
        dof=np.array([joint.dofadr[0] for joint in joints], np.int32),
        actuator=np.array([model.actuator(joint.name).id for joint in rig.joints], np.int32),
    )


def settled_data(model: mujoco.MjModel, rig: Rig) -> mujoco.MjData:
    """Return the body standing at its neutral pose, torque on, at rest.

    Args:
        model: from `build_model`
        rig: the rig it was built for

    Returns:
        Its data at time 0, after `mj_forward`.
    """
    data = mujoco.MjData(model)
    layout = body_layout(model, rig)
    neutral = np.array([joint.neutral_rad for joint in rig.joints])
    velocity = np.array([joint.mode == "velocity" for joint in rig.joints])
    data.qpos[layout.qpos] = neutral
    data.ctrl[layout.actuator] = np.where(velocity, 0.0, neutral)
    if velocity.any():
        # a motor told to stand would sink a little: a person would hold the joint at its angle
        for _ in range(round(SETTLE_S / model.opt.timestep)):
            away = neutral - data.qpos[layout.qpos]
            data.ctrl[layout.actuator] = np.where(velocity, away / _HOLD_S, neutral)
            mujoco.mj_step(model, data)
        data.ctrl[layout.actuator] = np.where(velocity, 0.0, neutral)
    else:
        mujoco.mj_step(model, data, round(SETTLE_S / model.opt.timestep))
    data.qvel[:] = 0.0
    data.qacc_warmstart[:] = 0.0
    data.time = 0.0
    mujoco.mj_forward(model, data)
    return data


def base_rotation(model: mujoco.MjModel, data: mujoco.MjData) -> FloatArray:
    """Return the rotation of the base from `qpos`, which is never a step old.

    Args:
        model: from `build_model`
        data: its data

    Returns:
        Rotation matrix from the base's frame to the world's, (3, 3).
    """
    if model.jnt_type[0] != mujoco.mjtJoint.mjJNT_FREE:
        cosine, sine = math.cos(data.qpos[2]), math.sin(data.qpos[2])
        return np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])
    w, x, y, z = (float(value) for value in data.qpos[3:7])
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def base_pose(model: mujoco.MjModel, data: mujoco.MjData) -> Pose:
    """Return the pose of the base from `qpos`, as a camera above it would see it.

    Args:
        model: from `build_model`
        data: its data

    Returns:
        The pose.
    """
    free = model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE
    rotation = base_rotation(model, data)
    x, y, z = (
        (float(data.qpos[0]), float(data.qpos[1]), float(data.qpos[2]))
        if free
        else (float(data.qpos[0]), 0.0, float(data.qpos[1] + model.body("base").pos[2]))
    )
    return Pose(
        x=x,
        y=y,
        z=z,
        heading=math.atan2(rotation[1, 0], rotation[0, 0]),
        roll=math.atan2(rotation[2, 1], rotation[2, 2]),
        pitch=math.asin(min(1.0, max(-1.0, -rotation[2, 0]))),
    )


def base_force(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Return the contact force on the base, as the load cell under it sums it: the normal forces of its contacts.

    After `mj_step` the force belongs to the state before that step; the rollouts use the same convention.

    Args:
        model: from `build_model`
        data: its data

    Returns:
        The force [N].
    """
    base = model.body("base").id
    wrench = np.zeros(6)
    total = 0.0
    for index in range(data.ncon):
        if base in model.geom_bodyid[data.contact.geom[index]]:
            mujoco.mj_contactForce(model, data, index, wrench)
            total += float(wrench[0])
    return total


def clearance(model: mujoco.MjModel, data: mujoco.MjData, layout: Layout) -> float:
    """Return the height of the lowest foot above the floor.

    Args:
        model: from `build_model`
        data: its data
        layout: from `body_layout`

    Returns:
        The clearance [m], negative where a foot presses in.
    """
    heights = layout.foot_position @ base_rotation(model, data)[2]
    return float(base_pose(model, data).z + heights.min() - layout.foot_radius)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


def _add_motors(spec: mujoco.MjSpec, rig: Rig) -> None:
    """Find the hinge of each joint; add a motor and give joint and servo geom the product's numbers, if it has one."""
    for index, joint in enumerate(rig.joints):
        hinge = spec.joint(joint.mjcf_joint)
        if hinge is None:
            known = ", ".join(other.name for other in spec.joints if other.type == mujoco.mjtJoint.mjJNT_HINGE)
            raise InputError(
                f"{rig.path}: joint {joint.name}: {rig.body.name} has no hinge {joint.mjcf_joint!r}; it has {known}"
            )
        stated = spec.actuator(joint.name)
        if joint.ideal and (stated is None or stated.target != joint.mjcf_joint):
            raise InputError(
                f"{rig.path}: joint {joint.name}: {rig.body.name} has no actuator {joint.name!r} on the hinge "
                f"{joint.mjcf_joint!r}; write a <{joint.mode}> of that name there, with its forcerange"
            )
        if joint.ideal:
            continue
        for key in ("i_gain", "velocity_i_gain"):
            if getattr(joint, key) != 0:
                raise InputError(
                    f"{rig.path}: joint {joint.name}: {key}: simulated servos have no integrator; set it to 0"
                )
        _add_servo(spec, hinge, joint).group = index


def _add_servo(spec: mujoco.MjSpec, hinge: mujoco.MjsJoint, joint: Joint) -> mujoco.MjsActuator:
    """Add a joint's servo, and give its hinge and case the product's numbers."""
    product = joint.product
    hinge.armature = product.armature_kg_m2
    hinge.frictionloss = product.friction_loss_nm
    hinge.damping = [product.damping_nms_rad, 0.0, 0.0]
    case = spec.geom(f"servo_{joint.mjcf_joint}")
    if case is not None:
        case.mass = product.mass_kg
    motor = spec.add_actuator(name=joint.name, target=joint.mjcf_joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    inputs = mujoco.mjtCtrlInput.mjINPUT_POS if joint.mode == "position" else mujoco.mjtCtrlInput.mjINPUT_VEL
    gains = [1.0, 0.0, 0.0] if joint.mode == "position" else [0.0, 0.0, 1.0]
    # the numbers of the rig's own registers follow after compilation
    motor.set_to_dcmotor(
        [0.0, 0.0],
        0.0,
        nominal=[product.voltage_v, product.stall_torque_nm, product.no_load_speed_rad_s],
        saturation=[product.stall_torque_nm, 0.0, 0.0],
        controller=[*gains, 0.0, 0.0, product.voltage_v],
        ctrlspec=int(inputs),
    )
    return motor


def _check_ideal(model: mujoco.MjModel, motor: int, rig: Rig, joint: Joint) -> None:
    """Refuse an actuator that is no spring-damper to an angle or no damper to a rate, or that has no limit."""
    gain, (_, spring, damper) = float(model.actuator_gainprm[motor, 0]), model.actuator_biasprm[motor, :3].tolist()
    expected = gain > 0.0 and ((spring, damper)[joint.mode == "velocity"] == -gain)
    if not expected or (joint.mode == "velocity" and spring != 0.0):
        raise InputError(
            f"{rig.path}: joint {joint.name}: mode: the actuator {joint.name!r} of {rig.body.name} takes no "
            f"{joint.mode}; make it a <{joint.mode}>, or change the mode"
        )
    low, high = model.actuator_forcerange[motor].tolist()
    if not model.actuator_forcelimited[motor] or low != -high or high <= 0.0:
        raise InputError(
            f"{rig.path}: joint {joint.name}: the actuator {joint.name!r} of {rig.body.name} has no forcerange that is "
            "the same both ways; write one"
        )


def _make_planar(spec: mujoco.MjSpec) -> None:
    """Replace the free joint by slides along x and z and a hinge about y, and keep one foot of each pair."""
    base = spec.body("base")
    spec.delete(spec.joint("root"))
    kinds = (("root_x", "SLIDE", [1, 0, 0]), ("root_z", "SLIDE", [0, 0, 1]), ("root_pitch", "HINGE", [0, 1, 0]))
    for name, kind, axis in kinds:
        joint = base.add_joint(name=name, type=getattr(mujoco.mjtJoint, f"mjJNT_{kind}"), axis=axis)
        joint.armature = 0.0
        joint.frictionloss = 0.0
        joint.damping = [0.0, 0.0, 0.0]
    for geom in list(base.geoms):
        if geom.name.startswith("foot"):
            if geom.pos[1] < 0.0:
                spec.delete(geom)
            else:
                geom.pos = [geom.pos[0], 0.0, geom.pos[2]]


def _make_lean(spec: mujoco.MjSpec) -> None:
    """Remove what a rollout does not read."""
    for element in (*spec.sensors, *spec.cameras, *spec.lights):
        spec.delete(element)
    if spec.body("goal") is not None:
        spec.delete(spec.body("goal"))
    spec.compiler.discardvisual = True
    # with so few geoms it is dearer to sort pairs than to try them all; the contacts are the same
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ISLAND | mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
