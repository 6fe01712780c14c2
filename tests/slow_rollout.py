"""A rollout by the book: one step of MuJoCo at a time, the reference cycle, and every statistic judged afterwards."""

from __future__ import annotations

import dataclasses
import math

import mujoco
import numpy as np

from controller import parse_controller
from controller.native import encode
from controller.reference import ReferenceCycle
from controller.registers import registers
from controller.terminals import TerminalKind, TerminalSpec, terminals_of
from sim_models.body import (
    base_force,
    base_pose,
    base_rotation,
    body_layout,
    build_model,
    clearance,
    settled_data,
    substeps,
)
from sim_models.servo import servo_parameters, set_servo, velocity_parameters
from sim_models.statistics import count_hops

UNITS = {"t": "s", "a0": "rad", "a1_vel": "rad/s", "a2_load": "1", "px": "m", "py": "m", "pz": "m", "goal_met": "1"}
UNITS |= {"goal_dist": "m", "heading_error": "rad", "s0": "N"}
GAIT = "(* 20 (sin (+ (* 36 t) (+ px (+ s0 (* 0.01 a1_vel))))))"
SENSING = (
    "(+ (* 5 (sin (* 20 heading_error))) (* 90 (- pz a0)))",
    GAIT,
    "(if goal_met 0 (+ (* 60 a2_load) (* 10 (+ py goal_dist))))",
)


def make_controller(*expressions, inputs=UNITS, filter_=0.8, slew=15.0, joints=(), more=()):
    units = UNITS | dict.fromkeys(("vx", "vy", "vz"), "m/s")
    velocity = bool(joints) and joints[0].mode == "velocity"
    if more:
        expressions = (f"(+ {expressions[0]} (* 3 (+ vx (- vy vz))))", *expressions[1:])
    if velocity:
        expressions = tuple(f"(* 0.2 {expression})" for expression in expressions)
    kind, unit = ("velocity", "rad/s") if velocity else ("position", "deg")
    text = f'program = "(list {" ".join(expressions)})"\n[controller]\nname = "c"\nperiod_s = 0.02\n'
    text += f"filter = {filter_}\nslew_rad_s = {slew}\n"
    for name in (*inputs, *sorted(more)):
        text += f'[[input]]\nname = "{name}"\nunit = "{units[name]}"\nlow = -10.0\nhigh = 10.0\n'
    for name in ("a0", "a1", "a2"):
        text += (
            f'[[output]]\nname = "{name}"\nkind = "{kind}"\nunit = "{unit}"\nlow = -60.0\nhigh = 60.0\nneutral = 0.0\n'
        )
    return parse_controller(text, "test")


def splitmix_normal(seed, substep, channel):
    """The noise, written anew: eight 16-bit uniforms of splitmix64, centred, of variance 1."""
    mask, total = (1 << 64) - 1, 0
    for i in range(2):
        z = (seed + ((substep * 32 + channel) * 2 + i + 1) * 0x9E3779B97F4A7C15) & mask
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & mask
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
        z ^= z >> 31
        total += sum((z >> (16 * j)) & 0xFFFF for j in range(4))
    return (total - 4 * 65535) / 65536 * math.sqrt(1.5)


def perturbed_model(rig, form, timestep, row):
    """Build the rig of one row of perturbations without the batch."""
    model = build_model(rig, form=form, timestep_s=timestep, lean=True)
    model.geom_friction[:, 0] *= row.friction[0]
    model.body_mass *= row.mass[0]
    model.body_inertia *= row.mass[0]
    mujoco.mj_setConst(model, mujoco.MjData(model))
    for i, joint in enumerate(rig.joints):
        voltage = rig.supply_v * row.voltage[0]
        motor = model.actuator(joint.name)
        if joint.ideal:
            for values in (motor.gainprm, motor.biasprm, motor.forcerange):
                values[:] = values * (row.torque[0, i] * row.voltage[0])
        elif joint.mode == "velocity":
            gains = (joint.velocity_p_gain, joint.pwm_limit)
            set_servo(model, motor.id, velocity_parameters(joint.product, *gains, voltage, row.torque[0, i]))
        else:
            gains = (joint.p_gain, joint.d_gain, joint.pwm_limit)
            set_servo(model, motor.id, servo_parameters(joint.product, *gains, voltage, row.torque[0, i]))
    return model


def input_scales(rig, row):
    """Return what each motor's input is over its goal: a velocity servo's gain shares the motor with the back-EMF."""
    scales = []
    for joint in rig.joints:
        product = joint.product
        if joint.ideal or joint.mode == "position":
            scales.append(1.0)
            continue
        volts_per_rad_s = joint.velocity_p_gain / 128 / 885 * rig.supply_v * row.voltage[0]
        volts_per_rad_s /= product.velocity_unit_rad_s
        back_emf = product.voltage_v / product.no_load_speed_rad_s
        scales.append(float(np.float32(volts_per_rad_s / (volts_per_rad_s + back_emf))))
    return np.array(scales)


def slow_rollout(controller, rig, form, timestep, nstep, goal, row):
    """Run the loop in Python: MuJoCo's bindings, the reference cycle, sensor lines as a list of what was sent."""
    model = perturbed_model(rig, form, timestep, row)
    nominal = build_model(rig, form=form, timestep_s=timestep, lean=True)
    start = settled_data(nominal, rig)
    data, layout = mujoco.MjData(model), body_layout(model, rig)
    data.qpos[:] = start.qpos
    data.qpos[layout.qpos] += row.initial_rad[0].astype(np.float32)
    data.ctrl[layout.actuator] = [0 if joint.mode == "velocity" else joint.neutral_rad for joint in rig.joints]
    mujoco.mj_forward(model, data)
    cycle, specs, nsub = ReferenceCycle(controller, rig), terminals_of(rig), substeps(rig, timestep)
    sigma = {name: np.float32(row.pose_noise_m[0]) for name in "xyz"}
    sigma |= {name: np.float32(row.angle_noise_rad[0]) for name in ("heading", "roll", "pitch")}
    sigma["force"] = np.float32(row.force_noise_n[0])
    scales_in = input_scales(rig, row)
    latency, sent, pending, records, states = round(row.latency_s[0] / timestep), [], {}, [], []

    def judge():
        pose = base_pose(model, data)
        up = base_rotation(model, data)[2, 2]
        speed = np.linalg.norm(data.qvel[:3] if form == "free" else data.qvel[:2])
        place = (pose.x, pose.y, pose.heading, math.acos(up), clearance(model, data, layout), speed)
        rates, shares = data.qvel[layout.dof], loads(rig, nominal, data.actuator_force[layout.actuator])
        states.append((*place, *data.qpos[layout.qpos], *rates, *shares))

    def look(substep):
        pose = dataclasses.asdict(base_pose(model, data)) | {"force": base_force(model, data)}
        speed = data.qvel[:3] if form == "free" else (data.qvel[0], 0.0, data.qvel[1])
        ahead = base_rotation(model, data)[:2, 0]
        c, s = ahead / np.sqrt(ahead[0] * ahead[0] + ahead[1] * ahead[1])
        pose |= {"vx": speed[0] * c + speed[1] * s, "vy": speed[1] * c - speed[0] * s, "vz": speed[2]}
        for channel, sensor in enumerate(rig.sensors):
            due = substep * timestep * sensor.rate_hz
            if abs(due - round(due)) < 1e-6:
                value = pose[sensor.name]
                value += float(sigma.get(sensor.name, 0.0)) * splitmix_normal(int(row.seed[0]), substep, channel)
                arrival = substep * timestep + sensor.latency_s
                sent.append((arrival, channel, value, sensor))

    look(0)
    for k in range(nstep):
        now = k * rig.period_s
        raw = []
        for suffix, values in (
            ("", data.qpos[layout.qpos] + row.encoder_bias_rad[0].astype(np.float32)),
            ("_vel", data.qvel[layout.dof]),
            ("_load", loads(rig, nominal, data.actuator_force[layout.actuator])),
        ):
            raw += [encode(specs[j.name + suffix], v) for j, v in zip(rig.joints, values, strict=True)]
        for channel, sensor in enumerate(rig.sensors):
            lines = [line for line in sent if line[1] == channel]
            value = next((v for at, _, v, _ in reversed(lines) if at <= now + 1e-9), lines[0][2])
            kind = TerminalKind.RAW
            raw.append(encode(TerminalSpec("", kind, "", len(raw), sensor.zero, sensor.scale), value))
        _, outputs, counts = cycle.step(*goal, np.array(raw, np.int32))
        scales = [np.float64(np.float32(output.count_scale)) for output in cycle.spec.outputs]
        pending[k * nsub + latency] = [
            (count - output.zero) / scale
            for count, output, scale in zip(counts.tolist(), cycle.spec.outputs, scales, strict=True)
        ]
        judge()
        pose = base_pose(model, data)
        height = clearance(model, data, layout)
        records.append((raw, outputs, counts, [pose.x, pose.y, pose.z, height, *data.qpos[layout.qpos]]))
        for i in range(nsub):
            if k * nsub + i in pending:
                data.ctrl[layout.actuator] = np.array(pending[k * nsub + i]) * scales_in
            mujoco.mj_step(model, data)
            look(k * nsub + i + 1)
    judge()
    return [np.array(column) for column in zip(*records, strict=True)], np.array(states)


def judged(states, goal):
    """Compute the statistics of a rollout from its states at control instants, in plain numpy."""
    x, y, heading, tilt, height, speed = states[:, :6].T
    joints, rates, shares = np.split(states[:, 6:], 3, axis=1)
    direction = heading[0] + goal[1]
    goal_x, goal_y = x[0] + goal[0] * math.cos(direction), y[0] + goal[0] * math.sin(direction)
    error = np.hypot(goal_x - x, goal_y - y)
    px = (goal_x - x) * np.cos(heading) + (goal_y - y) * np.sin(heading)
    moved = np.hypot(np.diff(x), np.diff(y))
    turned = np.abs(np.diff(joints, axis=0)).mean(axis=1)
    down = height < 0.002
    hits = np.flatnonzero(error <= 0.015)
    first = int(hits[0]) if len(hits) else len(moved)
    outside = np.flatnonzero(error > 0.015)
    arrive = int(outside[-1]) + 1 if len(outside) else 0
    arrive = arrive if arrive < len(states) else -1
    return {
        "final_error": error[-1],
        "final_px": px[-1],
        "min_error": error.min(),
        "min_abs_px": np.abs(px).min(),
        "end_tilt": tilt[-1],
        "max_tilt": tilt.max(),
        "end_speed": speed[-11:].max(),
        "end_joint_error": np.abs(joints[-1]).mean(),
        "max_clearance": max(height.max(), 0.0),
        "path": moved.sum(),
        "ground_path": moved[down[:-1] & down[1:]].sum(),
        "path_after_hit": moved[first:].sum(),
        "joint_path_after_hit": turned[first:].sum(),
        "status": 0,
        "fallen": 0,
        "upright_end": int(tilt[-1] <= 0.35),
        "alive_steps": len(moved),
        "hops": count_hops(height),
        "first_hit_step": first if len(hits) else -1,
        "arrive_step": arrive,
        "end_joint_speed": np.abs(rates[-1]).mean(),
        "peak_torque": np.abs(shares).max(),
        "idle_steps": int((speed[: arrive if arrive >= 0 else None] < 0.02).sum()),
    }


def loads(rig, model, torque):
    """Return torques as shares of the current limit, by way of the current, or of an ideal motor's own limit."""
    shares = []
    for joint, value in zip(rig.joints, torque, strict=True):
        if joint.ideal:
            shares.append(value / model.actuator(joint.name).forcerange[1])
            continue
        limit = registers(joint.product)["current_limit"]
        full = joint.product.stall_torque_nm * limit.high * limit.scale / joint.product.stall_current_a
        shares.append(value / full)
    return shares
