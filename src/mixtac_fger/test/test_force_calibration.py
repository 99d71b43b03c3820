# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Known loads give the gain of a sensor, and spoiled ones are refused with the reason."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixtac_fger.force_calibration import (
    GRAVITY,
    PRESS,
    PULL,
    ForceCalibrationError,
    Load,
    check_loads,
    find_plateaus,
    fit_gain,
    last_contact,
    load_of,
    reference_loads,
    sideways_gain,
)

RATE_HZ = 500
GRAMS = (20.0, 50.0, 100.0)


def procedure(
    grams=GRAMS,
    *,
    gain=1.5,
    seed=0,
    hold_s=3.0,
    noise=0.008,
    tremor=0.01,
    creep=0.008,
    rocking=0.0,
    walk=0.0,
    staircase=False,
    withheld=0.0,
):
    """Return times and estimates of a sensor that reads 1 / gain of each load in grams.

    Noise is in newtons per window. Of the load: a hand's tremor at 8 Hz, the creep per second, and
    the rocking. `walk` is the zero after the first load [N], `withheld` the share of the time
    without a force.
    """
    rng = np.random.default_rng(seed)
    rest_s = 2.2
    knots, values = [0.0, rest_s], [0.0, 0.0]
    spans = []
    for index, each in enumerate(grams):
        force = 1e-3 * GRAVITY * each / gain
        begin = knots[-1] + rng.uniform(0.1, 0.8)
        end = begin + hold_s * rng.uniform(1.0, 1.3)
        knots += [begin, end]
        values += [force, force * (1.0 + creep * (end - begin))]
        spans.append((begin, end, force))
        if not staircase or index == len(grams) - 1:
            start = end + 0.3
            knots += [start, start + rest_s]
            values += [walk, walk]
    t_s = np.arange(0.0, knots[-1], 1.0 / RATE_HZ)
    force_n = np.interp(t_s, knots, values)
    for begin, end, force in spans:
        on = (t_s > begin) & (t_s < end)
        force_n[on] += tremor * force * np.sin(2 * np.pi * 8.0 * t_s[on] + rng.uniform(0, 6))
        force_n[on] += rocking * force * np.sin(2 * np.pi * 2.5 * t_s[on])
    slow = rng.normal(0.0, noise, len(t_s) // 20 + 1).repeat(20)[: len(t_s)]
    force_n += rng.normal(0.0, noise, len(t_s)) + 0.5 * slow
    kept = (rng.random(len(t_s) // 50 + 1) >= withheld).repeat(50)[: len(t_s)]
    return t_s[kept], force_n[kept]


def calibrated(grams=GRAMS, sd_g=1.0, known=None, **conditions):
    loads = [load_of(each, sd_g) for each in known or grams]
    check_loads(loads)
    return fit_gain(loads, find_plateaus(*procedure(grams, **conditions), len(loads)))


@settings(max_examples=60)
@given(
    gain=st.floats(0.4, 3.0),
    wrong_g=st.tuples(*[st.floats(-1.0, 1.0)] * 3),
    tremor=st.floats(0.0, 0.02),
    creep=st.floats(-0.005, 0.015),
    hold_s=st.floats(2.5, 6.0),
    seed=st.integers(0, 1000),
)
def test_the_gain_is_recovered_within_its_stated_uncertainty(
    gain, wrong_g, tremor, creep, hold_s, seed
):
    grams = tuple(each + wrong for each, wrong in zip(GRAMS, wrong_g, strict=True))
    found = calibrated(
        grams, known=GRAMS, gain=gain, tremor=tremor, creep=creep, hold_s=hold_s, seed=seed
    )
    assert abs(found.gain - gain) < 3.0 * found.gain_sd
    assert found.gain_sd < 0.06 * found.gain
    assert max(abs(point.residual_n) for point in found.points) < 0.1


def test_a_gel_that_stiffens_is_calibrated_with_a_wider_share():
    straight = calibrated(sd_g=0.1)
    assert straight.exponent == pytest.approx(1.0, abs=0.03)
    assert PRESS.spread < straight.share < 1.2 * PRESS.spread
    stiffens = calibrated(sd_g=0.1, known=[each * (each / 50.0) ** 0.2 for each in GRAMS])
    assert stiffens.exponent == pytest.approx(1.2, abs=0.03)
    assert stiffens.share > 1.3 * straight.share


@pytest.mark.parametrize('conditions', [{'withheld': 0.2}, {'staircase': True}])
def test_withheld_forces_and_loads_without_a_release_are_no_obstacle(conditions):
    for seed in range(5):
        found = calibrated(seed=seed, **conditions)
        assert abs(found.gain - 1.5) < 3.0 * found.gain_sd


def test_plateaus_lie_within_the_loads_and_describe_them():
    t_s, force_n = procedure((50.0,), gain=1.0, creep=0.02, noise=0.002)
    (plateau,) = find_plateaus(t_s, force_n, 1)
    known, span = 0.05 * GRAVITY, plateau.span
    assert force_n[(t_s >= span.start_s) & (t_s <= span.end_s)].min() > 0.95 * known
    assert span.creep_n_per_s == pytest.approx(0.02 * known, rel=0.2)
    assert plateau.size_n == pytest.approx(known, rel=0.08)
    assert abs(plateau.rests[1].mean_n - plateau.rests[0].mean_n) < 0.01


@pytest.mark.parametrize(
    ('conditions', 'reason'),
    [
        ({'grams': (20.0, 75.0, 100.0), 'known': GRAMS}, 'loads'),
        ({'grams': (20.0, 100.0, 50.0), 'known': GRAMS}, 'loads'),
        ({'known': (0.02, 0.05, 0.1)}, 'loads'),
        ({'creep': 0.2}, 'unsteady'),
        ({'rocking': 0.15}, 'unsteady'),
        ({'grams': (0.5, 0.5, 0.5), 'known': GRAMS}, 'contact'),
        ({'grams': (20.0, 50.0), 'known': GRAMS}, 'contact'),
        ({'walk': 0.035}, 'zero'),
        ({'grams': (50.0,)}, 'few'),
        ({'grams': (20.0, 50.0, 100.0), 'known': (20.0, 50.0)}, 'few'),
    ],
)
def test_spoiled_calibrations_are_refused(conditions, reason):
    for seed in range(3):
        with pytest.raises(ForceCalibrationError) as caught:
            calibrated(seed=seed, **conditions)
        assert caught.value.reason == reason
        assert caught.value.remedy


def test_a_reference_sensor_gives_the_loads():
    t_s, force_n = procedure(gain=2.0, creep=0.0, tremor=0.0)
    plateaus = find_plateaus(t_s, force_n, None)
    loads = reference_loads(t_s, 2.0 * force_n[:, None] + 0.3, plateaus)
    assert [each.force_n for each in loads] == pytest.approx(
        [1e-3 * GRAVITY * each for each in GRAMS], abs=0.01
    )
    assert fit_gain(loads, plateaus).gain == pytest.approx(2.0, rel=0.01)
    with pytest.raises(ForceCalibrationError):
        reference_loads(t_s[:5], force_n[:5, None], plateaus)


def test_the_stated_uncertainty_of_the_loads_widens_that_of_the_gain():
    assert calibrated(sd_g=5.0).gain_sd > calibrated(sd_g=0.1).gain_sd
    with pytest.raises(ForceCalibrationError):
        check_loads([Load(0.4903, 0.01), Load(0.4905, 0.01)])


@pytest.mark.parametrize('jump_s', [-3.0, 1e9])
def test_a_clock_that_jumps_is_refused(jump_s):
    t_s, force_n = procedure()
    t_s[len(t_s) // 2 :] += jump_s
    with pytest.raises(ForceCalibrationError, match='jumped'):
        find_plateaus(t_s, force_n, None)


def pulled(grams, gain=1.4, *, left=0.0, swing=0.0, seed=1):
    """Return times, normal and sideways force (complex) of a contact with pulls [N].

    Each pull goes another way than the one before. `left` is the part of each that stays, `swing`
    the amplitude at 3 Hz under it.
    """
    second = np.arange(RATE_HZ) / RATE_HZ
    two = np.concatenate([second, second + 1.0])
    aside, kept = [0.0 * two], 0.0
    for index, each in enumerate(grams):
        pull = 1e-3 * GRAVITY * each / gain * np.exp(1j * index)
        ramp, held = kept + pull * second, kept + pull * (1.0 + swing * np.sin(6 * np.pi * two))
        kept += left * pull
        aside += [ramp, held, kept + (1.0 - left) * pull * second[::-1], kept + 0.0 * two]
    series = np.concatenate([0.0 * two, *aside, 0.0 * two])
    force = np.ones(len(series))
    force[: len(two)] = force[-len(two) :] = 0.0
    noise = np.random.default_rng(seed).normal(0.0, 0.004, (2, len(series)))
    return np.arange(len(series)) / RATE_HZ, force, series + noise[0] + 1j * noise[1]


def gain_of_pulls(grams, known=None, **conditions):
    t_s, force_n, aside = pulled(grams, **conditions)
    loads = [load_of(each, 1.0) for each in known or grams]
    first, contact = last_contact(t_s, force_n)
    assert t_s[first] < t_s[contact.start]
    return fit_gain(loads, find_plateaus(t_s[contact], aside[contact], len(loads), PULL), PULL)


@pytest.mark.parametrize('grams', [(20.0,), (20.0, 30.0, 20.0)])
@pytest.mark.parametrize('gain', [0.6, 2.0])
def test_pulls_in_any_direction_give_the_gain_of_the_sideways_force(grams, gain):
    found = gain_of_pulls(grams, gain=gain)
    assert found.gain == pytest.approx(gain, rel=0.03)
    elsewhere, sd = sideways_gain(found, 1.0)
    assert min(1.0, gain) < elsewhere < max(1.0, gain)
    assert sd > found.gain_sd


@pytest.mark.parametrize(
    ('conditions', 'reason'),
    [
        ({'left': 0.5}, 'zero'),
        ({'swing': 0.6}, 'unsteady'),
        ({'known': (20.0, 20.0, 20.0)}, 'contact'),
        ({'known': (20.0,)}, 'few'),
        ({'known': (20.0, 60.0)}, 'loads'),
    ],
)
def test_spoiled_pulls_are_refused(conditions, reason):
    with pytest.raises(ForceCalibrationError) as caught:
        gain_of_pulls((20.0, 20.0), **conditions)
    assert caught.value.reason == reason
