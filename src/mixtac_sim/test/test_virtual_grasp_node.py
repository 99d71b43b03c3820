# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The virtual grasp as a process of its own: frames of what it publishes."""

from __future__ import annotations

import pytest

pytest.importorskip('rclpy')

from geometry_msgs.msg import PointStamped, WrenchStamped
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from mixtac_core.node.base_node import QOS_FORCE, QOS_SENSOR
from mixtac_core.node.topics import stamp_to_ns
from mixtac_sim.arm import JOINT_NAMES, READY

pytestmark = pytest.mark.dds


def test_what_is_struck_goes_down_in_the_contact_frame_and_drags_the_skin_along(
    node_under_test, tmp_path
):
    graph = node_under_test
    truth = graph.listen(WrenchStamped, '/mixtac/truth/wrench', QOS_FORCE)
    places = graph.listen(PointStamped, '/mixtac/truth/object', QOS_FORCE)
    joints = graph.listen(JointState, '/joint_states', QOS_SENSOR)
    arm = graph.node.create_publisher(JointState, '/virtual_arm/joint_states', 10)
    graph.start('mixtac_sim.virtual_grasp_node', f'socket:={tmp_path}/camera.sock', 'preset:=easy')
    graph.spin_until(lambda: places)
    assert graph.call(Trigger, '/mixtac/virtual_grasp/put_back').success
    truth.clear()
    # A hand holds the object for 0.6 s.
    graph.spin_until(lambda: len(truth) > 700 and truth[-700].wrench.force.z > 0.0)
    assert graph.call(Trigger, '/mixtac/virtual_grasp/knock').success
    graph.spin_until(lambda: places[-1].point.y < -1e-4)
    assert places[-1].header.frame_id == truth[-1].header.frame_id == 'mixtac_contact'
    assert (places[-1].point.x, places[-1].point.z) == (0.0, 0.0)
    force = truth[-1].wrench.force
    assert force.y < 0.0 < force.z

    # The fingertip reports where it is, on the clock of the other topics.
    arm.publish(JointState(name=JOINT_NAMES, position=READY.tolist()))
    graph.spin_until(lambda: len(joints) > 2)
    assert list(joints[-1].position) == READY.tolist()
    stamps = [stamp_to_ns(each.header.stamp) for each in joints]
    assert stamps == sorted(set(stamps))
    assert abs(stamps[-1] - stamp_to_ns(truth[-1].header.stamp)) < 1_000_000_000
