# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The fit from recordings: accuracy against the known clocks, and every refusal."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mixtac_alignment.errors import (
    AlignmentError,
    AmbiguousImpulsesError,
    NoImpulseError,
    SaturatedImpulseError,
    ShortBaselineError,
)
from mixtac_alignment.histories import EventCounts
from mixtac_alignment.two_impulse import fit_counts


def fit_two_impulses(events: np.ndarray, t: np.ndarray, force: np.ndarray) -> Any:
    return fit_counts(EventCounts.of(events), t, force)


def errors_ms(fit: Any, scene: Any) -> np.ndarray:
    t = np.linspace(0.0, scene.seconds, 50)
    camera = np.array([scene.camera_us(float(s)) for s in t])
    return 1e3 * (fit.to_reference(camera) - scene.reference_s(t))


@pytest.mark.parametrize('seed', range(6))
@pytest.mark.parametrize('drift', [-9e-5, 9e-5])
def test_the_known_clocks_are_found(scene: Any, seed: int, drift: float) -> None:
    rng = np.random.default_rng(seed)
    case = scene(
        seed=seed,
        drift=drift,
        taps_s=(0.8 + rng.uniform(), 23.5 + rng.uniform()),
        heights=tuple(rng.uniform(1.5, 5.0, 2)),
        tap_s=float(rng.uniform(0.008, 0.03)),
        noise=0.03,
    )
    fit = fit_two_impulses(*case.recording())
    assert fit.method == 'two_impulse'
    assert len(fit.anchors) == 2
    assert np.abs(errors_ms(fit, case)).max() < 1.0
    assert abs(fit.drift_ppm - drift * 1e6) < 60.0


def test_stated_uncertainty_covers_the_error(scene: Any) -> None:
    for seed in range(25):
        case = scene(seed=seed, tap_s=0.02, presses=False)
        fit = fit_two_impulses(*case.recording())
        for t in case.taps_s:
            std_ms = 1e3 * float(fit.std_at(case.camera_us(t)))
            error_ms = 1e3 * float(
                fit.to_reference(case.camera_us(t)) - case.reference_s(np.array(t))
            )
            assert abs(error_ms) < 2.0 * std_ms
            assert std_ms < 1.0


def test_pressing_may_be_negative(scene: Any) -> None:
    events, t, force = scene().recording()
    plus, minus = fit_two_impulses(events, t, force), fit_two_impulses(events, t, 4.0 - force)
    assert plus.a == pytest.approx(minus.a, abs=1e-12)


def test_more_taps_are_fitted_by_least_squares_where_asked(scene: Any) -> None:
    case = scene(taps_s=(1.0, 1.9, 12.1, 24.0), heights=(3.0, 2.5, 2.8, 3.1))
    events, t, force = case.recording()
    fit = fit_counts(EventCounts.of(events), t, force, use_all=True)
    assert len(fit.anchors) == 4
    assert fit.method == 'least_squares'
    assert np.abs(errors_ms(fit, case)).max() < 1.0
    assert len(fit_two_impulses(events, t, force).anchors) == 2


def test_recordings_that_start_and_end_apart_still_match(scene: Any) -> None:
    case = scene(taps_s=(2.0, 5.3, 23.0), heights=(3.0, 2.5, 3.0))
    events, t, force = case.recording()
    late = t > case.reference_s(np.array(3.0))
    fit = fit_two_impulses(events, t[late], force[late])
    assert np.abs(errors_ms(fit, case)).max() < 1.5
    assert fit.anchors[0].camera_us == pytest.approx(case.camera_us(5.3), abs=1000)


def test_no_impulse_is_refused(scene: Any) -> None:
    with pytest.raises(NoImpulseError):
        fit_two_impulses(*scene(taps_s=(), heights=()).recording())
    with pytest.raises(NoImpulseError):
        fit_two_impulses(*scene(taps_s=(2.0,), heights=(3.0,)).recording())
    events, t, force = scene().recording()
    rng = np.random.default_rng(0)
    still = np.sort(rng.integers(events[0], events[-1], 500_000))
    with pytest.raises(NoImpulseError):
        fit_two_impulses(still, t, force)


def test_taps_of_another_recording_are_refused(scene: Any) -> None:
    events, _, _ = scene().recording()
    _, t, force = scene(taps_s=(1.2, 20.1)).recording()
    with pytest.raises(NoImpulseError):
        fit_two_impulses(events, t, force)


def test_evenly_spaced_taps_missing_from_one_side_are_ambiguous(scene: Any) -> None:
    case = scene(taps_s=(2.0, 12.0, 22.0), heights=(3.0, 3.0, 3.0), presses=False)
    events, t, force = case.recording()
    cut = t < case.reference_s(np.array(15.0))
    with pytest.raises(AmbiguousImpulsesError):
        fit_two_impulses(events, t[cut], force[cut])


def test_cut_off_peaks_are_refused(scene: Any) -> None:
    with pytest.raises(SaturatedImpulseError):
        fit_two_impulses(*scene(limit=1.5, tap_s=0.03).recording())


def test_taps_close_together_are_refused(scene: Any) -> None:
    case = scene(taps_s=(2.0, 3.1), presses=False)
    with pytest.raises(ShortBaselineError):
        fit_two_impulses(*case.recording())


def test_lost_packets_are_not_taken_for_a_trough(scene: Any) -> None:
    events, t, force = scene().recording()
    counts = EventCounts.of(events)
    bins = (scene().camera_us(24.0) - counts.start_us) // counts.width_us
    lost = EventCounts(counts.start_us, counts.width_us, counts.counts, ((bins - 2, bins + 2),))
    with pytest.raises(NoImpulseError):
        fit_counts(lost, t, force)


def test_arrays_that_are_no_recording_are_refused(scene: Any) -> None:
    events, t, force = scene(seconds=3.0, taps_s=(), heights=()).recording()
    with pytest.raises(AlignmentError):
        fit_two_impulses(events[:0], t, force)
    with pytest.raises(AlignmentError):
        fit_two_impulses(events, t[:0], force[:0])
    with pytest.raises(AlignmentError):
        fit_two_impulses(events, t, force[1:])
    with pytest.raises(AlignmentError):
        fit_two_impulses(events, t[::-1], force)
    with pytest.raises(AlignmentError):
        fit_two_impulses(events, t, np.where(t > t[5], np.nan, force))
