# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The slip control node as a process of its own, over real topics."""

from __future__ import annotations

import subprocess
import sys
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from mixtac_events.arrays import Events
from mixtac_events.codec import encode

rclpy = pytest.importorskip('rclpy', reason='needs ROS 2')
pytest.importorskip('mixtac_msgs.msg', reason='needs the built workspace')
pytest.importorskip('event_camera_msgs.msg', reason='needs the built workspace')

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = pytest.mark.dds
EPOCH_US = 1_700_000_000_000_000


@pytest.fixture
def process(ros_domain: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    """Run the node with a short learning time; ended by its pid."""
    command = [sys.executable, '-m', 'mixtac_slip_control.slip_control_node', '--ros-args']
    command += ['-p', 'learning_time:=0.1', '-p', 'max_total:=2e-6']
    started = subprocess.Popen(command, env=ros_domain, text=True, stderr=subprocess.PIPE)
    yield started
    started.terminate()
    _, errors = started.communicate(timeout=20)
    assert started.returncode == 0, errors


@pytest.fixture
def peer(ros_domain: dict[str, str]) -> Iterator[Peer]:
    """Yield the test's own end of the topics."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=int(ros_domain['ROS_DOMAIN_ID']))
    made = Peer(context)
    yield made
    made.node.destroy_node()
    context.try_shutdown()


class Peer:
    """Sends milliseconds of events and collects the slip states they lead to."""

    def __init__(self, context: Any) -> None:
        from event_camera_msgs.msg import EventPacket
        from rclpy.executors import SingleThreadedExecutor
        from std_srvs.srv import SetBool

        from mixtac_msgs.msg import SlipState
        from mixtac_node.base_node import QOS_EVENTS, QOS_FORCE

        self.node = rclpy.create_node('peer', context=context, namespace='mixtac')
        self.executor = SingleThreadedExecutor(context=context)
        self.executor.add_node(self.node)
        self.states: dict[int, Any] = {}
        self._packet, self._request = EventPacket, SetBool.Request
        self._events = self.node.create_publisher(EventPacket, 'events', QOS_EVENTS)
        self._client = self.node.create_client(SetBool, 'slip_control/enable')
        self._subscription = self.node.create_subscription(
            SlipState, 'slip', self._on_slip, QOS_FORCE
        )
        self._sent = 0

    def ready(self) -> bool:
        deadline = time.monotonic() + 40.0
        while time.monotonic() < deadline:
            self.executor.spin_once(timeout_sec=0.1)
            matched = self._events.get_subscription_count() and self.node.count_publishers('slip')
            if matched and self._client.service_is_ready():
                time.sleep(0.5)  # the other side may not have matched yet
                return True
        return False

    def enable(self, wanted: bool) -> Any:
        future = self._client.call_async(self._request(data=wanted))
        self.executor.spin_until_future_complete(future, timeout_sec=20.0)
        return future.result()

    def send(self, counts: list[int]) -> list[Any]:
        """Send one packet per count and millisecond; return the states of their windows."""
        first = self._sent
        for count in counts:
            start = EPOCH_US + self._sent * 1000
            t = start + np.arange(count, dtype=np.int64) * 1000 // max(count, 1)
            place = np.zeros(count, np.uint16)
            packet = encode(
                Events(t, place, place, np.ones(count, np.bool_)), complete_until=start + 1000
            )
            message = self._packet(
                width=346,
                height=260,
                seq=self._sent,
                time_base=packet.time_base,
                encoding=packet.encoding,
            )
            message.events.frombytes(packet.payload)
            self._events.publish(message)
            self._sent += 1
            self.executor.spin_once(timeout_sec=0.002)
        wanted = [EPOCH_US + (k + 1) * 1000 for k in range(first, self._sent)]
        deadline = time.monotonic() + 10.0
        while wanted[-1] not in self.states and time.monotonic() < deadline:
            self.executor.spin_once(timeout_sec=0.05)
        return [self.states[end] for end in wanted if end in self.states]

    def _on_slip(self, message: Any) -> None:
        stamp = message.header.stamp
        self.states[stamp.sec * 1_000_000 + stamp.nanosec // 1000] = message


def test_the_node_watches_counts_and_answers_slip_when_enabled(
    process: subprocess.Popen[str], peer: Peer
) -> None:
    assert peer.ready()
    assert process.poll() is None
    assert 'not learned' in peer.enable(wanted=True).message
    quiet = peer.send([30] * 300)
    assert len(quiet) > 250
    assert {s.count for s in quiet[-100:]} == {30}
    assert quiet[-1].background == pytest.approx(30.0, abs=0.1)
    assert quiet[-1].threshold > quiet[-1].background
    assert not any(s.slipping or s.enabled for s in quiet)

    disabled = peer.send([30, 600, *[30] * 50])
    assert any(s.slipping and s.count == 600 for s in disabled)
    assert all(s.advance == 0.0 and s.total_advance == 0.0 for s in disabled)

    answer = peer.enable(wanted=True)
    assert answer.success
    assert 'no arm' in answer.message
    slips = peer.send([30, 90, 600, 600, 30])
    assert all(s.enabled for s in slips)
    moved = [s.advance for s in slips if s.count > s.threshold]
    assert moved
    assert all(advance > 0.0 for advance in moved[:1])
    assert slips[-1].total_advance == pytest.approx(2e-6)
    assert max(s.total_advance for s in slips) <= 2e-6

    assert peer.enable(wanted=False).success
    assert peer.send([30, 600])[-1].advance == 0.0
