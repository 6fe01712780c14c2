"""A twin's body: the rig's, with other masses and joints, motors of every mode, and gears that have play."""

from __future__ import annotations

from typing import Any, Final

import mujoco

from controller.rig import Joint, Rig
from deploy.virtual.twin import Twin
from sim_models.body import build_model

PLAY: Final = "_play"
"""What follows a hinge's name in that of its play."""

_INPUTS: Final = mujoco.mjtCtrlInput.mjINPUT_POS | mujoco.mjtCtrlInput.mjINPUT_VEL | mujoco.mjtCtrlInput.mjINPUT_FF


def twinned_model(rig: Rig, twin: Twin, timestep_s: float, *, inputs: bool) -> mujoco.MjModel:
    """Compile a rig's body with a twin's differences.

    Args:
        rig: the rig
        twin: the twin
        timestep_s: MuJoCo's step [s]
        inputs: whether the motors have the inputs of every mode, angle, velocity and torque, and the gears their play;
            without, it is the body that `sim_models.body.settled_data` can settle

    Returns:
        the model
    """

    def change(spec: mujoco.MjSpec) -> None:
        for joint in rig.joints if inputs else ():
            _add_inputs(spec, joint)
            play_rad = joint.product.backlash_rad * twin.joint(joint.name).backlash_scale
            if play_rad > 0.0:
                _add_play(spec, joint, play_rad, timestep_s)

    model: Any = build_model(rig, form="free", timestep_s=timestep_s, lean=True, scene=change)
    model.geom_friction[:, 0] *= twin.friction_scale
    model.body_mass[:] *= twin.mass_scale
    model.body_inertia[:] *= twin.mass_scale
    model.body_ipos[model.body("base").id, :2] += (twin.com_x_m, twin.com_y_m)
    for joint in rig.joints:
        own = twin.joint(joint.name)
        dof = model.joint(joint.mjcf_joint).dofadr[0]
        model.dof_frictionloss[dof] *= own.joint_friction_scale
        model.dof_damping[dof] *= own.joint_damping_scale
        model.dof_armature[dof] *= own.armature_scale
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def _add_inputs(spec: mujoco.MjSpec, joint: Joint) -> None:
    """Give a servo's motor the inputs of every mode."""
    product = joint.product
    spec.actuator(joint.name).set_to_dcmotor(
        [0.0, 0.0],
        0.0,
        nominal=[product.voltage_v, product.stall_torque_nm, product.no_load_speed_rad_s],
        saturation=[product.stall_torque_nm, 0.0, 0.0],
        controller=[1.0, 0.0, 1.0, 0.0, 0.0, product.voltage_v],
        ctrlspec=int(_INPUTS),
    )


def _add_play(spec: mujoco.MjSpec, joint: Joint, play_rad: float, timestep_s: float) -> None:
    """Let a second hinge about the same axis part the link from its motor, between two stops."""
    hinge = spec.joint(joint.mjcf_joint)
    play = hinge.parent.add_joint(
        name=joint.mjcf_joint + PLAY, type=mujoco.mjtJoint.mjJNT_HINGE, axis=hinge.axis, pos=hinge.pos
    )
    play.range = [-0.5 * play_rad, 0.5 * play_rad]
    play.limited = mujoco.mjtLimited.mjLIMITED_TRUE
    # stops as hard as the step allows
    play.solref_limit = [2.0 * timestep_s, 1.0]
    play.armature = 0.0
    play.frictionloss = 0.0
    play.damping = [0.0, 0.0, 0.0]
