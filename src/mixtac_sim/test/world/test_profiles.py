# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Profiles: names, seeds, ranges, synchronising impulses, refusals."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixtac_sim import SimulationError
from mixtac_sim.grids import STEP_US
from mixtac_sim.mechanics.contact import Mode
from mixtac_sim.world.profiles import PROFILES, PULL_WAYS, PULLED_G, make_profile


def commands(profile):
    return profile.commands(0, round(1e6 * profile.duration_s / STEP_US))


@settings(max_examples=40)
@given(st.sampled_from(sorted(PROFILES)), st.integers(0, 10**6), st.floats(10.0, 30.0))
def test_commanded_forces_stay_in_range(name, seed, duration):
    profile = make_profile(name, seed, duration)
    modes, targets, _ = commands(profile)
    forces = targets[modes == Mode.FORCE]
    assert np.all(forces > -0.01)
    assert np.all(forces < 2.0)
    assert all(s.end_s <= duration + 1e-9 for s in profile.segments)


@pytest.mark.parametrize('name', sorted(PROFILES))
def test_seed_fixes_the_profile(name):
    assert make_profile(name, 4, 12.0) == make_profile(name, 4, 12.0)
    assert name == 'idle' or make_profile(name, 4, 12.0) != make_profile(name, 5, 12.0)


@pytest.mark.parametrize('name', sorted(PROFILES))
def test_sync_impulses_are_short_alone_and_strong(name):
    profile = make_profile(name, 2, 12.0, sync=True)
    modes, targets, _ = commands(profile)
    t = (np.arange(len(modes)) + 1) * 1e-6 * STEP_US
    assert len(profile.sync_s) == 2
    for centre in profile.sync_s:
        near = (np.abs(t - centre) < 0.5) & (modes != Mode.FREE)
        assert 0.019 < np.ptp(t[near]) < 0.041
        assert 1.0 <= targets[near].max() <= 2.0
        assert t[near][np.argmax(targets[near])] == pytest.approx(centre, abs=1e-3)


def test_commands_do_not_depend_on_how_they_are_asked_for():
    profile = make_profile('demo', 3, 11.0)
    whole = commands(profile)
    parts = [profile.commands(k, 32) for k in range(0, 88_000, 32)]
    for column in range(3):
        np.testing.assert_array_equal(np.concatenate([p[column] for p in parts]), whole[column])


@pytest.mark.parametrize(
    ('name', 'axes'),
    [('shear', (0, 1)), ('slide', (0, 1)), ('torsion', (2,)), ('roll', (3, 4))],
)
def test_slides_and_turns_move_only_while_they_press_and_end_where_they_began(name, axes):
    profile = make_profile(name, 4, 12.0, sync=True)
    modes, targets, _ = commands(profile)
    steps = profile.motion(0, len(modes))[:, :5]
    still = [axis for axis in range(5) if axis not in axes]
    assert not steps[:, still].any()
    assert np.abs(np.cumsum(steps, axis=0)).max() > 0.15
    assert np.abs(steps.sum(axis=0)).max() < 1e-9
    moving = steps.any(axis=1)
    assert set(modes[moving].tolist()) <= {Mode.FREE, Mode.FORCE, Mode.HOLD}
    assert np.all(targets[moving & (modes == Mode.FORCE)] > 0.2)
    parts = [profile.motion(k, 32)[:, :5] for k in range(0, len(modes), 32)]
    np.testing.assert_array_equal(np.concatenate(parts), steps)
    assert make_profile('touch', 4, 12.0).motion(0, 32) is None


def test_a_hanging_mass_pulls_in_four_directions_and_rests_in_between():
    profile = make_profile('pulls', 3, 24.0)
    modes, targets, _ = commands(profile)
    steps = profile.motion(0, len(modes))
    assert not steps[:, :5].any()
    pull = steps[modes == Mode.FORCE, 5:]
    force = targets[modes == Mode.FORCE]
    assert np.isfinite(pull).all()
    assert np.isnan(steps[modes != Mode.FORCE, 5:]).all()
    assert np.abs(np.diff(pull, axis=0)).max() < 1e-3
    weight = 1e-3 * PULLED_G * 9.80665
    held = np.isclose(np.abs(pull), weight, rtol=1e-9).any(axis=1)
    starts = np.flatnonzero(held[1:] & ~held[:-1]) + 1
    assert pull[starts] == pytest.approx(weight * np.array(PULL_WAYS))
    # Each pull, and each rest without one, lasts long enough for a steady mean.
    assert (np.diff(np.flatnonzero(np.diff(held.astype(int))))).min() > 1.8 * 8000
    assert force[held].min() > 0.9
    parts = [profile.motion(k, 32) for k in range(0, len(modes), 32)]
    np.testing.assert_array_equal(np.concatenate(parts), steps)


@pytest.mark.parametrize(('name', 'duration'), [('waltz', 10.0), ('demo', 9.0), ('press', 0.1)])
def test_impossible_profiles_are_refused(name, duration):
    with pytest.raises(SimulationError):
        make_profile(name, 0, duration)
