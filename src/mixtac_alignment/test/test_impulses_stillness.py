# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The moment of stillness against pixels that fire by thresholds, as real ones do."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_alignment.histories import EventCounts
from mixtac_alignment.impulses import find_event_impulses, stillness

if TYPE_CHECKING:
    from collections.abc import Callable

PEAK_S = 0.1
STEP_S = 1e-4


def sharp(phase: np.ndarray) -> np.ndarray:
    """Return the depth of a tap that begins and ends at full speed, 1 at phase 0."""
    return np.cos(np.pi * phase)


def smooth(phase: np.ndarray) -> np.ndarray:
    """Return the depth of a tap whose force rises and falls smoothly, as an arm would tap."""
    u = 1.0 - 2.0 * np.abs(phase)
    return np.sqrt(u * u * (3.0 - 2.0 * u))


def tap_events(
    shape: Callable[[np.ndarray], np.ndarray],
    depth_mm: float,
    tap_s: float,
    release: float,
    seed: int,
) -> np.ndarray:
    """Return event times [us] of 2000 pixels whose log intensity follows a tap's depth.

    Each pixel remembers the level of its last event and fires per threshold of change, either way.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 2.0 * PEAK_S, STEP_S)
    phase = (t - PEAK_S) / tap_s
    phase = np.clip(np.where(phase > 0.0, phase / release, phase), -0.5, 0.5)
    gain = rng.normal(0.0, 3.0, 2000)
    threshold = 0.2 * rng.lognormal(0.0, 0.1, 2000)
    memory = rng.uniform(-0.5, 0.5, 2000) * threshold
    times = []
    for now, deep in zip(t, depth_mm * shape(phase), strict=True):
        fired = np.trunc((gain * deep - memory) / threshold)
        memory += fired * threshold
        times.append(np.full(int(np.abs(fired).sum()), now))
    noise = rng.uniform(0.0, 2.0 * PEAK_S, 2000)
    return np.sort(np.rint(np.concatenate([*times, noise]) * 1e6).astype(np.int64))


@pytest.mark.parametrize('release', [1.0, 1.8])
@pytest.mark.parametrize('depth_mm', [0.3, 0.9])
@pytest.mark.parametrize(
    ('shape', 'tap_s'), [(sharp, 0.010), (sharp, 0.020), (smooth, 0.020), (smooth, 0.040)]
)
def test_the_moment_is_that_of_the_largest_depth(
    shape: Callable[[np.ndarray], np.ndarray], depth_mm: float, tap_s: float, release: float
) -> None:
    t_us = tap_events(shape, depth_mm, tap_s, release, seed=int(1e4 * depth_mm * tap_s))
    counts = EventCounts.of(t_us)
    impulse = max(find_event_impulses(counts), key=lambda i: i.strength)
    error_s = 1e-6 * counts.start_us + impulse.time_s - PEAK_S
    assert abs(error_s) < 2e-4 + 0.015 * tap_s
    assert abs(error_s) < 3.0 * impulse.std_s


@given(
    slope=st.floats(10.0, 1e4),
    stop=st.floats(40.0, 44.0),
    rest=st.floats(0.0, 1e3),
)
def test_a_straight_flank_runs_out_exactly(slope: float, stop: float, rest: float) -> None:
    at = np.arange(80) + 0.5
    falling = slope * np.clip(stop - at, 0.0, 15.0) * (at > 15.0)
    rising = slope * np.clip(at - stop - 6.0, 0.0, 15.0)
    rate = rest + falling + rising
    trough = 46
    position, std = stillness(rate, rate, trough, 10.0 * slope, rest)
    assert position == pytest.approx(stop, abs=0.05)
    assert std < 0.2


@given(
    rate=st.lists(st.floats(0.0, 1e6), min_size=8, max_size=60),
    share=st.floats(0.1, 1.0),
)
def test_it_is_a_number_near_the_trough_for_any_rate(rate: list[float], share: float) -> None:
    values = np.array(rate)
    trough = int(np.argmin(values))
    left = values[: trough + 1].max() - values[trough]
    if left < 1.0:
        return
    position, std = stillness(values, values, trough, share * left, float(values[trough]))
    assert 0.0 <= position <= 2 * len(values)
    assert std >= 0.0
    assert np.isfinite(std)
