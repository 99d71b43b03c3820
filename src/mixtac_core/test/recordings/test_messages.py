# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Messages of rclpy and rosbags from the same readings, and the readings read back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_core.events.errors import MixtacError
from mixtac_core.events.readings import EdgeKind, Frame, InertialSamples
from mixtac_core.recordings import messages
from mixtac_core.recordings.bag import blank_message, typestore

ORIGIN_US = 1_700_000_000_000_000
PIXELS = np.random.default_rng(1).integers(0, 1024, (6, 8)).astype(np.uint16)
FRAME = Frame(PIXELS, 2, 3, 1000, 1100, 5101, 9000, 4001, True)
SAMPLES = InertialSamples(
    np.array([10, 20]),
    np.array([[1.0, 2.0, 3.0], [np.nan] * 3]),
    np.array([[np.nan] * 3, [4.0, 5.0, 6.0]]),
    np.array([40.0, 41.0]),
)


def built(new):
    """Return one message of each kind."""
    image = messages.image(FRAME, ORIGIN_US, 2, 'camera', new)
    return [
        image,
        messages.camera_info(FRAME, (346, 260), image, new),
        messages.frame_exposure(FRAME, ORIGIN_US, image, new),
        messages.imu(SAMPLES, 0, ORIGIN_US, 'imu', new),
        messages.imu(SAMPLES, 1, ORIGIN_US, 'imu', new),
        messages.temperature(40.5, ORIGIN_US + 3, 'imu', new),
        messages.camera_clock(1_800_000_000_000_000_001, ORIGIN_US, 'A1', new),
        messages.external_edge(EdgeKind.EXTERNAL_RISING, ORIGIN_US + 5, 3, 'camera', new),
    ]


def test_both_kinds_of_messages_are_equal():
    serialization = pytest.importorskip('rclpy.serialization', reason='needs ROS 2')
    pytest.importorskip('event_camera_msgs.msg', reason='needs the built workspace')
    for plain, ros in zip(built(blank_message), built(messages.ros_message), strict=True):
        data = bytes(typestore().serialize_cdr(plain, plain.__msgtype__))
        assert serialization.deserialize_message(data, type(ros)) == ros


def test_readings_come_back():
    image, info, exposure, first, second, _, _, edge = built(blank_message)
    assert (info.roi.x_offset, info.roi.y_offset) == (FRAME.x, FRAME.y)
    read = messages.read_frame(image, FRAME.middle_us, (FRAME.x, FRAME.y))
    read = messages.exposed_frame(read, exposure, ORIGIN_US)
    np.testing.assert_array_equal(read.image, FRAME.image)
    for name in ('x', 'y', 'exposure_start_us', 'exposure_end_us', 'frame_end_us', 'middle_us'):
        assert getattr(read, name) == getattr(FRAME, name)
    assert read.global_shutter
    for index, message in enumerate((first, second)):
        sample = messages.read_samples(message, 7)
        assert sample.t[0] == 7
        np.testing.assert_array_equal(sample.acceleration[0], SAMPLES.acceleration[index])
        np.testing.assert_array_equal(sample.angular_velocity[0], SAMPLES.angular_velocity[index])
    edges = messages.read_edges(edge, 5)
    assert (edges.t.tolist(), edges.kind.tolist()) == ([5], [EdgeKind.EXTERNAL_RISING])


@given(number=st.integers(0, 8), x=st.integers(0, 345), y=st.integers(0, 259))
def test_colour_filters_are_recovered_from_any_corner(number, x, y):
    encoding = messages.image_encoding(number, x, y)
    assert messages.color_filter(encoding, x, y) == (number if number in messages.BAYER else 0)


@pytest.mark.parametrize(
    ('values', 'expected'),
    [(np.array([1, 255], 'u1'), [4, 1020]), (np.array([64, 65535], 'u2'), [1, 1023])],
)
def test_pixels_become_ten_bits(values, expected):
    assert messages.ten_bits(values).tolist() == expected


@pytest.mark.parametrize('encoding', ['rgb8', 'bayer_xxxx8', 'mono12', ''])
def test_other_images_are_refused(encoding):
    message = messages.image(FRAME, ORIGIN_US, 0, 'camera', blank_message)
    message.encoding = encoding
    with pytest.raises(MixtacError):
        messages.read_frame(message, 0, (0, 0))
