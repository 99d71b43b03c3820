# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The virtual arm as a process of its own: the contract of its topics, and what it does."""

from __future__ import annotations

import time

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import ReliabilityPolicy
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from mixtac_core.node.base_node import QOS_SENSOR
from mixtac_core.node.topics import ns_to_stamp
from mixtac_sim.arm import JOINT_NAMES, READY

pytestmark = pytest.mark.dds
NAME = 'mixtac/virtual_arm'
TOPIC = '/fr3_arm_controller/joint_trajectory'


def send(trajectories, goal, names=JOINT_NAMES):
    message = JointTrajectory(joint_names=list(names))
    message.header.stamp = ns_to_stamp(time.time_ns())
    point = JointTrajectoryPoint(positions=list(goal), velocities=[0.0] * 7)
    point.accelerations = [0.0] * 7
    point.time_from_start.sec = 20  # ends in the future on any machine
    message.points = [point]
    trajectories.publish(message)


def test_follows_trajectories_and_says_why_it_rejects_one(node_under_test):
    graph = node_under_test
    states = graph.listen(JointState, '/joint_states', QOS_SENSOR)
    graph.listen(DiagnosticArray, '/diagnostics', 10)
    trajectories = graph.node.create_publisher(JointTrajectory, TOPIC, 10)

    def figure(name):
        return graph.diagnostics(NAME).get(name)

    graph.start('mixtac_sim.virtual_arm_node')
    graph.spin_until(lambda: states and trajectories.get_subscription_count())
    assert tuple(states[-1].name) == JOINT_NAMES
    assert np.array_equal(states[-1].position, READY)
    [published] = graph.node.get_publishers_info_by_topic('/joint_states')
    assert published.topic_type == 'sensor_msgs/msg/JointState'
    assert published.qos_profile.reliability == ReliabilityPolicy.RELIABLE
    [commands] = graph.node.get_subscriptions_info_by_topic(TOPIC)
    assert commands.topic_type == 'trajectory_msgs/msg/JointTrajectory'
    assert commands.qos_profile.reliability == ReliabilityPolicy.RELIABLE

    send(trajectories, READY, names=JOINT_NAMES[::-1])
    graph.spin_until(lambda: figure('trajectories_rejected') == '1')
    assert np.array_equal(states[-1].position, READY)

    goal = READY + 0.01
    send(trajectories, goal)
    graph.spin_until(lambda: states[-1].position[0] > READY[0] + 1e-4)
    graph.spin_until(lambda: figure('trajectories_accepted') == '1')
    stamps = [s.header.stamp.sec + 1e-9 * s.header.stamp.nanosec for s in states]
    assert np.all(np.diff(stamps) > 0.0)
