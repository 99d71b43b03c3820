# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Known loads give the gain of a sensor, and spoiled ones are refused with the reason."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixtac_fger.force_calibration import (
    GRAVITY,
    ForceCalibrationError,
    Load,
    Plateau,
    check_gain,
    find_plateaus,
    fit_gain,
    load_of,
    next_load_tells,
    reference_loads,
    steady_stretches,
)

RATE_HZ = 500
GRAMS = (20.0, 50.0, 100.0)


def procedure(
    grams=GRAMS,
    *,
    gain=1.5,
    seed=0,
    hold_s=3.0,
    rest_s=2.2,
    noise=0.008,
    tremor=0.01,
    creep=0.008,
    rocking=0.0,
    rocking_hz=2.5,
    walk=0.0,
    staircase=False,
):
    """Return times and estimates of a sensor that reads 1 / gain of each load.

    Args:
        grams: Loads in their order; the sensor is released in between.
        gain: True force over estimate.
        seed: Of all that is random.
        hold_s: Time of each load.
        rest_s: Time between them.
        noise: Standard deviation of each window [N].
        tremor: Amplitude of a hand at 8 Hz, as a part of the load.
        creep: Slope, as a part of the load per second.
        rocking: Amplitude of a load that rocks, as a part of it.
        rocking_hz: Its frequency.
        walk: The zero after the first load [N].
        staircase: Do not release between loads.
    """
    rng = np.random.default_rng(seed)
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
        force_n[on] += rocking * force * np.sin(2 * np.pi * rocking_hz * t_s[on])
    slow = rng.normal(0.0, noise, len(t_s) // 20 + 1).repeat(20)[: len(t_s)]
    return t_s, force_n + rng.normal(0.0, noise, len(t_s)) + 0.5 * slow


def calibrated(grams=GRAMS, sd_g=1.0, known=None, **conditions):
    loads = [load_of(each, sd_g) for each in known or grams]
    return fit_gain(loads, find_plateaus(*procedure(grams, **conditions), loads))


def refusal(*arguments, **conditions):
    with pytest.raises(ForceCalibrationError) as caught:
        calibrated(*arguments, **conditions)
    assert caught.value.remedy
    return caught.value.reason


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
    assert found.mae_after_n <= max(found.mae_before_n, 0.05 * 0.1 * GRAVITY)
    assert all(not each.plateau.unloading for each in found.points)


def test_plateaus_lie_within_the_loads_and_describe_them():
    t_s, force_n = procedure((50.0,), gain=1.0, creep=0.02, noise=0.002)
    (plateau,) = find_plateaus(t_s, force_n, [load_of(50.0, 1.0)])
    known = 0.05 * GRAVITY
    inside = (t_s >= plateau.start_s) & (t_s <= plateau.end_s)
    assert force_n[inside].min() > 0.95 * known
    assert plateau.creep_n_per_s == pytest.approx(0.02 * known, rel=0.2)
    assert plateau.estimate_n == pytest.approx(known, rel=0.08)
    assert abs(plateau.zero_shift_n) < 0.01


def test_steady_stretches_leave_out_gaps_and_short_series():
    t_s, force_n = procedure((50.0,), hold_s=6.0)
    hole = (t_s < 5.0) | (t_s > 5.5)
    assert len(steady_stretches(t_s[hole], force_n[hole])) > len(steady_stretches(t_s, force_n))
    for size in (0, 1, 2, 100):
        assert steady_stretches(t_s[:size], force_n[:size]) == []


def test_unloading_shows_hysteresis():
    loads = [load_of(each, 0.1) for each in (50.0, 100.0, 50.0)]
    t_s, force_n = procedure((50.0, 100.0, 53.0), gain=1.0, staircase=True, creep=0.0)
    plateaus = find_plateaus(t_s, force_n, loads)
    assert [each.unloading for each in plateaus] == [False, False, True]
    found = fit_gain(loads, plateaus)
    assert found.hysteresis_n == pytest.approx(0.003 * GRAVITY, abs=0.01)
    assert calibrated().hysteresis_n is None


@pytest.mark.parametrize(
    ('conditions', 'reason'),
    [
        ({'grams': (20.0, 75.0, 100.0), 'known': GRAMS}, 'loads'),
        ({'grams': (50.0, 20.0, 100.0), 'known': GRAMS}, 'loads'),
        ({'grams': (20.0, 100.0, 50.0), 'known': GRAMS}, 'loads'),
        ({'creep': 0.08}, 'creep'),
        ({'grams': (0.5, 0.5, 0.5), 'known': GRAMS}, 'contact'),
        ({'grams': (20.0, 50.0), 'known': GRAMS}, 'contact'),
        ({'rocking': 0.15}, 'rocking'),
        ({'rocking': 0.3, 'rocking_hz': 0.8}, 'rocking'),
        ({'walk': 0.035}, 'zero'),
        ({'walk': 0.2}, 'zero'),
        ({'known': (0.02, 0.05, 0.1)}, 'units'),
        ({'known': (196.0, 490.0, 980.0)}, 'units'),
        ({'grams': (50.0,)}, 'few'),
        ({'grams': (50.0, 50.0)}, 'few'),
        ({'grams': (20.0, 50.0, 100.0), 'known': (20.0, 50.0)}, 'order'),
    ],
)
def test_spoiled_calibrations_are_refused(conditions, reason):
    for seed in range(3):
        assert refusal(seed=seed, **conditions) == reason


@pytest.mark.parametrize('kind', ['wrong grams', 'swapped', 'moved', 'off the gel', 'rocking'])
def test_eight_spoiled_calibrations_of_each_kind_are_refused_or_flagged(kind):
    for seed in range(8):
        rng = np.random.default_rng(seed)
        load, other = rng.permutation(3)[:2].tolist()
        grams, conditions = list(GRAMS), {}
        if kind == 'wrong grams':
            grams[load] *= rng.choice((1.0 / 1.5, 1.5))
        elif kind == 'swapped':
            grams[load], grams[other] = grams[other], grams[load]
        elif kind == 'moved':
            conditions['walk'] = rng.choice((-1.0, 1.0)) * rng.uniform(0.05, 0.2)
        elif kind == 'off the gel':
            grams[load] *= 0.1
        else:
            conditions = {
                'rocking': rng.uniform(0.15, 0.3),
                'rocking_hz': rng.uniform(0.8, 2.5),
            }
        try:
            found = calibrated(tuple(grams), known=GRAMS, seed=seed, **conditions)
        except ForceCalibrationError:
            continue
        assert any(each.doubtful for each in found.points)


def test_a_load_that_is_somewhat_off_is_doubtful():
    assert not any(each.doubtful for each in calibrated().points)
    found = calibrated((20.0, 57.0, 100.0), known=GRAMS)
    assert [each.doubtful for each in found.points] == [False, True, False]


def test_swapped_loads_are_named():
    with pytest.raises(ForceCalibrationError) as caught:
        calibrated((20.0, 100.0, 50.0), known=GRAMS)
    assert '2' in caught.value.remedy
    assert '3' in caught.value.remedy


def test_a_further_load_tells_until_the_gain_is_known():
    assert next_load_tells(calibrated((20.0, 50.0)), load_of(100.0, 1.0))
    many = calibrated((50.0, 100.0, 70.0, 90.0), sd_g=0.1)
    assert not next_load_tells(many, load_of(100.0, 0.1))
    assert not next_load_tells(calibrated((20.0, 50.0)), load_of(1.0, 1.0))


def test_a_check_passes_until_the_sensor_has_changed():
    load = load_of(50.0, 1.0)
    plateau = Plateau(0.0, 2.0, load.force_n, 0.005, 0.001, 0.0)
    assert check_gain(load, plateau, 0.02).passed
    assert check_gain(load, replace(plateau, estimate_n=1.05 * load.force_n), 0.02).passed
    for factor in (0.7, 1.4):
        found = check_gain(load, replace(plateau, estimate_n=factor * load.force_n), 0.02)
        assert not found.passed
        assert found.ratio == pytest.approx(1.0 / factor)


def test_a_reference_sensor_gives_the_loads():
    t_s, force_n = procedure(gain=2.0, creep=0.0, tremor=0.0)
    plateaus = find_plateaus(t_s, force_n, ())
    zeros = [each for each in steady_stretches(t_s, force_n) if abs(each.mean_n) < 0.04]
    loads = reference_loads(t_s, 2.0 * force_n + 0.3, plateaus, zeros)
    assert [each.force_n for each in loads] == pytest.approx(
        [1e-3 * GRAVITY * each for each in GRAMS], abs=0.01
    )
    assert fit_gain(loads, plateaus).gain == pytest.approx(2.0, rel=0.01)
    with pytest.raises(ForceCalibrationError):
        reference_loads(t_s[:5], force_n[:5], plateaus, zeros)


def test_the_stated_uncertainty_of_the_loads_widens_that_of_the_gain():
    exact, rough = calibrated(sd_g=0.1), calibrated(sd_g=5.0)
    assert rough.gain_sd > exact.gain_sd
    with pytest.raises(ForceCalibrationError):
        fit_gain([Load(0.5, 0.01)], [exact.points[0].plateau])


def test_one_load_that_is_measured_twice_is_one():
    plateau = calibrated().points[0].plateau
    with pytest.raises(ForceCalibrationError) as caught:
        fit_gain([Load(0.4903, 0.01), Load(0.4905, 0.01)], [plateau, plateau])
    assert caught.value.reason == 'few'


@pytest.mark.parametrize('jump_s', [-3.0, 1e9])
def test_a_clock_that_jumps_is_named(jump_s):
    t_s, force_n = procedure()
    t_s[len(t_s) // 2 :] += jump_s
    with pytest.raises(ForceCalibrationError, match='jumped'):
        find_plateaus(t_s, force_n, ())
