# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The live view: its pictures, its server, and the node in its own process, which writes a file."""

from __future__ import annotations

import importlib.util
import socket
import subprocess
import sys
import time
import urllib.request
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import psutil
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from diagnostic_msgs.msg import DiagnosticArray
from event_camera_msgs.msg import EventPacket
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import Image

from mixtac import view_node
from mixtac.view_node import (
    COLOURS,
    FULL,
    HOST,
    STILL,
    EventPicture,
    ViewError,
    ViewerServer,
    contact_outline,
    free_port,
    require_rerun,
)
from mixtac_core.events.arrays import Events
from mixtac_core.events.codec import encode
from mixtac_core.node.base_node import QOS_FORCE, QOS_SENSOR, qos
from mixtac_core.node.graph import node
from mixtac_core.node.images import fill
from mixtac_core.node.topics import EVENTS

NAME = 'mixtac/view'
needs_rerun = pytest.mark.skipif(
    importlib.util.find_spec('rerun') is None, reason='rerun-sdk is not installed: make view'
)


def events(*found: tuple[int, int, bool]) -> Events:
    columns, kinds = zip(*found, strict=True), (np.uint16, np.uint16, np.bool_)
    return Events(np.arange(len(found), dtype=np.int64), *map(np.array, columns, kinds))


def test_polarities_have_their_levels_and_cancel():
    picture = EventPicture(3, 4)
    picture.add(events(*[(1, 0, True)] * 5, *[(2, 1, False)] * 2, (3, 2, True), (3, 2, False)))
    shown = picture.take()
    assert shown.shape == (3, 4)
    assert shown[0, 1] == STILL + FULL
    assert shown[1, 2] == STILL - 2
    assert shown[2, 3] == STILL
    assert (picture.take() == STILL).all()


def test_every_level_has_its_own_colour_and_none_is_zero():
    assert sorted(COLOURS) == list(range(STILL - FULL, STILL + FULL + 1))
    assert len(set(COLOURS.values())) == len(COLOURS)
    assert 0 not in COLOURS


def test_a_contact_is_an_ellipse_around_its_centre():
    contact = SimpleNamespace(
        major=2e-3, minor=1e-3, angle=np.pi / 2, column=100.0, row=80.0, scale=10_000.0
    )
    outline = contact_outline(contact)
    assert np.ptp(outline, axis=0) == pytest.approx((20.0, 40.0), abs=0.5)
    assert outline.mean(axis=0) == pytest.approx((100.0, 80.0), abs=1.0)


def test_a_missing_viewer_is_named_with_its_remedy(monkeypatch):
    monkeypatch.setattr(view_node.importlib.util, 'find_spec', lambda name: None)
    with pytest.raises(ViewError) as caught:
        require_rerun()
    assert 'make view' in caught.value.remedy


def test_a_port_in_use_is_named():
    with socket.socket() as other:
        other.bind((HOST, 0))
        other.listen()
        taken = other.getsockname()[1]
        with pytest.raises(ViewError) as caught:
            free_port(taken, 'port')
        assert f'port {taken}' in str(caught.value)


def listening(process: psutil.Process) -> set[str]:
    """Wait until the server listens on both its ports; return their addresses."""
    while True:
        found = [c.laddr for c in process.net_connections('inet') if c.status == 'LISTEN']
        if len(found) >= 2:
            return {each.ip for each in found}
        assert process.is_running()
        time.sleep(0.1)


@pytest.mark.live
@needs_rerun
def test_the_page_is_served_on_this_machine_only_and_ends_with_its_owner(tmp_path, monkeypatch):
    monkeypatch.setenv('HOME', str(tmp_path))
    before = set(psutil.Process().children())
    with closing(ViewerServer(0, 0, 50)) as server:
        (child,) = set(psutil.Process().children()) - before
        assert listening(child) == {HOST}
        page = urllib.request.urlopen(server.page_url.partition('?')[0], timeout=20).read()
        assert b'<canvas' in page.lower()
        assert child.environ()['TELEMETRY_ENABLED'] == 'false'
        settings = Path(child.environ()['XDG_CONFIG_HOME']) / 'rerun' / 'analytics.json'
        assert '"analytics_enabled":false' in settings.read_text().replace(' ', '')
        assert not (tmp_path / '.config').exists()
    assert not child.is_running()


def packet(sequence: int) -> EventPacket:
    encoded = encode(events((sequence % 346, 7, True)), complete_until=sequence * 1000)
    message = EventPacket(width=346, height=260, seq=sequence, encoding=encoded.encoding)
    message.time_base = encoded.time_base
    message.events.frombytes(encoded.payload)
    return message


class Feeder:
    """Publishes everything that the view shows."""

    def __init__(self, node) -> None:
        create = node.create_publisher
        self.events = create(EventPacket, '/mixtac/events', qos(EVENTS))
        self.image = create(Image, '/mixtac/image_raw', QOS_SENSOR)
        self.force = create(WrenchStamped, '/mixtac/force', QOS_FORCE)
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
        self.seen += self.force.get_subscription_count() > 0


@pytest.mark.dds
@needs_rerun
def test_what_is_published_is_shown_and_nothing_is_undecodable(node_under_test, tmp_path):
    path = tmp_path / 'run.rrd'
    node_under_test.listen(DiagnosticArray, '/diagnostics', 10)
    node_under_test.start_nodes([node('mixtac', 'view', overrides={'save': str(path)})], 'mixtac')
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


@pytest.mark.dds
@needs_rerun
def test_the_seconds_of_a_file_begin_with_it(ros_domain, tmp_path):
    path = tmp_path / 'new' / 'run.rrd'
    command = [sys.executable, '-m', 'mixtac', 'view', '--save', path, '--seconds', '0.2']
    subprocess.run(command, check=True, env=ros_domain, timeout=120)
    assert path.exists()


@pytest.mark.dds
@needs_rerun
def test_a_file_that_cannot_be_written_ends_the_view_with_one_line(node_under_test, tmp_path):
    (tmp_path / 'file').touch()
    path = str(tmp_path / 'file' / 'run.rrd')
    node_under_test.start_nodes([node('mixtac', 'view', overrides={'save': path})], 'mixtac')
    assert node_under_test.process.wait(120) == 1
    assert path in node_under_test.process.stderr.splitlines()[-1]
    assert 'Traceback' not in node_under_test.process.stdout + node_under_test.process.stderr
