# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Readings of a camera from recorded ROS messages.

The messages are rosbags' own classes: fields as in ROS, arrays as NumPy arrays.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from mixtac_events.readings import Edges, Frame, InertialSamples
from mixtac_recordings.recording import RecordingError

PATTERNS = {1: 'rggb', 2: 'grbg', 3: 'gbrg', 4: 'bggr'}
"""Colour filters, as in `identity.Features`, by their first two rows."""
GLOBAL_SHUTTER = 0
"""FrameExposure.GLOBAL_SHUTTER"""
_DEPTHS = {'mono8': 8, '8UC1': 8, 'mono16': 16, '16UC1': 16}


def stamp_us(header: Any) -> int:  # noqa: ANN401
    """Return the stamp of a header in whole microseconds of its clock."""
    return time_of(header.stamp)


def time_of(stamp: Any) -> int:  # noqa: ANN401
    """Return a Time in whole microseconds of its clock."""
    return int(stamp.sec) * 1_000_000 + int(stamp.nanosec) // 1000


def frame(message: Any, *, offset_us: int, corner: tuple[int, int]) -> Frame:  # noqa: ANN401
    """Return the frame of an Image; all its times are its stamp, the middle of its exposure.

    Pixels become 10 bits, as the camera's converter has: the upper 10 of 16, or 8 and two zeros.

    Args:
        message: The message.
        offset_us: To subtract from the stamp to get the recorded camera clock.
        corner: Column and row of the image's first pixel in the whole array.

    Raises:
        RecordingError: The encoding is none of one channel, or the data are too short.
    """
    depth = image_depth(message.encoding)
    size = depth // 8
    height, width, step = int(message.height), int(message.width), int(message.step)
    data = np.asarray(message.data, np.uint8)
    if step < width * size or len(data) < step * height:
        raise RecordingError(
            f'image of {width} x {height} with {len(data)} bytes in rows of {step}: it is cut off'
        )
    rows = np.ascontiguousarray(data[: step * height].reshape(height, step)[:, : width * size])
    if size == 1:
        image = np.left_shift(rows, 2, dtype=np.uint16)
    else:
        kind = '>u2' if message.is_bigendian else '<u2'
        image = np.right_shift(rows.view(kind), 6, dtype=np.uint16)
    middle_us = stamp_us(message.header) - offset_us
    return Frame(
        image=image,
        x=corner[0],
        y=corner[1],
        frame_start_us=middle_us,
        exposure_start_us=middle_us,
        exposure_end_us=middle_us,
        frame_end_us=middle_us,
        exposure_cycles=0,
        global_shutter=True,
    )


def exposed_frame(frame: Frame, message: Any, *, offset_us: int) -> Frame:  # noqa: ANN401
    """Return a frame with the times of its FrameExposure message.

    Args:
        frame: The frame.
        message: The message.
        offset_us: To subtract from its times to get the recorded camera clock.
    """

    def time_us(name: str) -> int:
        return time_of(getattr(message, name)) - offset_us

    return replace(
        frame,
        frame_start_us=time_us('frame_start'),
        exposure_start_us=time_us('exposure_start'),
        exposure_end_us=time_us('exposure_end'),
        frame_end_us=time_us('frame_end'),
        exposure_cycles=time_us('exposure_end') - time_us('exposure_start'),
        global_shutter=message.shutter == GLOBAL_SHUTTER,
    )


def edges(message: Any, *, offset_us: int) -> Edges:  # noqa: ANN401
    """Return the one edge of an ExternalEdge message.

    Args:
        message: The message.
        offset_us: To subtract from the stamp to get the recorded camera clock.
    """
    t = np.array([stamp_us(message.header) - offset_us], np.int64)
    return Edges(t, np.array([message.kind], np.uint8))


def image_depth(encoding: str) -> int:
    """Return the bits per pixel of an image encoding of one channel.

    Raises:
        RecordingError: It is another one.
    """
    if encoding in _DEPTHS:
        return _DEPTHS[encoding]
    pattern, depth = encoding[6:10], encoding[10:]
    if encoding.startswith('bayer_') and pattern in PATTERNS.values() and depth in {'8', '16'}:
        return int(depth)
    raise RecordingError(
        f'images in {encoding!r} cannot be played, only mono8, mono16 and bayer_*: name another '
        'topic with playback_image_topic, or none'
    )


def color_filter(encoding: str, corner: tuple[int, int]) -> int:
    """Return the colour filter of the camera behind an image, 0 for none.

    Args:
        encoding: Encoding of the image.
        corner: Column and row of the image's first pixel in the whole array.
    """
    pattern = encoding[6:10]
    if not encoding.startswith('bayer_'):
        return 0
    rows = [pattern[:2], pattern[2:]]
    rows = rows[::-1] if corner[1] % 2 else rows
    whole = ''.join(row[::-1] if corner[0] % 2 else row for row in rows)
    return next(number for number, name in PATTERNS.items() if name == whole)


def samples(message: Any, *, offset_us: int) -> InertialSamples:  # noqa: ANN401
    """Return the one sample of an Imu message; what it marks as missing is NaN (REP-145).

    Args:
        message: The message.
        offset_us: To subtract from the stamp to get the recorded camera clock.
    """
    t = np.array([stamp_us(message.header) - offset_us], np.int64)
    acceleration = _vector(message.linear_acceleration, message.linear_acceleration_covariance)
    rotation = _vector(message.angular_velocity, message.angular_velocity_covariance)
    return InertialSamples(t, acceleration, rotation, np.array([np.nan]))


def _vector(vector: Any, covariance: Any) -> np.ndarray[Any, np.dtype[np.float64]]:  # noqa: ANN401
    if covariance[0] == -1:
        return np.full((1, 3), np.nan)
    return np.array([[vector.x, vector.y, vector.z]], np.float64)
