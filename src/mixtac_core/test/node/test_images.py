# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Image messages to arrays: every encoding, padding and byte order, against sums done by hand."""

from __future__ import annotations

from array import array
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_core.node.images import (
    ENCODINGS,
    ImageConversionError,
    decompress_grey,
    fill,
    grey,
    picture,
    pixels,
)


def message_of(image: np.ndarray, encoding: str, *, padding: int = 0, big: bool = False):
    """Return an image message, written byte by byte."""
    ordered = image.astype(image.dtype.newbyteorder('>' if big else '<'))
    data = b''.join(row.tobytes() + b'\xee' * padding for row in ordered)
    height, width = image.shape[:2]
    return SimpleNamespace(
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=int(big),
        step=len(data) // height,
        data=array('B', data),
    )


def random_image(encoding: str, height: int = 6, width: int = 8, seed: int = 0) -> np.ndarray:
    dtype = np.uint16 if '16' in encoding else np.uint8
    shape = (height, width, 3) if encoding in ('rgb8', 'bgr8') else (height, width)
    return np.random.default_rng(seed).integers(0, np.iinfo(dtype).max + 1, shape).astype(dtype)


@given(
    encoding=st.sampled_from(ENCODINGS),
    height=st.integers(1, 7),
    width=st.integers(1, 7),
    padding=st.integers(0, 5),
    big=st.booleans(),
)
def test_pixels_survive_any_layout(encoding, height, width, padding, big):
    image = random_image(encoding, height, width)
    found = pixels(message_of(image, encoding, padding=padding, big=big))
    np.testing.assert_array_equal(found, image)
    assert found.dtype == image.dtype
    assert found.dtype.isnative


@pytest.mark.parametrize('encoding', ENCODINGS)
def test_white_stays_white_and_black_black(encoding):
    image = random_image(encoding)
    for value in (0, np.iinfo(image.dtype).max):
        message = message_of(np.full_like(image, value), encoding)
        found = grey(message)
        assert (found.shape, found.dtype) == (image.shape[:2], image.dtype)
        assert set(found.ravel()) == {value}
        shown = picture(message)
        plain = encoding in ('mono8', 'mono16', '8UC1', '16UC1')
        assert (shown.shape, shown.dtype) == (image.shape[:2] + (() if plain else (3,)), np.uint8)
        assert set(shown.ravel()) == {min(value, 255)}


@pytest.mark.parametrize('encoding', ['rgb8', 'bgr8'])
def test_colours_become_the_luma_of_the_standard_or_stay(encoding):
    image = random_image(encoding)
    rgb = image if encoding == 'rgb8' else image[..., ::-1]
    luma = rgb @ np.array([0.299, 0.587, 0.114])  # ITU-R BT.601
    assert np.abs(grey(message_of(image, encoding)).astype(float) - luma).max() <= 1.0
    np.testing.assert_array_equal(picture(message_of(image, encoding)), rgb)


def test_depth_is_scaled_to_the_nearest_level():
    every = np.arange(65536, dtype=np.uint16).reshape(256, 256)
    found = picture(message_of(every, 'mono16'))
    np.testing.assert_array_equal(found, np.rint(every / 65535 * 255))


@pytest.mark.parametrize('bits', [8, 16])
@pytest.mark.parametrize('pattern', ['rggb', 'grbg', 'gbrg', 'bggr'])
def test_a_mosaic_of_one_colour_becomes_that_colour(pattern, bits):
    dtype = np.uint8 if bits == 8 else np.uint16
    colour = {'r': 200, 'g': 90, 'b': 30}
    mosaic = np.empty((8, 8), dtype)
    for place, letter in enumerate(pattern):
        mosaic[place // 2 :: 2, place % 2 :: 2] = colour[letter] * (257 if bits == 16 else 1)
    message = message_of(mosaic, f'bayer_{pattern}{bits}')
    shown = picture(message)
    np.testing.assert_array_equal(shown, np.broadcast_to([200, 90, 30], (8, 8, 3)))
    mean = grey(message)[2:-2, 2:-2].mean() / (257 if bits == 16 else 1)
    assert abs(mean - (0.299 * 200 + 0.587 * 90 + 0.114 * 30)) <= 1.0


@pytest.mark.parametrize('encoding', ['mono8', 'mono16', 'bgr8'])
def test_compressed_images_have_the_grey_of_plain_ones(encoding):
    image = random_image(encoding)
    _, png = cv2.imencode('.png', image)
    found = decompress_grey(SimpleNamespace(data=png.tobytes(), format=f'{encoding}; png'))
    np.testing.assert_array_equal(found, grey(message_of(image, encoding)))
    with pytest.raises(ImageConversionError):
        decompress_grey(SimpleNamespace(data=b'\xff\xd8', format='jpeg'))


@pytest.mark.parametrize('encoding', ENCODINGS)
def test_filling_is_the_inverse(encoding):
    image = random_image(encoding)
    message = SimpleNamespace(data=array('B'))
    fill(message, image, encoding)
    np.testing.assert_array_equal(pixels(message), image)
    assert message.encoding == encoding


@pytest.mark.parametrize(
    ('name', 'value'),
    [('encoding', 'yuv422'), ('step', 15), ('height', 7), ('height', 0), ('width', 0)],
)
def test_damage_is_named(name, value):
    message = message_of(random_image('mono16'), 'mono16')
    setattr(message, name, value)
    with pytest.raises(ImageConversionError) as caught:
        picture(message)
    assert str(value) in str(caught.value)
