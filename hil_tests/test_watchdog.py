"""What stops the servos if the program that drives them dies?"""

from __future__ import annotations

import pytest

from deploy.checks import check_servos

COUNT = 5
UNIT_S = 0.02
TRIPPED = 255


def test_the_bus_watchdog_stops_a_servo_that_nobody_talks_to(bench, armed):
    if bench.family.watchdog is None:
        pytest.skip(f"{bench.rig.joints[0].product.name} servos have no bus watchdog")
    for joint in bench.rig.joints:
        bench.bus.write_register(joint.id, bench.register(joint, joint.family.watchdog), COUNT)
    bench.clock.sleep_until(bench.clock.now() + 3 * COUNT * UNIT_S)
    for joint, seeded in zip(bench.rig.joints, armed, strict=True):
        watchdog, goal = joint.family.watchdog, joint.family.goal_position
        assert bench.read(joint, watchdog) == TRIPPED
        assert bench.write(joint, goal, seeded).status == "refused"
        bench.bus.write_register(joint.id, bench.register(joint, watchdog), 0)
        assert bench.write(joint, goal, seeded).status == "data"


def test_a_bus_watchdog_that_is_fed_does_not_trip(bench, armed):
    if bench.family.watchdog is None:
        pytest.skip(f"{bench.rig.joints[0].product.name} servos have no bus watchdog")
    for joint in bench.rig.joints:
        bench.bus.write_register(joint.id, bench.register(joint, joint.family.watchdog), 4 * COUNT)
    until = bench.clock.now() + 8 * COUNT * UNIT_S
    while bench.clock.now() < until:
        bench.bus.sync_read(bench.ids, *bench.state())
        bench.clock.sleep_until(bench.clock.now() + bench.rig.period_s)
    for joint in bench.rig.joints:
        assert bench.read(joint, joint.family.watchdog) == 4 * COUNT
        bench.bus.write_register(joint.id, bench.register(joint, joint.family.watchdog), 0)


def test_servos_without_a_bus_watchdog_are_warned_of(bench):
    told = [finding.text for finding in check_servos(bench.bus, bench.rig)[1] if "no bus watchdog" in finding.text]
    lacking = any(joint.family.watchdog is None for joint in bench.rig.joints)
    assert bool(told) == lacking
