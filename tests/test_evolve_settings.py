"""Settings and conditions: typed overrides, contradictions refused, goals that keep their distance."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controller.errors import InputError
from evolve.conditions import draw_conditions, pick, poisson_disk, stratified, unperturbed
from evolve.decide import Candidate, who_hit_most
from evolve.settings import OBJECTIVES, Settings, apply_overrides, asked_objectives, check, describe
from evolve.streams import Stream, generator
from sim_models.perturbations import nominal_perturbations


def test_overrides_are_read_as_the_type_of_their_setting():
    changed = apply_overrides(
        Settings(), ["population=7", "mass=0", "cache=FALSE", "screen_form=free", "population=9", "filter=1"]
    )
    assert changed == dataclasses.replace(
        Settings(), population=9, mass=0.0, cache=False, screen_form="free", filter=1.0
    )
    assert isinstance(changed.mass, float)


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("population", 'no "="'),
        ("populaton=3", "did you mean population?"),
        ("xyz=3", "known are population"),
        ("population=many", "not a whole number"),
        ("population=1", "from 2 to"),
        ("population=2.5", "not a whole number"),
        ("filter=nan", "finite"),
        ("filter=0", "from 0.001 to 1"),
        ("cache=maybe", "true or false"),
        ("screen_form=round", "planar, free"),
        ("crossover=-0.1", "from 0 to 1"),
        ("mutate_point=0.2", "more than 1"),
        ("grow_depth_low=7", "grow_depth_low is above grow_depth_high"),
        ("goal_low_m=0.7", "goal_low_m is above goal_high_m"),
        ("depth_max=5", "grow_depth_high is above depth_max"),
        ("elites=200000", "from 0 to"),
        ("bearing_high_rad=-1", "bearing_low_rad is above bearing_high_rad"),
        ("bearing_high_rad=6.3", "from -6.28319 to 6.28319"),
        ("bearing_low_rad=-1", "set screen_form=free"),
        ("selection=roulette", "tournament, proportionate"),
        ("parsimony=occam", "none, lexicographic, tarpeian, double"),
        ("objectives=speed", "give some of size,instructions,peak_torque"),
        ("objectives=size,size", "give some of size"),
    ],
)
def test_wrong_overrides_are_refused_in_one_sentence(override, told):
    with pytest.raises(InputError) as caught:
        apply_overrides(Settings(population=100), [override])
    assert told in str(caught.value)
    assert "--set" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_every_default_may_be_written_out():
    defaults = Settings()
    overrides = [f"{field.name}={getattr(defaults, field.name)}" for field in dataclasses.fields(defaults)]
    assert apply_overrides(defaults, overrides) == defaults


@settings(derandomize=True, deadline=None)
@given(seed=st.integers(0, 2**32), n=st.integers(1, 40), low=st.floats(-1, 1), width=st.floats(0, 2))
def test_goals_keep_their_distance_and_their_interval(seed, n, low, width):
    points = np.sort(poisson_disk(generator(seed, Stream.CONDITIONS), n, low, low + width))
    assert len(points) == n
    assert points[0] >= low and points[-1] <= low + width + 1e-12
    if n > 1:
        assert np.diff(points).min() >= 0.5 * width / (n - 1) - 1e-12


def test_goals_cover_their_interval_evenly():
    rng = generator(1, Stream.CONDITIONS)
    points = np.concatenate([poisson_disk(rng, 4, 0.1, 0.6) for _ in range(3000)])
    first = np.array([poisson_disk(rng, 4, 0.1, 0.6)[0] for _ in range(3000)])
    for sample in (points, first):
        share = np.histogram(sample, 5, (0.1, 0.6))[0] / len(sample)
        assert np.all(np.abs(share - 0.2) < 0.06), share
    assert abs(np.mean(first) - 0.35) < 0.01, "the order of goals is random"


def test_conditions_are_named_by_their_numbers():
    numbers = Settings()
    a = draw_conditions(generator(1, Stream.CONDITIONS, 3), numbers, 5, 3)
    b = draw_conditions(generator(1, Stream.CONDITIONS, 3), numbers, 5, 3)
    c = draw_conditions(generator(1, Stream.CONDITIONS, 4), numbers, 5, 3)
    assert a.draw == b.draw and a.keys == b.keys
    assert not set(a.keys) & set(c.keys)
    assert len(set(a.keys)) == 5
    assert pick(a, [4, 0]).keys == (a.keys[4], a.keys[0])
    assert pick(a, [4]).perturbations.mass == a.perturbations.mass[4]


def test_without_ranges_conditions_are_nominal_and_the_same_every_generation():
    names = ("friction", "mass", "torque", "voltage", "latency_s", "encoder_bias_rad", "initial_rad")
    names += ("pose_noise_m", "angle_noise_rad", "force_noise_n")
    numbers = dataclasses.replace(Settings(), goal_low_m=0.3, goal_high_m=0.3, **dict.fromkeys(names, 0.0))
    assert unperturbed(dataclasses.replace(Settings(), goal_low_m=0.3, goal_high_m=0.3)) == numbers
    a, b = (draw_conditions(generator(1, Stream.CONDITIONS, g), numbers, 1, 3) for g in (0, 1))
    assert a.keys == b.keys
    assert np.all(a.perturbations.torque == 1) and np.all(a.perturbations.latency_s == 0)


def test_the_first_conditions_are_the_rig_as_its_file_states_it():
    numbers = Settings()
    drawn = draw_conditions(generator(1, Stream.CONDITIONS), numbers, 5, 3, nominal=2)
    perturbed = draw_conditions(generator(1, Stream.CONDITIONS), numbers, 5, 3)
    stated = nominal_perturbations(5, 3)
    np.testing.assert_array_equal(drawn.goal_m, perturbed.goal_m)
    for field in dataclasses.fields(stated):
        mixed = getattr(drawn.perturbations, field.name)
        np.testing.assert_array_equal(mixed[:2], getattr(stated, field.name)[:2])
        np.testing.assert_array_equal(mixed[2:], getattr(perturbed.perturbations, field.name)[2:])
    assert (drawn.perturbations.friction[2:] != 1).all()


@pytest.mark.parametrize(
    ("hits", "share", "left"),
    [
        ((0, 8, 7), 0.9, "b"),
        ((16, 15, 3), 0.9, "ab"),
        ((16, 8, 7), 0.5, "ab"),
        ((0, 0, 0), 0.9, "abc"),
        ((1, 0, 1), 0.9, "ac"),
        ((8, 0, 1), 0.0, "abc"),
    ],
)
def test_who_fails_on_the_rig_as_stated_is_out(hits, share, left):
    hall = [Candidate(0, 0, name, 1, None) for name in "abc"]
    assert "".join(c.program for c in who_hit_most(hall, np.array(hits), share)) == left


@settings(derandomize=True, deadline=None)
@given(seed=st.integers(0, 2**32), n=st.integers(1, 40), low=st.floats(-3, 3), width=st.floats(1e-3, 6))
def test_directions_fill_equal_parts_of_their_range(seed, n, low, width):
    drawn = np.sort(stratified(generator(seed, Stream.CONDITIONS), n, low, low + width))
    edges = low + width * np.arange(n + 1) / n
    assert np.all(edges[:-1] - 1e-12 <= drawn) and np.all(drawn <= edges[1:] + 1e-12)


@settings(derandomize=True, deadline=None)
@given(seed=st.integers(0, 2**32), n=st.integers(1, 40), low=st.floats(-3, 0))
def test_directions_of_a_whole_turn_leave_none_out(seed, n, low):
    drawn = np.sort(stratified(generator(seed, Stream.CONDITIONS), n, low, low + 2 * np.pi))
    assert drawn[0] >= low and drawn[-1] <= low + 2 * np.pi + 1e-12
    gaps = np.diff(drawn, append=drawn[0] + 2 * np.pi)
    assert gaps.max() <= 2 * 2 * np.pi / n + 1e-9


def test_directions_are_uniform_and_in_random_order():
    rng = generator(1, Stream.CONDITIONS)
    for low, high in ((-1.0, 2.0), (0.0, 2 * np.pi)):
        drawn = np.array([stratified(rng, 4, low, high) for _ in range(3000)])
        for sample in (drawn.ravel(), drawn[:, 0]):
            share = np.histogram(sample, 8, (low, high))[0] / len(sample)
            assert np.all(np.abs(share - 1 / 8) < 5 * np.sqrt(1 / 8 / len(sample))), share


def test_a_single_direction_needs_no_chance():
    rng = generator(1, Stream.CONDITIONS)
    assert stratified(rng, 3, 0.5, 0.5).tolist() == [0.5] * 3
    assert rng.random() == generator(1, Stream.CONDITIONS).random()


def test_directions_come_after_everything_else():
    ahead = draw_conditions(generator(1, Stream.CONDITIONS), Settings(), 6, 3)
    numbers = Settings(bearing_low_rad=-np.pi, bearing_high_rad=np.pi, screen_form="free")
    around = draw_conditions(generator(1, Stream.CONDITIONS), check(numbers, "test"), 6, 3)
    assert not ahead.bearing_rad.any()
    assert len(set(around.bearing_rad)) == 6
    np.testing.assert_array_equal(ahead.goal_m, around.goal_m)
    np.testing.assert_array_equal(ahead.perturbations.seed, around.perturbations.seed)
    assert not set(ahead.keys) & set(around.keys)


def test_draws_of_older_runs_are_as_they_were():
    drawn = draw_conditions(generator(1, Stream.CONDITIONS, 3), Settings(), 2, 3)
    assert drawn.goal_m.tolist() == [0.1452767137017012, 0.43894130379916674]
    assert drawn.perturbations.friction.tolist() == [0.8607289648636404, 0.8080084200041411]
    assert drawn.perturbations.seed.tolist() == [2777918984625560178, 2828294869332585954]


def test_every_setting_is_declared_in_full():
    described = list(describe(Settings(cache=False)))
    assert [one.name for one in described] == [field.name for field in dataclasses.fields(Settings)]
    assert all(one.allowed and one.meaning for one in described)
    of = {one.name: one for one in described}
    assert (of["cache"].value, of["cache"].allowed) == ("false", "true | false")
    assert of["population"].allowed == "2 to 100000"
    assert of["selection"].allowed == "tournament | proportionate"


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"cache": 1}, "cache is 1; give true or false"),
        ({"population": 10.0}, "population is 10.0; give a whole number"),
        ({"objectives": 3}, "objectives is 3; give text"),
        ({"objectives": "size", "selection": "proportionate"}, "set parsimony=none and selection=tournament"),
    ],
)
def test_a_tasks_own_settings_are_held_to_their_types(change, told):
    with pytest.raises(InputError, match=told):
        check(dataclasses.replace(Settings(), **change), "my_task.py")


def test_objectives_are_named_with_commas():
    assert asked_objectives(Settings()) == ()
    assert asked_objectives(Settings(objectives="size, peak_torque")) == ("size", "peak_torque")
    assert asked_objectives(check(Settings(objectives=",".join(OBJECTIVES)), "test")) == OBJECTIVES
