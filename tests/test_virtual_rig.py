"""The virtual rig: repeatable to the byte, its registers act on the body, its sensors tell the truth."""

import math

import numpy as np
import pytest
from standing_lamp import LINES, PERIOD_S, READ_BLOCK, RIG, goals, lines_of, read, standing, write

from controller.errors import InputError
from controller.rig_file import parse_rig
from deploy.virtual import dynamixel2 as dxl
from deploy.virtual.faults import parse_fault
from deploy.virtual.profile import Profile
from deploy.virtual.rig import VirtualRig
from deploy.virtual.twin import Twin


def run(seed=0, periods=50, rng_seed=3, **settings):
    """Return every byte that a master hears, with times, and the body's path, while it sends random goals."""
    rng = np.random.default_rng(rng_seed)
    rig = standing(seed=seed, **settings)
    heard, path = [], []
    start = rig.now
    for k in range(periods):
        t = start + k * PERIOD_S
        rig.advance(t)
        rig.transmit(READ_BLOCK, t)
        heard += rig.replies_until(t + 0.004)
        goals(rig, [int(goal) for goal in 2048 + rng.integers(-250, 250, 3)])
        heard.append((t, rig.sensor_until(t + 0.01)))
        path.append(np.concatenate([rig.truth().base_pos, rig.truth().joint_rad]))
    return heard, np.array(path)


FAULTS = [parse_fault(spec) for spec in ("drop=0.1", "corrupt=0.1", "sensor-drop=0.1", "sensor-corrupt=0.1")]


def test_the_same_bytes_in_give_the_same_bytes_out_and_the_same_motion():
    noisy = Twin(force_noise_n=0.1, position_noise_m=0.001, angle_noise_rad=0.01, torque_scale=0.9)
    heard, path = run(faults=FAULTS, twin=noisy)
    again, path_again = run(faults=FAULTS, twin=noisy)
    assert heard == again
    assert np.array_equal(path, path_again)
    other, path_other = run(seed=1, faults=FAULTS, twin=noisy)
    assert heard != other, "another seed is another noise"
    assert np.array_equal(path, path_other), "noise and lost answers do not move the body"


def test_when_it_is_asked_changes_nothing():
    quiet, watched = standing(), standing()
    goals(quiet, [2200, 1900, 2100])
    goals(watched, [2200, 1900, 2100])
    end = quiet.now + 0.5
    quiet.advance(end)
    while watched.now < end - 0.003:
        watched.transmit(READ_BLOCK, watched.now)
        watched.advance(watched.now + 0.0017)
        watched.replies_until(watched.now)
        watched.truth()
    watched.advance(end)
    assert np.array_equal(quiet.truth().joint_rad, watched.truth().joint_rad)
    assert np.array_equal(quiet.truth().base_pos, watched.truth().base_pos)


def test_a_rig_stands_until_it_is_switched_on_then_by_itself_then_falls():
    rig = VirtualRig(RIG)
    rig.advance(5.0)
    assert np.abs(rig.truth().joint_rad).max() < 0.03
    assert read(rig, "torque_enable") == [0, 0, 0]
    write(rig, "torque_enable", [1, 1, 1])
    rig.advance(6.0)
    assert np.abs(rig.truth().joint_rad).max() < 0.1
    write(rig, "torque_enable", [0, 0, 0])
    rig.advance(8.0)
    assert np.abs(rig.truth().joint_rad).max() > 0.5


def test_a_limp_start_is_not_held():
    rig = VirtualRig(RIG, start="limp")
    rig.advance(2.0)
    assert np.abs(rig.truth().joint_rad).max() > 0.5


@pytest.mark.parametrize("p_gain", [500, 1450, 4000])
def test_pwm_at_rest_is_gain_times_error(p_gain):
    rig = standing()
    write(rig, "position_p_gain", [p_gain] * 3)
    goals(rig, [2148, 1998, 2078])
    rig.advance(rig.now + 2.0)
    assert read(rig, "moving") == [0, 0, 0]
    per_tick = p_gain / RIG.joints[0].product.p_divisor
    for pwm, goal, position in zip(
        read(rig, "present_pwm"), read(rig, "goal_position"), read(rig, "present_position"), strict=True
    ):
        # present position is rounded to a tick, PWM to a count
        assert pwm == pytest.approx((goal - position) * per_tick, abs=0.5 * per_tick + 1.0)
    errors = np.abs(np.subtract(read(rig, "goal_position"), read(rig, "present_position")))
    assert errors.max() * per_tick <= 885


def fastest(pwm_limit, register):
    """Return the largest speed of the head's joint on a long way, with a PWM limit."""
    rig = standing()
    if register == "pwm_limit":
        write(rig, "torque_enable", [0, 0, 0])
    limits = [885, 885, pwm_limit]
    write(rig, register, limits)
    write(rig, "torque_enable", [1, 1, 1])
    goals(rig, [2048, 2048, 2048 + 600])
    speed = 0.0
    for _ in range(300):
        rig.advance(rig.now + 0.001)
        speed = max(speed, abs(float(rig.truth().joint_vel[2])))
    return speed


def test_the_pwm_limit_bounds_the_speed():
    free_rad_s = RIG.joints[2].product.no_load_speed_rad_s
    full, half, by_goal = fastest(885, "goal_pwm"), fastest(440, "pwm_limit"), fastest(440, "goal_pwm")
    assert 0.6 * free_rad_s < full < 1.05 * free_rad_s
    assert 0.3 * free_rad_s < half < 0.55 * free_rad_s
    assert by_goal == pytest.approx(half, rel=0.1), "goal PWM limits as the PWM limit does"


def test_the_d_gain_brakes():
    peaks = []
    for d_gain in (0, 4000):
        rig = standing()
        write(rig, "position_d_gain", [d_gain] * 3)
        goals(rig, [2048, 2048, 2048 + 200])
        speeds = []
        for _ in range(200):
            rig.advance(rig.now + 0.001)
            speeds.append(abs(float(rig.truth().joint_vel[2])))
        peaks.append(max(speeds))
    assert peaks[1] < 0.8 * peaks[0]


def test_a_profile_moves_the_goal_at_its_velocity():
    rig = standing()
    velocity = 30  # 0.72 rad/s
    write(rig, "profile_velocity", [velocity] * 3)
    start = read(rig, "present_position")[2]
    goals(rig, [2048, 2048, 2448])
    rig.advance(rig.now + 0.5)
    assert read(rig, "moving")[2] == 1
    wanted = velocity * LINES["profile_velocity"].scale
    assert abs(float(rig.truth().joint_vel[2])) == pytest.approx(wanted, rel=0.15)
    assert read(rig, "moving_status")[2] == 0b010010
    rig.advance(rig.now + 1.5)
    assert read(rig, "moving")[2] == 0
    assert abs(read(rig, "present_position")[2] - 2448) < 20 < abs(start - 2448)


@pytest.mark.parametrize(("velocity", "acceleration"), [(1000.0, 0.0), (1000.0, 3000.0), (5000.0, 3000.0)])
def test_a_profile_takes_the_time_of_its_trapezoid(velocity, acceleration):
    way, dt = 700.0, 1e-3
    profile, steps, fastest_step, furthest = Profile(), 0, 0.0, 0.0
    while profile.step(way, velocity, acceleration, dt):
        steps += 1
        fastest_step = max(fastest_step, profile.velocity)
        furthest = max(furthest, profile.position)
    if acceleration:
        top = min(velocity, math.sqrt(acceleration * way))
        expected = way / top + top / acceleration
    else:
        top, expected = velocity, way / velocity
    assert steps * dt == pytest.approx(expected, rel=0.02)
    assert fastest_step <= top * 1.001
    assert furthest <= way + 1e-2
    assert (profile.position, profile.velocity) == (way, 0.0)


def test_registers_tell_what_the_joints_do():
    rig = standing()
    goals(rig, [2100, 1990, 2120])
    for _ in range(20):
        rig.advance(rig.now + 0.007)
        truth = rig.truth()
        rig.transmit(READ_BLOCK, rig.now)
        # the question takes 0.17 ms: the body has not moved on, or by one step
        after = rig.truth()
        rig.advance(rig.now + 0.002)
        answers = dxl.PacketParser().feed(b"".join(frame for _, frame in rig.replies_until(rig.now)))
        for joint, answer, state in zip(RIG.joints, answers, zip(*joints_of(truth, after), strict=True), strict=True):
            velocity = int.from_bytes(answer.parameters[3:7], "little", signed=True)
            position = int.from_bytes(answer.parameters[7:11], "little", signed=True)
            seen = joint.sign * (position - joint.zero_tick) * 2.0 * math.pi / 4096
            assert min(state[0:2]) - 0.001 <= seen <= max(state[0:2]) + 0.001
            seen = joint.sign * velocity * joint.product.velocity_unit_rad_s
            assert min(state[2:4]) - 0.013 <= seen <= max(state[2:4]) + 0.013


def joints_of(*truths):
    return (*(truth.joint_rad for truth in truths), *(truth.joint_vel for truth in truths))


def test_sensor_lines_are_samples_of_the_body_that_arrive_late():
    rig = VirtualRig(RIG)
    latency_s = RIG.sensors[0].latency_s
    interval_s = 1.0 / RIG.sensors[0].rate_hz
    seen = lines_of(rig.sensor_until(latency_s - 1e-6))
    assert seen == []
    for count in range(1, 40):
        sampled = (count - 1) * interval_s
        lines = {letter: (seq, t_us, raw) for letter, seq, t_us, raw in lines_of(rig.sensor_until(sampled + latency_s))}
        assert lines["P"][:2] == (count - 1, round(sampled * 1e6))
        truth = rig.truth()
        for sensor in RIG.sensors:
            value = (lines[sensor.message][2][sensor.field] - sensor.zero) * sensor.scale
            if sensor.name in "xyz":
                assert value == pytest.approx(truth.base_pos["xyz".index(sensor.name)], abs=0.5 * sensor.scale + 1e-5)
            elif sensor.name == "force":
                assert value == pytest.approx(0.229 * 9.81, abs=0.02), "a lamp at rest weighs what its parts weigh"
            else:
                angle = truth.base_rpy[("roll", "pitch", "heading").index(sensor.name)]
                assert value == pytest.approx(angle, abs=0.5 * sensor.scale + 1e-5)


def test_a_sensor_that_the_virtual_rig_lacks_is_refused():
    other = parse_rig(RIG.text.replace('name = "pitch"', 'name = "range"'), RIG.path)
    with pytest.raises(InputError, match="sensor range: the virtual rig can not measure it"):
        VirtualRig(other)


def test_noise_is_what_the_twin_says():
    rig = VirtualRig(RIG, twin=Twin(force_noise_n=0.2, position_noise_m=0.003))
    quiet = lines_of(VirtualRig(RIG).sensor_until(5.0))
    force = [raw[0] * 1e-3 for letter, _, _, raw in lines_of(rig.sensor_until(5.0)) if letter == "F"]
    steady = [raw[0] * 1e-3 for letter, _, _, raw in quiet if letter == "F"]
    assert np.std(force) == pytest.approx(0.2, rel=0.15)
    assert np.mean(force) == pytest.approx(np.mean(steady), abs=0.05)
    assert np.std(steady) < 0.01
