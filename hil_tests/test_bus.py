"""How fast and how surely does the bus answer?"""

from __future__ import annotations

import numpy as np

from controller.register import decode_register

SAMPLES = 200
LOST_MAX = 0.01


def test_sync_read_agrees_with_single_reads(bench):
    position = bench.register(bench.rig.joints[0], bench.family.position)
    together = bench.bus.sync_read(bench.ids, position.address, position.size)
    for joint in bench.rig.joints:
        assert together[joint.id].status == "data"
        now = bench.read(joint, joint.family.position)
        assert abs(decode_register(position, together[joint.id].data) - now) <= 2


def timed(bench, ask):
    """Return how long questions take [ms], and how many of their replies were lost."""
    taken, lost = [], 0
    for _ in range(SAMPLES):
        started = bench.clock.now()
        replies = ask()
        taken.append(1e3 * (bench.clock.now() - started))
        lost += sum(reply.status != "data" for reply in replies)
    return taken, lost


def spread(taken):
    p50, p90, p99 = np.percentile(taken, (50, 90, 99))
    return {"p50": p50, "p90": p90, "p99": p99, "max": max(taken)}


def test_round_trips_of_the_state_of_all(bench, measured):
    block = bench.state()
    taken, lost = timed(bench, lambda: bench.bus.sync_read(bench.ids, *block).values())
    limit = f"the period is {1e3 * bench.rig.period_s:g} ms"
    measured(f"state of {len(bench.ids)} servos", "ms", limit, **spread(taken), lost=lost)
    assert lost <= LOST_MAX * SAMPLES * len(bench.ids)
    assert np.percentile(taken, 99) < 1e3 * bench.rig.period_s


def test_round_trips_of_single_reads(bench, measured):
    for joint in bench.rig.joints:
        position = bench.register(joint, joint.family.position)
        taken, lost = timed(bench, lambda: [bench.bus.read(joint.id, position.address, position.size)])  # noqa: B023
        measured(f"position of servo {joint.id}", "ms", **spread(taken), lost=lost)
        assert lost <= LOST_MAX * SAMPLES


def test_an_unused_id_is_silent(bench, measured):
    unused = next(number for number in range(1, 250) if number not in bench.ids)
    started = bench.clock.now()
    reply, _ = bench.bus.ping(unused)
    measured("silence of an unused id is noticed after", "ms", t=1e3 * (bench.clock.now() - started))
    assert reply.status == "missing"
