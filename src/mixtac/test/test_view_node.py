# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The view node in its own process, fed over DDS, writing what it would show to a file."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')
pytest.importorskip('rerun_cli', reason='rerun-sdk is not installed: make view')

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from event_camera_msgs.msg import EventPacket
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import Image

from mixtac.view import require_rerun
from mixtac_core.events.arrays import Events
from mixtac_core.events.codec import encode
from mixtac_core.node.base_node import QOS_EVENTS, QOS_FORCE, QOS_SENSOR
from mixtac_core.node.graph import live_view
from mixtac_core.node.images import fill
from mixtac_msgs.msg import SlipState

pytestmark = pytest.mark.dds
NAME = 'mixtac/view'


def packet(sequence: int) -> EventPacket:
    one = Events(
        np.array([sequence * 1000], np.int64),
        np.array([sequence % 346], np.uint16),
        np.array([7], np.uint16),
        np.array([True]),
    )
    encoded = encode(one)
    message = EventPacket(width=346, height=260, seq=sequence, encoding=encoded.encoding)
    message.time_base = encoded.time_base
    message.events.frombytes(encoded.payload)
    return message


class Feeder:
    """Publishes everything that the view shows."""

    def __init__(self, node) -> None:
        create = node.create_publisher
        self.events = create(EventPacket, '/mixtac/events', QOS_EVENTS)
        self.image = create(Image, '/mixtac/image_raw', QOS_SENSOR)
        self.force = create(WrenchStamped, '/mixtac/force', QOS_FORCE)
        self.slip = create(SlipState, '/mixtac/slip', QOS_FORCE)
        self.frame = Image()
        fill(self.frame, np.full((260, 346), 30_000, np.uint16), 'mono16')
        self.sequence = self.seen = 0

    def feed(self) -> None:
        self.sequence += 1
        self.events.publish(packet(self.sequence))
        self.image.publish(self.frame)
        wrench = WrenchStamped()
        wrench.wrench.force.z = 1.5
        self.force.publish(wrench)
        self.slip.publish(SlipState(count=3, threshold=5.0))
        self.seen += self.force.get_subscription_count() > 0


def test_what_is_published_is_shown_and_nothing_is_undecodable(node_under_test, tmp_path):
    path = tmp_path / 'run.rrd'
    node_under_test.listen(DiagnosticArray, '/diagnostics', 10)
    node_under_test.start_nodes([live_view(save=path)], 'mixtac')
    feeder = Feeder(node_under_test.node)
    node_under_test.spin_until(lambda: feeder.seen >= 60, feeder.feed)
    node_under_test.spin_until(lambda: node_under_test.diagnostics(NAME), feeder.feed)
    said = node_under_test.diagnostics(NAME)
    assert node_under_test.process.end() == 0
    assert said['undecodable'] == '0'
    assert said['page'] == str(path)
    printed = subprocess.run(
        [require_rerun(), 'rrd', 'print', path], capture_output=True, text=True, check=True
    ).stdout
    for entity in ('/events', '/frame', '/force/estimate', '/state'):
        assert entity in printed


def view(path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, '-m', 'mixtac', 'view', '--save', path, '--seconds', '0.2']
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=120)


def test_the_seconds_of_a_file_begin_with_it(node_under_test, tmp_path):
    path = tmp_path / 'new' / 'run.rrd'
    assert view(path).returncode == 0
    assert path.exists()


def test_a_file_that_cannot_be_written_ends_the_view_with_one_line(node_under_test, tmp_path):
    (tmp_path / 'file').touch()
    ended = view(tmp_path / 'file' / 'run.rrd')
    assert ended.returncode == 1
    assert str(tmp_path / 'file') in ended.stderr.splitlines()[-1]
    assert 'Traceback' not in ended.stdout + ended.stderr
