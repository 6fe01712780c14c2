"""Rollouts: what the native loop promises of threads, switches, perturbations, statistics and failures."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from slow_rollout import SENSING, make_controller, splitmix_normal

from controller import load_controller, load_rig
from controller.errors import InputError, RunError
from controller.reference import ReferenceCycle
from sim_models import native_rollouts
from sim_models.perturbations import draw_perturbations, nominal_perturbations, take
from sim_models.rollouts import RolloutPool, StopConditions, make_cases, trace_channels
from sim_models.simulation import NEVER_STOP, simulate
from sim_models.statistics import count_hops


@pytest.fixture(scope="module")
def rig():
    return load_rig("lamp-xc330")


@pytest.fixture(scope="module")
def hopper(request):
    return load_controller(request.config.rootpath / "tests" / "golden" / "lamp-hop.controller.toml")


@pytest.fixture(scope="module")
def sensing():
    return make_controller(*SENSING)


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
