# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Grey images out of `sensor_msgs/Image`, live or from a bag, without cv_bridge."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from mixtac_bringup.bag_reader import BagFile
from mixtac_bringup.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    Grey = NDArray[np.uint8 | np.uint16]

IMAGE_TYPE = 'sensor_msgs/msg/Image'
_CHANNELS = {
    'mono8': (np.uint8, 1),
    '8UC1': (np.uint8, 1),
    'mono16': (np.uint16, 1),
    '16UC1': (np.uint16, 1),
    'rgb8': (np.uint8, 3),
    'bgr8': (np.uint8, 3),
    'rgb16': (np.uint16, 3),
    'bgr16': (np.uint16, 3),
}
_PATTERNS = ('rggb', 'grbg', 'gbrg', 'bggr')
_CONVERSIONS = {
    'rgb': cv2.COLOR_RGB2GRAY,
    'bgr': cv2.COLOR_BGR2GRAY,
    'bayer_rggb': cv2.COLOR_BayerRGGB2GRAY,
    'bayer_grbg': cv2.COLOR_BayerGRBG2GRAY,
    'bayer_gbrg': cv2.COLOR_BayerGBRG2GRAY,
    'bayer_bggr': cv2.COLOR_BayerBGGR2GRAY,
}
for _pattern in _PATTERNS:
    _CHANNELS[f'bayer_{_pattern}8'] = (np.uint8, 1)
    _CHANNELS[f'bayer_{_pattern}16'] = (np.uint16, 1)


def grey_image(message: Any) -> Grey:  # noqa: ANN401
    """Return the brightness of an image message, `uint8` or `uint16` [height, width].

    Args:
        message: A `sensor_msgs/Image` of rclpy or of rosbags.

    Raises:
        BagError: Unknown encoding, or fewer data than the size needs.
    """
    encoding = str(message.encoding)
    if encoding not in _CHANNELS:
        raise BagError(f'image encoding {encoding!r}: use one of {", ".join(_CHANNELS)}')
    dtype, channels = _CHANNELS[encoding]
    width, height, step = int(message.width), int(message.height), int(message.step)
    row = width * channels * np.dtype(dtype).itemsize
    data = np.frombuffer(message.data, np.uint8)
    if step < row or len(data) < step * height or not row or not height:
        raise BagError(
            f'image {width}x{height} {encoding}, step {step}, holds {len(data)} bytes: damaged'
        )
    pixels = data[: step * height].reshape(height, step)[:, :row].copy().view(dtype)
    if bool(message.is_bigendian) != (sys.byteorder == 'big'):
        pixels = pixels.byteswap()
    kind = encoding.rstrip('0123456789')
    if kind not in _CONVERSIONS:
        return pixels
    if channels > 1:
        pixels = pixels.reshape(height, width, channels)
    return np.asarray(cv2.cvtColor(pixels, _CONVERSIONS[kind]), dtype)


def image_label(message: Any) -> str:  # noqa: ANN401
    """Return the stamp of a message [s], to name its view by."""
    stamp = message.header.stamp
    return f'{stamp.sec}.{stamp.nanosec // 1_000_000:03d}'


def bag_images(path: Path, topic: str, rate_hz: float) -> Iterator[tuple[str, Grey]]:
    """Yield label and brightness of the images of a bag.

    Args:
        path: Folder of the bag.
        topic: Topic of the images.
        rate_hz: Most images per second of the recording [Hz]; 0 for all.

    Raises:
        BagError: No bag, no such topic, or no images on it.
    """
    period_ns = round(1e9 / rate_hz) if rate_hz > 0.0 else 0
    next_ns = 0
    with BagFile(path) as bag:
        kind = bag.types.get(topic)
        if kind not in (None, IMAGE_TYPE):
            raise BagError(f'{path}: {topic} carries {kind}; name the topic of the images')
        for received_ns, message in bag.messages(topic):
            # Half a millisecond early is not a frame more.
            if received_ns < next_ns - 500_000:
                continue
            next_ns = received_ns + period_ns
            yield image_label(message), grey_image(message)
