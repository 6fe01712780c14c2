"""Control cycles over the terminals of a lamp, for the tests of both cycles."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from controller.controller import Controller, Input, Output
from controller.lowering import lower
from controller.native import run_cycle
from controller.reference import ReferenceCycle
from controller.terminals import terminals_of
from controller.text import parse

EVERY = "(list (+ a0 (integrate goal_met)) (* 40 (% px (- t 0.1))) (* 57.3 heading_error))"


def controller_for(rig, text, *, limits=(-40.0, 50.0, 3.0), unit="deg", filter=1.0, slew_rad_s=0.0, names=None):
    """Build a controller over all (or the named) terminals of a rig; limits are low, high, neutral."""
    supplied = terminals_of(rig)
    names = list(supplied) if names is None else names
    source = parse(text, names)
    low, high, neutral = limits
    return Controller(
        name="test",
        period_s=rig.period_s,
        inputs=tuple(Input(name, supplied[name].unit, -1, 1) for name in names),
        outputs=tuple(
            Output(joint.name, joint.mode, f"{unit}/s" if joint.mode == "velocity" else unit, low, high, neutral)
            for joint in rig.joints
        ),
        source=source,
        program=lower(source, names),
        filter=filter,
        slew_rad_s=slew_rad_s,
    )


def raw_of(rig, *, angles=(0.0, 0.0, 0.0), x=0.0, y=0.0, z=0.0, heading=0.0, force=0.0):
    """Write raw counts as the rig's servos and sensors would, rounded to counts by numpy in double."""
    values = {"x": x, "y": y, "z": z, "heading": heading, "force": force}
    counts = [
        joint.zero_tick + joint.sign * angle * 4096 / (2 * math.pi)
        for joint, angle in zip(rig.joints, angles, strict=True)
    ]
    counts += [0] * (2 * len(rig.joints))
    counts += [sensor.zero + values.get(sensor.name, 0.0) / sensor.scale for sensor in rig.sensors]
    return np.rint(counts).astype(np.int32)


def terminals(rig, rows, goal=(0.3, 0.0)):
    """Run both cycles over raw rows; return the terminals by name, (nstep,) each, after comparing both."""
    controller = controller_for(rig, EVERY)
    reference = ReferenceCycle(controller, rig)
    native, *_ = run_cycle(controller, rig, np.array(rows), goal)
    judged = np.array([reference.step(*goal, row)[0] for row in rows])
    assert native.tobytes() == judged.tobytes()
    return dict(zip(terminals_of(rig), native.T, strict=True))


def turned(rig):
    """Return the rig with joints in velocity mode, the first without limits, looking along that one."""
    joints = [replace(joint, mode="velocity", speed_rad_s_max=8.0) for joint in rig.joints]
    joints[0] = replace(joints[0], unlimited=True, low_rad=-math.inf, high_rad=math.inf)
    return replace(rig, joints=tuple(joints), facing=joints[0].name)
