"""Settings and conditions: typed overrides, contradictions refused, goals that keep their distance."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controller.errors import InputError
from evolve.conditions import draw_conditions, pick, poisson_disk
from evolve.decide import Candidate, who_hit_most
from evolve.settings import Settings, apply_overrides
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
    ("hits", "left"), [((0, 8, 7), "b"), ((16, 15, 3), "ab"), ((0, 0, 0), "abc"), ((1, 0, 1), "ac")]
)
def test_who_fails_on_the_rig_as_stated_is_out(hits, left):
    hall = [Candidate(0, 0, name, 1, None) for name in "abc"]
    assert "".join(c.program for c in who_hit_most(hall, np.array(hits))) == left
