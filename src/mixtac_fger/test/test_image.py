# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Image messages in all layouts that a publisher may choose."""

from __future__ import annotations

from array import array

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_fger.errors import ImageError
from mixtac_fger.image import pixels


@given(
    st.integers(1, 12),
    st.integers(1, 12),
    st.integers(0, 5),
    st.booleans(),
    st.sampled_from(['mono8', 'mono16', '8UC1', '16UC1']),
    st.integers(0, 99),
)
def test_pixels_survive_padding_and_byte_order(height, width, pad, big_endian, encoding, seed):
    wide = '16' in encoding
    kind = np.dtype(np.uint16 if wide else np.uint8)
    image = np.random.default_rng(seed).integers(0, 2 ** (8 * kind.itemsize), (height, width))
    raw = image.astype(kind.newbyteorder('>' if big_endian else '<')).view(np.uint8)
    rows = np.pad(raw.reshape(height, -1), ((0, 0), (0, pad)), constant_values=0xAB)
    data = array('B', rows.tobytes())
    out = pixels(data, encoding, height, width, rows.shape[1], big_endian=big_endian)
    assert np.array_equal(out, image)
    assert out.dtype == kind
    assert out.dtype.isnative


def test_an_image_without_padding_is_not_copied():
    data = array('B', bytes(24))
    assert pixels(data, 'mono16', 3, 4, 8, big_endian=False).base is not None


@pytest.mark.parametrize(
    ('encoding', 'height', 'step', 'size', 'text'),
    [
        ('rgb8', 2, 12, 24, "encoding 'rgb8'"),
        ('mono16', 2, 7, 16, 'step 7'),
        ('mono8', 3, 4, 11, '11 bytes'),
    ],
)
def test_images_that_contradict_themselves_are_refused(encoding, height, step, size, text):
    with pytest.raises(ImageError, match=text):
        pixels(bytes(size), encoding, height, 4, step, big_endian=False)
