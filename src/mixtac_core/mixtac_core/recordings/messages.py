# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""ROS messages of a camera from its readings, and readings from recorded messages.

Functions that build a message have the argument `new`, a function that returns an empty message of
a type: `ros_message` or `mixtac_core.recordings.bag.blank_message`. Stamps are on the camera clock,
epoch-based. Event packets are written by `mixtac_core.events.packets.PacketWriter`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.readings import Edges, Frame, InertialSamples
from mixtac_core.node import topics
from mixtac_core.node.images import fill, pixels
from mixtac_core.node.topics import stamp_to_us
from mixtac_core.recordings.recording import RecordingError

Message: TypeAlias = Any
"""A message of rclpy or rosbags."""
New = Callable[[str], Message]


BIT_SHIFT = 6
"""From 10-bit values to the upper bits of 16, as libcaer_driver publishes them."""
BAYER = {1: 'rggb', 2: 'grbg', 3: 'gbrg', 4: 'bggr'}
"""ROS names of the camera's colour filters, by their first two rows. Filters with white pixels,
5 to 8, have no name: their frames are mono16."""
EXPOSURE_TIMES = ('frame_start', 'exposure_start', 'exposure_end', 'frame_end')
"""Fields of FrameExposure, and with `_us` attributes of `Frame`."""
GLOBAL_SHUTTER = 0
"""Value of FrameExposure.shutter; 1 is the rolling shutter."""


def ros_message(type_name: str) -> Message:
    """Return an empty message of rclpy, for example of `sensor_msgs/msg/Image`."""
    return topics.message_class(type_name)()


def image(
    frame: Frame, origin_us: int, color_filter: int, frame_id: str, new: New = ros_message
) -> Message:
    """Return the Image of a frame; its stamp is the middle of the exposure.

    Args:
        frame: The frame.
        origin_us: Origin of the camera's clock [us since the Unix epoch].
        color_filter: Colour filter of the camera, 0 for none.
        frame_id: Frame of the camera.
        new: See module.
    """
    message = image_header(frame, origin_us, frame_id, new)
    fill(message, left_aligned(frame.image), image_encoding(color_filter, frame.x, frame.y))
    return message


def left_aligned(image: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Return 10-bit values in the upper bits of 16."""
    return np.left_shift(image, BIT_SHIFT)


def ten_bits(image: NDArray[Any]) -> NDArray[np.uint16]:
    """Return the upper 10 of 16 bits, or 8 bits and two zeros: the camera converts to 10 bits."""
    if image.dtype == np.uint8:
        return np.asarray(np.left_shift(image, 2, dtype=np.uint16))
    return np.asarray(np.right_shift(image, BIT_SHIFT, dtype=np.uint16))


def image_header(frame: Frame, origin_us: int, frame_id: str, new: New = ros_message) -> Message:
    """Return the Image of a frame without its pixels, for messages that share its header."""
    return _stamped(topics.IMAGE_RAW, 1000 * (frame.middle_us + origin_us), frame_id, new)


def image_encoding(color_filter: int, x: int, y: int) -> str:
    """Return the ROS encoding of a frame whose first pixel is (x, y) of the array."""
    pattern = BAYER.get(color_filter)
    return 'mono16' if pattern is None else f'bayer_{_shifted(pattern, x, y)}16'


def color_filter(encoding: str, x: int, y: int) -> int:
    """Return the colour filter of the camera behind an image, 0 for none.

    Args:
        encoding: Encoding of the image.
        x: Column of the image's first pixel in the array.
        y: Row of that pixel.
    """
    if not encoding.startswith('bayer_'):
        return 0
    pattern = _shifted(encoding[6:10], x, y)
    return next((number for number, name in BAYER.items() if name == pattern), 0)


def _shifted(pattern: str, x: int, y: int) -> str:
    """Return the two rows of a colour filter as seen from pixel (x, y); its own inverse."""
    rows = [pattern[:2], pattern[2:]]
    rows = rows[::-1] if y % 2 else rows
    return ''.join(row[::-1] if x % 2 else row for row in rows)


def camera_info(
    frame: Frame, size: tuple[int, int], image_message: Message, new: New = ros_message
) -> Message:
    """Return the CameraInfo that goes with an image: sizes and region, no calibration.

    Args:
        frame: The frame.
        size: Width and height of the pixel array.
        image_message: The message of the same frame.
        new: See module.
    """
    message = new(topics.CAMERA_INFO.type_name)
    message.header = image_message.header
    message.width, message.height = size
    height, width = frame.image.shape
    if (width, height) != (message.width, message.height):
        message.roi.x_offset, message.roi.y_offset = frame.x, frame.y
        message.roi.width, message.roi.height = width, height
        message.roi.do_rectify = True
    return message


def imu(
    samples: InertialSamples, index: int, origin_us: int, frame_id: str, new: New = ros_message
) -> Message:
    """Return the Imu of one inertial sample; values that were not measured are marked (REP-145).

    Args:
        samples: The samples.
        index: Which of them.
        origin_us: Origin of the camera's clock [us since the Unix epoch].
        frame_id: Frame of the unit.
        new: See module.
    """
    message = _stamped(topics.IMU, 1000 * (int(samples.t[index]) + origin_us), frame_id, new)
    message.orientation.w = 1.0
    message.orientation_covariance[0] = -1.0
    parts = (
        (samples.acceleration, message.linear_acceleration, message.linear_acceleration_covariance),
        (samples.angular_velocity, message.angular_velocity, message.angular_velocity_covariance),
    )
    for values, vector, covariance in parts:
        x, y, z = values[index].tolist()
        if math.isnan(x):
            covariance[0] = -1.0
        else:
            vector.x, vector.y, vector.z = x, y, z
    return message


def camera_clock(host_ns: int, camera_us: int, source: str, new: New = ros_message) -> Message:
    """Return the TimeReference with the camera clock at a host time.

    Args:
        host_ns: Host time [ns since the Unix epoch].
        camera_us: Epoch-based camera clock at that time [us].
        source: Serial number of the camera.
        new: See module.
    """
    message = _stamped(topics.CAMERA_CLOCK, host_ns, '', new)
    _set_time(message.time_ref, 1000 * camera_us)
    message.source = source
    return message


def frame_exposure(
    frame: Frame, origin_us: int, image_message: Message, new: New = ros_message
) -> Message:
    """Return the FrameExposure of a frame, with the header of its image.

    Args:
        frame: The frame.
        origin_us: Origin of the camera's clock [us since the Unix epoch].
        image_message: The message of the same frame.
        new: See module.
    """
    message = new(topics.IMAGE_EXPOSURE.type_name)
    message.header = image_message.header
    for name in EXPOSURE_TIMES:
        _set_time(getattr(message, name), 1000 * (getattr(frame, f'{name}_us') + origin_us))
    message.shutter = GLOBAL_SHUTTER if frame.global_shutter else 1
    return message


def external_edge(
    kind: int, time_us: int, sequence: int, frame_id: str, new: New = ros_message
) -> Message:
    """Return the ExternalEdge of an edge at the synchronisation connector.

    Args:
        kind: Value of EdgeKind.
        time_us: Its time [us, epoch-based camera clock].
        sequence: Number of the edge.
        frame_id: Frame of the camera.
        new: See module.
    """
    message = _stamped(topics.EXTERNAL_EDGES, 1000 * time_us, frame_id, new)
    message.kind = kind
    message.seq = sequence
    return message


def temperature(celsius: float, time_us: int, frame_id: str, new: New = ros_message) -> Message:
    """Return the Temperature of the inertial unit's die.

    Args:
        celsius: Temperature [degrees Celsius].
        time_us: Time of the measurement [us, epoch-based camera clock].
        frame_id: Frame of the unit.
        new: See module.
    """
    message = _stamped(topics.TEMPERATURE, 1000 * time_us, frame_id, new)
    message.temperature = celsius
    return message


def _stamped(topic: topics.Topic, t_ns: int, frame_id: str, new: New) -> Message:
    return set_header(new(topic.type_name), t_ns, frame_id)


def set_header(message: Message, t_ns: int, frame_id: str) -> Message:
    """Write the stamp [ns] and the frame of a message's header, and return the message."""
    _set_time(message.header.stamp, t_ns)
    message.header.frame_id = frame_id
    return message


def _set_time(stamp: Message, t_ns: int) -> None:
    stamp.sec, stamp.nanosec = divmod(int(t_ns), 1_000_000_000)


def read_frame(message: Message, t_us: int, corner: tuple[int, int]) -> Frame:
    """Return the frame of an Image; all its times are that of the middle of its exposure.

    Pixels become 10 bits, as the camera's converter has: the upper 10 of 16, or 8 and two zeros.

    Args:
        message: The message.
        t_us: Its time [us, recorded camera clock].
        corner: Column and row of the image's first pixel in the whole array.

    Raises:
        RecordingError: The image has several channels.
        ImageConversionError: Its encoding is unknown, or its data are too short.
    """
    image = pixels(message)
    if image.ndim > 2:
        raise RecordingError(
            f'images in {message.encoding!r} cannot be read, only mono8, mono16 and bayer_*',
            remedy='choose another topic with playback_image_topic, or none',
        )
    return Frame(ten_bits(image), *corner, t_us, t_us, t_us, t_us, 0, True)


def exposed_frame(frame: Frame, message: Message, offset_us: int) -> Frame:
    """Return a frame with the times of its FrameExposure message.

    Args:
        frame: The frame.
        message: The message.
        offset_us: Subtracted from its times to get the recorded camera clock.
    """
    times: dict[str, Any] = {
        f'{name}_us': stamp_to_us(getattr(message, name)) - offset_us for name in EXPOSURE_TIMES
    }
    return replace(
        frame,
        **times,
        exposure_cycles=times['exposure_end_us'] - times['exposure_start_us'],
        global_shutter=message.shutter == GLOBAL_SHUTTER,
    )


def read_edges(message: Message, t_us: int) -> Edges:
    """Return the one edge of an ExternalEdge message, at a time [us, recorded camera clock]."""
    return Edges(np.array([t_us], np.int64), np.array([message.kind], np.uint8))


def read_samples(message: Message, t_us: int, celsius: float = math.nan) -> InertialSamples:
    """Return the one sample of an Imu message; values marked as missing are NaN (REP-145).

    Args:
        message: The message.
        t_us: Its time [us, recorded camera clock].
        celsius: Temperature of the inertial unit at that time [degrees Celsius], NaN if unknown.
    """
    acceleration = _vector(message.linear_acceleration, message.linear_acceleration_covariance)
    rotation = _vector(message.angular_velocity, message.angular_velocity_covariance)
    return InertialSamples(np.array([t_us], np.int64), acceleration, rotation, np.array([celsius]))


def _vector(vector: Message, covariance: Message) -> NDArray[np.float64]:
    if covariance[0] == -1:
        return np.full((1, 3), np.nan)
    return np.array([[vector.x, vector.y, vector.z]], np.float64)
