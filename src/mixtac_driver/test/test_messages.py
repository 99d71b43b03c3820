# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""ROS messages made of what the camera saw."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip('event_camera_msgs.msg')
pytest.importorskip('mixtac_msgs.msg')

from davis_fake import FakeBackend, FakeCamera

from mixtac_core.events.readings import Frame
from mixtac_core.node.topics import stamp_to_us
from mixtac_core.recordings import messages
from mixtac_driver.camera import Davis346

ORIGIN_US = 1_760_000_000_000_000


def frame(x=0, y=0, shape=(260, 346)):
    image = np.random.default_rng(0).integers(0, 1024, shape).astype(np.uint16)
    return Frame(image, x, y, 100, 1000, 5001, 9000, 0, global_shutter=True)


def test_image_is_left_aligned_and_stamped_mid_exposure():
    sent = frame()
    message = messages.image(sent, ORIGIN_US, 0, 'cam')
    assert stamp_to_us(message.header.stamp) == ORIGIN_US + 3000
    assert (message.encoding, message.step, message.is_bigendian) == ('mono16', 692, False)
    pixels = np.frombuffer(message.data, np.uint16).reshape(260, 346)
    np.testing.assert_array_equal(pixels, sent.image * 64)


def test_camera_info_tells_the_region():
    with Davis346(backend=FakeBackend(FakeCamera())) as camera:
        identity = camera.identity
    size = (identity.geometry.width, identity.geometry.height)
    part = frame(10, 20, (30, 40))
    image = messages.image(part, ORIGIN_US, 0, 'cam')
    info = messages.camera_info(part, size, image)
    assert (info.width, info.height, info.header) == (346, 260, image.header)
    roi = info.roi
    assert (roi.x_offset, roi.y_offset, roi.width, roi.height) == (10, 20, 40, 30)
    assert roi.do_rectify
    whole = messages.camera_info(frame(), size, image).roi
    assert (whole.width, whole.do_rectify) == (0, False)


@pytest.mark.parametrize('global_shutter', [True, False])
def test_exposure_has_the_header_of_its_image(global_shutter):
    sent = replace(frame(), global_shutter=global_shutter)
    image = messages.image(sent, ORIGIN_US, 0, 'cam')
    message = messages.frame_exposure(sent, ORIGIN_US, image)
    assert message.header == image.header
    marks = (message.frame_start, message.exposure_start, message.exposure_end, message.frame_end)
    assert [stamp_to_us(mark) - ORIGIN_US for mark in marks] == [100, 1000, 5001, 9000]
    assert message.shutter == (not global_shutter)
    assert messages.image_header(sent, ORIGIN_US, 'cam').header == image.header
