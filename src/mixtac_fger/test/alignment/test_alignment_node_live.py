# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The alignment node as a process: a simulated trial over topics."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')
pytest.importorskip('mixtac_msgs.msg', reason='needs the built workspace')
pytest.importorskip('event_camera_msgs.msg', reason='needs the built workspace')

from event_camera_msgs.msg import EventPacket
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import Image
from std_srvs.srv import Trigger

from mixtac_core.events.codec import encode
from mixtac_core.node.base_node import QOS_FORCE, qos
from mixtac_core.node.topics import CLOCK_FIT, EVENTS, us_to_stamp
from mixtac_fger.alignment.clock_fit import ClockFit
from mixtac_msgs.msg import ClockFit as ClockFitMessage
from mixtac_msgs.msg import FrameExposure
from mixtac_sim.world.trial import simulate_trial

if TYPE_CHECKING:
    from mixtac_sim.world.trial import Trial

pytestmark = pytest.mark.dds
SECONDS = 8.0
PACKET_US = 20_000


PAUSES_S = (0.012, 0.05, 0.2)
"""Between packets, longer after each refusal: a busy machine loses best-effort messages."""


class Peer:
    """Publishes what camera and reference sensor would, and asks for the fit."""

    def __init__(self, graph: Any) -> None:
        make = graph.node.create_publisher
        self.graph = graph
        self.events = make(EventPacket, '/mixtac/events', qos(EVENTS))
        self.images = make(Image, '/mixtac/image_raw', QOS_FORCE)
        self.exposures = make(FrameExposure, '/mixtac/image_exposure', QOS_FORCE)
        self.forces = make(WrenchStamped, '/ft_sensor/wrench', QOS_FORCE)
        self.fits = graph.listen(ClockFitMessage, '/mixtac/clock_fit', qos(CLOCK_FIT))
        for publisher in (self.events, self.images, self.exposures, self.forces):
            graph.spin_until(publisher.get_subscription_count)
        time.sleep(0.5)  # the other side may not have matched yet

    def fit(self) -> tuple[Any, ClockFit | None]:
        self.fits.clear()
        answer = self.graph.call(Trigger, '/mixtac/alignment/fit')
        if not answer.success:
            return answer, None
        self.graph.spin_until(lambda: self.fits)
        message = self.fits[-1]
        names = message.get_fields_and_field_types()
        return answer, ClockFit.from_fields({name: getattr(message, name) for name in names})

    def play(self, trial: Trial, pause_s: float) -> None:
        """Publish a trial."""
        at_frame = at_force = 0
        cuts = np.arange(0, round(1e6 * SECONDS), PACKET_US)
        for number, start in enumerate(cuts):
            end = int(start) + PACKET_US
            a, b = np.searchsorted(trial.events.t, (start, end))
            packet = encode(trial.events[slice(int(a), int(b))], complete_until=end)
            message = EventPacket(width=346, height=260, seq=number, encoding=packet.encoding)
            message.time_base = packet.time_base
            message.events.frombytes(packet.payload)
            self.events.publish(message)
            while at_frame < len(trial.frames) and trial.exposure_end_us[at_frame] < end:
                self._frame(trial, at_frame)
                at_frame += 1
            until = len(trial.reference_t_us) * (number + 1) // len(cuts)
            for k in range(at_force, until):
                force = WrenchStamped()
                force.header.stamp = us_to_stamp(int(trial.reference_t_us[k]) + OFFSET_US)
                force.wrench.force.z = float(trial.reference_wrench[k, 2])
                self.forces.publish(force)
            at_force = until
            time.sleep(pause_s)

    def _frame(self, trial: Trial, k: int) -> None:
        start, end = int(trial.exposure_start_us[k]), int(trial.exposure_end_us[k])
        times = {'exposure_start': us_to_stamp(start), 'exposure_end': us_to_stamp(end)}
        exposure = FrameExposure(**times)
        image = Image(height=260, width=346, encoding='mono16', step=692)
        image.header.stamp = exposure.header.stamp = us_to_stamp((start + end) // 2)
        image.data.frombytes((trial.frames[k] << 6).astype('<u2').tobytes())
        self.images.publish(image)
        self.exposures.publish(exposure)


OFFSET_US = 20_000_000
"""Keeps the reference clock's stamps positive."""


def test_a_trial_with_frames_is_aligned(node_under_test: Any) -> None:
    node_under_test.start('mixtac_fger.alignment.alignment_node')
    peer = Peer(node_under_test)
    trial = simulate_trial(300_000, 300_101, 'oscillation', SECONDS, sync=True)
    refused, _ = peer.fit()
    assert not refused.success
    for pause_s in PAUSES_S:
        peer.play(trial, pause_s)
        time.sleep(0.5)
        answer, fit = peer.fit()
        if fit is not None and fit.method == 'two_impulse':
            break
    assert answer.success, answer.message
    assert fit is not None
    assert fit.method == 'two_impulse'
    camera_us = np.array([1_000_000, 7_000_000])
    shown_us = trial.clock[0] * camera_us + trial.clock[1] + trial.reference_delay_us + OFFSET_US
    error_s = fit.to_reference(camera_us) - 1e-6 * shown_us
    assert np.abs(error_s).max() < 2e-3
    assert np.all(np.abs(error_s) < 4.0 * fit.std_at(camera_us))
