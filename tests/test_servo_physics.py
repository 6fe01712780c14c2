"""The servo against its datasheet, in closed form: one servo on one hinge."""

from __future__ import annotations

import math

import mujoco
import pytest

from controller import PRODUCTS
from sim_models.servo import servo_parameters, set_servo, set_torque

HINGE = """
<mujoco>
  <option gravity="0 0 0" integrator="implicitfast" timestep="0.001"/>
  <worldbody><body><joint name="shaft" axis="0 1 0" armature="0.0005"/>
    <geom size="0.02" mass="0.02" contype="0" conaffinity="0"/></body></worldbody>
</mujoco>
"""
FAR = 100.0  # an error that asks for full PWM


def bench(product, p_gain=1450, d_gain=0, pwm_limit=885, voltage_v=5.0, torque_scale=1.0):
    spec = mujoco.MjSpec.from_string(HINGE)
    motor = spec.add_actuator(name="servo", target="shaft", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    motor.set_to_dcmotor([0, 0], 0, nominal=[5, 1, 10], saturation=[1, 0, 0], controller=[1, 0, 0, 0, 0, 5], ctrlspec=1)
    motor.group = 4
    model = spec.compile()
    set_servo(model, 0, servo_parameters(product, p_gain, d_gain, pwm_limit, voltage_v, torque_scale))
    return model, mujoco.MjData(model)


def torque(model, data, error_rad=0.0, speed=0.0):
    data.qpos[0], data.qvel[0], data.ctrl[0] = 0.0, speed, error_rad
    mujoco.mj_forward(model, data)
    return data.actuator_force[0]


@pytest.fixture(params=["xc330-m181", "xl330-m288"])
def product(request):
    return PRODUCTS[request.param]


def test_stall_torque_at_full_pwm_and_nominal_voltage(product):
    model, data = bench(product)
    assert torque(model, data, FAR) == pytest.approx(product.stall_torque_nm)
    assert torque(model, data, -FAR) == pytest.approx(-product.stall_torque_nm)


@pytest.mark.parametrize("voltage", [4.0, 5.0, 6.0])
def test_free_shaft_reaches_the_no_load_speed(product, voltage):
    model, data = bench(product, voltage_v=voltage)
    data.ctrl[0] = 1e4
    mujoco.mj_step(model, data, 2000)
    assert data.qvel[0] == pytest.approx(product.no_load_speed_rad_s * voltage / 5.0, rel=1e-6)


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 0.9, 1.0])
def test_torque_falls_in_a_line_with_speed(product, share):
    model, data = bench(product)
    expected = product.stall_torque_nm * (1.0 - share)
    assert torque(model, data, FAR, share * product.no_load_speed_rad_s) == pytest.approx(expected, abs=1e-12)


def test_torque_is_clipped_at_stall_when_driven_backwards(product):
    model, data = bench(product)
    assert torque(model, data, FAR, -0.5 * product.no_load_speed_rad_s) == pytest.approx(product.stall_torque_nm)


@pytest.mark.parametrize("p_gain", [400, 1200, 1450])
def test_p_gain_sets_the_error_of_full_pwm(product, p_gain):
    model, data = bench(product, p_gain=p_gain)
    ticks = 885 * 128 / p_gain  # duty = ticks * P / 128 / 885
    full = ticks * 2 * math.pi / 4096
    for share in (0.1, 0.5, 0.99):
        assert torque(model, data, share * full) == pytest.approx(share * product.stall_torque_nm)
    assert torque(model, data, 1.5 * full) == pytest.approx(product.stall_torque_nm)


def test_factory_gain_of_the_xc330_means_full_pwm_at_0_145_rad():
    product = PRODUCTS["xc330-m181"]
    model, data = bench(product, p_gain=1200)
    assert torque(model, data, 0.1440) < product.stall_torque_nm
    assert torque(model, data, 0.1449) == pytest.approx(product.stall_torque_nm)


def test_back_emf_acts_within_the_linear_range(product):
    model, data = bench(product)
    full, speed = 885 * 128 / 1450 * 2 * math.pi / 4096, 0.3 * product.no_load_speed_rad_s
    expected = product.stall_torque_nm * (0.5 - 0.3)
    assert torque(model, data, 0.5 * full, speed) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("limit", [221, 442, 885])
def test_pwm_limit_caps_torque_and_speed(product, limit):
    model, data = bench(product, pwm_limit=limit)
    assert torque(model, data, FAR) == pytest.approx(product.stall_torque_nm * limit / 885)
    data.ctrl[0] = 1e4
    mujoco.mj_step(model, data, 2000)
    assert data.qvel[0] == pytest.approx(product.no_load_speed_rad_s * limit / 885, rel=1e-6)


def test_no_pwm_leaves_a_shorted_motor(product):
    model, data = bench(product, pwm_limit=0)
    speed = 0.2 * product.no_load_speed_rad_s
    assert torque(model, data, FAR) == 0.0
    assert torque(model, data, FAR, speed) == pytest.approx(-0.2 * product.stall_torque_nm)


def test_d_gain_brakes_the_shaft(product):
    speed = 0.1 * product.no_load_speed_rad_s
    model, data = bench(product, d_gain=800)
    ticks_s = speed * 4096 / (2 * math.pi)
    duty = 800 / product.d_divisor / 885 * ticks_s
    assert duty < 0.5
    assert torque(model, data, 0.0, speed) == pytest.approx(-product.stall_torque_nm * (duty + 0.1))


def test_torque_scale_keeps_the_no_load_speed(product):
    model, data = bench(product, torque_scale=0.8)
    assert torque(model, data, FAR) == pytest.approx(0.8 * product.stall_torque_nm)
    full = 885 * 128 / 1450 * 2 * math.pi / 4096
    assert torque(model, data, 0.5 * full) == pytest.approx(0.4 * product.stall_torque_nm)
    assert torque(model, data, FAR, product.no_load_speed_rad_s) == pytest.approx(0.0, abs=1e-12)


def test_torque_off_leaves_the_shaft_alone(product):
    model, data = bench(product)
    set_torque(model, 0, False)
    assert torque(model, data, FAR) == 0.0
    data.qvel[0] = 3.0
    mujoco.mj_step(model, data, 100)
    assert data.qvel[0] == pytest.approx(3.0)
    set_torque(model, 0, True)
    assert torque(model, data, FAR) == pytest.approx(product.stall_torque_nm)
