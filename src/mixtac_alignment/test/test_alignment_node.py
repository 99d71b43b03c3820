# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The alignment node as a process of its own, over real topics."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest

from mixtac_alignment.clock_fit import ClockFit
from mixtac_events.arrays import Events
from mixtac_events.codec import encode

pytest.importorskip('rclpy', reason='needs ROS 2')
pytest.importorskip('mixtac_msgs.msg', reason='needs the built workspace')
pytest.importorskip('event_camera_msgs.msg', reason='needs the built workspace')

pytestmark = pytest.mark.dds
PACKET_US = 10_000
PAUSES_S = (0.004, 0.02, 0.08)
"""Between packets, longer after each refusal: a busy machine loses best-effort messages."""


class Peer:
    """Plays a recording, asks for the fit and receives it."""

    def __init__(self, graph: Any) -> None:
        from event_camera_msgs.msg import EventPacket
        from geometry_msgs.msg import WrenchStamped

        from mixtac_node.base_node import QOS_EVENTS, QOS_FORCE

        self.graph = graph
        self._packet, self._wrench = EventPacket, WrenchStamped
        make = graph.node.create_publisher
        self._events = make(EventPacket, '/mixtac/events', QOS_EVENTS)
        self._force = make(WrenchStamped, '/ft_sensor/wrench', QOS_FORCE)

    def wait_for_node(self) -> None:
        for each in (self._events, self._force):
            self.graph.spin_until(each.get_subscription_count)
        time.sleep(0.5)  # the other side may not have matched yet

    def fit(self) -> Any:
        from std_srvs.srv import Trigger

        return self.graph.call(Trigger, '/mixtac/alignment/fit')

    def receive_late(self) -> Any:
        """Subscribe after the fact: the fit is latched."""
        from mixtac_msgs.msg import ClockFit
        from mixtac_node.base_node import QOS_LATCHED

        fits = self.graph.listen(ClockFit, '/mixtac/clock_fit', QOS_LATCHED)
        self.graph.spin_until(lambda: fits)
        return fits[-1]

    def hear_aligned(self, case: Any) -> None:
        """Check that a sample comes back on the camera clock."""
        from mixtac_node.base_node import QOS_FORCE

        heard = self.graph.listen(self._wrench, '/mixtac/reference/wrench', QOS_FORCE)
        # Not before what was sent: that would be a clock that starts anew.
        sent_s = float(case.reference_s(np.array(7.0)))
        self.graph.spin_until(lambda: heard, lambda: self._send_force(sent_s, 0.5))
        stamp = heard[0].header.stamp
        assert abs(stamp.sec * 1e6 + stamp.nanosec / 1e3 - float(case.camera_us(7.0))) < 2000.0

    def play(self, case: Any, pause_s: float) -> None:
        """Publish packets and force samples side by side."""
        t_us, force_s, force = case.recording()
        acting_s = (t_us - case.camera_start_us) * 1e-6 - case.latency_s
        rising = case.force(acting_s + 5e-5) > case.force(acting_s - 5e-5)
        borders = np.arange(t_us[0], t_us[-1] + PACKET_US, PACKET_US)
        cuts = np.searchsorted(t_us, borders)
        shares = np.linspace(0, len(force_s), len(borders)).astype(int)
        for i in range(len(borders) - 1):
            part = slice(cuts[i], cuts[i + 1])
            self._send_packet(i, t_us[part], rising[part], int(borders[i + 1]))
            for k in range(shares[i], shares[i + 1]):
                self._send_force(float(force_s[k]), float(force[k]))
            time.sleep(pause_s)

    def _send_packet(self, sequence: int, t_us: np.ndarray, rising: np.ndarray, until: int) -> None:
        n = len(t_us)
        x, y = np.arange(n) % 346, np.arange(n) % 260
        # The left half brightens with the force, the right half darkens.
        polarity = rising == (x < 173)
        events = Events(t_us, x.astype(np.uint16), y.astype(np.uint16), polarity)
        packet = encode(events, complete_until=until)
        message = self._packet(
            width=346,
            height=260,
            seq=sequence,
            time_base=packet.time_base,
            encoding=packet.encoding,
        )
        message.events.frombytes(packet.payload)
        self._events.publish(message)

    def _send_force(self, t_s: float, force: float) -> None:
        message = self._wrench()
        message.header.stamp.sec = int(t_s)
        message.header.stamp.nanosec = round((t_s - int(t_s)) * 1e9)
        message.wrench.force.z = -force
        self._force.publish(message)


def test_the_node_fits_and_latches_the_clock_map(scene: Any, node_under_test: Any) -> None:
    node_under_test.start('mixtac_alignment.alignment_node')
    peer = Peer(node_under_test)
    peer.wait_for_node()
    refused = peer.fit()
    assert not refused.success
    assert 'no ' in refused.message
    case = scene(taps_s=(1.0, 5.5), seconds=6.5, presses=False, tap_s=0.02, rate_hz=400.0)
    for pause_s in PAUSES_S:
        peer.play(case, pause_s)
        time.sleep(0.3)
        answer = peer.fit()
        if answer.success:
            break
    assert answer.success, answer.message
    message = peer.receive_late()
    fit = ClockFit.from_fields(
        {name: getattr(message, name) for name in message.get_fields_and_field_types()}
    )
    times = np.array([case.camera_us(t) for t in case.taps_s])
    error = fit.to_reference(times) - case.reference_s(np.array(case.taps_s))
    assert np.abs(error).max() < 2e-3
    peer.hear_aligned(case)
    assert message.method == 'two_impulse'
    assert message.message == answer.message
    assert message.header.stamp.sec > 0
    assert len(message.camera_anchors) == 2
