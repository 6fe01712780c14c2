"""The control cycle: the compiled one against the reference bit for bit, and both against what is meant."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lamp_cycles import EVERY, controller_for, raw_of, terminals, turned

from controller.library import SvCycle
from controller.lowering import lower
from controller.native import encode, pack_cycle, run_cycle
from controller.reference import ReferenceCycle
from controller.rig_file import load_rig
from controller.terminals import TerminalKind, TerminalSpec, terminals_of


@pytest.fixture(scope="module")
def rig():
    return load_rig("lamp-xc330")


@given(st.data())
def test_compiled_cycle_is_the_reference(programs, data):
    rig = load_rig("lamp-xc330")
    rig = data.draw(st.sampled_from([rig, turned(rig), replace(rig, facing="a2"), load_rig("paper-lamp")]))
    names = list(programs.terminals)
    source = data.draw(programs.sources())
    source = replace(source, outputs=(source.outputs * 3)[:3])
    limits = data.draw(st.tuples(*[st.floats(-200, 200, width=32)] * 3).map(sorted))
    controller = replace(
        controller_for(
            rig,
            "(list 0 0 0)",
            limits=(limits[0], limits[2], limits[1]),
            unit=data.draw(st.sampled_from(["deg", "rad"])),
            filter=data.draw(st.one_of(st.just(1.0), st.floats(1e-6, 1))),
            slew_rad_s=data.draw(st.one_of(st.just(0.0), st.floats(0, 20))),
            names=names,
        ),
        source=source,
        program=lower(source, names),
    )
    goal = data.draw(st.tuples(st.floats(0, 2, width=32), st.floats(-7, 7, width=32)))
    count = st.one_of(st.integers(-5000, 5000), st.integers(-(2**31), 2**31 - 1))
    rows = data.draw(st.lists(st.lists(count, min_size=rig.nraw, max_size=rig.nraw), min_size=1, max_size=6))
    native, reference = pack_cycle(controller, rig), ReferenceCycle(controller, rig)
    for _ in range(2):
        for row in rows:
            raw = np.array(row, np.int32)
            for a, b in zip(native.step(*goal, raw), reference.step(*goal, raw), strict=True):
                assert (a.dtype, a.shape) == (b.dtype, b.shape)
                assert programs.same(a, b) if a.dtype == np.float32 else a.tolist() == b.tolist()
        native.reset()
        reference.reset()


def test_derived_terminals_are_the_reference_over_random_motion(rig, programs):
    rng = np.random.default_rng(3)
    for _ in range(20):
        rows = rng.integers(-9000, 9000, (40, rig.nraw), dtype=np.int32)
        goal = (float(rng.uniform(0, 1)), float(rng.uniform(-3.2, 3.2)))
        terminals(rig, rows, goal)


def test_joint_terminals_are_si(rig):
    raw = raw_of(rig, angles=(0.5, -1.0, 0.25), force=2.5)
    raw[3:6] = (10, -20, 30)
    raw[6:9] = (235, -1176, 2352)
    told = terminals(rig, [raw] * 2)
    sign = [joint.sign for joint in rig.joints]
    half_tick = math.pi / 4096 + 1e-6
    for name, angle in zip(("a0", "a1", "a2"), (0.5, -1.0, 0.25), strict=True):
        assert told[name][0] == pytest.approx(angle, abs=half_tick)
    velocity = 0.229 * 2 * math.pi / 60  # [rad/s] a count
    assert told["a0_vel"][0] == pytest.approx(10 * sign[0] * velocity, rel=1e-3)
    assert told["a1_vel"][0] == pytest.approx(-20 * sign[1] * velocity, rel=1e-3)
    assert told["a1_load"][0] == pytest.approx(-0.5 * sign[1])
    assert told["a2_load"][0] == pytest.approx(1.0 * sign[2])
    assert told["s0"][0] == pytest.approx(2.5)
    assert told["t"].tolist() == [0, np.float32(0.02)]


def test_px_is_the_way_that_is_left(rig):
    # goal 0.3 m ahead; the base walks to it, past it, and turns round
    poses = [(0.0, 0.0), (0.1, 0.0), (0.4, 0.0), (0.4, math.pi), (0.3, math.pi / 2)]
    told = terminals(rig, [raw_of(rig, x=x, heading=heading) for x, heading in poses])
    assert told["px"] == pytest.approx([0.3, 0.2, -0.1, 0.1, 0.0], abs=3e-4)
    assert told["py"] == pytest.approx([0.0] * 5, abs=3e-4)
    assert told["goal_dist"].tolist() == [np.float32(0.3)] * 5


@pytest.mark.parametrize("heading", [0.0, 1.0, -2.5, 3.0])
@pytest.mark.parametrize("bearing", [0.0, math.pi / 2, -1.0])
def test_the_goal_is_latched_from_the_first_pose(rig, heading, bearing):
    start = raw_of(rig, x=1.2, y=-0.7, heading=heading)
    goal = (1.2 + 0.3 * math.cos(heading + bearing), -0.7 + 0.3 * math.sin(heading + bearing))
    poses = [(1.25, -0.6, heading - 0.5), (1.0, -1.1, heading + 2.0)]
    rows = [start, *(raw_of(rig, x=x, y=y, heading=h) for x, y, h in poses)]
    told = terminals(rig, rows, (0.3, bearing))
    assert told["px"][0] == pytest.approx(0.3 * math.cos(bearing), abs=1e-6)
    assert told["py"][0] == pytest.approx(0.3 * math.sin(bearing), abs=1e-6)  # to the left is positive
    assert told["heading_error"][0] == pytest.approx(bearing, abs=1e-5)
    for i, (x, y, h) in enumerate(poses, start=1):
        dx, dy = goal[0] - x, goal[1] - y
        assert told["px"][i] == pytest.approx(dx * math.cos(h) + dy * math.sin(h), abs=5e-4)
        assert told["py"][i] == pytest.approx(dy * math.cos(h) - dx * math.sin(h), abs=5e-4)
        error = math.atan2(dy, dx) - h
        error = math.atan2(math.sin(error), math.cos(error))
        assert told["heading_error"][i] == pytest.approx(error, abs=5e-3)


def test_heading_error_wraps_at_pi(rig):
    headings = np.linspace(-10, 10, 401)
    told = terminals(rig, [raw_of(rig), *(raw_of(rig, heading=h) for h in headings)])
    wrapped = np.arctan2(np.sin(-headings), np.cos(-headings))
    error = told["heading_error"][1:]
    assert np.abs(error).max() <= np.float32(math.pi)
    assert np.abs(np.angle(np.exp(1j * (error - wrapped)))).max() < 1e-3


def test_on_the_goal_every_direction_is_right(rig):
    told = terminals(rig, [raw_of(rig)] * 2, (0.0, 0.0))
    assert told["heading_error"].tolist() == [0, 0] and told["px"].tolist() == [0, 0]


def test_goal_met_is_latched_within_15_mm(rig):
    xs = [0.0, 0.2849, 0.28, 0.2851, 0.1, 0.5]
    assert terminals(rig, [raw_of(rig, x=x) for x in xs])["goal_met"].tolist() == [0, 0, 0, 1, 1, 1]
    # from beyond it, too
    xs = [0.0, 0.3151, 0.3149, 0.4]
    assert terminals(rig, [raw_of(rig, x=x) for x in xs])["goal_met"].tolist() == [0, 0, 1, 1]
    assert terminals(rig, [raw_of(rig)], (0.015, 0.0))["goal_met"].tolist() == [1]


def velocities(rig, text, angles=(0.0, 0.0, 0.0), **how):
    """Run both cycles once with the joints at these angles; return the rates that the goal counts command [rad/s]."""
    controller = controller_for(rig, text, unit="rad", limits=(-100.0, 100.0, 0.0), **how)
    raw = raw_of(rig, angles=angles)
    _, _, counts = run_cycle(controller, rig, np.array([raw]), (0.3, 0.0))
    assert ReferenceCycle(controller, rig).step(0.3, 0.0, raw)[2].tolist() == counts[0].tolist()
    return [j.sign * c * j.product.velocity_unit_rad_s for j, c in zip(rig.joints, counts[0], strict=True)]


def test_velocities_are_commanded_in_velocity_counts(rig):
    half = 0.5 * rig.joints[0].product.velocity_unit_rad_s + 1e-6
    told = velocities(turned(rig), "(list 3 -2 1)", names=[])
    assert told == pytest.approx([3.0, -2.0, 1.0], abs=half)
    assert velocities(turned(rig), "(list 50 -50 0)", names=[]) == pytest.approx([8.0, -8.0, 0.0], abs=half)
    # filter and slew limit are in rad/s and rad/s2: half of 4, then 50 rad/s2 for 20 ms
    assert velocities(turned(rig), "(list 4 0 0)", names=[], filter=0.5)[0] == pytest.approx(2.0, abs=half)
    assert velocities(turned(rig), "(list 4 0 0)", names=[], slew_rad_s=50.0)[0] == pytest.approx(1.0, abs=half)


@pytest.mark.parametrize("speed", [5.0, -5.0])
def test_a_velocity_that_would_leave_the_travel_is_none(rig, speed):
    other, limit = turned(rig), rig.joints[1].high_rad * math.copysign(1.0, speed)
    way = speed * rig.period_s
    for angle, expected in ((0.0, speed), (limit - 1.1 * way, speed), (limit - 0.9 * way, 0.0), (limit + way, 0.0)):
        told = velocities(other, f"(list {speed} {speed} {speed})", (limit, angle, angle), names=[])
        assert told == pytest.approx([speed, expected, expected], abs=0.02), angle
        # back inside is always allowed
        back = velocities(other, f"(list 0 {-speed} {-speed})", (limit, angle, angle), names=[])
        assert back == pytest.approx([0.0, -speed, -speed], abs=0.02)


@pytest.mark.parametrize("angle", [0.0, 0.7, -2.0, 3.0, 40.0])
def test_a_rig_that_looks_along_a_joint_sees_the_goal_turned(rig, angle):
    other = replace(rig, facing="a0")
    plain, seen = (
        terminals(one, [raw_of(one), raw_of(one, angles=(angle, 0, 0), x=0.1, y=0.05, heading=0.4)], (0.4, 0.9))
        for one in (rig, other)
    )
    assert (seen["px"][0], seen["py"][0]) == (plain["px"][0], plain["py"][0])  # the goal itself does not turn
    exact = raw_of(rig, angles=(angle, 0, 0))[0] - rig.joints[0].zero_tick
    turn = exact * 2 * math.pi / 4096
    x, y = float(plain["px"][1]), float(plain["py"][1])
    assert seen["px"][1] == pytest.approx(x * math.cos(turn) + y * math.sin(turn), abs=1e-5)
    assert seen["py"][1] == pytest.approx(y * math.cos(turn) - x * math.sin(turn), abs=1e-5)
    expected = math.remainder(math.atan2(y, x) - turn, 2 * math.pi)
    assert seen["heading_error"][1] == pytest.approx(expected, abs=1e-4)
    assert abs(seen["heading_error"][1]) <= np.float32(math.pi)


def outputs(rig, text, nstep=1, **how):
    """Run both cycles at rest; return clamped outputs (nstep, 3) and goal angles in ticks from zero, sign taken out."""
    controller = controller_for(rig, text, **how)
    reference = ReferenceCycle(controller, rig)
    rows = np.array([raw_of(rig)] * nstep)
    _, values, counts = run_cycle(controller, rig, rows, (0.3, 0.0))
    for i, row in enumerate(rows):
        _, judged, ticks = reference.step(0.3, 0.0, row)
        assert judged.tobytes() == values[i].tobytes() and ticks.tolist() == counts[i].tolist()
    return values, [[(c - j.zero_tick) * j.sign for c, j in zip(row, rig.joints, strict=True)] for row in counts]


def test_outputs_are_clamped_in_their_own_unit(rig):
    values, ticks = outputs(rig, "(list 49 51 -41)")
    assert values.tolist() == [[49, 50, -40]]
    # degrees / 360 * 4096: 557.5…, 568.9…, -455.1…
    assert ticks == [[558, 569, -455]]
    infinite = "(* 3e38 10)"
    values, ticks = outputs(rig, f"(list (- {infinite} {infinite}) {infinite} (- 0 {infinite}))")
    assert values.tolist() == [[3, 50, -40]]  # NaN is neutral
    assert ticks == [[34, 569, -455]]


def test_radians_pass_as_they_are_and_the_rig_limits_counts(rig):
    values, ticks = outputs(rig, "(list 0.5 3 -3)", unit="rad", limits=(-3.0, 3.0, 0.0))
    assert values.tolist() == [[0.5, 3, -3]]
    limit = [round(joint.high_rad * 4096 / (2 * math.pi)) for joint in rig.joints]
    assert ticks == [[326, limit[1], -limit[2]]]


def test_the_filter_starts_at_neutral(rig):
    # 0 -> 40 degrees, half the way each period: 20, 30, 35 degrees
    _, ticks = outputs(rig, "(list 40 40 -40)", 3, limits=(-40.0, 40.0, 0.0), filter=0.5)
    assert ticks == [[228, 228, -228], [341, 341, -341], [398, 398, -398]]
    _, ticks = outputs(rig, "(list 40 40 40)", 2, limits=(-40.0, 40.0, 20.0), filter=0.5)
    assert ticks == [[341] * 3, [398] * 3]


def test_the_slew_limit_is_a_rate(rig):
    # 1 rad/s for 20 ms: 0.02 rad, 13.04 ticks, until 0.05 rad is reached
    _, ticks = outputs(rig, "(list 0.05 -0.05 0.01)", 4, unit="rad", limits=(-1.0, 1.0, 0.0), slew_rad_s=1.0)
    assert ticks == [[13, -13, 7], [26, -26, 7], [33, -33, 7], [33, -33, 7]]


def test_the_filter_runs_before_the_slew_limit(rig):
    # filter: half of 0.1 is 0.05, limited to 0.02; then half of 0.08, limited; … then half of 0.02
    _, ticks = outputs(rig, "(list 0.1 0 0)", 6, unit="rad", limits=(-1.0, 1.0, 0.0), slew_rad_s=1.0, filter=0.5)
    radians = [0.02, 0.04, 0.06, 0.08, 0.09, 0.095]
    assert [row[0] for row in ticks] == [round(r * 4096 / (2 * math.pi)) for r in radians]


@pytest.mark.parametrize(
    ("value", "count"),
    [
        (0.5, 0), (1.5, 2), (2.5, 2), (-0.5, 0), (-1.5, -2), (-2.5, -2), (0.50000006, 1), (-0.49999997, 0),
        (8388607.5, 8388608), (8388606.5, 8388606), (16777217.0, 16777216), (1e30, 2**30), (-math.inf, -(2**30)),
        (math.nan, 0), (1073741760.0, 1073741760), (0.0, 0), (1e-45, 0),
    ],
)  # fmt: skip
def test_encoding_rounds_half_to_even_and_saturates(value, count):
    assert encode(TerminalSpec("x", TerminalKind.RAW, "1", 0, 0, 1.0), value) == count
    assert encode(TerminalSpec("x", TerminalKind.RAW, "1", 0, 2048, -1.0), value) == 2048 - count


def test_encoding_inverts_decoding(rig):
    specs = [spec for spec in terminals_of(rig).values() if spec.kind == TerminalKind.RAW]
    for spec in specs:
        for count in range(-3000, 9000, 7):
            value = np.float32(count - spec.zero) * np.float32(spec.scale)
            assert encode(spec, float(value)) == count


def test_the_cycle_is_at_an_address(rig):
    cycle = pack_cycle(controller_for(rig, EVERY, filter=0.25), rig)
    seen = SvCycle.from_address(cycle.address)
    assert (seen.nraw, seen.filter, seen.program.contents.noutput) == (rig.nraw, 0.25, 3)
    assert seen.outputs[1].high == 50
