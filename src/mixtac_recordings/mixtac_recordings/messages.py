# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""ROS messages of a camera from its readings.

Stamps are on the camera clock, epoch-based; the stamp of an event packet is its arrival on the
host.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from event_camera_msgs.msg import EventPacket
from sensor_msgs.msg import CameraInfo, Image, Imu, Temperature, TimeReference

from mixtac_msgs.msg import ExternalEdge, FrameExposure
from mixtac_node.images import fill
from mixtac_node.stamps import ns_to_stamp, us_to_stamp

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_events.packetizer import Packet
    from mixtac_events.readings import Frame, InertialSamples


BIT_SHIFT = 6
"""From 10-bit values to the upper bits of 16, as libcaer_driver does."""
BAYER = {1: 'rggb', 2: 'grbg', 3: 'gbrg', 4: 'bggr'}
"""Colour filters as ROS names them. Those with white pixels, 5 to 8, have no name: mono16."""


def event_packet(
    packet: Packet, sequence: int, size: tuple[int, int], frame_id: str
) -> EventPacket:
    """Return the message of a packet; its header's stamp is the host time of arrival.

    Args:
        packet: The packet.
        sequence: Number of the packet.
        size: Width and height of the event array.
        frame_id: Frame of the camera.
    """
    message = EventPacket()
    message.header.stamp = ns_to_stamp(packet.arrival_ns)
    message.header.frame_id = frame_id
    message.width, message.height = size
    message.seq = sequence
    message.time_base = packet.encoded.time_base
    message.encoding = packet.encoded.encoding
    message.is_bigendian = False
    # Assigning the array goes through every element; this is one copy.
    message.events.frombytes(packet.encoded.payload)
    return message


def image(frame: Frame, origin_us: int, color_filter: int, frame_id: str) -> Image:
    """Return the message of a frame; its stamp is the middle of the exposure.

    Args:
        frame: The frame.
        origin_us: Origin of the camera's clock [us since the Unix epoch].
        color_filter: Colour filter of the camera, 0 for none.
        frame_id: Frame of the camera.
    """
    message = image_header(frame, origin_us, frame_id)
    encoding = image_encoding(color_filter, frame.x, frame.y)
    return filled(message, left_aligned(frame.image), encoding)


def left_aligned(image: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Return 10-bit values in the upper bits of 16, as libcaer_driver publishes them."""
    return np.left_shift(image, BIT_SHIFT)


def filled(message: Image, pixels: NDArray[np.uint8 | np.uint16], encoding: str) -> Image:
    """Return an image message with its pixels.

    Args:
        message: With its header.
        pixels: [height, width] or [height, width, channels].
        encoding: ROS encoding.
    """
    fill(message, pixels, encoding)
    return message


def image_header(frame: Frame, origin_us: int, frame_id: str) -> Image:
    """Return the message of a frame without its pixels, for what shares its header."""
    message = Image()
    message.header.stamp = us_to_stamp(frame.middle_us + origin_us)
    message.header.frame_id = frame_id
    return message


def image_encoding(color_filter: int, x: int, y: int) -> str:
    """Return the ROS encoding of a frame whose first pixel is (x, y) of the array."""
    pattern = BAYER.get(color_filter)
    if pattern is None:
        return 'mono16'
    rows = [pattern[0:2], pattern[2:4]]
    rows = rows[::-1] if y % 2 else rows
    return 'bayer_' + ''.join(row[::-1] if x % 2 else row for row in rows) + '16'


def camera_info(frame: Frame, size: tuple[int, int], image_message: Image) -> CameraInfo:
    """Return the camera information that goes with an image: sizes and region, no calibration.

    Args:
        frame: The frame.
        size: Width and height of the pixel array.
        image_message: The message of the same frame.
    """
    message = CameraInfo()
    message.header = image_message.header
    message.width, message.height = size
    height, width = frame.image.shape
    if (width, height) != (message.width, message.height):
        message.roi.x_offset, message.roi.y_offset = frame.x, frame.y
        message.roi.width, message.roi.height = width, height
    return message


def imu(samples: InertialSamples, index: int, origin_us: int, frame_id: str) -> Imu:
    """Return the message of one inertial sample; what was not measured is marked (REP-145).

    Args:
        samples: The samples.
        index: Which of them.
        origin_us: Origin of the camera's clock [us since the Unix epoch].
        frame_id: Frame of the unit.
    """
    message = Imu()
    message.header.stamp = us_to_stamp(int(samples.t[index]) + origin_us)
    message.header.frame_id = frame_id
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


def camera_clock(host_ns: int, camera_us: int, source: str) -> TimeReference:
    """Return the camera clock at a host time.

    Args:
        host_ns: Host time [ns since the Unix epoch].
        camera_us: Epoch-based camera clock at that time [us].
        source: Serial number of the camera.
    """
    message = TimeReference()
    message.header.stamp = ns_to_stamp(host_ns)
    message.time_ref = us_to_stamp(camera_us)
    message.source = source
    return message


def frame_exposure(frame: Frame, origin_us: int, image_message: Image) -> FrameExposure:
    """Return when a frame was exposed, under the header of its image.

    Args:
        frame: The frame.
        origin_us: Origin of the camera's clock [us since the Unix epoch].
        image_message: The message of the same frame.
    """
    message = FrameExposure()
    message.header = image_message.header
    message.frame_start = us_to_stamp(frame.frame_start_us + origin_us)
    message.exposure_start = us_to_stamp(frame.exposure_start_us + origin_us)
    message.exposure_end = us_to_stamp(frame.exposure_end_us + origin_us)
    message.frame_end = us_to_stamp(frame.frame_end_us + origin_us)
    shutters = (FrameExposure.ROLLING_SHUTTER, FrameExposure.GLOBAL_SHUTTER)
    message.shutter = shutters[frame.global_shutter]
    return message


def external_edge(kind: int, time_us: int, sequence: int, frame_id: str) -> ExternalEdge:
    """Return the message of an edge at the synchronisation connector.

    Args:
        kind: Value of EdgeKind.
        time_us: When it happened [us, epoch-based camera clock].
        sequence: Number of the edge.
        frame_id: Frame of the camera.
    """
    message = ExternalEdge()
    message.header.stamp = us_to_stamp(time_us)
    message.header.frame_id = frame_id
    message.kind = kind
    message.seq = sequence
    return message


def temperature(celsius: float, time_us: int, frame_id: str) -> Temperature:
    """Return the message of a temperature of the inertial unit's die.

    Args:
        celsius: Temperature [degrees Celsius].
        time_us: When it was measured [us, epoch-based camera clock].
        frame_id: Frame of the unit.
    """
    message = Temperature()
    message.header.stamp = us_to_stamp(time_us)
    message.header.frame_id = frame_id
    message.temperature = celsius
    return message
