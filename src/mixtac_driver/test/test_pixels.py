# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Masked pixels, by the camera and by the host, and finding hot ones among noise and edges."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_core.events.arrays import Events
from mixtac_core.events.readings import NO_EDGES, NO_SAMPLES, DecodedBatch
from mixtac_core.node.files import FileError
from mixtac_driver.camera import CameraBatch
from mixtac_driver.clock import Origin
from mixtac_driver.errors import ConfigurationError
from mixtac_driver.pixels import PixelCounter, PixelMask, hot_pixels, load_mask, save_mask

SIZE = (346, 260)
PIXELS = st.tuples(st.integers(0, 345), st.integers(0, 259))


def events_at(pixels):
    x, y = np.array(pixels, np.uint16).reshape(-1, 2).T
    t = np.arange(len(x), dtype=np.int64)
    return Events(t, np.ascontiguousarray(x), np.ascontiguousarray(y), t % 2 == 0)


@given(st.lists(PIXELS, max_size=12), st.lists(PIXELS, max_size=50))
def test_events_of_masked_pixels_are_dropped_and_counted(masked, seen):
    mask = PixelMask(masked, SIZE)
    events = events_at(seen)
    kept = mask.keep(events)
    expected = [i for i, pixel in enumerate(seen) if pixel not in set(masked)]
    np.testing.assert_array_equal(kept.t, expected)
    for name in ('x', 'y', 'polarity'):
        np.testing.assert_array_equal(getattr(kept, name), getattr(events, name)[expected])
    assert mask.dropped == len(seen) - len(expected)


def test_images_keep_the_mask_and_which_pixels_come_first(tmp_path):
    pixels = [(300 - k, 200 + k) for k in range(20)]
    path = str(tmp_path / 'mask.png')
    save_mask(PixelMask(pixels, SIZE), path)
    mask = load_mask(path)
    assert set(mask.pixels) == set(pixels)
    assert set(mask.in_camera) == set(pixels[:8])


def test_files_that_are_no_masks_are_refused(tmp_path):
    small, colour = str(tmp_path / 'small.png'), str(tmp_path / 'colour.png')
    cv2.imwrite(small, np.full((10, 10), 9, np.uint8))
    cv2.imwrite(colour, np.zeros((260, 346, 3), np.uint8))
    with pytest.raises(ConfigurationError) as error:
        load_mask(small).check_size(SIZE)
    assert '346 x 260' in error.value.remedy
    with pytest.raises(ConfigurationError):
        load_mask(colour)
    with pytest.raises(ConfigurationError):
        load_mask(str(tmp_path / 'none.png'))
    with pytest.raises(FileError):
        save_mask(PixelMask([(0, 0)], SIZE), f'{small}/mask.png')
    with pytest.raises(ConfigurationError):
        PixelMask([(346, 0)], SIZE)


HOT = [(10, 20), (11, 20), (0, 0), (345, 259), (200, 100)]


def counts_with(rates, background_hz=1.0, seconds=2.0, seed=1):
    rng = np.random.default_rng(seed)
    rate = np.full((260, 346), background_hz)
    for (column, row), hz in rates.items():
        rate[row, column] = hz
    return rng.poisson(rate * seconds)


def test_the_hot_pixels_are_found_the_noisiest_first():
    rates = dict(zip(HOT, [5000, 2000, 1000, 300, 100], strict=True))
    assert hot_pixels(counts_with(rates), 2.0) == HOT


def test_noise_alone_has_no_hot_pixels():
    for background in (0.1, 1.0, 10.0, 100.0):
        for seconds in (0.1, 2.0):
            counts = counts_with({}, background, seconds)
            assert hot_pixels(counts, seconds) == []


def test_edges_and_flickering_lights_are_not_hot():
    counts = counts_with({(300, 200): 3000})
    counts[100, :] += 400
    np.fill_diagonal(counts[:, 40:], 500)
    counts[150:200, 50:90] += 900
    assert hot_pixels(counts, 2.0) == [(300, 200)]


def test_counting_begins_after_the_first_stretch_and_ends_in_time():
    counter = PixelCounter(1000, SIZE)

    def add(pixels, time_us):
        decoded = DecodedBatch(events_at(pixels), (), NO_SAMPLES, NO_EDGES, time_us, 0)
        counter.add(CameraBatch(decoded, Origin(0, 0), 0))

    add([(1, 1)] * 50, 10_000)
    add([(1, 2), (345, 259), (1, 2)], 10_500)
    assert not counter.done.is_set()
    add([(1, 2)], 11_000)
    assert counter.done.is_set()
    add([(1, 2)], 11_500)
    assert counter.counts.sum() == 4
    assert counter.counts[2, 1] == 3
    assert counter.counts[259, 345] == 1
