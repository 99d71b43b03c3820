# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The clock map: exactness at epoch times, uncertainty, refusals."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_fger.alignment.clock_fit import (
    AlignmentError,
    Anchor,
    ClockFit,
    DriftError,
    ShortBaselineError,
    fit_clock,
)

EPOCH_US = 1_700_000_000_000_000


def exact_reference_s(fit: ClockFit, t_us: int) -> Fraction:
    """Return the map evaluated without rounding [s]."""
    since = Fraction(t_us - fit.camera_epoch_us, 10**6)
    return Fraction(fit.reference_epoch_s) + Fraction(fit.a) * since + Fraction(fit.b)


@given(
    start_us=st.sampled_from([0, 12_345_678, EPOCH_US + 987_654]),
    baseline_us=st.integers(5_000_000, 3_600_000_000),
    reference_s=st.sampled_from([0.0, 1_690_000_000.25]) | st.floats(0.0, 1e6),
    drift=st.floats(-1.5e-4, 1.5e-4),
)
def test_two_anchors_are_met_exactly(
    start_us: int, baseline_us: int, reference_s: float, drift: float
) -> None:
    second_s = reference_s + baseline_us * 1e-6 * (1.0 + drift)
    anchors = [
        Anchor(start_us + baseline_us, second_s, 1e-3),
        Anchor(start_us, reference_s, 1e-3),
    ]
    fit = fit_clock(anchors)
    assert fit.method == 'two_impulse'
    digits = max(1e-9, 4.0 * float(np.spacing(second_s)))
    assert np.abs(fit.residuals_s).max() <= digits
    assert abs(fit.a - (1.0 + drift)) <= 4.0 * digits / (baseline_us * 1e-6)
    for anchor in anchors:
        assert abs(float(fit.to_reference(anchor.camera_us)) - anchor.reference_s) <= digits
        assert abs(int(fit.to_camera(anchor.reference_s)) - anchor.camera_us) <= 1 + digits * 1e6


@given(
    since_us=st.lists(st.integers(-10_000_000, 60_000_000), min_size=1, max_size=20),
    drift=st.floats(-1e-4, 1e-4),
)
def test_the_map_is_exact_to_the_last_digit(since_us: list[int], drift: float) -> None:
    fit = fit_clock(
        [
            Anchor(EPOCH_US + 100, 1_690_000_000.5, 1e-3),
            Anchor(EPOCH_US + 25_000_100, 1_690_000_000.5 + 25.0 * (1.0 + drift), 1e-3),
        ]
    )
    times = np.array(since_us, np.int64) + EPOCH_US
    digit = float(np.spacing(fit.reference_epoch_s))
    for t, mapped in zip(times.tolist(), fit.to_reference(times).tolist(), strict=True):
        assert abs(float(Fraction(mapped) - exact_reference_s(fit, t))) <= digit
    ordered = np.sort(times)
    assert np.all(np.diff(fit.to_reference(ordered)) >= 0)
    assert np.abs(fit.to_camera(fit.to_reference(times)) - times).max() <= 1


def test_uncertainty_is_that_of_the_anchors_and_grows_outside() -> None:
    fit = fit_clock([Anchor(EPOCH_US, 5.0, 1e-3), Anchor(EPOCH_US + 20_000_000, 25.0, 1e-3)])
    middle, first, last, after = (
        float(fit.std_at(EPOCH_US + s * 1_000_000)) for s in (10, 0, 20, 60)
    )
    assert first == pytest.approx(1e-3)
    assert last == pytest.approx(1e-3)
    assert middle == pytest.approx(1e-3 / np.sqrt(2.0))
    assert after > 3e-3
    assert np.sqrt(fit.covariance[0, 0]) == pytest.approx(np.sqrt(2.0) * 1e-3 / 20.0)
    assert fit.residual_rms_s < 1e-9


def test_least_squares_agrees_with_a_plain_solution_and_its_covariance_with_scatter() -> None:
    rng, at, z = np.random.default_rng(1), EPOCH_US + 30_000_000, []
    for _ in range(300):
        t_us = EPOCH_US + np.sort(rng.integers(0, 60_000_000, 8))
        t_us[-1] = t_us[0] + 50_000_000
        since = (t_us - EPOCH_US) * 1e-6
        reference = 100.0 + (1.0 + 5e-5) * since + rng.normal(0.0, 1e-3, 8)
        anchors = map(Anchor, t_us.tolist(), reference.tolist(), [1e-3] * 8)
        fit = fit_clock([*anchors])
        assert abs(fit.a - np.polyfit(since, reference, 1)[0]) < 1e-10
        z.append((float(fit.to_reference(at)) - 130.0 - 5e-5 * 30.0) / float(fit.std_at(at)))
    assert fit.method == 'least_squares'
    assert 0.75 < np.std(z) < 1.1


def test_covariance_grows_when_anchors_scatter_more_than_they_claim() -> None:
    scatter = [0.004, -0.004, 0.004, -0.004, 0.004]
    fit = fit_clock([Anchor(10_000_000 * k, 10 * k + s, 1e-4) for k, s in enumerate(scatter)])
    assert float(fit.std_at(20_000_000)) > 1e-3
    assert fit.residual_rms_s == pytest.approx(0.004, rel=0.1)


def test_the_uncertainty_covers_a_drift_that_changes_in_an_hour() -> None:
    seconds = np.arange(3600)
    strayed = 1e-6 * 1800 / np.pi * np.sin(np.pi * seconds / 1800)
    noise = np.random.default_rng(2).normal(0.0, 2e-6, len(seconds))
    times = [EPOCH_US + 1_000_000 * k for k in seconds.tolist()]
    shown = (seconds + strayed + noise).tolist()
    fit = fit_clock([Anchor(t, r, 2e-6) for t, r in zip(times, shown, strict=True)])
    error = fit.to_reference(np.array(times)) - seconds - strayed
    assert np.mean(np.abs(error) < 1.96 * fit.std_at(np.array(times))) > 0.9


def test_refusals_name_the_reason() -> None:
    with pytest.raises(ShortBaselineError):
        fit_clock([Anchor(0, 0.0, 1e-3), Anchor(500_000, 0.5, 1e-3)])
    with pytest.raises(ShortBaselineError):
        fit_clock([Anchor(0, 0.0, 1e-3), Anchor(0, 0.0, 1e-3)], min_baseline_s=0.0)
    with pytest.raises(DriftError):
        fit_clock([Anchor(0, 0.0, 1e-5), Anchor(10_000_000, 10.01, 1e-5)])


@given(
    errors_s=st.lists(st.floats(-2e-3, 2e-3), min_size=2, max_size=5),
    std_ppm=st.floats(1.0, 500.0),
    seed=st.integers(0, 1000),
)
def test_a_prior_of_the_drift_is_one_more_measurement(
    errors_s: list[float], std_ppm: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    std_s = rng.uniform(2e-4, 1e-3, len(errors_s))
    camera_us = 1_000_000 * np.arange(len(errors_s)) * 10 + 12_345_678
    reference_s = 100.0 + 1e-6 * camera_us + np.array(errors_s)
    anchors = [Anchor(*each) for each in zip(camera_us.tolist(), reference_s, std_s, strict=True)]
    fit = fit_clock(anchors, max_drift=1.0)
    # Anchors that scatter widen the covariance; what follows takes it as it is.
    free = max(len(errors_s) - 2, 1)
    wider = max(1.0, float(np.sum((fit.residuals_s / std_s) ** 2)) / free)
    since = 1e-6 * (camera_us - fit.camera_epoch_us)
    rows = np.column_stack([since, np.ones(len(since))]) / (std_s * np.sqrt(wider))[:, None]
    seen = (reference_s - fit.reference_epoch_s) / (std_s * np.sqrt(wider))
    rows = np.vstack([rows, [1e6 / std_ppm, 0.0]])
    wanted = np.linalg.lstsq(rows, np.append(seen, 1e6 / std_ppm), rcond=None)[0]
    found = fit_clock(anchors, max_drift=1.0, drift_std=1e-6 * std_ppm)
    assert [found.a - 1.0, found.b] == pytest.approx([wanted[0] - 1.0, wanted[1]], abs=1e-8)
    assert found.covariance == pytest.approx(np.linalg.inv(rows.T @ rows), rel=1e-4, abs=1e-14)
    assert found.residuals_s == pytest.approx(reference_s - found.to_reference(camera_us), abs=1e-9)


@given(
    seconds=st.lists(st.integers(1, 40_000_000), min_size=1, max_size=5),
    drift=st.floats(-1e-4, 1e-4),
    offset=st.floats(0.0, 2e9),
)
def test_maps_come_back_exactly(seconds: list[int], drift: float, offset: float) -> None:
    camera = (EPOCH_US + np.cumsum([0, 2_000_000, *seconds])).tolist()
    fit = fit_clock(
        [Anchor(t, offset + (t - EPOCH_US) * 1e-6 * (1.0 + drift), 1e-3) for t in camera]
    )
    back = ClockFit.from_fields(fit.to_fields())
    times = EPOCH_US + np.arange(-50, 50) * 1_234_567
    assert np.array_equal(back.to_reference(times), fit.to_reference(times))
    assert np.array_equal(back.std_at(times), fit.std_at(times))
    assert back.method == fit.method
    stamps = np.round(1e9 * fit.to_reference(times)).astype(np.int64)
    assert np.abs(fit.stamp_to_camera_us(stamps) - times).max() < 1.0
    assert [a.camera_us for a in back.anchors] == [a.camera_us for a in fit.anchors]
    assert back.residual_rms_s == pytest.approx(fit.residual_rms_s)


@pytest.mark.parametrize(
    ('name', 'value'),
    [
        ('a', 0.0),
        ('a', float('nan')),
        ('b', float('inf')),
        ('camera_anchors', [float('nan'), 9.0]),
        ('reference_anchors', ['soon', 'later']),
    ],
)
def test_fields_that_are_no_map_are_refused(name: str, value: object) -> None:
    fields = fit_clock([Anchor(0, 7.5, 1e-3), Anchor(9_000_000, 16.5, 1e-3)]).to_fields()
    with pytest.raises(AlignmentError):
        ClockFit.from_fields({**fields, name: value})
