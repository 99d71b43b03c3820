# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The view node in its own process, fed over DDS, writing what it would show to a file."""

from __future__ import annotations

import signal
import subprocess
import time

import pytest

rclpy = pytest.importorskip('rclpy', reason='needs ROS 2')
pytest.importorskip('rerun_cli', reason='rerun-sdk is not installed: make view')

import numpy as np  # noqa: E402
from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from event_camera_msgs.msg import EventPacket  # noqa: E402
from geometry_msgs.msg import WrenchStamped  # noqa: E402
from sensor_msgs.msg import Image  # noqa: E402

from mixtac_cli.view.server import require_rerun  # noqa: E402
from mixtac_events.arrays import Events  # noqa: E402
from mixtac_events.codec import encode  # noqa: E402
from mixtac_msgs.msg import SlipState  # noqa: E402
from mixtac_node.base_node import QOS_EVENTS, QOS_FORCE, QOS_SENSOR  # noqa: E402
from mixtac_node.graph import live_view  # noqa: E402
from mixtac_node.images import fill  # noqa: E402

pytestmark = pytest.mark.dds


def packet(sequence: int) -> EventPacket:
    one = Events(
        np.array([sequence * 1000], np.int64),
        np.array([sequence % 346], np.uint16),
        np.array([7], np.uint16),
        np.array([True]),
    )
    encoded = encode(one, 'libcaer_cmp')
    message = EventPacket(width=346, height=260, seq=sequence, encoding=encoded.encoding)
    message.time_base = encoded.time_base
    message.events.frombytes(encoded.payload)
    return message


class Feeder:
    """Publishes everything that the view shows and listens to its diagnostics."""

    def __init__(self) -> None:
        rclpy.init()
        self.node = rclpy.create_node('feeder', namespace='/mixtac')
        create = self.node.create_publisher
        self.events = create(EventPacket, 'events', QOS_EVENTS)
        self.image = create(Image, 'image_raw', QOS_SENSOR)
        self.force = create(WrenchStamped, 'force', QOS_FORCE)
        self.slip = create(SlipState, 'slip', QOS_FORCE)
        self.said: dict[str, str] = {}
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self.listen, 10)
        self.frame = Image()
        fill(self.frame, np.full((260, 346), 30_000, np.uint16), 'mono16')
        self.sequence = 0

    def listen(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == 'mixtac/view':
                self.said = {each.key: each.value for each in status.values}

    def feed(self) -> None:
        self.sequence += 1
        self.events.publish(packet(self.sequence))
        self.image.publish(self.frame)
        wrench = WrenchStamped()
        wrench.wrench.force.z = 1.5
        self.force.publish(wrench)
        self.slip.publish(SlipState(count=3, threshold=5.0))
        rclpy.spin_once(self.node, timeout_sec=0.02)

    def close(self) -> None:
        self.node.destroy_node()
        rclpy.try_shutdown()


def test_what_is_published_is_shown_and_nothing_is_undecodable(ros_domain, tmp_path):
    path = tmp_path / 'run.rrd'
    process = subprocess.Popen(live_view(save=path).command('mixtac'), env=ros_domain)
    feeder = Feeder()
    try:
        deadline = time.monotonic() + 60
        seen = 0
        while seen < 60 and time.monotonic() < deadline:
            assert process.poll() is None
            feeder.feed()
            seen += feeder.force.get_subscription_count() > 0
        while not feeder.said and time.monotonic() < deadline:
            feeder.feed()
    finally:
        feeder.close()
        process.send_signal(signal.SIGTERM)
        assert process.wait(30) == 0
    assert feeder.said['undecodable'] == '0'
    assert feeder.said['page'] == str(path)
    printed = subprocess.run(
        [require_rerun(), 'rrd', 'print', path], capture_output=True, text=True, check=True
    ).stdout
    for entity in ('/events', '/frame', '/force/estimate', '/slip/count', '/state', '/rates/force'):
        assert entity in printed
