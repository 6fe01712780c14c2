"""Each product as a servo on a line, its factory registers in it: steps are answered in the closed form of its motor.

The formulas are those of the manuals, written anew here; the motor's numbers are its datasheet's.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from wheel_body import HINGE, wheel_body
from wire import LAMP, Wire

from controller.products import PRODUCTS
from controller.registers import registers

INERTIA = 2e-3
START_RAD = -2.3
WAY_RAD = 4.6
ID = 1
SPEED = {"feetech-sts": "goal_speed", "feetech-scs": "goal_speed", "dynamixel-ax": "moving_speed"}


class OnALine(Wire):
    """A wheel on a vertical axis, turned by one servo that is asked over its line."""

    def __init__(self, name, folder, *faults):
        product = PRODUCTS[name]
        body = wheel_body(folder, INERTIA)
        lines = registers(product)
        joint = replace(
            LAMP.joints[0], id=ID, mjcf_joint=HINGE, product=product, zero_tick=product.center_tick, sign=1, gains={}
        )
        joint = replace(joint, neutral_rad=START_RAD, low_rad=-2.4, high_rad=2.4, ceiling=product.duty_full)
        family = joint.family
        joint = replace(
            joint, gains={line: lines[line].initial for held in family.gains["position"].values() for line in held}
        )
        bus = replace(LAMP.bus, protocol=family.bus_protocol, baud=1_000_000, return_delay_us=0)
        rig = replace(LAMP, body=body, joints=(joint,), sensors=(), supply_v=product.voltage_v, bus=bus)
        super().__init__(*faults, rig=rig)
        self.product, self.family = product, family
        self.count = {name: line.initial for name, line in lines.items()}
        self.inertia = INERTIA + product.armature_kg_m2
        self.brake = product.stall_torque_nm / product.no_load_speed_rad_s + product.damping_nms_rad
        self.final = (product.stall_torque_nm - product.friction_loss_nm) / self.brake
        self.rad = 2.0 * math.pi / product.ticks_per_turn
        self.write(ID, "torque_enable", 1)

    def goal(self, angle):
        self.write(ID, "goal_position", self.product.center_tick + round(angle / self.rad))

    def path(self, seconds):
        """Return times since now and angles, as the servo tells them."""
        start, times, angles = self.rig.now, [], []
        while self.rig.now < start + seconds:
            line = self.line(ID, "present_position")
            self.send(ID, 2, self.place(line.address, line.size))
            times.append(self.rig.now - start)
            [(_, frame)] = self.hear(0.002)
            data = frame[9:-2] if self.new else frame[5:-1]
            count = int.from_bytes(data, line.byte_order)
            angles.append((count - self.product.center_tick) * self.rad)
        return np.array(times), np.array(angles)

    def duty(self, error):
        """Return the duty that the manuals' formulas give for an error, beyond friction."""
        ticks, count = abs(error) / self.rad, self.count
        if self.family.name.startswith("dynamixel-x"):
            duty = count["position_p_gain"] / 128 / 885 * ticks
        elif self.family.name == "dynamixel-ax":
            beyond = max(0.0, ticks - count["cw_compliance_margin"])
            punch = count["punch"] / 1023
            duty = (punch + (1 - punch) * beyond / count["cw_compliance_slope"]) if beyond else 0.0
        else:
            # an SCS counts as if each of its counts were four of an STS's, of which there are 4096 to the turn
            per_rad = 0.1649 if self.family.name == "feetech-sts" else 0.1649 * 4 * 1228.8 / 4096
            beyond = max(0.0, ticks - count["cw_dead_zone"]) * self.rad
            duty = count["p_coefficient"] * per_rad * beyond + count.get("minimum_startup_force", 0) / 1000
        return math.copysign(min(duty, 1.0), error)


@pytest.fixture(params=sorted(PRODUCTS))
def servo(request, tmp_path):
    return OnALine(request.param, tmp_path)


def test_a_far_goal_is_run_to_at_full_duty(servo):
    servo.goal(START_RAD + WAY_RAD)
    t, angle = servo.path(1.5 * WAY_RAD / servo.final)
    lag = servo.inertia / servo.brake
    expected = START_RAD + servo.final * (t + lag * np.expm1(-t / lag))
    # until it is so near that the law takes less than all
    free = expected < START_RAD + 0.6 * WAY_RAD
    assert free.sum() > 8
    assert np.abs(angle - expected)[free].max() < 0.02 * WAY_RAD


@pytest.mark.parametrize("share", [0.25, 0.6])
def test_the_torque_of_a_stalled_servo_is_its_gain_times_its_error(servo, share):
    servo.faults("stuck=1")
    errors = np.linspace(0.002, 0.6, 400)
    error = errors[int(np.argmax([servo.duty(error) >= share for error in errors]))]
    error = round(error / servo.rad) * servo.rad
    start = servo.read(ID, "present_position")
    servo.write(ID, "goal_position", start + round(error / servo.rad))
    servo.rig.advance(servo.rig.now + 0.3)
    error = (start + round(error / servo.rad) - servo.rig.shafts[0].ticks()) * servo.rad
    torque = servo.rig.shafts[0].torque()
    assert torque == pytest.approx(servo.duty(error) * servo.product.stall_torque_nm, rel=0.02)


def test_a_profile_has_the_speed_that_it_is_told(servo):
    name = SPEED.get(servo.family.name, "profile_velocity")
    per_count = servo.line(ID, name).scale
    count = round(0.35 * servo.product.no_load_speed_rad_s / per_count)
    servo.write(ID, name, count)
    servo.goal(START_RAD + WAY_RAD)
    t, angle = servo.path(WAY_RAD / (count * per_count))
    middle = (angle > START_RAD + 0.3 * WAY_RAD) & (angle < START_RAD + 0.8 * WAY_RAD)
    speed = np.polyfit(t[middle], angle[middle], 1)[0]
    assert speed == pytest.approx(count * per_count, rel=0.02)


def test_a_profile_takes_the_time_of_its_trapezoid(servo):
    name = {"feetech-sts": "acceleration"}.get(servo.family.name, "profile_acceleration")
    if name not in servo.count:
        pytest.skip(f"{servo.product.name} has no acceleration to set")
    speed_name = SPEED.get(servo.family.name, "profile_velocity")
    speed_unit, unit = servo.line(ID, speed_name).scale, servo.line(ID, name).scale
    speed = round(0.5 * servo.product.no_load_speed_rad_s / speed_unit)
    acceleration = round(2.0 * (speed * speed_unit) ** 2 / WAY_RAD / unit)
    if "position_d_gain" in servo.count:
        servo.write(ID, "position_d_gain", 0)  # an XL430's own brakes half its speed away
    servo.write(ID, speed_name, speed)
    servo.write(ID, name, acceleration)
    servo.goal(START_RAD + WAY_RAD)
    top, slope = speed * speed_unit, acceleration * unit
    t, angle = servo.path(1.2 * (WAY_RAD / top + top / slope))
    half = float(np.interp(START_RAD + 0.5 * WAY_RAD, angle, t))
    # the reference passes half the way in half the time of its trapezoid; the joint trails it by the error of the duty
    # that this speed takes
    duty = (top * servo.brake + servo.product.friction_loss_nm) / servo.product.stall_torque_nm
    errors = np.linspace(0.0, 0.6, 3000)
    behind = errors[int(np.argmax([servo.duty(error) >= duty for error in errors]))] / top
    assert half - behind == pytest.approx(0.5 * (WAY_RAD / top + top / slope), rel=0.02)
