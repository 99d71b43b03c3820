# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The URDF without xacro: a set of frames per prefix, the contact frame where forces point."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mixtac_description.fingertip import (
    DescriptionError,
    fingertip_urdf,
    fixed_frames,
    quaternion,
)
from mixtac_node.topics import CAMERA_FRAME, CONTACT_FRAME, IMU_FRAME, frame_id, frame_prefix

URDF = Path(__file__).resolve().parents[1] / 'urdf' / 'fingertip.urdf.xacro'


def rotation(frame):
    x, y, z, w = frame.quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def test_frames_hang_together_and_have_the_names_of_the_topics():
    frames = fixed_frames(fingertip_urdf(path=URDF))
    children = {each.child for each in frames}
    roots = {each.parent for each in frames} - children
    assert roots == {'mixtac_mount'}
    assert {CAMERA_FRAME, IMU_FRAME, CONTACT_FRAME} <= children


def test_the_contact_frame_points_into_the_gel_and_up_in_the_image():
    frames = {each.child: each for each in fixed_frames(fingertip_urdf(path=URDF))}
    gel, contact = frames['mixtac_gel'], frames['mixtac_contact']
    assert gel.parent == 'camera'
    assert contact.parent == 'mixtac_gel'
    turn = rotation(gel) @ rotation(contact)
    assert turn == pytest.approx(np.diag([1.0, -1.0, -1.0]), abs=1e-12)
    assert gel.xyz[2] > 0.0


def test_two_sensors_have_two_sets_of_frames():
    left, right = (
        {each.child for each in fixed_frames(fingertip_urdf(frame_prefix(name), URDF))}
        for name in ('/left', '/right')
    )
    assert not left & right
    assert frame_id(CONTACT_FRAME, '/left') in left
    assert frame_id(CONTACT_FRAME, '/mixtac') == CONTACT_FRAME
    assert frame_id('my_own', '/left') == 'my_own'


def test_what_only_xacro_can_read_is_refused(tmp_path):
    path = tmp_path / 'other.xacro'
    path.write_text(URDF.read_text().replace('0.01725', '${gap}'))
    with pytest.raises(DescriptionError):
        fingertip_urdf(path=path)


def test_angles_turn_about_fixed_axes():
    assert quaternion(0.0, 0.0, np.pi / 2) == pytest.approx((0, 0, np.sqrt(0.5), np.sqrt(0.5)))
    assert quaternion(np.pi / 2, 0.0, np.pi / 2) == pytest.approx((0.5, 0.5, 0.5, 0.5))
