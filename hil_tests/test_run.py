"""Does a whole run go as it should, by the host loop or by firmware? What it left is read by a client of its own."""

from __future__ import annotations

import pytest

from controller import registers
from deploy.logs.replay import replay
from deploy.states import State

SECONDS = 1.0
LOST_MAX = 0.01
TRACKING_RAD_MAX = 0.3


def test_a_run_moves_every_joint_and_ends_with_torque_off(bench, run, measured):
    made = run(SECONDS)
    outcome, rig = made.outcome, bench.rig
    assert (outcome.state, outcome.done, outcome.faulty) == (State.OFF, True, False), outcome.reason
    assert outcome.cycles == round(SECONDS / rig.period_s)
    lost = outcome.missed_replies / (outcome.cycles * len(rig.joints))
    measured("replies of a run that were lost", "1", f"at most {LOST_MAX:g}", share=lost)
    measured("deadlines of a run that were missed", "1", missed=outcome.missed_deadlines)
    assert lost <= LOST_MAX
    for joint in rig.joints:
        counts = [cycle["raw"][joint.name] for cycle in made.log.cycles]
        turned = (max(counts) - min(counts)) / joint.product.ticks_per_turn * 6.283
        measured(f"joint {joint.name} turned in a run", "rad", range=turned)
        assert 0.02 < turned < TRACKING_RAD_MAX
    assert bench.values("torque_enable") == [0] * len(bench.ids)
    assert replay(made.log.path).difference is None


def test_a_run_goes_through_every_state(bench, run):
    entered = [event["entered"] for event in run(SECONDS).log.events if event["kind"] == "state"]
    assert entered == ["checked", "armed", "homing", "running", "stopping", "off"]


def test_a_runs_settings_are_the_rigs(bench, run):
    assert run(0.1).outcome.done
    for joint in bench.rig.joints:
        table = registers(joint.product)
        for name, count in joint.gains.items():
            assert bench.bus.read_register(joint.id, table[name]) == count
        if joint.family.torque_ceiling is not None:
            assert bench.read(joint, joint.family.torque_ceiling) == joint.ceiling
        if joint.family.watchdog is not None:
            assert bench.read(joint, joint.family.watchdog) == 0, "disarmed at the end"


def test_a_derated_run_lowers_the_ceiling(bench, run):
    if bench.family.torque_ceiling is None:
        pytest.skip("it has no torque ceiling in RAM")
    assert run(0.1, derate=0.5).outcome.done
    for joint in bench.rig.joints:
        assert bench.read(joint, joint.family.torque_ceiling) == round(0.5 * joint.ceiling)
    assert run(0.1).outcome.done


def test_a_dry_run_writes_nothing(bench, run):
    goals = [bench.read(joint, joint.family.goal_position) for joint in bench.rig.joints]
    outcome = run(SECONDS, arm=False).outcome
    assert (outcome.state, outcome.done, outcome.touched) == (State.OFF, True, False)
    assert goals == [bench.read(joint, joint.family.goal_position) for joint in bench.rig.joints]
    assert bench.values("torque_enable") == [0] * len(bench.ids)


@pytest.mark.parametrize("after_s", [0.4, 1.2])
def test_a_run_that_is_stopped_leaves_no_torque(bench, run, after_s):
    outcome = run(60.0, stop_after_s=after_s).outcome
    assert (outcome.state, outcome.done) == (State.OFF, False)
    assert outcome.reason.startswith("stopped: ")
    assert bench.values("torque_enable") == [0] * len(bench.ids)
