# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Masked pixels: which the camera takes, which the host."""

from __future__ import annotations

import os

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_driver.errors import ConfigurationError
from mixtac_driver.pixels import PixelMask, load_mask, mask_of_image, save_mask
from mixtac_events.arrays import Events
from mixtac_node.files import FileError

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
    kept = mask.keep(events, SIZE)
    expected = [i for i, pixel in enumerate(seen) if pixel not in set(masked)]
    np.testing.assert_array_equal(kept.t, expected)
    for name in ('x', 'y', 'polarity'):
        np.testing.assert_array_equal(getattr(kept, name), getattr(events, name)[expected])
    assert mask.dropped == len(seen) - len(expected)


def test_buffers_are_kept_for_shorter_batches():
    mask = PixelMask([(1, 1)], SIZE)
    assert len(mask.keep(events_at([(0, 0)] * 100), SIZE)) == 100
    assert len(mask.keep(events_at([(1, 1), (2, 2)]), SIZE)) == 1
    assert mask.dropped == 1


def test_addresses_outside_the_array_are_not_looked_up():
    outside = events_at([(65535, 65535), (346, 0), (0, 260)])
    assert len(PixelMask([(1, 1)], SIZE).keep(outside, SIZE)) == 3


def test_a_mask_of_another_size_has_no_effect():
    assert len(PixelMask([(1, 1)], SIZE).keep(events_at([(1, 1)]), (240, 180))) == 1


def test_the_camera_takes_the_first_eight():
    pixels = [(k, k) for k in range(20)]
    mask = PixelMask([*pixels, (0, 0)], SIZE)
    assert mask.in_camera == tuple(pixels[:8])
    assert len(mask.pixels) == 20


def test_images_keep_the_mask_and_which_pixels_come_first(tmp_path):
    pixels = [(300 - k, 200 + k) for k in range(20)]
    path = str(tmp_path / 'mask.png')
    save_mask(PixelMask(pixels, SIZE), path)
    mask = load_mask(path)
    assert set(mask.pixels) == set(pixels)
    assert set(mask.in_camera) == set(pixels[:8])


def test_brighter_is_noisier():
    image = np.zeros((260, 346), np.uint8)
    image[5, 7], image[9, 8], image[0, 0] = 10, 200, 100
    assert mask_of_image(image).pixels == ((8, 9), (0, 0), (7, 5))


def test_no_path_is_no_mask():
    assert load_mask('').pixels == ()


def test_a_mask_is_a_file(tmp_path):
    pipe = str(tmp_path / 'pipe.png')
    os.mkfifo(pipe)
    for path in (pipe, str(tmp_path), f'{tmp_path}\0'):
        with pytest.raises(ConfigurationError):
            load_mask(path)


def test_files_that_are_no_masks_are_refused(tmp_path):
    import cv2

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
    (tmp_path / 'notes.png').write_text('mine')
    with pytest.raises(ConfigurationError):
        save_mask(PixelMask([(0, 0)], SIZE), str(tmp_path / 'notes.png'))
    assert (tmp_path / 'notes.png').read_text() == 'mine'
    with pytest.raises(ConfigurationError):
        save_mask(PixelMask(), str(tmp_path / 'mask.foo'))
    with pytest.raises(ConfigurationError):
        PixelMask([(346, 0)], SIZE)
