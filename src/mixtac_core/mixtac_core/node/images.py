# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Conversion between `sensor_msgs/Image` and NumPy arrays, without cv_bridge.

The Python part of cv_bridge cannot swap bytes with NumPy 2 and assumes that the padding of a row is
a whole number of pixels. Colours are converted by the OpenCV functions that it uses. Messages are
those of rclpy or of rosbags.
"""

from __future__ import annotations

import contextlib
import sys
from array import array
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.errors import MixtacError

Pixels = NDArray[np.uint8 | np.uint16]

_MOSAICS = ('bayer_rggb', 'bayer_grbg', 'bayer_gbrg', 'bayer_bggr')
_LAYOUTS = {'8UC1': ('mono', 8), '16UC1': ('mono', 16), 'rgb8': ('rgb', 8), 'bgr8': ('bgr', 8)}
_LAYOUTS |= {f'{kind}{bits}': (kind, bits) for kind in ('mono', *_MOSAICS) for bits in (8, 16)}
"""Colours and bits per channel of the encodings."""
ENCODINGS = tuple(_LAYOUTS)
"""Encodings that can be read."""


class ImageConversionError(MixtacError):
    """An encoding that cannot be converted, or an image message that contradicts itself."""


def pixels(message: Any) -> Pixels:  # noqa: ANN401
    """Return the pixels of an image message in native byte order.

    Args:
        message: A `sensor_msgs/Image`.

    Returns:
        `uint8` or `uint16`, [height, width] or [height, width, channels], contiguous; a read-only
        view of the message's data where their layout allows that, else a copy.

    Raises:
        ImageConversionError: Unknown encoding, or sizes that contradict each other.
    """
    kind, bits = _layout(message)
    dtype, channels = np.dtype(f'u{bits // 8}'), 3 if kind in ('rgb', 'bgr') else 1
    height, width, step = int(message.height), int(message.width), int(message.step)
    row = width * channels * dtype.itemsize
    data = np.frombuffer(message.data, np.uint8)
    if not (0 < row <= step and 0 < step * height <= data.size):
        raise ImageConversionError(
            f'image of {width} x {height} {message.encoding}, {step} bytes a row, holds '
            f'{data.size} bytes: the publisher must fill {row} bytes a row'
        )
    data.flags.writeable = False
    rows = np.ascontiguousarray(data[: step * height].reshape(height, step)[:, :row])
    found = rows.view(dtype)
    if dtype.itemsize > 1 and bool(message.is_bigendian) != (sys.byteorder == 'big'):
        found = found.byteswap()
    return found if channels == 1 else found.reshape(height, width, channels)


def grey(message: Any) -> Any:  # noqa: ANN401  (mypy keeps the types of arrays apart)
    """Return the grey levels of an image message with as many bits as it has, [height, width].

    Args:
        message: A `sensor_msgs/Image` in one of `ENCODINGS`.

    Returns:
        `uint8` or `uint16`.

    Raises:
        ImageConversionError: Another encoding, or a damaged message.
    """
    found, (kind, _) = pixels(message), _layout(message)
    return found if kind == 'mono' else cv2.cvtColor(found, _code(kind, 'GRAY'))


def picture(message: Any) -> NDArray[np.uint8]:  # noqa: ANN401
    """Return an image message with 8 bits, white stays white: grey levels, or colours as RGB.

    Args:
        message: A `sensor_msgs/Image` in one of `ENCODINGS`.

    Returns:
        [height, width] for grey encodings, else [height, width, 3].

    Raises:
        ImageConversionError: Another encoding, or a damaged message.
    """
    found: Any = pixels(message)
    kind, _ = _layout(message)
    if kind not in ('mono', 'rgb'):
        found = cv2.cvtColor(found, _code(kind, 'RGB'))
    if found.dtype == np.uint16:
        # The nearest of 256 levels; no value lies between two.
        found = (found.astype(np.uint32) + 128) // 257
    return np.asarray(found, np.uint8)


def fill(message: Any, image: Pixels, encoding: str) -> None:  # noqa: ANN401
    """Write pixels into a new image message; its header is not changed.

    Args:
        message: A `sensor_msgs/msg/Image` without data.
        image: `uint8` or `uint16`, [height, width] or [height, width, channels].
        encoding: Their encoding, one of `ENCODINGS`.
    """
    message.height, message.width = image.shape[:2]
    message.encoding = encoding
    message.is_bigendian = sys.byteorder == 'big'
    message.step = image.nbytes // image.shape[0]
    octets: Any = np.ascontiguousarray(image).view(np.uint8).ravel()
    if isinstance(message.data, array):
        # rclpy checks every element that is assigned; this is one copy.
        message.data.frombytes(octets)
    else:
        message.data = octets


def decompress_grey(message: Any) -> Pixels:  # noqa: ANN401
    """Return the grey levels of a compressed image with as many bits as it has, [height, width].

    Args:
        message: A `sensor_msgs/CompressedImage` in JPEG or PNG.

    Raises:
        ImageConversionError: Another compression, a damaged or too large image.
    """
    data = np.frombuffer(message.data, np.uint8)
    found: Any = None
    with contextlib.suppress(cv2.error):
        found = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    if found is None or found.dtype not in (np.uint8, np.uint16):
        raise ImageConversionError(f'compressed image of {data.size} bytes is damaged')
    if found.ndim == 3:
        return np.asarray(cv2.cvtColor(found, cv2.COLOR_BGR2GRAY))
    kind = str(message.format).partition(';')[0].rstrip('0123456789')
    return np.asarray(cv2.cvtColor(found, _code(kind, 'GRAY'))) if kind in _MOSAICS else found


def _layout(message: Any) -> tuple[str, int]:  # noqa: ANN401
    """Return the colours of an image message, and the bits of a channel."""
    encoding = str(message.encoding)
    if encoding not in _LAYOUTS:
        raise ImageConversionError(
            f'image encoding {encoding!r}: use one of {", ".join(ENCODINGS)}'
        )
    return _LAYOUTS[encoding]


def _code(kind: str, target: str) -> int:
    """Return OpenCV's number of a conversion. It interpolates mosaics bilinearly."""
    source = f'Bayer{kind[-4:].upper()}' if kind in _MOSAICS else kind.upper()
    return int(getattr(cv2, f'COLOR_{source}2{target}'))
