"""What every rig must do, before a controller is let loose on it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from controller import registers
from controller.registers import X330_BAUD
from deploy.checks import check_servos
from deploy.comparison import joint_errors
from deploy.dynamixel_bus import decode, encode
from deploy.goal_replay import GoalWrites, SampleTimes, Start, replay_goals
from deploy.joint_counts import count_limits, joint_angle, joint_count
from deploy.rig_io import RigIO

STEP_RAD = 0.15
STEP_S = 0.6
VIRTUAL_RMSE_DEG = 0.2  # the same physics with another step and encoder ticks of 0.088 degrees
BENCH_RMSE_DEG = 6.0  # friction, backlash and armature of real servos are estimates until identified
LATENCY_SAMPLES = 200
ACCESS_ERROR = 7
REFUSALS_OF_LIMIT = (4, 6)  # the manual names both for a goal beyond the limits


def test_every_servo_is_the_right_one(bench):
    for joint in bench.rig.joints:
        reply, model = bench.bus.ping(joint.id)
        assert reply.status == "data" and not reply.alert
        assert model == joint.product.model_number
    assert bench.values("id") == list(bench.ids)


def test_start_up_checks_find_nothing_wrong(bench):
    _, findings = check_servos(bench.bus, bench.rig)
    assert [finding.text for finding in findings if finding.level == "error"] == []


def test_eeprom_is_as_the_rig_says(bench):
    assert {X330_BAUD[value] for value in bench.values("baud_rate")} == {bench.rig.bus.baud}
    assert {2 * value for value in bench.values("return_delay_time")} == {bench.rig.bus.return_delay_us}
    assert set(bench.values("operating_mode")) == {3}


def test_every_register_can_be_read_within_its_range(bench):
    for joint in bench.rig.joints:
        for register in registers(joint.product).values():
            value = bench.bus.read_register(joint.id, register)
            if register.access == "rw" and register.name != "bus_watchdog":
                assert register.low <= value <= register.high, register.name


def test_a_gain_is_written_and_read_back(bench):
    gain = bench.table()["position_p_gain"]
    for joint in bench.rig.joints:
        before = bench.bus.read_register(joint.id, gain)
        for value in (0, 1, 0x1234, before):
            bench.bus.write_register(joint.id, gain, value)
            assert bench.bus.read_register(joint.id, gain) == value


def test_a_read_only_register_refuses_to_be_written(bench):
    position = bench.table()["present_position"]
    for servo in bench.ids:
        reply = bench.bus.write(servo, position.address, encode(position, 0))
        assert (reply.status, reply.error & 0x7F) == ("refused", ACCESS_ERROR)


def test_eeprom_is_locked_while_torque_is_on(bench, armed):
    delay = bench.table()["return_delay_time"]
    for servo in bench.ids:
        before = bench.bus.read_register(servo, delay)
        reply = bench.bus.write(servo, delay.address, encode(delay, before))
        assert (reply.status, reply.error & 0x7F) == ("refused", ACCESS_ERROR)


@pytest.mark.parametrize("beyond", ["min_position_limit", "max_position_limit"])
def test_a_goal_beyond_the_limits_is_refused(bench, armed, beyond):
    goal = bench.table()["goal_position"]
    for servo, seeded in zip(bench.ids, armed, strict=True):
        limit = bench.bus.read_register(servo, bench.table()[beyond])
        wrong = limit - 1 if beyond == "min_position_limit" else limit + 1
        reply = bench.bus.write(servo, goal.address, encode(goal, wrong))
        assert reply.status == "refused" and reply.error & 0x7F in REFUSALS_OF_LIMIT
        assert bench.bus.read_register(servo, goal) == seeded


def test_sync_read_agrees_with_single_reads(bench):
    position = bench.table()["present_position"]
    together = bench.bus.sync_read(bench.ids, position.address, position.size)
    for servo in bench.ids:
        assert together[servo].status == "data"
        assert abs(decode(position, together[servo].data) - bench.bus.read_register(servo, position)) <= 2


def test_round_trips_are_complete(bench, report):
    table = bench.table()
    first, last = table["present_current"], table["present_position"]
    taken = []
    for _ in range(LATENCY_SAMPLES):
        started = bench.clock.now()
        replies = bench.bus.sync_read(bench.ids, first.address, last.address + last.size - first.address)
        taken.append(1e3 * (bench.clock.now() - started))
        assert [reply.status for reply in replies.values()] == ["data"] * len(bench.ids)
    p50, p90, p99 = np.percentile(taken, (50, 90, 99))
    shares = f"50 % {p50:.2f}, 90 % {p90:.2f}, 99 % {p99:.2f}, max {max(taken):.2f}"
    report(f"sync read of {len(bench.ids)} servos [ms]: {shares}")


def test_a_step_moves_each_joint_as_the_model_says(bench, armed, report):
    rig, clock = bench.rig, bench.clock
    table = bench.table()
    first, last = table["present_current"].address, table["present_position"].address + 4
    io = RigIO(rig, bench.bus, None, clock)
    goals = list(armed)
    begin = clock.now() + rig.period_s
    io.read_servos(first, last - first)
    start, held = io.angles_rad(), [joint_angle(j, count) for j, count in zip(rig.joints, goals, strict=True)]
    sampled, angles, written, aims = [], [], [], []
    nstep = round(STEP_S / rig.period_s)
    for k in range(2 * len(rig.joints) * nstep):
        clock.sleep_until(begin + k * rig.period_s)
        asked = clock.now()
        io.read_servos(first, last - first)
        sampled.append(asked - begin)
        angles.append(io.angles_rad())
        index, back = divmod(k // nstep, 2)
        if k % nstep == 0:
            joint = rig.joints[index]
            goals[index] = armed[index] if back else joint_count(joint, held[index] + STEP_RAD)
            assert count_limits(joint)[0] <= goals[index] <= count_limits(joint)[1]
            written.append(clock.now() - begin)
            assert io.write_goals(goals, table["goal_position"].address) is not None
            aims.append([joint_angle(j, count) for j, count in zip(rig.joints, goals, strict=True)])
    none = np.empty(0)
    model = replay_goals(
        rig,
        Start(0.0, np.array(start), None, np.array(held), None),
        GoalWrites(np.array(written), np.array(aims)),
        SampleTimes(np.array(sampled), none, none),
    )
    names = tuple(joint.name for joint in rig.joints)
    for error in joint_errors(names, np.array(sampled), np.array(angles), model.joint_rad):
        report(
            f"step of joint {error.name} against the model [deg]: RMSE {error.rmse_deg:.2f}, max {error.max_deg:.2f}"
        )
        assert error.rmse_deg <= (VIRTUAL_RMSE_DEG if bench.virtual else BENCH_RMSE_DEG)
    reached = np.array(angles)[nstep - 1 :: 2 * nstep]
    for index in range(len(rig.joints)):
        assert math.isclose(reached[index, index] - start[index], STEP_RAD, abs_tol=0.05)


def test_the_bus_watchdog_stops_a_servo_that_nobody_talks_to(bench, armed):
    table = bench.table()
    watchdog, goal = table["bus_watchdog"], table["goal_position"]
    for servo in bench.ids:
        bench.bus.write_register(servo, watchdog, 5)
    bench.clock.sleep_until(bench.clock.now() + 0.3)
    for servo, seeded in zip(bench.ids, armed, strict=True):
        assert bench.bus.read_register(servo, watchdog) == 255
        assert bench.bus.write(servo, goal.address, encode(goal, seeded)).status == "refused"
        bench.bus.write_register(servo, watchdog, 0)
        assert bench.bus.write(servo, goal.address, encode(goal, seeded)).status == "data"


def test_torque_is_off_after_all_this(bench):
    assert bench.values("torque_enable") == [0] * len(bench.ids)
