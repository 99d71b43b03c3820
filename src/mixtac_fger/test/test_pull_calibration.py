# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The gain of the sideways force by known pulls, from series of known truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixtac_fger.force_calibration import GRAVITY, ForceCalibrationError, load_of
from mixtac_fger.pull_calibration import (
    WAYS,
    find_pulls,
    fit_pulls,
    last_contact,
    measured,
    parse_pulls,
    pull_of,
    span_at,
)

RATE_HZ, REST_S, PULL_S = 500, 1.6, 1.6
LOADS = parse_pulls('20', 1.0)


def series(loads, gain=1.4, turn=0.0, *, left=0.0, noise=0.004, swing=0.0, drift=0.0, seed=1):
    """Return times, normal force [N] and estimates of x and y [N] of a contact with pulls.

    Args:
        loads: Pulls.
        gain: Known force over estimate.
        turn: Angle from what is seen to what is meant [rad].
        left: Part of each pull that stays.
        noise: Of each estimate [N].
        swing: Amplitude at 3 Hz under a pull [N].
        drift: Change under a pull [N/s].
        seed: Seed of the noise.
    """
    parts, kept = [np.zeros(int(REST_S * RATE_HZ), complex)], 0j
    for load, way in loads:
        pull = load.force_n * WAYS[way] * np.exp(-1j * turn) / gain
        ramp = np.linspace(0.0, 1.0, int(0.3 * RATE_HZ))
        s = np.arange(int(PULL_S * RATE_HZ)) / RATE_HZ
        held = pull + WAYS[way] * (swing * np.sin(6 * np.pi * s) + drift * s)
        back = kept + left * pull
        parts += [
            kept + pull * ramp,
            kept + held,
            back + (kept + held[-1] - back) * ramp[::-1],
            np.full(int(REST_S * RATE_HZ), back),
        ]
        kept = back
    across = np.concatenate(parts)
    free = np.zeros(int(1.5 * RATE_HZ))
    touched = np.ones(len(across))
    force = np.concatenate([free, touched, free])
    across = np.concatenate([free, across, free])
    rng = np.random.default_rng(seed)
    t_s = np.arange(len(force)) / RATE_HZ
    table = np.column_stack([across.real, across.imag])
    return t_s, force, table + rng.normal(0.0, noise, table.shape)


def pulls_of(loads=LOADS, **settings):
    t_s, force, across = series(loads, **settings)
    _, contact = last_contact(t_s, force)
    return find_pulls(t_s[contact], across[contact], loads)[0]


def refusal(loads=LOADS, known=None, **settings):
    t_s, force, across = series(loads, **settings)
    _, contact = last_contact(t_s, force)

    def fit():
        fit_pulls(find_pulls(t_s[contact], across[contact], known or loads)[0])

    with pytest.raises(ForceCalibrationError) as caught:
        fit()
    return caught.value.reason


@pytest.mark.parametrize(('gain', 'turn'), [(1.4, 0.0), (0.6, 0.2), (2.5, -0.3)])
def test_gain_and_angle_are_found_within_their_uncertainty(gain, turn):
    found = fit_pulls(pulls_of(gain=gain, turn=turn))
    assert abs(found.gain - gain) < 2.0 * found.gain_sd < 0.2 * gain
    assert abs(found.turn - turn) < found.turn_sd
    assert found.mae_after_n < 0.01 < found.mae_before_n
    assert [point.pull.way for point in found.points] == [1.0, -1.0, 1j, -1j]


def test_elsewhere_the_gain_is_between_that_of_the_pulls_and_that_of_the_normal_force():
    found = fit_pulls(pulls_of(gain=1.4))
    gain, gain_sd = found.elsewhere(1.0)
    assert 1.0 < gain < found.gain
    assert gain_sd > found.gain_sd
    # Twice as stiff a gel doubles all of it.
    stiffer = replace(found, gain=2.0 * found.gain, gain_sd=2.0 * found.gain_sd)
    assert stiffer.elsewhere(2.0) == pytest.approx((2.0 * gain, 2.0 * gain_sd))
    # Pulls that disagree tell less.
    assert replace(found, gain_sd=0.5).elsewhere(1.0)[0] < gain


def test_residuals_have_the_sign_of_known_less_calibrated():
    loads = parse_pulls('+x:20,-x:20,+x:22', 1.0)
    t_s, force, across = series(parse_pulls('+x:20,-x:20,+x:20', 1.0), noise=1e-4)
    _, contact = last_contact(t_s, force)
    points = fit_pulls(find_pulls(t_s[contact], across[contact], loads)[0]).points
    assert points[2].residual_n > 0.0 > points[0].residual_n
    assert all(abs(point.residual_n) < point.allowed_n for point in points)


def test_pulls_of_unknown_directions_give_the_same_gain():
    t_s, _, across = series(LOADS, gain=1.7, turn=2.0)
    rest, turn = 1.5 + REST_S, 0.6 + PULL_S + REST_S
    found = []
    for k in range(2):
        start = rest + k * turn + 0.3
        inside = span_at(t_s, across, start, start + PULL_S)
        before = span_at(t_s, across, start - 0.9, start - 0.3)
        found.append(pull_of(load_of(20.0, 1.0), None, inside, before, None))
    fit = fit_pulls(found)
    assert fit.gain == pytest.approx(1.7, rel=0.03)
    assert fit.turn is None


def test_a_span_outside_of_the_series_or_without_values_is_none():
    t_s, _, across = series(LOADS)
    assert span_at(t_s, across, 1e3, 1e3 + 2.0) is None
    assert span_at(t_s, across, 2.0, 2.2) is None
    assert span_at(t_s, np.full_like(across, np.nan), 2.0, 4.0) is None


@pytest.mark.parametrize(
    ('settings', 'reason'),
    [
        ({'gain': 0.01}, 'units'),
        ({'gain': 12.0}, 'slid'),
        ({'turn': 1.2}, 'ways'),
        ({'left': 0.5}, 'slid'),
        ({'drift': 0.06}, 'slid'),
        ({'known': parse_pulls('+x:20,-x:35,+y:20,-y:20', 1.0)}, 'loads'),
        ({'known': parse_pulls('+x:20,+x:20,+y:20,-y:20', 1.0)}, 'loads'),
        ({'known': parse_pulls('20,20', 1.0)}, 'slid'),
        ({'known': parse_pulls('+x:20,-x:20', 1.0)}, 'order'),
    ],
)
def test_what_no_gel_explains_is_refused(settings, reason):
    assert refusal(**settings) == reason


def test_a_mass_that_swings_is_refused():
    assert refusal(swing=0.045) in {'rocking', 'slid'}


def test_a_recording_that_ends_in_contact_is_refused():
    t_s, force, _ = series(LOADS)
    with pytest.raises(ForceCalibrationError):
        last_contact(t_s[:-800], force[:-800])
    with pytest.raises(ForceCalibrationError):
        last_contact(t_s, np.zeros_like(force))


def test_a_reference_sensor_gives_the_sizes():
    """Its axes may lie in any direction, and its zero drifts."""
    t_s, force, across = series(LOADS, gain=1.4)
    _, contact = last_contact(t_s, force)
    pulls, rests = find_pulls(t_s[contact], across[contact], LOADS)
    true = 1.4 * (across[:, 0] + 1j * across[:, 1]) * np.exp(0.7j)
    drift = 0.004 * t_s
    found = measured(t_s, np.column_stack([true.imag + drift, true.real - drift]), pulls, rests)
    assert [each.load.force_n for each in found] == pytest.approx([0.02 * GRAVITY] * 4, rel=0.05)
    assert fit_pulls(found).gain == pytest.approx(1.4, rel=0.03)
    with pytest.raises(ForceCalibrationError) as caught:
        measured(t_s, np.zeros((len(t_s), 2)), pulls, rests)
    assert caught.value.reason == 'pull'


def test_loads_are_grams_with_directions():
    assert [way for _, way in parse_pulls('20', 1.0)] == ['+x', '-x', '+y', '-y']
    (first, x), (second, y) = parse_pulls('+x:20, -y:30.5', 2.0)
    assert (x, y) == ('+x', '-y')
    assert (first.grams, second.grams) == pytest.approx((20.0, 30.5))
    assert second.sd_n == pytest.approx(2e-3 * GRAVITY)
    for text in ('', 'x:20', '+z:20', '+x:', '+x:-5', '+x:nan', '20,', '+x:20:30'):
        with pytest.raises(ForceCalibrationError) as caught:
            parse_pulls(text, 1.0)
        assert caught.value.reason == 'units'
    with pytest.raises(ForceCalibrationError) as caught:
        parse_pulls('+x:20', 1.0)
    assert caught.value.reason == 'few'
