"""Calibration arithmetic: what a hand does to a joint, computed independently, comes back as zero and limits."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller import load_rig
from controller.errors import InputError
from controller.products import PRODUCTS
from deploy.commissioning.calibration import (
    Travel,
    begin_travel,
    calibrate_joint,
    centred_offset,
    exported_motor,
    extend_travel,
    imported_travel,
    shifted,
)
from deploy.commissioning.lerobot import MotorCalibration

X330 = load_rig("lamp-xc330").joints[0]
STS = replace(X330, name="s", product=PRODUCTS["sts3215"])
AX = replace(X330, name="x", product=PRODUCTS["ax-12a"], zero_tick=512)


def travel_of(counts, ticks_per_turn=4096):
    travel = begin_travel(counts[0])
    for count in counts[1:]:
        travel = extend_travel(travel, count, ticks_per_turn)
    return travel


@given(st.lists(st.integers(-900, 900), max_size=30), st.integers(0, 4095))
def test_travel_is_what_the_shaft_did_whatever_the_encoder_showed(steps, start):
    shaft = [start]
    for step in steps:
        shaft.append(shaft[-1] + step)
    travel = travel_of([count % 4096 for count in shaft])
    assert travel == Travel(min(shaft), max(shaft), shaft[-1])


def test_zero_and_limits_of_a_joint_that_was_moved():
    # horn mounted 10 degrees off, stops at -40 and +50 degrees of the joint, turned by hand through both
    zero = 2048 + round(4096 * 10 / 360)
    ends = [zero + round(4096 * degrees / 360) for degrees in (-40, 50)]
    found = calibrate_joint(X330, at=zero, travel=travel_of([zero, *ends]), margin_rad=0.0)
    assert found["zero_tick"] == zero
    assert found["low_rad"] == pytest.approx(math.radians(-40), abs=2e-3)
    assert found["high_rad"] == pytest.approx(math.radians(50), abs=2e-3)
    tight = calibrate_joint(X330, at=zero, travel=travel_of([zero, *ends]), margin_rad=0.1)
    assert tight["low_rad"] == pytest.approx(found["low_rad"] + 0.1, abs=1e-9)
    assert tight["high_rad"] == pytest.approx(found["high_rad"] - 0.1, abs=1e-9)


def test_a_joint_that_counts_backwards_and_rests_off_zero():
    joint = replace(X330, sign=-1, neutral_rad=0.2)
    stands = 2000
    zero = stands + round(0.2 * 4096 / (2 * math.pi))  # angle falls as the count grows
    found = calibrate_joint(joint, at=stands, travel=Travel(1500, 2600, stands), margin_rad=0.0)
    assert found["zero_tick"] == zero
    assert found["low_rad"] == pytest.approx((zero - 2600) * 2 * math.pi / 4096, abs=2e-4)
    assert found["high_rad"] == pytest.approx((zero - 1500) * 2 * math.pi / 4096, abs=2e-4)
    assert calibrate_joint(joint, at=stands) == {"zero_tick": zero}


@given(st.integers(0, 4095), st.integers(120, 2047), st.integers(0, 4095))
def test_limits_lie_inside_what_was_recorded(low, span, zero):
    joint = replace(X330, zero_tick=zero)
    travel = Travel(low, low + span, low)
    try:
        found = calibrate_joint(joint, travel=travel, margin_rad=0.0)
    except InputError as error:
        assert low + span > 4095 or not low <= zero <= low + span, error
        return
    unit = 2 * math.pi / 4096
    assert low <= zero + found["low_rad"] / unit
    assert zero + found["high_rad"] / unit <= low + span


def test_a_wrap_inside_the_travel_is_refused_with_a_remedy():
    wrapped = travel_of([3900, 4090, 30, 400])
    for joint, remedy in (
        (X330, "mount its horn so that the middle of the travel, now 102, is near 2048"),
        (STS, "add --center"),
    ):
        with pytest.raises(InputError, match=f"goes from 3900 to 4496, across the encoder's wrap at 4095; {remedy}"):
            calibrate_joint(joint, at=4000, travel=wrapped)
    with pytest.raises(InputError, match="across the encoder's wrap"):
        calibrate_joint(X330, at=4000)  # the limits of the file, around that zero
    with pytest.raises(InputError, match="across the encoder's wrap at 1023; mount its horn"):
        calibrate_joint(AX, travel=travel_of([900, 1023, 0, 40], 1228.8))


def test_a_joint_that_was_not_moved_or_not_to_its_neutral_angle():
    with pytest.raises(InputError, match=r"joint a0: travelled 0.031 rad only; move it from stop to stop"):
        calibrate_joint(X330, travel=Travel(2048, 2068, 2048))
    with pytest.raises(InputError, match="leaves out neutral_rad 0; stand it there and add --neutral"):
        calibrate_joint(X330, travel=Travel(1000, 1900, 1000))
    found = calibrate_joint(X330, travel=Travel(1000, 1900, 1000), middle=True, margin_rad=0.0)
    assert found["zero_tick"] == 1450
    assert found["low_rad"] == -found["high_rad"] == pytest.approx(-450 * 2 * math.pi / 4096, abs=1e-4)
    with pytest.raises(InputError, match="may turn for ever"):
        calibrate_joint(replace(X330, unlimited=True), travel=Travel(0, 4000, 0))


def test_a_servo_is_centred_on_its_travel_so_that_the_wrap_is_outside():
    # an STS3215 reports (encoder - offset) mod 4096; its travel crosses the wrap
    encoder = range(3500, 4900, 50)
    for held in (0, 300, -1500):
        travel = travel_of([(count - held) % 4096 for count in encoder])
        offset = centred_offset(STS, travel, held)
        assert abs(offset) <= 2047
        reported = [(count - offset) % 4096 for count in encoder]
        after = shifted(STS, travel, held, offset)
        assert (after.low, after.high) == (min(reported), max(reported))
        assert after.low + after.high == pytest.approx(4096, abs=2)
        calibrate_joint(replace(STS, neutral_rad=0.0), travel=after, middle=True)


def test_half_a_turn_fits_no_register_and_is_held_one_count_short():
    travel = Travel(3596, 4596, 3596)  # its middle is the wrap: 2048 counts away from the middle
    offset = centred_offset(STS, travel, 0)
    assert offset == -2047
    assert shifted(STS, travel, 0, offset) == Travel(1547, 2547, 1547)


def test_who_can_not_be_centred():
    with pytest.raises(InputError, match="without homing offset; mount its horn"):
        centred_offset(X330, Travel(3900, 4500, 3900), 0)
    with pytest.raises(InputError, match="a whole turn or more"):
        centred_offset(STS, Travel(0, 4200, 0), 0)


def test_a_lerobot_range_is_shifted_by_what_the_servo_holds_now():
    motor = MotorCalibration(1, 0, -1365, 746, 3477)
    assert imported_travel(STS, motor, -1365) == Travel(746, 3477, 746)
    encoder = [motor.range_min + motor.homing_offset, motor.range_max + motor.homing_offset]
    for held in (0, 900, -2047):
        travel = imported_travel(STS, motor, held)
        assert [(count + held) % 4096 for count in (travel.low, travel.high)] == [count % 4096 for count in encoder]
        assert 0 <= travel.low + travel.high < 2 * 4096
    # a Dynamixel adds its offset
    assert imported_travel(X330, replace(motor, homing_offset=100), 0) == Travel(646, 3377, 646)


@pytest.mark.parametrize(
    ("joint", "change", "expected"),
    [
        (STS, {"homing_offset": -2048}, "homing_offset -2048 is more than the 2047 that its sts3215 holds; record"),
        (STS, {"range_max": 4368}, "range 746 to 4368 is outside 0 to 4095"),
        (AX, {"range_max": 1000}, "its ax-12a has none"),
        (X330, {"drive_mode": 1}, "drive_mode 1 turns its xc330-m181 around"),
    ],
)
def test_a_lerobot_calibration_that_the_servo_can_not_have(joint, change, expected):
    motor = replace(MotorCalibration(1, 0, -1365, 746, 3477), **change)
    with pytest.raises(InputError, match=expected):
        imported_travel(joint, motor, None if joint is AX else 0)


def test_an_export_comes_back_as_it_was():
    for joint, held in ((STS, {"homing_offset": -700}), (X330, {"homing_offset": 0, "drive_mode": 0}), (AX, {})):
        motor = exported_motor(joint, (300, 900), held)
        assert imported_travel(joint, motor, held.get("homing_offset")) == Travel(300, 900, 300)
    backwards = replace(STS, sign=-1)
    assert exported_motor(backwards, (300, 900), {}).drive_mode == 1
    assert exported_motor(replace(X330, sign=-1), (300, 900), {"drive_mode": 0}).drive_mode == 0
