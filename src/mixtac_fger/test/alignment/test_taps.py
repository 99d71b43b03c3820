# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Times of taps against made-up pixels whose taps are known.

The pixels are simulated here one by one, with thresholds and gains of their own; nothing of them
comes from the model under test.
"""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_fger.alignment import taps
from mixtac_fger.alignment.histories import CellEvents
from mixtac_fger.alignment.taps import (
    TapModel,
    brightening,
    common_course,
    even_force,
    tap_signal,
)

CELLS = 60


def force_at(t: np.ndarray, tap_s: float) -> np.ndarray:
    """Return a tap of 1.5 N about time 0 [N]."""
    return 1.5 * np.cos(np.pi * np.clip(t / tap_s, -0.5, 0.5)) ** 2


def pixels(
    rng: np.random.Generator, tap_s: float, delay_s: float, before: float = 0.0
) -> tuple[CellEvents, np.ndarray]:
    """Return the events of pixels that see the depth, and how each cell brightens.

    A share of them, `before`, has seen the same tap already.
    """
    t = np.arange(-0.1, 0.15, 5e-5)
    depth = np.sqrt(force_at(t - delay_s, tap_s))
    gains = rng.normal(0.0, 1.0, CELLS)
    drawn = []
    for gain in np.repeat(gains, 12):
        on, off = rng.normal(0.21, 0.03), rng.normal(0.27, 0.04)
        slope, last = gain * rng.uniform(0.7, 1.3), rng.uniform(-off, on)
        drawn.append((on, off, slope, last, rng.random() < before))
    on, off, slope, last, loaded = np.array(drawn).T

    def crossed(value: float, seeing: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        change = slope * value - last
        rise = seeing & (change >= on)
        fall = seeing & ~rise & (change <= -off)
        last[rise] += on[rise]
        last[fall] -= off[fall]
        return rise, fall

    if before:
        for value in depth:
            crossed(value, loaded > 0)
    seen = np.array([crossed(value, loaded >= 0) for value in depth])
    step, falls, pixel = np.nonzero(seen)
    order = np.lexsort((1 - falls, pixel // 12, step))
    times = np.round(1e6 * t[step[order]]).astype(np.int64) + 1_000_000
    cells = (pixel[order] // 12).astype(np.uint16)
    return CellEvents(times, cells, falls[order] == 0), gains


@pytest.fixture(autouse=True)
def rigid_gel(monkeypatch: pytest.MonkeyPatch) -> None:
    """The depth of the made-up pixels follows the force at once."""
    monkeypatch.setattr(taps, 'LAG_WEIGHTS', (0.0,) * len(taps.LAG_WEIGHTS))


def test_the_elastic_part_of_a_step_lags_it() -> None:
    taps.LAG_WEIGHTS = (0.26, 0.26, 0.035, 0.035, 0.03)
    t = np.arange(0.0, 0.3, 1.0 / 800.0)
    step = (t > 0.05).astype(float)
    at = np.arange(0.01, 0.29, taps.STEP_S)
    found = taps.elastic_force(t, step, at)
    first, later = (float(found[np.searchsorted(at, s)]) for s in (0.052, 0.2))
    # Solid after all short responses have ended: what the two slowest leave.
    assert first < 0.8 < later
    assert later == pytest.approx(1.0 - 0.035 - 0.03, abs=0.03)


def model_of(tap_s: float, *, loaded: bool = False) -> TapModel:
    t = np.arange(-0.3, 0.3, 1.0 / 800.0)
    return TapModel(t, force_at(t, tap_s), 0.0, loaded=loaded)


@pytest.mark.parametrize(('tap_s', 'delay_s'), [(0.03, 0.0), (0.024, 0.004), (0.04, -0.006)])
def test_taps_are_timed_to_a_fraction_of_a_millisecond(tap_s: float, delay_s: float) -> None:
    events, gains = pixels(np.random.default_rng(3), tap_s, delay_s)
    found = model_of(tap_s).fit(*tap_signal(events, 1_000_000, gains))
    assert found.misfit < 0.15
    # The model's pixels have a time constant of 0.5 ms, those made up here have none.
    assert found.delay_s + 0.5e-3 == pytest.approx(delay_s, abs=4e-4)


def test_pixels_that_come_back_from_a_load_are_not_taken_for_late_ones() -> None:
    errors = []
    for seed in range(4):
        events, gains = pixels(np.random.default_rng(seed), 0.03, 0.0, before=0.5)
        signal = tap_signal(events, 1_000_000, gains)
        errors.append(
            [
                model_of(0.03, loaded=loaded).fit(*signal).delay_s + 0.5e-3
                for loaded in (False, True)
            ]
        )
    fresh, loaded = np.mean(errors, axis=0)
    assert fresh > loaded + 1e-4
    assert abs(loaded) < 4e-4


def test_without_frames_the_cells_common_course_times_the_tap() -> None:
    events, gains = pixels(np.random.default_rng(4), 0.03, 0.002)
    common = common_course(events, 1_000_000, CELLS)
    assert abs(np.corrcoef(common, np.sign(gains))[0, 1]) > 0.6
    fits = [model_of(0.03).fit(*tap_signal(events, 1_000_000, s * common)) for s in (1, -1)]
    best = min(fits, key=lambda fit: fit.misfit)
    assert best.delay_s + 0.5e-3 == pytest.approx(0.002, abs=6e-4)


def test_events_of_another_course_are_left_over() -> None:
    rng = np.random.default_rng(5)
    times, cells = np.sort(rng.integers(900_000, 1_150_000, 5000)), rng.integers(0, CELLS, 5000)
    noise = CellEvents(times, cells.astype(np.uint16), rng.random(5000) < 0.5)
    assert model_of(0.03).fit(*tap_signal(noise, 1_000_000, rng.normal(size=CELLS))).misfit > 0.65


def test_cells_that_follow_the_depth_weigh_more_than_noise() -> None:
    rng = np.random.default_rng(6)
    depth = rng.uniform(0.0, 1.0, 200)
    values = rng.normal(0.0, 0.05, (200, 3))
    values[:, 0] += 0.5 * depth
    values[:, 1] -= 0.3 * depth
    weight = brightening(values.astype(np.float32), depth)
    assert weight[0] > 0.0 > weight[1]
    assert abs(weight[2]) < 0.1 * abs(weight[1])


def test_noise_goes_and_a_tap_stays_where_it_was() -> None:
    t = np.arange(0.0, 4.0, 1.25e-3)
    tap = 2.0 * np.exp(-0.5 * ((t - 2.0) / 0.006) ** 2)
    even, force = even_force(t, tap + np.random.default_rng(0).normal(0.0, 0.02, len(t)))
    assert np.allclose(np.diff(even), 1.25e-3)
    assert np.std((force - np.interp(even, t, tap))[even < 1.8]) < 0.006
    assert force.max() == pytest.approx(2.0, abs=0.1)
    assert even[np.argmax(force)] == pytest.approx(2.0, abs=2e-3)
