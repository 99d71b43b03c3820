# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The slip control node as a process of its own, over real topics, on a simulated clock."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from mixtac_core.events.arrays import Events
from mixtac_core.events.codec import encode

pytest.importorskip('rclpy', reason='needs ROS 2')
pytest.importorskip('mixtac_msgs.msg', reason='needs the built workspace')
pytest.importorskip('event_camera_msgs.msg', reason='needs the built workspace')

pytestmark = pytest.mark.dds
EPOCH_US = 1_700_000_000_000_000
READY = [0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4]
NAMES = [f'fr3_joint{k}' for k in range(1, 8)]
TOPIC = '/fr3_arm_controller/joint_trajectory'


class Peer:
    """Plays clock, driver, estimator, arm, its controller, and supervisor."""

    def __init__(self, graph: Any) -> None:
        from event_camera_msgs.msg import EventPacket
        from geometry_msgs.msg import WrenchStamped
        from rcl_interfaces.srv import GetParameters
        from rosgraph_msgs.msg import Clock
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Empty, Float64MultiArray
        from trajectory_msgs.msg import JointTrajectory

        from mixtac_core.node.base_node import QOS_FORCE, qos
        from mixtac_core.node.topics import EVENTS
        from mixtac_msgs.msg import SlipState

        self.graph = graph
        make = graph.node.create_publisher
        self._inputs = {
            Clock: make(Clock, '/clock', 10),
            EventPacket: make(EventPacket, '/mixtac/events', qos(EVENTS)),
            WrenchStamped: make(WrenchStamped, '/mixtac/force', QOS_FORCE),
            JointState: make(JointState, '/joint_states', 10),
            Empty: make(Empty, '/mixtac/slip_control/heartbeat', 10),
        }
        self._types = tuple(self._inputs)
        self.states: dict[int, Any] = {}
        graph.node.create_subscription(SlipState, '/mixtac/slip', self._on_slip, QOS_FORCE)
        self.trajectories = graph.listen(JointTrajectory, TOPIC, 10)
        self.grips = graph.listen(Float64MultiArray, '/mixtac/grip', 10)
        self.settings: dict[str, object] = {
            'interpolate_from_desired_state': True,
            'allow_trajectory_replacement': True,
        }
        service = '/fr3_arm_controller/get_parameters'
        graph.node.create_service(GetParameters, service, self._on_settings)
        self._packets, self.ms, self.force = 0, 0, 0.5

    def _on_slip(self, message: Any) -> None:
        stamp = message.header.stamp
        self.states[stamp.sec * 1_000_000 + stamp.nanosec // 1000] = message

    def _on_settings(self, request: Any, response: Any) -> Any:
        from rclpy.parameter import Parameter

        response.values = [
            Parameter('p', value=self.settings.get(name)).get_parameter_value()
            for name in request.names
        ]
        return response

    def start(self, *parameters: str) -> None:
        """Start the node and wait until both sides have found each other."""
        values = ('arm:=fr3', 'law:=paper', 'gain:=2e-8', 'use_sim_time:=true')
        self.graph.start('mixtac_slip_control.slip_control_node', *values, *parameters)
        inputs = self._inputs.values()
        self.graph.spin_until(lambda: all(each.get_subscription_count() for each in inputs))
        outputs = ('/mixtac/slip', TOPIC)
        self.graph.spin_until(lambda: all(map(self.graph.node.count_publishers, outputs)))

    def call(self, name: str, wanted: bool | None = None) -> Any:
        from std_srvs.srv import SetBool, Trigger

        if wanted is None:
            return self.graph.call(Trigger, f'/mixtac/slip_control/{name}')
        request = SetBool.Request(data=wanted)
        return self.graph.call(SetBool, f'/mixtac/slip_control/{name}', request)

    def send(self, count: int = 30, windows: int = 1) -> Any:
        """Let time go on, send every input, and return the state of the last window."""
        clock, packet, wrench, joints, empty = self._types
        start_us, width_us = EPOCH_US + 1000 * self.ms, 1000 * windows
        self.ms += windows
        end_us = EPOCH_US + 1000 * self.ms
        now = clock()
        force = wrench()
        for stamp in (now.clock, force.header.stamp):
            stamp.sec, stamp.nanosec = end_us // 1_000_000, 1000 * (end_us % 1_000_000)
        force.wrench.force.z = self.force
        total = count * windows
        t = start_us + np.arange(total, dtype=np.int64) * width_us // total
        place = np.full(total, 130, np.uint16)
        made = encode(Events(t, place, place, np.arange(total) % 2 == 0), complete_until=end_us)
        message = packet(
            width=346,
            height=260,
            seq=self._packets,
            time_base=made.time_base,
            encoding=made.encoding,
        )
        message.events.frombytes(made.payload)
        self._packets += 1
        # The joints come in an order of their own.
        joint_state = joints(name=NAMES[::-1], position=READY[::-1])
        for kind, given in ((clock, now), (wrench, force), (joints, joint_state), (empty, empty())):
            self._inputs[kind].publish(given)
        self._inputs[packet].publish(message)
        self.graph.spin_until(lambda: end_us in self.states)
        return self.states[end_us]


def test_slip_moves_the_arm_when_enabled_and_a_fault_stops_it(node_under_test: Any) -> None:
    peer = Peer(node_under_test)
    peer.start('gripper:=force')
    assert not peer.call('enable', wanted=True).success
    for _ in range(11):
        state = peer.send(windows=100)
    assert not state.slipping
    assert not state.enabled
    assert state.background == pytest.approx(30.0, abs=2.0)
    assert state.header.frame_id == 'mixtac_contact'
    slip = peer.send(600)
    assert slip.slipping
    assert slip.advance == 0.0
    peer.graph.spin_until(lambda: bool(peer.grips))

    # The parameters of the controller of the arm decide whether it is enabled.

    def refused() -> bool:
        return 'allow_trajectory_replacement' in peer.call('enable', wanted=True).message

    peer.graph.spin_until(refused, lambda: peer.send(windows=20))
    peer.settings['allow_trajectory_replacement'] = False

    def enabled() -> bool:
        return bool(peer.call('enable', wanted=True).success)

    peer.graph.spin_until(enabled, lambda: peer.send(windows=20))
    peer.graph.spin_until(lambda: len(peer.trajectories) == 1)
    assert np.allclose(peer.trajectories[0].points[-1].positions, READY)
    for _ in range(80):
        state = peer.send()
    assert state.enabled, state.reason
    assert peer.send(600).total_advance > 0.0
    state = peer.send()
    assert state.state == state.ENABLED
    peer.graph.spin_until(lambda: len(peer.trajectories) > 1)
    check_trajectory(peer.trajectories[-1])
    assert not peer.call('tare').success
    assert not peer.call('reset').success

    peer.force = 3.0
    stopped = [peer.send(600) for _ in range(3)][-1]
    assert stopped.state == stopped.STOPPED
    assert stopped.advance == 0.0
    assert 'max_force' in stopped.reason
    assert not peer.call('enable', wanted=True).success
    assert not peer.call('reset').success
    peer.force = 0.5
    for _ in range(30):
        peer.send(windows=10)
    assert peer.call('reset').success
    assert peer.call('enable', wanted=False).success
    assert peer.call('tare').success


def check_trajectory(message: Any) -> None:
    """Check what joint_trajectory_controller asks of a trajectory."""
    assert list(message.joint_names) == NAMES
    times = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in message.points]
    assert len(times) > 2
    assert all(later > earlier for earlier, later in pairwise(times))
    last = message.points[-1]
    assert np.allclose(last.velocities, 0.0, atol=1e-9)
    assert np.allclose(last.accelerations, 0.0, atol=1e-6)
    moved = np.array([p.positions for p in message.points]) - READY
    assert 0.0 < np.abs(moved).max() < 0.02
