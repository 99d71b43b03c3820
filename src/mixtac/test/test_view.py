# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The live view without ROS: what is kept, counted and drawn; and the viewer, where it is there."""

from __future__ import annotations

import importlib.util
import socket
import subprocess
import time
import urllib.request
from array import array
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import psutil
import pytest

from mixtac import view
from mixtac.view import (
    COLOURS,
    FULL,
    HOST,
    MOST_PACKETS,
    MOST_SAMPLES,
    SILENT_NS,
    STILL,
    Drawing,
    EventPicture,
    Page,
    Received,
    ViewError,
    ViewerServer,
    free_port,
    require_rerun,
)
from mixtac_core.events.arrays import Events
from mixtac_core.events.codec import encode

S = 1_000_000_000
needs_rerun = pytest.mark.skipif(
    importlib.util.find_spec('rerun') is None, reason='rerun-sdk is not installed: make view'
)


def events(*found: tuple[int, int, bool]) -> Events:
    x, y, polarity = zip(*found, strict=True)
    return Events(
        np.arange(len(x), dtype=np.int64),
        np.array(x, np.uint16),
        np.array(y, np.uint16),
        np.array(polarity, np.bool_),
    )


def packet(*found: tuple[int, int, bool], width: int = 8, height: int = 6) -> SimpleNamespace:
    encoded = encode(events(*found))
    return SimpleNamespace(
        width=width,
        height=height,
        time_base=encoded.time_base,
        encoding=encoded.encoding,
        is_bigendian=False,
        events=array('B', encoded.payload),
    )


class Sheet:
    """A page that remembers."""

    def __init__(self) -> None:
        self.drawn: dict[str, object] = {}

    def at(self, time_ns):
        self.time_ns = time_ns

    def events(self, levels):
        self.drawn['events'] = levels

    def frame(self, pixels):
        self.drawn['frame'] = pixels

    def contact(self, outline):
        self.drawn['contact'] = outline

    def text(self, markdown):
        self.drawn['state'] = markdown

    def curve(self, entity, samples):
        self.drawn[entity] = samples

    def close(self):
        self.closed = True


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


def test_what_nobody_draws_is_bounded_and_counted():
    received, sheet = Received(), Sheet()
    for number in range(MOST_PACKETS + 10):
        received.on_packet(packet((number % 8, 0, True)), number)
    received.on_packet(packet((0, 0, True)), MOST_PACKETS + 14)
    for number in range(MOST_SAMPLES + 5):
        received.on_force('force', number, 1.0)
    assert received.skipped == 11
    assert received.counter.lost == 4
    Drawing(received, sheet).draw(S)
    assert len(sheet.drawn['force/estimate']) == MOST_SAMPLES
    assert sheet.drawn['force/estimate'][-1][0] == MOST_SAMPLES + 4


def test_everything_received_is_drawn_once():
    received, sheet = Received(), Sheet()
    received.on_packet(packet(*[(1, 2, True)] * 3), 7)
    received.on_packet(packet(*[(5, 4, False)] * 3), 8)
    image = np.arange(12, dtype=np.uint16).reshape(3, 4) * 5000
    received.on_frame(
        SimpleNamespace(
            height=3, width=4, encoding='mono16', is_bigendian=0, step=8, data=image.tobytes()
        )
    )
    received.on_force('force', 1, 1.0)
    received.on_diagnostics(
        SimpleNamespace(
            status=[SimpleNamespace(name='mixtac/driver', level=b'\x01', message='a|b is late')]
        )
    )
    received.slip = SimpleNamespace(count=7, threshold=5.5, slipping=True)
    drawing = Drawing(received, sheet)
    drawing.draw(S)
    assert sheet.drawn['events'][2, 1] == STILL + FULL
    assert sheet.drawn['events'][4, 5] == STILL - FULL
    np.testing.assert_array_equal(
        sheet.drawn['frame'], np.rint(np.arange(12).reshape(3, 4) * 5000 / 65535 * 255)
    )
    assert sheet.drawn['force/estimate'] == [(1, 1.0)]
    for row in ('# 1.00 N', '| mixtac/driver | **warning**: a/b is late |', '**SLIP**'):
        assert row in sheet.drawn['state']
    sheet.drawn.clear()
    drawing.draw(S + 1)
    assert sheet.drawn == {}


def test_a_sensor_that_is_silent_has_ended_and_so_has_a_view_that_is_closed():
    received, sheet = Received(), Sheet()
    drawing = Drawing(received, sheet)
    for number, at_ns in enumerate((S, 2 * S + SILENT_NS)):
        received.on_packet(packet((1, 2, True)), number)
        drawing.draw(at_ns)
        assert 'ended' not in sheet.drawn['state']
        drawing.draw(at_ns + SILENT_NS + 1)
        assert 'ended' in sheet.drawn['state']
    received.on_packet(packet((1, 2, True)), 2)
    drawing.draw(9 * S)
    drawing.close(10 * S)
    assert 'ended' in sheet.drawn['state']
    assert sheet.closed


def test_what_cannot_be_decoded_is_counted_and_the_rest_drawn():
    received, sheet = Received(), Sheet()
    broken = packet((1, 1, True))
    broken.encoding = 'evt9'
    received.on_packet(broken, 0)
    received.on_packet(packet((1, 1, True)), 1)
    received.on_frame(SimpleNamespace(height=2, width=2, encoding='yuv', step=4, data=b'1234'))
    drawing = Drawing(received, sheet)
    drawing.draw(S)
    assert drawing.undecodable == 2
    assert 'events' in sheet.drawn
    assert 'frame' not in sheet.drawn


def test_a_contact_is_outlined_on_the_frame():
    received, sheet = Received(), Sheet()
    received.contact = SimpleNamespace(
        in_contact=True,
        located=True,
        position=SimpleNamespace(x=1e-3, y=2e-3, z=0.0),
        area=3e-6,
        major=2e-3,
        minor=1e-3,
        angle=np.pi / 2,
        column=100.0,
        row=80.0,
        scale=10_000.0,
    )
    Drawing(received, sheet).draw(S)
    # Twice as high as wide, around its centre.
    outline = sheet.drawn['contact']
    assert np.ptp(outline, axis=0) == pytest.approx((20.0, 40.0), abs=0.5)
    assert outline.mean(axis=0) == pytest.approx((100.0, 80.0), abs=1.0)


def test_a_missing_viewer_is_named_with_its_remedy(monkeypatch):
    monkeypatch.setattr(view.importlib.util, 'find_spec', lambda name: None)
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


@pytest.mark.live
@needs_rerun
def test_a_server_that_ended_is_reported():
    before = set(psutil.Process().children())
    with closing(ViewerServer(0, 0, 50)) as server:
        (child,) = set(psutil.Process().children()) - before
        child.kill()
        child.wait()
        with pytest.raises(ViewError):
            server.check()


@pytest.mark.live
@needs_rerun
def test_what_is_drawn_is_in_the_file(tmp_path):
    path = tmp_path / 'view.rrd'
    page = Page(10.0, path=path)
    page.at(1_700_000_000_000_000_000)
    page.events(np.ones((4, 5), np.uint8))
    page.frame(np.zeros((4, 5), np.uint8))
    page.contact(np.zeros((3, 2)))
    page.contact(None)
    page.text('fine')
    page.curve('force/estimate', [(1_700_000_000_000_000_000 + i, 1.5) for i in range(3)])
    page.curve('force/reference', [])
    page.close()
    printed = subprocess.run(
        [require_rerun(), 'rrd', 'print', path], capture_output=True, text=True, check=True
    ).stdout
    for entity in ('/events', '/frame', '/frame/contact', '/state', '/force/estimate'):
        assert entity in printed
