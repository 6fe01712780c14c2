"""Each product's motor on a bench: steps are answered in the closed form of stall torque, no-load speed and gains."""

from dataclasses import replace

import numpy as np
import pytest
from wheel_body import HINGE, wheel_body

from controller.products import PRODUCTS
from controller.rig_file import load_rig
from deploy.virtual.drive import Drive, Law
from deploy.virtual.plant import Plant
from deploy.virtual.twin import Twin

INERTIA = 2e-3
STEP_S = 1e-3


class Bench:
    """Turn a wheel about a vertical axis with one product's motor, and reckon what it should do."""

    def __init__(self, product, folder, twin=None, **changes):
        body = wheel_body(folder, INERTIA)
        lamp = load_rig("lamp-xc330")
        self.product = replace(PRODUCTS[product], **changes)
        joint = replace(
            lamp.joints[0], mjcf_joint=HINGE, product=self.product, zero_tick=self.product.center_tick, neutral_rad=0.0
        )
        self.rig = replace(lamp, body=body, joints=(joint,), sensors=(), supply_v=self.product.voltage_v)
        self.plant = Plant(self.rig, twin or Twin(), "limp")
        self.shaft = self.plant.shafts[0]
        self.inertia = INERTIA + self.product.armature_kg_m2
        self.stall = self.product.stall_torque_nm
        # torque lost per speed: back-EMF and viscous friction
        self.brake = self.stall / self.product.no_load_speed_rad_s + self.product.damping_nms_rad
        self.friction = self.product.friction_loss_nm
        self.tick = 2.0 * np.pi / self.product.ticks_per_turn

    def run(self, seconds):
        """Return angle and speed after each step."""
        path = []
        for _ in range(round(seconds / STEP_S)):
            self.plant.step(1)
            path.append((self.angle(), self.shaft.speed()))
        return np.array(path).T

    def angle(self):
        return (self.shaft.ticks() - self.product.center_tick) * self.tick

    def aim(self, drive, value):
        self.shaft.drive(drive)
        self.shaft.aim(self.product.center_tick + value / self.tick if drive.mode == "position" else value)


@pytest.fixture(params=sorted(PRODUCTS))
def bench(request, tmp_path):
    return Bench(request.param, tmp_path)


def test_the_bench_is_at_rest(bench):
    angle, speed = bench.run(0.2)
    assert np.abs(angle).max() < 1e-6
    assert np.abs(speed).max() < 1e-6


@pytest.mark.parametrize("duty", [1.0, -0.5])
def test_a_voltage_step_runs_up_as_a_motor_does(bench, duty):
    lag = bench.inertia / bench.brake
    final = np.sign(duty) * (abs(duty) * bench.stall - bench.friction) / bench.brake
    bench.aim(Drive(on=True, mode="voltage", law=Law()), duty)
    _, speed = bench.run(8 * lag)
    t = STEP_S * np.arange(1, len(speed) + 1)
    expected = final * -np.expm1(-t / lag)
    assert np.abs(speed - expected).max() < 0.02 * abs(final)
    assert speed[-1] == pytest.approx(final, rel=0.005)
    # without friction it would be the datasheet's no-load speed, in proportion to the duty
    frictionless = speed[-1] * bench.brake * bench.product.no_load_speed_rad_s / bench.stall
    lost = np.sign(duty) * bench.friction * bench.product.no_load_speed_rad_s / bench.stall
    assert frictionless + lost == pytest.approx(duty * bench.product.no_load_speed_rad_s, rel=0.005)
    assert bench.shaft.duty() == pytest.approx(duty, abs=0.005)


def test_a_stalled_motor_has_the_torque_and_current_of_its_duty(bench):
    bench.plant.jam(0, True)
    for duty in (1.0, 0.3, -0.3):
        bench.aim(Drive(on=True, mode="voltage", law=Law()), duty)
        bench.run(0.2)
        assert bench.shaft.torque() == pytest.approx(duty * bench.stall, rel=0.02)
        assert bench.shaft.current() == pytest.approx(duty * bench.product.stall_current_a, rel=0.02)
    for law, torque_max, expected in (
        (Law(duty_max=0.6), 1.0, 0.6),
        (Law(torque_share_max=0.25), 1.0, 0.25),
        (Law(), 0.4, 0.4),
        (Law(duty_max=0.0), 1.0, 0.0),
    ):
        bench.aim(Drive(on=True, mode="voltage", law=law, torque_max=torque_max), 1.0)
        bench.run(0.2)
        assert bench.shaft.torque() == pytest.approx(expected * bench.stall, rel=0.02, abs=1e-3)


def response(bench, kp, kd, goal, count):
    """Return the angle of a motor with P and D gain, from rest, while it turns towards the goal."""
    system = np.array([[0.0, 1.0], [-bench.stall * kp, -bench.brake - bench.stall * kd]])
    system[1] /= bench.inertia
    rest = np.array([goal - bench.friction / (bench.stall * kp), 0.0])
    values, vectors = np.linalg.eig(system)
    start = np.linalg.solve(vectors, -rest.astype(complex))
    t = STEP_S * np.arange(1, count + 1)
    return (rest[:, None] + vectors @ (start[:, None] * np.exp(np.outer(values, t)))).real


@pytest.mark.parametrize("damped", [0.0, 0.03])
def test_a_step_of_the_goal_is_answered_as_the_gains_say(bench, damped):
    kp, goal = 4.0, 0.2  # duty at most 0.8: nothing is at its limit
    bench.aim(Drive(on=True, mode="position", law=Law(kp=kp, kd=damped)), goal)
    angle, _ = bench.run(1.0)
    expected, rate = response(bench, kp, damped, goal, len(angle))
    turning = len(rate) if np.all(rate > 1e-3) else int(np.argmax(rate <= 1e-3))
    assert turning > 30
    assert np.abs(angle - expected)[:turning].max() < 0.02 * goal
    assert angle[-1] == pytest.approx(goal, abs=bench.friction / (bench.stall * kp) + 1e-3)


def test_a_goal_far_away_is_approached_at_full_duty(bench):
    bench.aim(Drive(on=True, mode="position", law=Law(kp=8.0, duty_max=0.5)), 50.0)
    lag = bench.inertia / bench.brake
    _, speed = bench.run(8 * lag)
    assert speed[-1] == pytest.approx((0.5 * bench.stall - bench.friction) / bench.brake, rel=0.02)


def test_the_angle_of_a_loaded_position_servo_is_load_over_gain(bench):
    kp = 5.0
    bench.aim(Drive(on=True, mode="position", law=Law(kp=kp)), 0.0)
    bench.plant.jam(0, True)
    bench.aim(Drive(on=True, mode="position", law=Law(kp=kp)), 0.1)
    bench.run(0.1)
    assert bench.shaft.torque() == pytest.approx(kp * 0.1 * bench.stall, rel=0.02)


def test_velocity_mode_turns_as_its_gain_says_and_its_integral_takes_the_rest(bench):
    goal, kp = 0.5 * bench.product.no_load_speed_rad_s, 4.0 / bench.product.no_load_speed_rad_s
    lag = bench.inertia / (bench.brake + kp * bench.stall)
    bench.aim(Drive(on=True, mode="velocity", law=Law(kp=kp)), goal)
    final = (kp * goal * bench.stall - bench.friction) / (bench.brake + kp * bench.stall)
    # the duty never reaches its limit but at the very beginning of a high gain
    _, speed = bench.run(12 * lag)
    assert speed[-1] == pytest.approx(final, rel=0.02)
    bench.aim(Drive(on=True, mode="velocity", law=Law(kp=kp, ki=20.0 * kp)), goal)
    _, speed = bench.run(1.5)
    assert speed[-1] == pytest.approx(goal, rel=0.005)


def test_the_integral_takes_what_friction_leaves_of_an_error(bench):
    kp, goal = 2.0, 0.05
    bench.aim(Drive(on=True, mode="position", law=Law(kp=kp, kd=0.05)), goal)
    bench.run(1.0)
    before = abs(goal - bench.angle())
    bench.aim(Drive(on=True, mode="position", law=Law(kp=kp, ki=20.0, kd=0.05)), goal)
    bench.run(4.0)
    assert before > 5 * abs(goal - bench.angle())


def test_an_integral_does_not_wind_up_while_the_duty_is_at_its_limit(bench):
    bench.plant.jam(0, True)
    law = Law(kp=5.0, ki=10.0, duty_max=0.5)
    bench.aim(Drive(on=True, mode="position", law=law), 0.2)
    bench.run(3.0)
    assert bench.shaft.torque() == pytest.approx(0.5 * bench.stall, rel=0.02)
    bench.shaft.aim(bench.product.center_tick - 0.02 / bench.tick)
    bench.run(0.4)
    assert bench.shaft.torque() < 0.4 * bench.stall, "it lets go at once"


def test_no_duty_within_the_dead_zone_and_a_punch_at_its_edge(bench):
    bench.plant.jam(0, True)
    law = Law(kp=3.0, dead_zone_rad=0.05, punch=0.04)
    for error, duty in ((0.04, 0.0), (-0.04, 0.0), (0.15, 3.0 * 0.1 + 0.04), (-0.15, -3.0 * 0.1 - 0.04)):
        bench.aim(Drive(on=True, mode="position", law=law), error)
        bench.run(0.1)
        assert bench.shaft.torque() == pytest.approx(duty * bench.stall, rel=0.02, abs=1e-4)


@pytest.mark.parametrize("product", sorted(PRODUCTS))
@pytest.mark.parametrize(("scale", "duties"), [(1.0, (0.4, 0.8, 1.0)), (2.0, (0.8, 1.0)), (0.0, (1.0, 1.0))])
def test_a_voltage_rises_as_fast_as_the_servo_and_its_twin_say(product, scale, duties, tmp_path):
    bench = Bench(product, tmp_path, Twin(voltage_slope_scale=scale))
    bench.plant.jam(0, True)
    slope = 4.0 * bench.product.voltage_v
    bench.aim(Drive(on=True, mode="voltage", law=Law(), slope_v_s=slope), 1.0)
    for duty in duties:
        bench.run(0.1)
        assert bench.shaft.torque() == pytest.approx(duty * bench.stall, rel=0.02)


def test_feedforward_adds_a_duty_in_every_mode(bench):
    bench.plant.jam(0, True)
    for mode in ("position", "velocity", "voltage"):
        for law in (Law(kp=1.0), Law(kp=1.0, ki=1e-9)):
            bench.aim(Drive(on=True, mode=mode, law=law), 0.0)
            bench.shaft.feedforward(0.25)
            bench.run(0.05)
            assert bench.shaft.torque() == pytest.approx(0.25 * bench.stall, rel=0.02)
            bench.shaft.feedforward(0.0)


def test_off_runs_out_and_a_brake_stops_sooner(bench):
    bench.aim(Drive(on=True, mode="voltage", law=Law()), 1.0)
    _, speed = bench.run(6 * bench.inertia / bench.brake)
    bench.shaft.drive(Drive(on=False, mode="voltage", law=Law(), brake=True))
    _, braked = bench.run(0.02)
    lag = bench.inertia / bench.brake
    rest = bench.friction / bench.brake
    expected = (speed[-1] + rest) * np.exp(-0.02 / lag) - rest
    assert braked[-1] == pytest.approx(expected, abs=0.02 * speed[-1])
    assert bench.shaft.torque() < 0.0
    bench.shaft.drive(Drive(on=False, mode="voltage", law=Law()))
    before = bench.shaft.speed()
    bench.run(0.01)
    assert bench.shaft.torque() == 0.0
    viscous = (bench.friction + bench.product.damping_nms_rad * before) / bench.inertia
    assert bench.shaft.speed() == pytest.approx(max(before - 0.01 * viscous, 0.0), abs=0.02 * speed[-1])


def test_modes_change_while_it_turns(bench):
    bench.aim(Drive(on=True, mode="voltage", law=Law()), 0.5)
    bench.run(0.3)
    bench.aim(Drive(on=True, mode="velocity", law=Law(kp=1.0, ki=5.0)), -1.0)
    bench.run(1.5)
    assert bench.shaft.speed() == pytest.approx(-1.0, rel=0.02)
    here = bench.angle()
    bench.aim(Drive(on=True, mode="position", law=Law(kp=8.0, ki=8.0, kd=0.2)), here + 0.3)
    bench.run(3.0)
    assert bench.angle() == pytest.approx(here + 0.3, abs=0.01)


@pytest.mark.parametrize("product", sorted(PRODUCTS))
def test_stiction_holds_what_friction_in_motion_would_not(product, tmp_path):
    turned = []
    for scale in (1.0, 4.0):
        bench = Bench(product, tmp_path, Twin(stiction_scale=scale))
        bench.aim(Drive(on=True, mode="voltage", law=Law()), 2.0 * bench.friction / bench.stall)
        angle, _ = bench.run(0.5)
        turned.append(angle[-1])
    assert turned[0] > 0.02
    # friction creeps a little in MuJoCo
    assert abs(turned[1]) < 0.2 * turned[0]
