# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Conversion between `sensor_msgs/Image` and NumPy arrays, without cv_bridge.

The Python part of cv_bridge cannot swap bytes with NumPy 2 and assumes that the padding of a row is
a whole number of pixels. Colours are converted by the OpenCV functions that it uses. Messages are
those of rclpy or of rosbags.
"""

from __future__ import annotations

import sys
from array import array
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.errors import MixtacError

Pixels = NDArray[np.uint8 | np.uint16]

MOST_PIXELS = 1 << 22
"""Larger images are refused: the work on a message is bounded."""
_MOSAICS = tuple(f'bayer_{pattern}' for pattern in ('rggb', 'grbg', 'gbrg', 'bggr'))
_CHANNELS = {'mono': 1, 'rgb': 3, 'bgr': 3, 'rgba': 4, 'bgra': 4} | dict.fromkeys(_MOSAICS, 1)
_ALIASES = {'8UC1': 'mono8', '16UC1': 'mono16', '8UC3': 'bgr8', '16UC3': 'bgr16'}
"""Encodings without colour names, and how OpenCV interprets them."""
ENCODINGS = (*(f'{kind}{bits}' for kind in _CHANNELS for bits in (8, 16)), *_ALIASES)
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
    dtype, channels, _ = _layout(str(message.encoding))
    height, width, step = int(message.height), int(message.width), int(message.step)
    row = width * channels * dtype.itemsize
    if width * height > MOST_PIXELS:
        raise ImageConversionError(
            f'image of {width} x {height} pixels: at most {MOST_PIXELS} pixels are read'
        )
    data = np.frombuffer(message.data, np.uint8)
    if not row or not height or step < row or data.size < step * height:
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
    return _converted(pixels(message), _layout(str(message.encoding))[2], 'mono')


def picture(message: Any) -> NDArray[np.uint8]:  # noqa: ANN401
    """Return an image message with 8 bits, white stays white: grey levels, or colours as RGB.

    Args:
        message: A `sensor_msgs/Image` in one of `ENCODINGS`.

    Returns:
        [height, width] for grey encodings, else [height, width, 3].

    Raises:
        ImageConversionError: Another encoding, or a damaged message.
    """
    kind = _layout(str(message.encoding))[2]
    found = _converted(pixels(message), kind, 'mono' if kind == 'mono' else 'rgb')
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

    Raises:
        ImageConversionError: Type or shape is not that of the encoding.
    """
    dtype, channels, _ = _layout(encoding)
    shape = image.shape[:2] if channels == 1 else (*image.shape[:2], channels)
    if image.dtype != dtype or image.shape != shape or not image.size:
        raise ImageConversionError(
            f'{encoding} has {channels} channels of {dtype}, got an array {image.shape} of '
            f'{image.dtype}'
        )
    message.height, message.width = image.shape[:2]
    message.encoding = encoding
    message.is_bigendian = sys.byteorder == 'big'
    message.step = image.nbytes // image.shape[0]
    set_octets(message, 'data', np.ascontiguousarray(image).view(np.uint8).ravel())


def set_octets(message: Any, name: str, octets: Any) -> None:  # noqa: ANN401
    """Set an empty field of type `uint8[]` in a message of rclpy or rosbags.

    Args:
        message: The message.
        name: Name of the field.
        octets: One-dimensional array, or anything with a buffer.
    """
    held = getattr(message, name)
    if isinstance(held, array):
        # Assigning to the field checks every element; this is one copy.
        held.frombytes(octets)
    else:
        setattr(message, name, np.frombuffer(octets, np.uint8))


def decompress_grey(message: Any) -> Pixels:  # noqa: ANN401
    """Return the grey levels of a compressed image with as many bits as it has, [height, width].

    Args:
        message: A `sensor_msgs/CompressedImage` in JPEG or PNG.

    Raises:
        ImageConversionError: Another compression or encoding, a damaged or too large image.
    """
    data = np.frombuffer(message.data, np.uint8)
    found: Any = None
    try:
        found = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise ImageConversionError(f'compressed image is damaged: {error}') from error
    if found is None or found.dtype not in (np.uint8, np.uint16):
        raise ImageConversionError(f'compressed image of {data.size} bytes is damaged')
    named = str(message.format).partition(';')[0].rstrip('0123456789')
    kind = named if named in _MOSAICS else 'mono'
    if found.ndim == 3:
        kind = 'bgr' if found.shape[2] == 3 else 'bgra'
    return np.asarray(_converted(found, kind, 'mono'))


def _layout(encoding: str) -> tuple[np.dtype[Any], int, str]:
    """Return type and number of the channels of an encoding, and the name of its colours."""
    if encoding not in ENCODINGS:
        raise ImageConversionError(
            f'image encoding {encoding!r}: use one of {", ".join(ENCODINGS)}'
        )
    name = _ALIASES.get(encoding, encoding)
    kind = name.rstrip('0123456789')
    return np.dtype(f'u{int(name[len(kind) :]) // 8}'), _CHANNELS[kind], kind


def _converted(found: Any, source: str, target: str) -> Any:  # noqa: ANN401
    """Return pixels in other colours, with as many bits. Mosaics are interpolated bilinearly."""
    if source == target:
        return found
    names = {'mono': 'GRAY'} | {mosaic: f'Bayer{mosaic[-4:].upper()}' for mosaic in _MOSAICS}
    one, other = (names.get(kind, kind.upper()) for kind in (source, target))
    return cv2.cvtColor(found, getattr(cv2, f'COLOR_{one}2{other}'))
