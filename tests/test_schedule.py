"""The order of bus transactions, written out by hand."""

from __future__ import annotations

import pytest

from controller.rig_file import load_rig, parse_rig
from controller.schedule import Schedule, Transaction, TransactionKind, period, schedule_of

READ = Transaction(TransactionKind.READ_STATE, -1, 126, 10)
RUN = Transaction(TransactionKind.RUN_CYCLE, -1, 0, 0)
WRITE = Transaction(TransactionKind.WRITE_GOALS, -1, 116, 4)


@pytest.mark.parametrize("name", ["lamp-xc330", "lamp-xl330"])
def test_a_lamp_reads_runs_writes_and_asks_one_servo_for_its_health(name):
    schedule = schedule_of(load_rig(name))
    # torque enable to hardware error (64 to 70) of each servo in turn, then voltage and temperature (144 to 146)
    turns = [(0, 64, 7), (1, 64, 7), (2, 64, 7), (0, 144, 3), (1, 144, 3), (2, 144, 3)] * 2
    for k, turn in enumerate(turns):
        assert period(schedule, k) == (READ, RUN, WRITE, Transaction(TransactionKind.READ_HEALTH, *turn))


def test_health_slots_are_fixed():
    schedule = Schedule(2, (126, 10), (116, 4), ((70, 1),), health_every=3)
    listed = [period(schedule, k) for k in range(12)]
    assert [len(transactions) for transactions in listed] == [3, 3, 4] * 4
    assert [listed[k][3].servo for k in (2, 5, 8, 11)] == [0, 1, 0, 1]
    assert all(transactions[:3] == (READ, RUN, WRITE) for transactions in listed)


def test_every_block_of_every_servo_is_read_once_a_round():
    schedule = Schedule(5, (126, 10), (116, 4), ((70, 1), (144, 3), (124, 2), (98, 1)), health_every=2)
    for start in (0, 2 * 40, 2 * 40 * 1000):
        last = [period(schedule, start + k)[3] for k in range(1, 40, 2)]
        assert {(item.servo, item.address) for item in last} == {(s, a) for s in range(5) for a in (70, 144, 124, 98)}


def test_no_health_and_the_last_period_of_all():
    assert period(Schedule(3, (126, 10), (116, 4), ()), 7) == (READ, RUN, WRITE)
    assert len(period(Schedule(3, (126, 10), (116, 4), ((70, 1),)), 2**31 - 1)) == 4


def test_a_rig_in_velocity_mode_writes_goal_velocities():
    jumper = schedule_of(load_rig("jumper-xc330"))
    assert (jumper.nservo, jumper.state, jumper.goal) == (4, (126, 10), (104, 4))
    sts = load_rig("lamp-sts3215")
    gains = "p_gain = 50\ni_gain = 0\nd_gain = 0\n"
    speed = 'mode = "velocity"\nspeed_rad_s_max = 4.0\nvelocity_p_gain = 10\nvelocity_i_gain = 0\n'
    assert schedule_of(parse_rig(sts.text.replace(gains, speed), sts.path)).goal == (46, 2)
