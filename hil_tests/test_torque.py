"""Is torque off after all this? Run last."""

from __future__ import annotations

from deploy.torque import release


def test_torque_comes_off_every_servo(bench, armed):
    assert bench.values("torque_enable") == [1] * len(bench.ids)
    assert release(bench.bus, bench.rig, bench.clock) == []
    assert bench.values("torque_enable") == [0] * len(bench.ids)


def test_torque_is_off_after_all_this(bench):
    assert bench.values("torque_enable") == [0] * len(bench.ids)
