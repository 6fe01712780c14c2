"""What the gains of each family mean, by the manuals' arithmetic, and the simulated motor by its datasheet."""

from __future__ import annotations

import dataclasses
import math

import mujoco
import pytest

from controller.products import PRODUCTS
from controller.rig_file import load_rig
from controller.servo_law import full_duty_error, joint_law, position_law, straight_law, velocity_law
from sim_models.servo import joint_parameters, law_parameters, servo_parameters, set_servo

STS, AX, XL = PRODUCTS["sts3215"], PRODUCTS["ax-12a"], PRODUCTS["xl430-w250"]
HINGE = """
<mujoco>
  <option gravity="0 0 0" integrator="implicitfast" timestep="0.001"/>
  <worldbody><body><joint name="shaft" axis="0 1 0" armature="0.01"/>
    <geom size="0.02" mass="0.02" contype="0" conaffinity="0"/></body></worldbody>
</mujoco>
"""


def test_an_x_servos_gains_are_the_manuals():
    law = position_law(XL, {"position_p_gain": 640, "position_d_gain": 4000, "pwm_limit": 885})
    per_tick = 2 * math.pi / 4096
    assert law.kp * 100 * per_tick == pytest.approx(100 * 640 / 128 / 885)
    # 50 ticks in a control tick of 1 ms
    assert law.kd * 50_000 * per_tick == pytest.approx(50 * 4000 / 16 / 885)
    # I / 65536 of the sum of errors over 200 control ticks of 30 ticks
    law = position_law(XL, {"position_i_gain": 1000})
    assert law.ki * 30 * per_tick * 0.2 == pytest.approx(1000 / 65536 * 200 * 30 / 885)
    assert (law.kp, law.duty_max) == (0.0, 1.0)


def test_a_velocity_gain_is_the_manuals():
    law = velocity_law(XL, {"velocity_p_gain": 100, "velocity_i_gain": 1000, "goal_pwm": 442})
    count = 0.229 * math.pi / 30
    assert law.kp * 40 * count == pytest.approx(40 * 100 / 128 / 885, rel=1e-3)
    assert law.ki * 40 * count * 0.05 == pytest.approx(1000 / 65536 * 50 * 40 / 885, rel=1e-3)
    assert law.duty_max == pytest.approx(442 / 885)


@pytest.mark.parametrize("name", ["ax-12a", "scs0009"])
def test_a_servo_without_velocity_mode_has_no_such_law(name):
    with pytest.raises(ValueError, match="no velocity mode"):
        velocity_law(PRODUCTS[name], {})


@pytest.mark.parametrize(("error_rad", "duty"), [(0.095, 0.1649 * 32 * 0.095), (0.05, 0.1608 * 32 * 0.05)])
def test_an_sts_pushes_as_was_measured(error_rad, duty):
    law = position_law(STS, {"p_coefficient": 32})
    assert law.kp * error_rad == pytest.approx(duty, rel=0.03)


# e-Manual: values 0 to 3 act as 2, 4 to 7 as 4, … 128 to 254 as 128
@pytest.mark.parametrize(
    ("slope", "acts"), [(0, 2), (3, 2), (4, 4), (31, 16), (32, 32), (127, 64), (128, 128), (254, 128)]
)
def test_an_ax_has_its_whole_torque_where_the_slope_ends(slope, acts):
    counts = {"cw_compliance_margin": 3, "ccw_compliance_margin": 3, "punch": 64, "torque_limit": 1023}
    law = position_law(AX, counts | {"cw_compliance_slope": slope, "ccw_compliance_slope": slope})
    count = math.radians(300 / 1024)
    assert law.dead_zone_rad == pytest.approx(3 * count)
    assert law.punch == pytest.approx(64 / 1023)
    assert law.punch + law.kp * acts * count == pytest.approx(1.0)
    assert full_duty_error(law) == pytest.approx((3 + acts) * count)


def test_the_smallest_limit_bounds_the_duty():
    assert position_law(AX, {"max_torque": 800, "torque_limit": 511}).duty_max == pytest.approx(511 / 1023)
    assert position_law(STS, {"max_torque": 300, "torque_limit": 1000}).duty_max == 0.3
    assert position_law(XL, {"pwm_limit": 885, "goal_pwm": -400}).duty_max == pytest.approx(400 / 885)


def test_a_straight_law_has_its_full_duty_where_the_servo_has():
    for product, counts in (
        (AX, {"cw_compliance_margin": 2, "punch": 100}),
        (STS, {"p_coefficient": 32, "cw_dead_zone": 4}),
    ):
        law = position_law(product, counts)
        straight = straight_law(law)
        assert (straight.dead_zone_rad, straight.punch) == (0.0, 0.0)
        assert full_duty_error(straight) == pytest.approx(full_duty_error(law))
        assert straight_law(straight) == straight


def shaft(product, parameters):
    spec = mujoco.MjSpec.from_string(HINGE)
    motor = spec.add_actuator(name="servo", target="shaft", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    motor.set_to_dcmotor([0, 0], 0, nominal=[5, 1, 10], saturation=[1, 0, 0], controller=[1, 0, 0, 0, 0, 5], ctrlspec=1)
    model = spec.compile()
    set_servo(model, 0, parameters)
    return model, mujoco.MjData(model)


@pytest.mark.parametrize("name", ["lamp-xl430", "lamp-sts3215", "lamp-ax12"])
@pytest.mark.parametrize("voltage", [0.9, 1.0])
def test_a_lamps_motor_is_the_datasheets(name, voltage):
    rig = load_rig(name)
    joint, volts = rig.joints[0], voltage * rig.supply_v
    product, law = joint.product, joint_law(joint)
    model, data = shaft(product, joint_parameters(joint, volts))
    stall = product.stall_torque_nm * volts / product.voltage_v
    fastest = product.no_load_speed_rad_s * volts / product.voltage_v
    for share, expected in ((0.5, 0.5 * stall), (0.99, 0.99 * stall), (1.5, stall), (-3.0, -stall)):
        data.qpos[0], data.qvel[0], data.ctrl[0] = 0.0, 0.0, share * full_duty_error(law)
        mujoco.mj_forward(model, data)
        assert data.actuator_force[0] == pytest.approx(expected)
    data.qvel[0] = 0.4 * fastest
    data.ctrl[0] = 5.0
    mujoco.mj_forward(model, data)
    assert data.actuator_force[0] == pytest.approx(0.6 * stall)
    data.ctrl[0] = 1e4
    mujoco.mj_step(model, data, 3000)
    assert data.qvel[0] == pytest.approx(fastest, rel=1e-3)


def test_a_law_makes_the_motor_that_the_registers_make():
    """Both ways to an X servo's motor meet, but for the last bits."""
    one = servo_parameters(XL, 900, 200, 700, 10.0, 0.9)
    counts = {"position_p_gain": 900, "position_d_gain": 200, "pwm_limit": 700}
    other = law_parameters(XL, position_law(XL, counts), 10.0, 0.9)
    assert dataclasses.astuple(other) == pytest.approx(dataclasses.astuple(one))
