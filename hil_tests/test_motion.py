"""Do the joints move as the model says?"""

from __future__ import annotations

import math

import numpy as np

from deploy.joint_counts import count_limits, joint_angle, joint_count
from deploy.logs.comparison import joint_errors
from deploy.logs.goal_replay import GoalWrites, SampleTimes, Start, replay_goals
from deploy.rig_io import RigIO

STEP_RAD = 0.15
STEP_S = 0.6
VIRTUAL_RMSE_DEG = 0.2  # the same physics with another step and encoder ticks of 0.088 degrees
VIRTUAL_TICKS = 1.5  # coarse encoders are read and aimed in whole counts
BENCH_RMSE_DEG = 6.0  # friction, backlash and armature of real servos are estimates until identified
HELD_DEG_MAX = 1.0


def test_a_step_moves_each_joint_as_the_model_says(bench, armed, measured):
    rig, clock = bench.rig, bench.clock
    address, size = bench.state()
    goal_address = bench.register(rig.joints[0], bench.family.goal_position).address
    io = RigIO(rig, bench.bus, None, clock)
    goals = list(armed)
    begin = clock.now() + rig.period_s
    io.read_servos(address, size)
    start, held = io.angles_rad(), [joint_angle(j, count) for j, count in zip(rig.joints, goals, strict=True)]
    sampled, angles, written, aims = [], [], [], []
    nstep = round(STEP_S / rig.period_s)
    for k in range(2 * len(rig.joints) * nstep):
        clock.sleep_until(begin + k * rig.period_s)
        asked = clock.now()
        io.read_servos(address, size)
        sampled.append(asked - begin)
        angles.append(io.angles_rad())
        index, back = divmod(k // nstep, 2)
        if k % nstep == 0:
            joint = rig.joints[index]
            goals[index] = armed[index] if back else joint_count(joint, held[index] + STEP_RAD)
            assert count_limits(joint)[0] <= goals[index] <= count_limits(joint)[1]
            written.append(clock.now() - begin)
            assert io.write_goals(goals, goal_address) is not None
            aims.append([joint_angle(j, count) for j, count in zip(rig.joints, goals, strict=True)])
    none = np.empty(0)
    model = replay_goals(
        rig,
        Start(0.0, np.array(start), None, np.array(held), None),
        GoalWrites(np.array(written), np.array(aims)),
        SampleTimes(np.array(sampled), none, none),
    )
    names = tuple(joint.name for joint in rig.joints)
    for joint, error in zip(
        rig.joints, joint_errors(names, np.array(sampled), np.array(angles), model.joint_rad), strict=True
    ):
        tick_deg = 360.0 / joint.product.ticks_per_turn
        limit = max(VIRTUAL_RMSE_DEG, VIRTUAL_TICKS * tick_deg) if bench.virtual else BENCH_RMSE_DEG
        what = f"step of joint {error.name} against the model"
        measured(what, "deg", f"RMSE at most {limit:.2g}", rmse=error.rmse_deg, max=error.max_deg)
        assert error.rmse_deg <= limit
    reached = np.array(angles)[nstep - 1 :: 2 * nstep]
    for index in range(len(rig.joints)):
        assert math.isclose(reached[index, index] - start[index], STEP_RAD, abs_tol=0.05)


def test_joints_hold_still(bench, armed, measured):
    rig, clock = bench.rig, bench.clock
    io = RigIO(rig, bench.bus, None, clock)
    angles = []
    for _ in range(50):
        io.read_servos(*bench.state())
        angles.append(io.angles_rad())
        clock.sleep_until(clock.now() + rig.period_s)
    span = np.degrees(np.ptp(np.array(angles), axis=0))
    for joint, width in zip(rig.joints, span, strict=True):
        measured(f"joint {joint.name} held for a second moves by", "deg", f"at most {HELD_DEG_MAX:g}", range=width)
    assert span.max() <= HELD_DEG_MAX
