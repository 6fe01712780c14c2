"""Rollouts: the native loop against a slow one of MuJoCo and the reference cycle, bit for bit."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from slow_rollout import SENSING, judged, make_controller, slow_rollout

from controller import load_rig
from sim_models.perturbations import draw_perturbations, take
from sim_models.rollouts import RolloutPool, make_cases
from sim_models.simulation import NEVER_STOP
from sim_models.statistics import STATISTICS


def velocity_lamp():
    """Return the lamp with its servos in velocity mode."""
    rig = load_rig("lamp-xc330")
    change = {"mode": "velocity", "speed_rad_s_max": 10.0, "gains": {"velocity_p_gain": 2000, "velocity_i_gain": 0}}
    return dataclasses.replace(rig, joints=tuple(dataclasses.replace(joint, **change) for joint in rig.joints))


def velocity_paper_lamp(folder):
    """Return the ideal lamp with velocity motors, looking along its last joint, which has no limits."""
    rig = load_rig("paper-lamp")
    text = (
        rig.body.read_text()
        .replace('<position kp="60" kv="1.5"', '<velocity kv="20"')
        .replace("<position", "<velocity")
    )
    body = folder / "velocity.xml"
    body.write_text(text)
    joints = [dataclasses.replace(joint, mode="velocity", speed_rad_s_max=10.0) for joint in rig.joints]
    joints[2] = dataclasses.replace(joints[2], unlimited=True, low_rad=-math.inf, high_rad=math.inf)
    return dataclasses.replace(rig, body=body, joints=tuple(joints), facing="a2")


@pytest.mark.parametrize(
    ("name", "form", "timestep", "seed", "goal"),
    [
        ("lamp", "free", 0.002, 3, (0.35, 0.2)),
        ("lamp", "planar", 0.005, 4, (0.02, 0.0)),
        ("lamp", "free", 0.0025, 5, (0.02, -0.3)),
        ("paper-lamp", "free", 0.004, 6, (0.3, 0.1)),
        ("velocity lamp", "free", 0.005, 7, (0.3, 0.0)),
        ("velocity paper-lamp", "free", 0.004, 8, (0.3, 0.0)),
        ("velocity paper-lamp", "planar", 0.005, 9, (0.3, 0.0)),
    ],
)
def test_rollouts_are_the_slow_loop_bit_for_bit(tmp_path, name, form, timestep, seed, goal):
    rig = {
        "lamp": lambda: load_rig("lamp-xc330"),
        "paper-lamp": lambda: load_rig("paper-lamp"),
        "velocity lamp": velocity_lamp,
        "velocity paper-lamp": lambda: velocity_paper_lamp(tmp_path),
    }[name]()
    sensing = make_controller(
        *SENSING, joints=rig.joints, more={"vx", "vy", "vz"} if name.endswith("paper-lamp") else ()
    )
    perturbations = draw_perturbations(np.random.default_rng(seed), 3, 3)
    nstep = 40
    with RolloutPool(rig, form=form, timestep_s=timestep, time_limit_s=0.8, threads=1, stop=NEVER_STOP) as pool:
        fast = pool.run([sensing], make_cases(0, *goal, np.arange(3)), perturbations, traces=True, record=True)
    for sim in range(3):
        slow, states = slow_rollout(sensing, rig, form, timestep, nstep, goal, take(perturbations, [sim]))
        assert np.array_equal(fast.raw[sim], slow[0])
        assert np.array_equal(fast.outputs[sim].view(np.uint32), slow[1].view(np.uint32))
        assert np.array_equal(fast.goal_counts[sim], slow[2])
        assert np.ptp(slow[2], axis=0).min() > 10  # the controller did move every joint
        places = [fast.channels.index(name) for name in ("x", "y", "z", "clearance", "a0", "a1", "a2")]
        assert np.array_equal(fast.traces[sim][:, places], slow[3].astype(np.float32))
        expected = judged(states, goal)
        assert set(expected) == set(STATISTICS.names) - {"head_touched"}
        for name, value in expected.items():
            assert fast.statistics[sim][name] == pytest.approx(value, rel=1e-4, abs=2e-6), name
