"""One controller on one rig: every number of the control cycle, resolved from names, as `sv_cycle` holds them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

from controller.controller import Controller, Output
from controller.errors import InputError
from controller.program import Program
from controller.rig import Joint, Rig
from controller.terminals import TerminalSpec, angle_channel, joint_scale, pose_channel, resolve_terminals

COUNT_MAX: Final = 1 << 30
"""`SV_COUNT_MAX` of `runtime/sv_cycle.h`: counts saturate here, and a count at zero is below."""


@dataclass(frozen=True)
class OutputSpec:
    """Describe how the cycle turns one program output into goal counts: `sv_output` and `sv_guard` of `sv_cycle.h`.

    Args:
        name: the joint's name
        kind: what is commanded
        low: lower clamp, in the output's own unit
        high: upper clamp, in the output's own unit
        neutral: what a NaN becomes, in the output's own unit
        unit_scale: SI per unit
        count_scale: counts per SI, sign included
        zero: counts at 0 SI
        count_low: smallest goal count that the rig allows
        count_high: largest goal count that the rig allows
        angle: encoder of a limited joint that a velocity drives, else channel -1
        angle_low: a velocity that would carry the joint below it within a period commands 0 [rad]
        angle_high: likewise above [rad]
    """

    name: str
    kind: Literal["position", "velocity"]
    low: float
    high: float
    neutral: float
    unit_scale: float
    count_scale: float
    zero: int
    count_low: int
    count_high: int
    angle: TerminalSpec
    angle_low: float
    angle_high: float


@dataclass(frozen=True)
class CycleSpec:
    """Describe the control cycle of one controller on one rig: `sv_cycle` of `runtime/sv_cycle.h`.

    Every float is used rounded to binary32.

    Args:
        program: the controller's program
        terminals: how each input is computed, (ninput,)
        outputs: how each output becomes counts, (noutput,)
        period_s: control period [s]
        filter: first-order filter, 1: none
        slew_step: largest change of an output in a period [SI], 0: no limit
        nraw: raw channels
        x: base pose along x [m], channel -1 where the rig has none
        y: base pose along y [m], likewise
        heading: base heading [rad], likewise
        facing: angle of the direction that the rig looks in from the heading [rad], likewise
    """

    program: Program
    terminals: tuple[TerminalSpec, ...]
    outputs: tuple[OutputSpec, ...]
    period_s: float
    filter: float
    slew_step: float
    nraw: int
    x: TerminalSpec
    y: TerminalSpec
    heading: TerminalSpec
    facing: TerminalSpec


def resolve_cycle(controller: Controller, rig: Rig) -> CycleSpec:
    """Resolve a controller's names on a rig.

    Args:
        controller: the controller
        rig: the rig

    Returns:
        the cycle's numbers

    Raises:
        InputError: the rig lacks a terminal or a joint, or differs in period, order of joints or kind of command
    """
    if not math.isclose(controller.period_s, rig.period_s, rel_tol=1e-9):
        raise InputError(
            f"{controller.name}: period_s {controller.period_s:g} is not the {rig.period_s:g} of rig '{rig.name}'; "
            "give both the same period"
        )
    names = [output.name for output in controller.outputs]
    joints = [joint.name for joint in rig.joints]
    if names != joints:
        raise InputError(
            f"{controller.name}: its outputs are {' '.join(names)}, but the joints of rig '{rig.name}' are "
            f"{' '.join(joints)}; give one output for each joint, in the rig's order"
        )
    terminals = resolve_terminals(controller, rig)
    pose = {name: pose_channel(rig, name) for name in ("x", "y", "heading")}
    pose["facing"] = angle_channel(rig, rig.facing)
    for spec in (*terminals, *pose.values()):
        if abs(spec.zero) >= COUNT_MAX:
            raise InputError(f"rig '{rig.name}': zero {spec.zero} of '{spec.name}' is not within 2^30; correct it")
    return CycleSpec(
        program=controller.program,
        terminals=terminals,
        outputs=tuple(
            _output(controller, output, joint, rig)
            for output, joint in zip(controller.outputs, rig.joints, strict=True)
        ),
        period_s=controller.period_s,
        filter=controller.filter,
        slew_step=slew_step(controller),
        nraw=rig.nraw,
        **pose,
    )


def unit_scale(output: Output) -> float:
    """Return how much SI (rad, rad/s) one unit of an output is.

    Args:
        output: the output
    """
    return math.pi / 180.0 if output.unit.startswith("deg") else 1.0


def slew_step(controller: Controller) -> float:
    """Return the largest change of a command in a period, 0: no limit [SI].

    Args:
        controller: the controller
    """
    return controller.slew_rad_s * controller.period_s


def _output(controller: Controller, output: Output, joint: Joint, rig: Rig) -> OutputSpec:
    if output.kind != joint.mode:
        raise InputError(
            f"{controller.name}: output '{output.name}' commands a {output.kind}, but joint '{joint.name}' of rig "
            f"'{rig.name}' is in {joint.mode} mode; use kind = \"{joint.mode}\""
        )
    velocity = joint.mode == "velocity"
    scale = joint.sign * joint.product.velocity_unit_rad_s if velocity else joint_scale(joint)
    zero = 0 if velocity else joint.zero_tick
    limits = (-joint.speed_rad_s_max, joint.speed_rad_s_max) if velocity else (joint.low_rad, joint.high_rad)
    counts = sorted(zero + round(limit / scale) for limit in limits)
    guarded = velocity and not joint.unlimited
    return OutputSpec(
        name=output.name,
        kind=output.kind,
        low=output.low,
        high=output.high,
        neutral=output.neutral,
        unit_scale=unit_scale(output),
        count_scale=1.0 / scale,
        zero=zero,
        count_low=counts[0],
        count_high=counts[1],
        angle=angle_channel(rig, joint.name if guarded else None),
        angle_low=joint.low_rad if guarded else 0.0,
        angle_high=joint.high_rad if guarded else 0.0,
    )
