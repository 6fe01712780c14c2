"""How tall a body stands."""

from __future__ import annotations

import mujoco
import numpy as np

_HALF_HEIGHT = {  # of a geom whose third row of the rotation matrix is r and whose size is s
    mujoco.mjtGeom.mjGEOM_SPHERE: lambda r, s: s[0],
    mujoco.mjtGeom.mjGEOM_CAPSULE: lambda r, s: s[0] + abs(r[2]) * s[1],
    mujoco.mjtGeom.mjGEOM_CYLINDER: lambda r, s: s[0] * np.hypot(r[0], r[1]) + abs(r[2]) * s[1],
    mujoco.mjtGeom.mjGEOM_BOX: lambda r, s: np.abs(r) @ s,
}


def standing_height(spec: mujoco.MjSpec) -> float:
    """Return the height of a body's highest point at its neutral pose, among what can touch something.

    Args:
        spec: the body, left as it is; its geoms that collide are spheres, capsules, cylinders and boxes

    Returns:
        The height above the floor [m].
    """
    model = spec.copy().compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    tops = []
    for geom in range(model.ngeom):
        extent = _HALF_HEIGHT.get(mujoco.mjtGeom(model.geom_type[geom]))
        collides = model.geom_contype[geom] or model.geom_conaffinity[geom]
        if extent is not None and collides and model.geom_bodyid[geom] != 0:
            tops.append(data.geom_xpos[geom, 2] + extent(data.geom_xmat[geom, 6:9], model.geom_size[geom]))
    return float(max(tops))
