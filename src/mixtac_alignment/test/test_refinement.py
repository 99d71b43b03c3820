# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The refinement against made-up frames of a layer whose lag, offset and drift are known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mixtac_alignment.align import Recording, align
from mixtac_alignment.clock_fit import Anchor, ClockFit, fit_clock
from mixtac_alignment.errors import (
    DriftError,
    InconsistentFitError,
    NoImpulseError,
    RefinementError,
)
from mixtac_alignment.gel_lag import TIMES_S, GelLag
from mixtac_alignment.histories import CellEvents, EventCounts, FrameFeatures, reduce_frame
from mixtac_alignment.refinement import refine

RATE, OFFSET_S, WEIGHT, TIME_S = 1.0 + 40e-6, 2.3456, 0.26, 3.26e-3
SECONDS = 20.0
FINE = np.arange(0.0, SECONDS, 2.5e-4)


def force_at(t: np.ndarray) -> np.ndarray:
    """Return a force with slow swings and blows of 6 ms [N]."""
    swing = 0.5 + 0.25 * np.sin(2.0 * np.pi * 1.7 * t) + 0.15 * np.sin(2.0 * np.pi * 3.1 * t + 1.0)
    blows = sum(2.0 * np.exp(-0.5 * ((t - at) / 3e-3) ** 2) for at in np.arange(0.7, 19.5, 0.31))
    return np.asarray(swing + blows)


def elastic_at_fine() -> np.ndarray:
    """Return the elastic part of it: F = F_e + h, dh/dt = -h / tau + g dF_e/dt, by small steps."""
    g, tau, step = WEIGHT / (1.0 - WEIGHT), TIME_S, FINE[1] - FINE[0]
    force, elastic, h = force_at(FINE), np.zeros_like(FINE), 0.0
    elastic[0] = force[0]
    for k in range(1, len(FINE)):
        decay = np.exp(-step / tau)
        gain = g * tau / step * (1.0 - decay)
        elastic[k] = (force[k] - decay * h + gain * elastic[k - 1]) / (1.0 + gain)
        h = decay * h + gain * (elastic[k] - elastic[k - 1])
    return elastic


def recording(seed: int = 1, jump_s: float = 0.0) -> tuple[FrameFeatures, np.ndarray, np.ndarray]:
    """Return frames, force times [s] and force [N]."""
    rng = np.random.default_rng(seed)
    start = np.arange(0.05, SECONDS - 0.1, 0.04)
    integral = np.concatenate([[0.0], np.cumsum(elastic_at_fine())]) * (FINE[1] - FINE[0])
    grid = np.append(FINE, SECONDS)
    mean = (np.interp(start + 7e-3, grid, integral) - np.interp(start, grid, integral)) / 7e-3
    shades = np.outer(mean, rng.normal(0.0, 1.0, 60)) + np.outer(mean**2, rng.normal(0.0, 0.3, 60))
    values = (shades + rng.normal(0.0, 0.004, shades.shape)).astype(np.float32)
    camera = start + np.where(start > 10.0, jump_s, 0.0)
    us = np.rint(camera * 1e6).astype(np.int64)
    frames = FrameFeatures(us, us + 7000, values)
    shown = np.arange(0.01, SECONDS - 0.01, 1.0 / 800.0)
    measured = force_at(shown) + rng.normal(0.0, 0.01, len(shown))
    return frames, RATE * shown + OFFSET_S, measured


def first_fit(error_s: float = 1.5e-3) -> ClockFit:
    """Return a map as two impulses give it, with an error."""
    anchors = [
        Anchor(round(t * 1e6), RATE * t + OFFSET_S + error_s, 0.6e-3) for t in (0.5, SECONDS - 0.5)
    ]
    return fit_clock(anchors, common_std_s=1e-3)


def whole(scene: Any) -> Recording:
    """Return the recording of a scene, without frames and edges."""
    events, t_s, force = scene.recording()
    return Recording(
        counts=EventCounts.of(events),
        events=CellEvents(events, np.zeros(len(events), np.uint16), np.ones(len(events), np.bool_)),
        frames=None,
        force_t_s=t_s,
        force=force,
        edges_us=np.zeros(0, np.int64),
        reference_edges_s=np.zeros(0),
    )


@pytest.mark.parametrize('error_s', [-2e-3, 0.0, 2e-3])
def test_offset_drift_and_lag_of_the_gel_are_found(error_s: float) -> None:
    frames, t_s, force = recording()
    refined = refine(first_fit(error_s), frames, t_s, force)
    times = np.linspace(0.0, SECONDS * 1e6, 21).astype(np.int64)
    errors = refined.fit.to_reference(times) - (RATE * times * 1e-6 + OFFSET_S)
    assert np.abs(errors).max() < 2e-4
    assert np.all(np.abs(errors) < 3.0 * refined.fit.std_at(times))
    assert refined.fit.method == 'refined'
    assert len(refined.fit.residuals_s) == 2


def test_what_is_stated_shrinks_with_the_trial() -> None:
    frames, t_s, force = recording()
    whole = refine(first_fit(), frames, t_s, force)
    half = FrameFeatures(frames.start_us[:250], frames.end_us[:250], frames.values[:250])
    part = refine(first_fit(), half, t_s, force)
    end_us = round(SECONDS * 1e6)
    assert whole.fit.std_at(end_us) < part.fit.std_at(end_us)
    assert whole.lag.std[1] < 0.06


def test_a_clock_that_jumps_is_refused() -> None:
    frames, t_s, force = recording(jump_s=5e-3)
    with pytest.raises((InconsistentFitError, DriftError)):
        refine(first_fit(), frames, t_s, force)


def test_a_first_map_that_is_wrong_is_refused() -> None:
    frames, t_s, force = recording()
    with pytest.raises((InconsistentFitError, DriftError)):
        refine(first_fit(0.4), frames, t_s, force)


def test_frames_that_are_few_or_still_refine_nothing() -> None:
    frames, t_s, force = recording()
    few = FrameFeatures(frames.start_us[:50], frames.end_us[:50], frames.values[:50])
    with pytest.raises(RefinementError):
        refine(first_fit(), few, t_s, force)
    with pytest.raises(RefinementError):
        refine(first_fit(), frames, t_s, np.zeros_like(force))


def test_without_frames_the_impulses_decide(scene: type) -> None:
    made = whole(scene())
    fit, refined = align(made)
    assert refined is None
    assert fit.method == 'two_impulse'
    assert align(made, method='paper')[0].to_fields() == fit.to_fields()


def test_a_recording_without_edges_has_no_map_by_edges(scene: type) -> None:
    with pytest.raises(NoImpulseError) as caught:
        align(whole(scene()), method='edges')
    assert caught.value.remedy


def test_a_frame_is_reduced_to_the_log_of_its_cells() -> None:
    image = np.full((260, 346), 500, np.uint16)
    image[:10, :10] = 0
    values = reduce_frame(image, 1000.0)
    assert values.shape == (26 * 34,)
    assert values[0] == pytest.approx(np.log(0.008), abs=1e-5)
    assert values[1] == pytest.approx(np.log(0.508), abs=1e-5)


def test_the_lag_of_another_trial_narrows_the_result() -> None:
    frames, t_s, force = recording()
    known = refine(first_fit(), frames, t_s, force)
    again = refine(first_fit(), frames, t_s, force, known.lag)
    assert again.lag.std[1] <= known.lag.std[1]
    assert fast_lag_s(again.lag) == pytest.approx(fast_lag_s(known.lag), abs=2e-4)


def fast_lag_s(lag: GelLag) -> float:
    """Return the lag of slow deformation due to the two shortest times [s]."""
    return TIMES_S[0] * lag.mean[0] + TIMES_S[1] * (lag.mean[1] + lag.mean[2])
