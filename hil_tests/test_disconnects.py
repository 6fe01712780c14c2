"""What if the port goes away in mid-run and comes back?"""

from __future__ import annotations

import pytest

from deploy.port import PortLostError
from deploy.torque import release

AWAY_S = 0.3


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


def test_replies_to_a_broken_question_do_not_answer_the_next(bench):
    position = bench.register(bench.rig.joints[0], bench.family.position)
    voltage = bench.register(bench.rig.joints[0], bench.family.voltage)
    for _ in range(20):
        bench.bus._send_read(bench.ids[0], position.address, position.size)  # and nobody waits for the answer
        bench.bus.port.is_using = False
        reply = bench.bus.read(bench.ids[0], voltage.address, voltage.size)
        assert reply.status in ("data", "missing", "corrupt")
        assert reply.status != "data" or len(reply.data) == voltage.size
