# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The virtual arm as a process of its own: the contract of its topics, and what it does."""

from __future__ import annotations

import subprocess
import sys
import time

import numpy as np
import pytest

rclpy = pytest.importorskip('rclpy', reason='needs ROS 2')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.qos import ReliabilityPolicy  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint  # noqa: E402

from mixtac_node.base_node import QOS_SENSOR  # noqa: E402
from mixtac_node.stamps import ns_to_stamp  # noqa: E402
from mixtac_sim.arm.fr3 import JOINT_NAMES, READY  # noqa: E402

pytestmark = pytest.mark.dds
TOPIC = '/fr3_arm_controller/joint_trajectory'
PATIENCE_S = 120.0


class Peer:
    """The node and the test's own end of its topics."""

    def __init__(self, env):
        command = [sys.executable, '-m', 'mixtac_sim.virtual_arm_node']
        self.process = subprocess.Popen(
            command, env=env, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
        )
        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        self.node = rclpy.create_node('peer', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.states, self.figures = [], {}
        self.node.create_subscription(JointState, '/joint_states', self.states.append, QOS_SENSOR)
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 10)
        self.trajectories = self.node.create_publisher(JointTrajectory, TOPIC, 10)

    def _on_diagnostics(self, message):
        for status in message.status:
            self.figures = {pair.key: pair.value for pair in status.values}

    def spin_until(self, condition):
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < deadline
            assert self.process.poll() is None, self.process.stdout.read()
            self.executor.spin_once(timeout_sec=0.1)

    def send(self, goal, names=JOINT_NAMES):
        message = JointTrajectory(joint_names=list(names))
        message.header.stamp = ns_to_stamp(time.time_ns())
        point = JointTrajectoryPoint(positions=list(goal), velocities=[0.0] * 7)
        point.accelerations = [0.0] * 7
        point.time_from_start.sec = 20  # ends in the future on any machine
        message.points = [point]
        self.trajectories.publish(message)

    def close(self):
        self.process.terminate()
        words, _ = self.process.communicate(timeout=40)
        self.node.destroy_node()
        self.context.try_shutdown()
        return self.process.returncode, words


@pytest.fixture
def peer(ros_domain):
    made = Peer(ros_domain)
    yield made
    code, words = made.close()
    assert code == 0, words


def test_follows_trajectories_and_says_why_it_rejects_one(peer):
    peer.spin_until(lambda: peer.states and peer.trajectories.get_subscription_count())
    assert tuple(peer.states[-1].name) == JOINT_NAMES
    assert np.array_equal(peer.states[-1].position, READY)
    [states] = peer.node.get_publishers_info_by_topic('/joint_states')
    assert states.topic_type == 'sensor_msgs/msg/JointState'
    assert states.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    [commands] = peer.node.get_subscriptions_info_by_topic(TOPIC)
    assert commands.topic_type == 'trajectory_msgs/msg/JointTrajectory'
    assert commands.qos_profile.reliability == ReliabilityPolicy.RELIABLE

    peer.send(READY, names=JOINT_NAMES[::-1])
    peer.spin_until(lambda: peer.figures.get('trajectories_rejected') == '1')
    assert np.array_equal(peer.states[-1].position, READY)

    goal = READY + 0.01
    peer.send(goal)
    peer.spin_until(lambda: peer.states[-1].position[0] > READY[0] + 1e-4)
    peer.spin_until(lambda: peer.figures.get('trajectories_accepted') == '1')
    stamps = [s.header.stamp.sec + 1e-9 * s.header.stamp.nanosec for s in peer.states]
    assert np.all(np.diff(stamps) > 0.0)
    # A rest-to-rest quintic over 20 s breaks no limit.
    assert peer.figures['limit_violations'] == '0'
