"""What if the port goes away in mid-run and comes back?"""

from __future__ import annotations

import pytest

from controller.register import encode_register
from deploy.buses.port import PortLostError
from deploy.torque import release

AWAY_S = 0.3
WATCHDOG = 10  # of 20 ms
TRIPPED = 255


def test_a_port_that_is_gone_is_said_so(bench):
    bench.bus.port.closePort()
    try:
        with pytest.raises(PortLostError):
            bench.bus.read(bench.ids[0], *bench.state())
    finally:
        assert bench.bus.port.reopen()
    assert bench.bus.ping(bench.ids[0])[0].status == "data"


def test_torque_can_be_taken_after_the_port_came_back(bench, armed):
    rig = bench.rig
    if bench.family.watchdog is not None:
        for joint in rig.joints:
            bench.bus.write_register(joint.id, bench.register(joint, joint.family.watchdog), 5)
    before = bench.values("position")
    bench.bus.port.closePort()
    bench.clock.sleep_until(bench.clock.now() + AWAY_S)
    assert bench.bus.port.reopen()
    for joint, was in zip(rig.joints, before, strict=True):
        assert abs(bench.read(joint, joint.family.position) - was) <= 0.02 * joint.product.ticks_per_turn
        if joint.family.watchdog is not None:
            assert bench.read(joint, joint.family.watchdog) == 255, "nobody talked to it"
    assert release(bench.bus, rig, bench.clock) == []
    assert bench.values("torque_enable") == [0] * len(bench.ids)


def test_an_adapter_that_is_unplugged_in_mid_run_and_plugged_in_again(bench, armed):
    """The run hears of it at once; the servos stay where they are meanwhile, and their torque can be taken after it."""
    if bench.unplug is None:
        pytest.skip("nobody is there to pull the plug; say --hands, or --control PATH of a served rig")
    rig, clock = bench.rig, bench.clock
    goal = bench.register(rig.joints[0], bench.family.goal_position)
    goals = {joint.id: encode_register(goal, count) for joint, count in zip(rig.joints, armed, strict=True)}
    guarded = [joint for joint in rig.joints if joint.family.watchdog is not None]
    for joint in guarded:
        bench.bus.write_register(joint.id, bench.register(joint, joint.family.watchdog), WATCHDOG)
    before = bench.values("position")
    until = clock.now() + bench.unplug()
    with pytest.raises(PortLostError):
        while clock.now() < until:
            clock.sleep_until(clock.now() + rig.period_s)
            bench.bus.sync_read(bench.ids, *bench.state())
            bench.bus.sync_write(goal.address, goals)
    while not bench.bus.port.reopen():
        assert clock.now() < until, "the adapter has not come back; name it by its path in /dev/serial/by-id"
        clock.sleep_until(clock.now() + rig.period_s)
    for joint, was in zip(rig.joints, before, strict=True):
        assert abs(bench.read(joint, joint.family.position) - was) <= 0.02 * joint.product.ticks_per_turn
    assert all(bench.read(joint, joint.family.watchdog) == TRIPPED for joint in guarded), "nobody talked to them"
    assert release(bench.bus, rig, clock) == []
    assert bench.values("torque_enable") == [0] * len(bench.ids)


def test_replies_to_a_broken_question_do_not_answer_the_next(bench):
    position = bench.register(bench.rig.joints[0], bench.family.position)
    voltage = bench.register(bench.rig.joints[0], bench.family.voltage)
    for _ in range(20):
        bench.bus._send_read(bench.ids[0], position.address, position.size)  # and nobody waits for the answer
        bench.bus.port.is_using = False
        reply = bench.bus.read(bench.ids[0], voltage.address, voltage.size)
        assert reply.status in ("data", "missing", "corrupt")
        assert reply.status != "data" or len(reply.data) == voltage.size
