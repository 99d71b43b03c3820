# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Clocks that start anew beside the alignment node, which fits them by edges."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mixtac_core.events.arrays import Events
from mixtac_core.events.codec import encode

pytest.importorskip('rclpy', reason='needs ROS 2')
pytest.importorskip('mixtac_msgs.msg', reason='needs the built workspace')

pytestmark = pytest.mark.dds
EPOCH_S = 1_700_000_000.0


class Peer:
    """Sends edges and forces, asks for fits and listens to what is aligned."""

    def __init__(self, graph: Any) -> None:
        from event_camera_msgs.msg import EventPacket
        from geometry_msgs.msg import WrenchStamped
        from sensor_msgs.msg import TimeReference

        from mixtac_core.node.base_node import QOS_EVENTS, QOS_FORCE, QOS_LATCHED
        from mixtac_msgs.msg import ClockFit, ExternalEdge

        self.graph = graph
        graph.start(
            'mixtac_fger.alignment.alignment_node', 'use_edges:=true', remap=('__ns:=/mixtac',)
        )
        make = graph.node.create_publisher
        self._edge, self._told, self._wrench = ExternalEdge, TimeReference, WrenchStamped
        self._packet = EventPacket
        self._packets = make(EventPacket, '/mixtac/events', QOS_EVENTS)
        self._edges = make(ExternalEdge, '/mixtac/external_edges', QOS_FORCE)
        self._reference = make(TimeReference, '/mixtac/reference_edges', QOS_FORCE)
        self._force = make(WrenchStamped, '/ft_sensor/wrench', QOS_FORCE)
        self.fits = graph.listen(ClockFit, '/mixtac/clock_fit', QOS_LATCHED)
        self.aligned = graph.listen(WrenchStamped, '/mixtac/reference/wrench', QOS_FORCE)
        for each in (self._packets, self._edges, self._reference, self._force):
            graph.spin_until(each.get_subscription_count)

    def edges(self, times_s: np.ndarray, reference_s: np.ndarray) -> None:
        """Send edges, as both clocks tell their times [s]."""
        from mixtac_core.node.stamps import us_to_stamp

        for t, r in zip(times_s, reference_s, strict=True):
            edge, told = self._edge(), self._told()
            edge.header.stamp = us_to_stamp(round(1e6 * t))
            told.time_ref = us_to_stamp(round(1e6 * r))
            self._edges.publish(edge)
            self._reference.publish(told)
            self.graph.executor.spin_once(timeout_sec=0.0)

    def force(self, first_s: float, samples: int = 50) -> None:
        """Send forces, 100 a second, from a time of the reference clock on [s]."""
        from mixtac_core.node.stamps import us_to_stamp

        for k in range(samples):
            message = self._wrench()
            message.header.stamp = us_to_stamp(round(1e6 * first_s) + 10_000 * k)
            self._force.publish(message)
            self.graph.executor.spin_once(timeout_sec=0.0)

    def packet(self, number: int, until_s: float) -> None:
        """Send an empty packet."""
        packet = encode(Events.empty(), complete_until=round(1e6 * until_s))
        message = self._packet(
            width=346, height=260, seq=number, time_base=packet.time_base, encoding=packet.encoding
        )
        message.events.frombytes(packet.payload)
        self._packets.publish(message)

    def stamps(self) -> list[float]:
        """Return the stamps of the aligned forces [s]."""
        stamps = [message.header.stamp for message in self.aligned]
        return [each.sec + 1e-9 * each.nanosec for each in stamps]

    def fit(self) -> Any:
        """Ask for a fit; return what is published, or None where it is refused."""
        from std_srvs.srv import Trigger

        number = len(self.fits)
        if not self.graph.call(Trigger, '/mixtac/alignment/fit').success:
            return None
        self.graph.spin_until(lambda: len(self.fits) > number)
        return self.fits[-1]


def test_a_reference_that_starts_anew_is_fitted_anew(node_under_test: Any) -> None:
    peer, rng = Peer(node_under_test), np.random.default_rng(2)

    def fitted(times_s: np.ndarray, reference_s: np.ndarray) -> bool:
        # Sent again until all arrives: the node may not have been discovered yet.
        peer.force(reference_s[0])
        peer.edges(times_s, reference_s)
        return peer.fit() is not None

    times = EPOCH_S + np.cumsum(rng.uniform(0.1, 0.5, 60))
    peer.graph.spin_until(lambda: fitted(times, times - EPOCH_S + 5.0))
    peer.force(6.0)
    peer.graph.spin_until(lambda: peer.aligned)
    assert peer.stamps()[0] == pytest.approx(EPOCH_S + 1.0, abs=1e-3)
    peer.force(6.2, 15)
    peer.force(6.5)

    zero = times[-1] + 3.0
    again = zero + np.cumsum(rng.uniform(0.1, 0.5, 30))
    peer.force(0.0)
    peer.graph.spin_until(lambda: fitted(again, again - zero))
    peer.force(2.0)
    peer.graph.spin_until(lambda: peer.stamps()[-1] > zero)
    # Stamps that do not increase are not handed on.
    former = [stamp for stamp in peer.stamps() if stamp < zero]
    assert former == sorted(set(former))
    # By the former map the first forces of the new clock would be older than all others.
    assert min(peer.stamps()) >= EPOCH_S + 0.99


def test_a_driver_that_starts_anew_ends_the_fit(node_under_test: Any) -> None:
    peer, rng = Peer(node_under_test), np.random.default_rng(4)
    times = EPOCH_S + np.cumsum(rng.uniform(0.1, 0.5, 60))

    def fitted() -> bool:
        peer.packet(1000, EPOCH_S)
        peer.edges(times, times - EPOCH_S + 5.0)
        return peer.fit() is not None

    peer.graph.spin_until(fitted)

    def forgotten() -> bool:
        # Its clock is a moment ahead of where the one before would be.
        peer.packet(0, EPOCH_S + 0.07)
        return peer.fit() is None

    peer.graph.spin_until(forgotten)
    peer.force(6.0)
    again = times + 0.07
    peer.edges(again, times - EPOCH_S + 5.0)
    peer.graph.spin_until(lambda: peer.fit() is not None)
    peer.force(7.0)
    peer.graph.spin_until(lambda: peer.aligned)
    assert peer.stamps()[0] == pytest.approx(EPOCH_S + 2.07, abs=1e-3)
