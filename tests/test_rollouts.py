"""Rollouts: the native loop against a slow one of MuJoCo and the reference cycle, bit for bit, and its promises."""

from __future__ import annotations

import dataclasses
import math

import mujoco
import numpy as np
import pytest

from controller import load_controller, load_rig, parse_controller
from controller.errors import InputError, RunError
from controller.native import encode
from controller.reference import ReferenceCycle
from controller.registers import registers
from controller.terminals import TerminalKind, TerminalSpec, terminals_of
from sim_models import native_rollouts
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
from sim_models.perturbations import draw_perturbations, nominal_perturbations, take
from sim_models.rollouts import RolloutPool, StopConditions, make_cases, trace_channels
from sim_models.servo import servo_parameters, set_servo, velocity_parameters
from sim_models.simulation import NEVER_STOP, simulate
from sim_models.statistics import STATISTICS, count_hops

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


@pytest.fixture(scope="module")
def rig():
    return load_rig("lamp-xc330")


@pytest.fixture(scope="module")
def hopper(request):
    return load_controller(request.config.rootpath / "tests" / "golden" / "lamp-hop.controller.toml")


@pytest.fixture(scope="module")
def sensing():
    return make_controller(*SENSING)


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


def velocity_lamp():
    """Return the lamp with its servos in velocity mode."""
    rig = load_rig("lamp-xc330")
    change = {"mode": "velocity", "speed_rad_s_max": 10.0, "gains": {"velocity_p_gain": 2000, "velocity_i_gain": 0}}
    return dataclasses.replace(rig, joints=tuple(dataclasses.replace(joint, **change) for joint in rig.joints))


def velocity_paper_lamp(folder):
    """Return the ideal lamp with velocity motors, looking along its last joint, which has no limits."""
    rig = load_rig("paper-lamp")
    text = (
        rig.body.read_text()
        .replace('<position kp="60" kv="1.5"', '<velocity kv="20"')
        .replace("<position", "<velocity")
    )
    body = folder / "velocity.xml"
    body.write_text(text)
    joints = [dataclasses.replace(joint, mode="velocity", speed_rad_s_max=10.0) for joint in rig.joints]
    joints[2] = dataclasses.replace(joints[2], unlimited=True, low_rad=-math.inf, high_rad=math.inf)
    return dataclasses.replace(rig, body=body, joints=tuple(joints), facing="a2")


@pytest.mark.parametrize(
    ("name", "form", "timestep", "seed", "goal"),
    [
        ("lamp", "free", 0.002, 3, (0.35, 0.2)),
        ("lamp", "planar", 0.005, 4, (0.02, 0.0)),
        ("lamp", "free", 0.0025, 5, (0.02, -0.3)),
        ("paper-lamp", "free", 0.004, 6, (0.3, 0.1)),
        ("velocity lamp", "free", 0.005, 7, (0.3, 0.0)),
        ("velocity paper-lamp", "free", 0.004, 8, (0.3, 0.0)),
        ("velocity paper-lamp", "planar", 0.005, 9, (0.3, 0.0)),
    ],
)
def test_rollouts_are_the_slow_loop_bit_for_bit(tmp_path, name, form, timestep, seed, goal):
    rig = {
        "lamp": lambda: load_rig("lamp-xc330"),
        "paper-lamp": lambda: load_rig("paper-lamp"),
        "velocity lamp": velocity_lamp,
        "velocity paper-lamp": lambda: velocity_paper_lamp(tmp_path),
    }[name]()
    sensing = make_controller(
        *SENSING, joints=rig.joints, more={"vx", "vy", "vz"} if name.endswith("paper-lamp") else ()
    )
    perturbations = draw_perturbations(np.random.default_rng(seed), 3, 3)
    nstep = 40
    with RolloutPool(rig, form=form, timestep_s=timestep, time_limit_s=0.8, threads=1, stop=NEVER_STOP) as pool:
        fast = pool.run([sensing], make_cases(0, *goal, np.arange(3)), perturbations, traces=True, record=True)
    for sim in range(3):
        slow, states = slow_rollout(sensing, rig, form, timestep, nstep, goal, take(perturbations, [sim]))
        assert np.array_equal(fast.raw[sim], slow[0])
        assert np.array_equal(fast.outputs[sim].view(np.uint32), slow[1].view(np.uint32))
        assert np.array_equal(fast.goal_counts[sim], slow[2])
        assert np.ptp(slow[2], axis=0).min() > 10  # the controller did move every joint
        places = [fast.channels.index(name) for name in ("x", "y", "z", "clearance", "a0", "a1", "a2")]
        assert np.array_equal(fast.traces[sim][:, places], slow[3].astype(np.float32))
        expected = judged(states, goal)
        assert set(expected) == set(STATISTICS.names) - {"head_touched"}
        for name, value in expected.items():
            assert fast.statistics[sim][name] == pytest.approx(value, rel=1e-4, abs=2e-6), name


def run_many(rig, controllers, threads, **options):
    perturbations = draw_perturbations(np.random.default_rng(7), 6, 3)
    cases = make_cases(np.arange(len(controllers))[:, None], np.linspace(0.1, 0.6, 6), 0.0, np.arange(6))
    with RolloutPool(rig, form="planar", timestep_s=0.005, time_limit_s=1.0, threads=threads, **options) as pool:
        return cases, perturbations, pool.run(controllers, cases, perturbations, traces=True, record=True)


def assert_same(a, b, sims=slice(None)):
    assert np.array_equal(a.statistics[sims], b.statistics[sims])
    for name in ("traces", "raw", "outputs", "goal_counts"):
        x, y = getattr(a, name)[sims], getattr(b, name)[sims]
        assert np.array_equal(x.view(np.uint32), y.view(np.uint32)), name


@pytest.mark.parametrize(
    "switch",
    [{"lean": False}, {"timer": True}, {"stop_early": False}, {"lean": False, "timer": True, "stop_early": False}],
)
@pytest.mark.parametrize("name", ["lamp-xc330", "paper-lamp"])
def test_a_switch_changes_no_statistic(name, switch, hopper, sensing):
    rig = load_rig(name)
    falling = make_controller("60", "60", "60", inputs=())
    controllers = [hopper, sensing, falling]
    one, other = (run_many(rig, controllers, threads=1, **options)[2] for options in ({}, switch))
    assert set(one.statistics["fallen"].tolist()) != {0}  # some did stop early
    assert one.statistics.tobytes() == other.statistics.tobytes()
    assert_same(one, other)


def test_threads_change_nothing(rig, hopper, sensing):
    still = make_controller("0", "0", "0", inputs=())
    _, _, one = run_many(rig, [hopper, sensing, still], threads=1)
    for threads in (2, 5):
        assert_same(one, run_many(rig, [hopper, sensing, still], threads=threads)[2])


def test_a_simulation_depends_on_its_own_case_only(rig, hopper, sensing):
    cases, perturbations, together = run_many(rig, [hopper, sensing], threads=2)
    with RolloutPool(rig, form="planar", timestep_s=0.005, time_limit_s=1.0, threads=1) as pool:
        # a pool that has run other things before, smaller batches, nominal rows first
        pool.run([sensing], make_cases(0, 0.2), nominal_perturbations(1, 3))
        for sim in (11, 0, 5):
            own = take(perturbations, [cases.perturbation[sim]])
            controller = [hopper, sensing][cases.controller[sim]]
            alone = pool.run([controller], make_cases(0, cases.goal_dist[sim]), own, traces=True, record=True)
            assert np.array_equal(alone.statistics[0], together.statistics[sim])
            assert np.array_equal(alone.traces[0], together.traces[sim], equal_nan=True)
            assert np.array_equal(alone.raw[0], together.raw[sim])


def test_nominal_rows_of_a_perturbed_batch_are_the_nominal_rig(rig, hopper):
    drawn, nominal = draw_perturbations(np.random.default_rng(1), 1, 3), nominal_perturbations(1, 3)
    names = [field.name for field in dataclasses.fields(nominal)]
    both = dataclasses.replace(
        nominal, **{name: np.concatenate([getattr(drawn, name), getattr(nominal, name)]) for name in names}
    )
    with RolloutPool(rig, time_limit_s=1.0, threads=1) as pool:
        plain = pool.run([hopper], make_cases(0, 0.3), nominal, traces=True)
        mixed = pool.run([hopper], make_cases(0, 0.3, 0, [0, 1]), both, traces=True)
    assert np.array_equal(plain.traces[0], mixed.traces[1], equal_nan=True)
    assert not np.array_equal(plain.traces[0], mixed.traces[0], equal_nan=True)


@pytest.mark.parametrize("field", ["friction", "mass", "torque", "voltage", "latency_s", "encoder_bias_rad"])
def test_every_perturbation_acts(rig, sensing, field):
    nominal, drawn = nominal_perturbations(1, 3), draw_perturbations(np.random.default_rng(2), 1, 3)
    changed = dataclasses.replace(nominal, **{field: getattr(drawn, field)})
    with RolloutPool(rig, form="planar", timestep_s=0.005, time_limit_s=1.0, threads=1, stop=NEVER_STOP) as pool:
        plain = pool.run([sensing], make_cases(0, 0.3), nominal, traces=True)
        other = pool.run([sensing], make_cases(0, 0.3), changed, traces=True)
    assert np.abs(plain.trace(0, "x") - other.trace(0, "x"))[25:].max() > 1e-4


def test_early_stop_is_the_full_run_cut_short(rig):
    # throws the head to the floor, lies there
    faller = make_controller("60", "60", "60", inputs=())
    nominal, cases = nominal_perturbations(1, 3), make_cases([0], 0.3)
    runs = {}
    stops = {
        "never": NEVER_STOP,
        "tilt": StopConditions(tilt_rad_max=0.3, head_contact=False, flight_s_max=math.inf),
        "head": StopConditions(tilt_rad_max=math.inf, head_contact=True, flight_s_max=math.inf),
    }
    for name, stop in stops.items():
        with RolloutPool(rig, time_limit_s=1.5, threads=1, stop=stop) as pool:
            runs[name] = pool.run([faller], cases, nominal, traces=True, record=True)
    full = runs["never"]
    assert full.statistics["alive_steps"][0] == full.nstep and full.statistics["fallen"][0] == 0
    assert full.statistics["head_touched"][0] == 1
    for value, name in ((1, "tilt"), (2, "head")):
        run = runs[name]
        alive = run.statistics["alive_steps"][0]
        assert run.statistics["fallen"][0] == value
        assert 0 < alive < full.nstep
        assert np.array_equal(run.traces[0, :alive], full.traces[0, :alive])
        assert np.array_equal(run.raw[0, :alive], full.raw[0, :alive])
        assert np.isnan(run.traces[0, alive:]).all() and not run.raw[0, alive:].any()


def test_a_base_in_the_air_too_long_is_a_fall(rig, hopper):
    hops = StopConditions(tilt_rad_max=math.inf, head_contact=False, flight_s_max=0.05)
    with RolloutPool(rig, time_limit_s=2.0, threads=1, stop=hops) as pool:
        run = pool.run([hopper], make_cases([0], 0.4), nominal_perturbations(1, 3), traces=True)
    alive = run.statistics["alive_steps"][0]
    assert run.statistics["fallen"][0] == 3
    assert run.trace(0, "clearance")[alive - 1] > 0.002


def test_statistics_are_those_of_the_trace(rig, hopper, sensing):
    _, _, run = run_many(rig, [hopper, sensing], threads=2)
    for sim, row in enumerate(run.statistics):
        alive = row["alive_steps"]
        x, y, z, px, height = (
            run.trace(sim, name)[:alive].astype(float) for name in ("x", "y", "z", "px", "clearance")
        )
        error = np.hypot(px, 0 * y)  # planar: along x alone
        if row["fallen"] == 0:
            assert alive == run.nstep
        # the last state is one period after the last row
        assert row["max_clearance"] >= height.max() - 1e-7
        assert row["min_abs_px"] <= np.abs(px).min() + 1e-7
        assert row["hops"] - count_hops(height) in (0, 1)
        assert row["path"] >= np.abs(np.diff(x)).sum() - 1e-4
        hits = np.flatnonzero(error <= 0.015)
        if len(hits):
            assert row["first_hit_step"] == hits[0]
        if row["arrive_step"] >= 0 and row["arrive_step"] < alive:
            assert (error[row["arrive_step"] :] <= 0.0150001).all() and row["final_error"] <= 0.0150001
        assert row["max_tilt"] >= row["end_tilt"] >= 0
        assert z.min() > 0.01


def test_standing_still_scores_as_such(rig):
    still = make_controller("0", "0", "0", inputs=())
    run = simulate(still, rig, goal_dist=0.25, time_limit_s=1.0, timestep_s=0.002)
    row = run.statistics
    assert row["final_error"] == pytest.approx(0.25, abs=1e-4) == row["min_abs_px"]
    assert row["upright_end"] == 1 and row["hops"] == 0 and row["first_hit_step"] == -1 == row["arrive_step"]
    assert row["end_speed"] < 1e-4 and row["path"] < 1e-3 and row["max_clearance"] < 1e-3


def test_goal_lies_where_distance_and_bearing_say(rig):
    still = make_controller("0", "0", "0", inputs=("px", "py", "heading_error"))
    run = simulate(still, rig, goal_dist=0.5, goal_bearing=0.6, time_limit_s=0.2, timestep_s=0.002)
    expected = (0.5 * math.cos(0.6), 0.5 * math.sin(0.6), 0.6)
    assert run.terminals[-1] == pytest.approx(expected, abs=2e-3)
    assert run.channel("px")[-1] == pytest.approx(expected[0], abs=1e-3)


def test_the_lamp_hops_to_the_goal_in_simulation(rig, hopper):
    with RolloutPool(rig, timestep_s=0.002, time_limit_s=5.0) as pool:
        goals = np.linspace(0.15, 0.55, 4)
        run = pool.run([hopper], make_cases(0, goals), nominal_perturbations(1, 3)).statistics
    assert (run["upright_end"] == 1).all() and (run["hops"] >= 2).all()
    assert (run["final_error"] < 0.015).all() and (run["end_speed"] < 0.2).all()
    assert (run["max_clearance"] > 0.02).all() and (run["arrive_step"] > 0).all()


def test_nan_outputs_become_neutral(rig):
    infinite = "(* (exp 80) (exp 80))"
    controller = make_controller(f"(- {infinite} {infinite})", "0", "0", inputs=())
    run = simulate(controller, rig, goal_dist=0.3, time_limit_s=0.3, timestep_s=0.002)
    assert (run.outputs == 0.0).all() and run.statistics["status"] == 0
    assert (run.goal_counts == 2048).all()


def test_divergence_is_a_failure_of_that_simulation_only(rig, hopper, sensing, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    torque = np.ones((2, 3))
    torque[0] = 1e16
    perturbations = dataclasses.replace(nominal_perturbations(2, 3), torque=torque)
    with RolloutPool(rig, time_limit_s=1.0, threads=2, stop=NEVER_STOP) as pool:
        run = pool.run([sensing, hopper], make_cases([0, 1], 0.3, 0, [0, 1]), perturbations, traces=True)
        good = pool.run([hopper], make_cases(0, 0.3), nominal_perturbations(1, 3), traces=True)
    assert run.statistics["status"].tolist() == [1, 0]
    assert np.isinf(run.statistics["final_error"][0]) and run.statistics["upright_end"][0] == 0
    assert run.statistics["alive_steps"][0] < run.nstep
    assert np.array_equal(run.traces[1], good.traces[0])
    assert not list(tmp_path.iterdir())  # no MUJOCO_LOG.TXT


def test_terminals_of_a_simulation_give_its_outputs(rig, sensing):
    run = simulate(sensing, rig, goal_dist=0.4, time_limit_s=0.5)
    cycle = ReferenceCycle(sensing, rig)
    for k, row in enumerate(run.raw):
        terminals, outputs, counts = cycle.step(run.goal_dist, run.goal_bearing, row)
        assert np.array_equal(terminals.view(np.uint32), run.terminals[k].view(np.uint32))
        assert np.array_equal(outputs.view(np.uint32), run.outputs[k].view(np.uint32))
        assert np.array_equal(counts, run.goal_counts[k])
    assert run.channels == trace_channels(rig) and run.trace.shape == (25, len(run.channels))


def test_noise_is_normal_and_depends_on_its_place_only():
    noise = native_rollouts.rollout_library().sv_noise
    values = np.array([noise(11, substep, channel) for substep in range(4000) for channel in range(3)])
    assert abs(values.mean()) < 0.03 and abs(values.std() - 1.0) < 0.02
    assert abs(np.corrcoef(values.reshape(-1, 3).T)[0, 1]) < 0.05
    assert noise(11, 5, 2) == splitmix_normal(11, 5, 2) == noise(11, 5, 2) != noise(12, 5, 2)


def test_wrong_requests_are_told_in_one_sentence(rig, hopper):
    nominal = nominal_perturbations(1, 3)
    with RolloutPool(rig, time_limit_s=0.1, threads=1) as pool:
        with pytest.raises(InputError, match="controller index outside 0 to 0"):
            pool.run([hopper], make_cases(1, 0.3), nominal)
        with pytest.raises(InputError, match="perturbation index outside 0 to 0"):
            pool.run([hopper], make_cases(0, 0.3, 0, 4), nominal)
        late = dataclasses.replace(nominal, latency_s=np.array([5.0]))
        with pytest.raises(InputError, match=r"latency_s is not within 0 to 1\.24 s"):
            pool.run([hopper], make_cases(0, 0.3), late)
        blind = dataclasses.replace(rig, sensors=())
        with pytest.raises(InputError, match="can not supply 'px'"), RolloutPool(blind, threads=1) as other:
            other.run([hopper], make_cases(0, 0.3), nominal)
    for options, fault in (
        ({"time_limit_s": 0.001}, "shorter than one period"),
        ({"threads": 0}, "at least one must simulate"),
        ({"timestep_s": 0.003}, "does not divide the period"),
    ):
        with pytest.raises(InputError, match=fault):
            RolloutPool(rig, **options)
    smell = dataclasses.replace(rig, sensors=(dataclasses.replace(rig.sensors[0], name="smell"),))
    with pytest.raises(InputError, match="sensor smell: simulation cannot show it; it has x, y"):
        RolloutPool(smell)


def test_an_error_of_the_engine_is_told(rig, hopper):
    with RolloutPool(rig, time_limit_s=0.1, threads=2) as pool:
        pool._model.opt.integrator = 99
        with pytest.raises(RunError, match=r"lamp-xc330: MuJoCo failed in simulation 0: .*integrator"):
            pool.run([hopper], make_cases(0, [0.2, 0.3]), nominal_perturbations(1, 3))


@pytest.mark.parametrize(
    ("attribute", "fault"),
    [("PATH", "is not built"), ("STATISTICS", "another version of its header")],
)
def test_a_library_that_does_not_fit_is_refused(monkeypatch, tmp_path, attribute, fault):
    value = tmp_path / "librollouts.so" if attribute == "PATH" else np.dtype("<f4")
    monkeypatch.setattr(native_rollouts, attribute, value)
    native_rollouts.rollout_library.cache_clear()
    try:
        with pytest.raises(InputError, match=fault):
            native_rollouts.rollout_library()
    finally:
        native_rollouts.rollout_library.cache_clear()
