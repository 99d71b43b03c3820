# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The URDF without xacro: a set of frames per prefix, the contact frame where forces point."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('geometry_msgs.msg', reason='needs ROS 2')

from scipy.spatial.transform import Rotation

from mixtac_core.node.topics import CAMERA_FRAME, CONTACT_FRAME, IMU_FRAME, frame_id, frame_prefix
from mixtac_driver.frames_node import fingertip_urdf, fixed_frames

URDF = Path(__file__).resolve().parents[2] / 'mixtac_bringup' / 'urdf' / 'fingertip.urdf.xacro'


def rotation(frame):
    turn = frame.transform.rotation
    return Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()


def test_the_contact_frame_points_into_the_gel_and_up_in_the_image():
    frames = {each.child_frame_id: each for each in fixed_frames(fingertip_urdf(URDF))}
    assert {each.header.frame_id for each in frames.values()} - set(frames) == {'mixtac_mount'}
    assert {CAMERA_FRAME, IMU_FRAME, CONTACT_FRAME} <= set(frames)
    gel, contact = frames['mixtac_gel'], frames['mixtac_contact']
    assert gel.header.frame_id == 'camera'
    assert contact.header.frame_id == 'mixtac_gel'
    turn = rotation(gel) @ rotation(contact)
    assert turn == pytest.approx(np.diag([1.0, -1.0, -1.0]), abs=1e-12)
    assert gel.transform.translation.z > 0.0


def test_two_sensors_have_two_sets_of_frames():
    left, right = (
        {each.child_frame_id for each in fixed_frames(fingertip_urdf(URDF, frame_prefix(name)))}
        for name in ('/left', '/right')
    )
    assert not left & right
    assert frame_id(CONTACT_FRAME, '/left') in left
