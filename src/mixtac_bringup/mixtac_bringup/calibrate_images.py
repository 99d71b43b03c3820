# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Grey images out of `sensor_msgs/Image`, live or from a bag."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mixtac_bringup.bag_reader import BagFile
from mixtac_bringup.errors import BagError
from mixtac_node.image_conversion import ImageConversionError, image_array

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    Grey = NDArray[np.uint8 | np.uint16]

IMAGE_TYPE = 'sensor_msgs/msg/Image'


def grey_image(message: Any) -> Grey:  # noqa: ANN401
    """Return the brightness of an image message, `uint8` or `uint16` [height, width].

    Args:
        message: A `sensor_msgs/Image` of rclpy or of rosbags.

    Raises:
        BagError: Unknown encoding, or fewer data than the size needs.
    """
    deep = '16' in str(message.encoding)
    try:
        return image_array(message, 'mono16' if deep else 'mono8')
    except ImageConversionError as error:
        raise BagError(str(error)) from error


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
