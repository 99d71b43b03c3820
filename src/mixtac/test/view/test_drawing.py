# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The live view without ROS and without a viewer: what is kept, thinned, counted and drawn."""

from __future__ import annotations

from array import array
from types import SimpleNamespace

import numpy as np
import pytest

from mixtac.view.drawing import MOST_PACKETS, MOST_SAMPLES, Drawing, EventPicture, Received
from mixtac.view.page import COLOURS, FULL, STILL
from mixtac_core.events.arrays import Events
from mixtac_core.events.codec import encode

S = 1_000_000_000


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
    for row in ('**1.00 N**', '| mixtac/driver | **warning**: a/b is late |', '**SLIP**'):
        assert row in sheet.drawn['state']
    sheet.drawn.clear()
    drawing.draw(S + 1)
    assert sheet.drawn == {}


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
