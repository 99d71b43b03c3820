# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The bytes of a force as ROS 2 reads them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_fger.fger_node import ForceMessage
from mixtac_fger.shear import Shear

names = st.text(st.characters(min_codepoint=32, max_codepoint=0x3FF), max_size=20)


@given(
    frame_id=names,
    stamp_us=st.integers(0, (2**31 - 1) * 1_000_000),
    force=st.floats(-100, 100),
    shear=st.none() | st.builds(Shear, *[st.floats(-9, 9)] * 5),
)
def test_ros_reads_what_was_written(frame_id, stamp_us, force, shear):
    pytest.importorskip('rclpy', reason='needs ROS 2')
    from geometry_msgs.msg import WrenchStamped
    from rclpy.serialization import deserialize_message

    writer = ForceMessage(frame_id)
    writer.serialised(1, 99.0, Shear(1.0, 2.0, 3.0, 4.0, 5.0))
    found = deserialize_message(writer.serialised(stamp_us, force, shear), WrenchStamped)
    expected = WrenchStamped()
    expected.header.frame_id = frame_id
    expected.header.stamp.sec = stamp_us // 1_000_000
    expected.header.stamp.nanosec = stamp_us % 1_000_000 * 1000
    expected.wrench.force.z = force
    if shear is not None:
        expected.wrench.force.x, expected.wrench.force.y = shear.x, shear.y
        expected.wrench.torque.z = shear.torque
    assert found == expected
