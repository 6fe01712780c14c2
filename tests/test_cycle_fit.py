"""What fits a rig and its counts, and what neither cycle takes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from lamp_cycles import EVERY, controller_for

from controller.controller import Input
from controller.cycle import resolve_cycle
from controller.errors import InputError
from controller.native import NativeCycle, pack_cycle, run_cycle
from controller.reference import ReferenceCycle
from controller.rig_file import load_rig
from controller.terminals import TerminalKind, TerminalSpec, terminals_of


@pytest.fixture(scope="module")
def rig():
    return load_rig("lamp-xc330")


def test_a_rig_without_a_pose(rig):
    blind = replace(rig, sensors=tuple(s for s in rig.sensors if s.name == "force"))
    assert set(terminals_of(rig)) - set(terminals_of(blind)) == {"px", "py", "pz", "goal_met", "heading_error"}
    told = run_cycle(controller_for(blind, "(list a0 s0 t)"), blind, np.zeros((2, blind.nraw), np.int32), (0.3, 0.0))
    assert told[1].shape == (2, 3)
    with pytest.raises(
        InputError, match=r"input \d+ \(pz\): rig 'lamp-xc330' can not supply 'pz'; .*use one of t goal_dist"
    ):
        pack_cycle(controller_for(rig, EVERY), blind)


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"period_s": 0.01}, "period_s 0.01 is not the 0.02 of rig"),
        ({"outputs": "reversed"}, "its outputs are a2 a1 a0, but the joints of rig 'lamp-xc330' are a0 a1 a2"),
        ({"outputs": "fewer"}, "its outputs are a0 a1, but the joints"),
        ({"outputs": "velocity"}, "output 'a0' commands a velocity"),
        ({"inputs": (Input("a0", "deg", -1, 1),)}, r"input 1 \(a0\): unit 'deg' is not the rig's"),
        ({"inputs": (Input("a7", "rad", -1, 1),)}, r"input 1 \(a7\): .* can not supply 'a7'; did you mean 'a"),
        ({"inputs": (Input("vx", "m/s", -1, 1),)}, r"input 1 \(vx\): .* can not supply 'vx'"),
    ],
)
def test_what_does_not_fit_the_rig_is_refused(rig, change, what):
    controller = controller_for(rig, "(list 1 2 3)", names=[])
    listed = {
        "reversed": controller.outputs[::-1],
        "fewer": controller.outputs[:2],
        "velocity": tuple(replace(output, kind="velocity", unit="deg/s") for output in controller.outputs),
    }
    change = {key: listed.get(value, value) if isinstance(value, str) else value for key, value in change.items()}
    for build in (pack_cycle, ReferenceCycle):
        with pytest.raises(InputError, match=what) as error:
            build(replace(controller, **change), rig)
        assert str(error.value).startswith("test: ") and "; " in str(error.value)


@pytest.mark.parametrize(
    "change",
    [
        {"filter": 0.0},
        {"filter": 1.5},
        {"filter": math.nan},
        {"slew_step": -1.0},
        {"slew_step": math.inf},
        {"period_s": 0.0},
        {"period_s": math.inf},
        {"nraw": 129},
        {"nraw": -1},
        {"terminals": {"channel": 16}},
        {"terminals": {"channel": -1}},
        {"terminals": {"scale": 0.0}},
        {"terminals": {"scale": math.nan}},
        {"terminals": {"zero": 2**31 - 1}},
        {"terminals": {"zero": -(2**30)}},
        {"x": {"channel": 16}},
        {"heading": {"kind": TerminalKind.TIME}},
        {"outputs": {"low": 51.0}},
        {"outputs": {"neutral": math.nan}},
        {"outputs": {"high": math.inf}},
        {"outputs": {"count_scale": math.inf}},
        {"outputs": {"count_low": 5000}},
        {"outputs": {"angle_low": 1.0}},
        {"outputs": {"angle": TerminalSpec("a0", TerminalKind.RAW, "rad", 16)}},
        {"facing": {"channel": 16}},
    ],
    ids=str,
)
def test_no_inconsistent_cycle_runs(rig, change):
    spec = resolve_cycle(controller_for(rig, "(list a0 a0 a0)", names=["a0"]), rig)
    assert rig.nraw == 16
    NativeCycle(spec)
    for key, value in change.items():
        new = value
        if isinstance(value, dict):
            old = getattr(spec, key)
            new = (replace(old[0], **value), *old[1:]) if isinstance(old, tuple) else replace(old, **value)
        with pytest.raises(InputError, match="not usable"):
            NativeCycle(replace(spec, **{key: new}))


def test_raw_of_another_size_is_refused(rig):
    with pytest.raises(InputError, match="give the rig's 16 channels"):
        pack_cycle(controller_for(rig, EVERY), rig).step(0.3, 0.0, np.zeros(15, np.int32))


@pytest.mark.parametrize("zero", [2**30, -(2**30), 2**31 - 1])
@pytest.mark.parametrize("cycle", [pack_cycle, ReferenceCycle])
def test_a_zero_that_counts_can_not_be_taken_from_is_refused(rig, cycle, zero):
    sensors = tuple(replace(sensor, zero=zero) for sensor in rig.sensors)
    with pytest.raises(InputError, match=r"zero .* is not within 2\^30"):
        cycle(controller_for(rig, EVERY), replace(rig, sensors=sensors))


def test_the_largest_zeros_and_counts_stay_in_32_bits(rig):
    sensors = tuple(replace(sensor, zero=1 - 2**30) for sensor in rig.sensors)
    far = replace(rig, sensors=sensors)
    raw = np.full(rig.nraw, 2**31 - 1, np.int32)
    both = [cycle(controller_for(rig, EVERY), far).step(0.3, 0.0, raw)[0] for cycle in (pack_cycle, ReferenceCycle)]
    assert both[0].tobytes() == both[1].tobytes()
    z = next(sensor for sensor in rig.sensors if sensor.name == "z")
    assert both[0][list(terminals_of(rig)).index("pz")] == np.float32(2**31 - 1) * np.float32(z.scale)


def test_limits_as_wide_as_they_go_never_stick(rig):
    text = "(list (* 3e38 (sin (* 100 t))) (* 3e38 (sin (* 70 t))) 0)"
    controller = controller_for(rig, text, limits=(-1e6, 1e6, 0.0), unit="rad", filter=0.5, slew_rad_s=0.0)
    _, _, counts = run_cycle(controller, rig, np.zeros((200, rig.nraw), np.int32), (0.3, 0.0))
    assert len(np.unique(counts[-50:, 0])) > 1
