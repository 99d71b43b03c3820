# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Finding hot pixels among noise and moving edges."""

from __future__ import annotations

import numpy as np

from mixtac_driver.pixels import PixelCounter, hot_pixels
from mixtac_events.arrays import Events

HOT = [(10, 20), (11, 20), (0, 0), (345, 259), (200, 100)]


def counts_with(rates, background_hz=1.0, seconds=2.0, seed=1):
    rng = np.random.default_rng(seed)
    rate = np.full((260, 346), background_hz)
    for (column, row), hz in rates.items():
        rate[row, column] = hz
    return rng.poisson(rate * seconds)


def test_the_hot_pixels_are_found_the_noisiest_first():
    rates = dict(zip(HOT, [5000, 2000, 1000, 300, 100], strict=True))
    assert hot_pixels(counts_with(rates), 2.0, 10.0, 10.0) == HOT


def test_noise_alone_has_no_hot_pixels():
    for background in (0.1, 1.0, 10.0, 100.0):
        for seconds in (0.1, 2.0):
            counts = counts_with({}, background, seconds)
            assert hot_pixels(counts, seconds, 10.0, 10.0) == []


def test_edges_and_flickering_lights_are_not_hot():
    counts = counts_with({(300, 200): 3000})
    counts[100, :] += 400
    np.fill_diagonal(counts[:, 40:], 500)
    counts[150:200, 50:90] += 900
    assert hot_pixels(counts, 2.0, 10.0, 10.0) == [(300, 200)]


def test_quiet_pixels_stay_whatever_is_around():
    assert hot_pixels(counts_with({(5, 5): 8}, background_hz=0.0), 2.0, 10.0, 10.0) == []


def events(pixels):
    x, y = np.array(pixels, np.uint16).reshape(-1, 2).T
    return Events(np.zeros(len(x), np.int64), x.copy(), y.copy(), np.zeros(len(x), np.bool_))


def test_counting_begins_after_the_first_stretch_and_ends_in_time():
    counter = PixelCounter(1000, (346, 260))
    counter.add(events([(1, 1)] * 50), 10_000)
    counter.add(events([(1, 2), (345, 259), (1, 2)]), 10_500)
    assert not counter.done.is_set()
    counter.add(events([(1, 2)]), 11_000)
    assert counter.done.is_set()
    counter.add(events([(1, 2)]), 11_500)
    assert counter.counts.sum() == 4
    assert counter.counts[2, 1] == 3
    assert counter.counts[259, 345] == 1
