# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The bytes of a wrench as ROS 2 reads them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_core.node.topics import WrenchWriter, absolute

names = st.text(st.characters(min_codepoint=32, max_codepoint=0x3FF), max_size=20)


@given(
    frame_id=names,
    stamp_ns=st.integers(0, (2**31 - 1) * 1_000_000_000),
    wrench=st.tuples(*[st.floats(-100, 100)] * 6),
)
def test_ros_reads_what_was_written(frame_id, stamp_ns, wrench):
    pytest.importorskip('rclpy', reason='needs ROS 2')
    from geometry_msgs.msg import Vector3, WrenchStamped
    from rclpy.serialization import deserialize_message

    writer = WrenchWriter(frame_id)
    writer.serialised(1, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    found = deserialize_message(writer.serialised(stamp_ns, wrench), WrenchStamped)
    expected = WrenchStamped()
    expected.header.frame_id = frame_id
    expected.header.stamp.sec, expected.header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
    expected.wrench.force = Vector3(x=wrench[0], y=wrench[1], z=wrench[2])
    expected.wrench.torque = Vector3(x=wrench[3], y=wrench[4], z=wrench[5])
    assert found == expected


@pytest.mark.parametrize(
    ('name', 'namespace', 'expected'),
    [
        ('force', 'mixtac', '/mixtac/force'),
        ('force', '/left/mixtac/', '/left/mixtac/force'),
        ('force', '/', '/force'),
        ('force', '', '/force'),
        ('/ft_sensor/wrench', 'mixtac', '/ft_sensor/wrench'),
    ],
)
def test_a_name_is_made_absolute_in_its_namespace(name, namespace, expected):
    assert absolute(name, namespace) == expected
