"""The whole control cycle on emulated Cortex-M4F and Cortex-M0: the reference's bits, raw counts to goal counts."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import pytest
from emulated_batch import M0, M4F, build_images, cycle_job, run_image

from controller.controller import Controller, Input, Output
from controller.cycle import resolve_cycle
from controller.lowering import lower
from controller.reference import ReferenceCycle
from controller.rig import Rig
from controller.rig_file import load_rig
from controller.source import Apply, Constant
from controller.terminals import terminals_of
from firmware_gen.transpiler.vectors import bits_of

GOAL = (np.float32(0.31), np.float32(-0.4))


@dataclass(frozen=True)
class Run:
    """Hold a controller on a rig, raw counts and what the reference makes of them.

    Args:
        controller: the controller
        rig: the rig
        raw: raw channels, (nstep, nraw)
        expected: a row a step: bits of terminals and outputs, then goal counts
    """

    controller: Controller
    rig: Rig
    raw: npt.NDArray[np.int32]
    expected: npt.NDArray[np.uint32]


def rigs():
    """Return rigs with every kind of joint and terminal: positions, guarded and free velocities, one that turns."""
    lamp, jumper = load_rig("lamp-xc330"), load_rig("jumper-xc330")
    rolling = [replace(joint, mode="velocity", speed_rad_s_max=8.0) for joint in lamp.joints]
    return (lamp, load_rig("lamp-sts3215"), jumper, replace(lamp, joints=tuple(rolling), facing="a2"))


def draw_raw(rng, rig, nstep):
    """Draw raw counts: joints and base wander, some counts are anything."""
    zeros = [joint.zero_tick for joint in rig.joints] + [0] * (2 * len(rig.joints)) + [s.zero for s in rig.sensors]
    walk = np.cumsum(rng.integers(-60, 61, (nstep, rig.nraw)), axis=0) + np.array(zeros)
    anything = rng.integers(-(2**31), 2**31, (nstep, rig.nraw))
    return np.where(rng.random((nstep, rig.nraw)) < 0.01, anything, walk).astype(np.int32)


def draw_run(programs, seed, nstep):
    rng = np.random.default_rng(seed)
    rig = rigs()[seed % len(rigs())]
    names = tuple(terminals_of(rig))
    source = programs.large_source(rng)
    # the first goal moves all over its range, whatever the program gives
    swing = Apply("*", (Constant(np.float32(45.0)), Apply("sin", source.outputs[:1])))
    source = replace(source, outputs=(swing, *(source.outputs * len(rig.joints)))[: len(rig.joints)])
    unit = str(rng.choice(["deg", "rad"]))
    controller = Controller(
        name="cycle",
        period_s=rig.period_s,
        inputs=tuple(Input(name, terminals_of(rig)[name].unit, -1, 1) for name in names),
        outputs=tuple(
            Output(joint.name, joint.mode, f"{unit}/s" if joint.mode == "velocity" else unit, -40.0, 50.0, 3.0)
            for joint in rig.joints
        ),
        source=source,
        program=lower(source, names),
        filter=float(rng.choice([1.0, rng.uniform(0.1, 1.0)])),
        slew_rad_s=float(rng.choice([0.0, rng.uniform(1.0, 20.0)])),
    )
    raw = draw_raw(rng, rig, nstep)
    reference = ReferenceCycle(controller, rig)
    rows = [reference.step(*GOAL, row) for row in raw]
    expected = [np.hstack([bits_of(t), bits_of(u), np.asarray(g, np.int32).view(np.uint32)]) for t, u, g in rows]
    return Run(controller, rig, raw, np.array(expected))


@pytest.fixture(scope="module")
def runs(request, programs):
    nrun, nstep = (40, 1_000) if request.config.getoption("--long") else (12, 200)
    return [draw_run(programs, seed, nstep) for seed in range(nrun)]


def test_the_runs_reach_goals_of_many_values(runs):
    assert len({run.rig.name for run in runs}) >= 3
    for i in range(len(rigs())):
        goals = np.concatenate([run.expected[:, -len(run.rig.joints) :].ravel() for run in runs[i :: len(rigs())]])
        assert len(np.unique(goals)) > 30


@pytest.mark.parametrize("target", [M4F, M0], ids=lambda target: target.name)
def test_the_cycle_on_a_microcontroller_has_the_references_bits(runs, target, tmp_path):
    (image,) = build_images(tmp_path, target, [], [])
    jobs = [cycle_job(resolve_cycle(run.controller, run.rig), GOAL, run.raw) for run in runs]
    answers = run_image(image, jobs, [1 + run.expected.size for run in runs])
    for run, answer in zip(runs, answers, strict=True):
        assert answer[0] == 0, f"sv_cycle_verify {answer[0].astype(np.int32)}"
        found = answer[1:].reshape(run.expected.shape)
        nfloat = run.expected.shape[1] - len(run.rig.joints)
        assert np.array_equal(bits_of(found[:, :nfloat].view(np.float32)), run.expected[:, :nfloat])
        assert np.array_equal(found[:, nfloat:], run.expected[:, nfloat:])
