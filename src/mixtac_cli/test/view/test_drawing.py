# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The live view without ROS and without a viewer: what is kept, thinned, counted and drawn."""

from __future__ import annotations

from array import array
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_cli.view.drawing import (
    BACKGROUND,
    BRIGHTER,
    DARKER,
    FULL,
    MOST_BYTES,
    MOST_PACKETS,
    MOST_SAMPLES,
    STILL,
    Curve,
    Drawing,
    EventPicture,
    PacketBacklog,
    Received,
    palette,
    thinned,
)
from mixtac_events.arrays import Events
from mixtac_events.codec import encode

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
    encoded = encode(events(*found), 'libcaer_cmp')
    return SimpleNamespace(
        width=width,
        height=height,
        time_base=encoded.time_base,
        encoding=encoded.encoding,
        is_bigendian=False,
        events=array('B', encoded.payload),
    )


class Sheet:
    """A canvas that remembers."""

    def __init__(self) -> None:
        self.pictures: dict[str, np.ndarray] = {}
        self.texts: dict[str, str] = {}
        self.curves: dict[str, list] = {}
        self.slip = False

    def at(self, time_ns: int) -> None:
        self.time_ns = time_ns

    def events(self, levels):
        self.pictures['events'] = levels

    def frame(self, pixels):
        self.pictures['frame'] = pixels

    def text(self, entity, markdown):
        self.texts[entity] = markdown

    def curve(self, entity, columns):
        self.curves.setdefault(entity, []).append(columns)

    def contact(self, outline):
        self.outline = outline

    def arrows(self, starts, vectors):
        self.starts, self.vectors = starts, vectors

    def show_slip(self):
        self.slip = True


def test_polarities_have_their_levels_and_cancel():
    picture = EventPicture(4, 3)
    picture.add(events(*[(1, 0, True)] * 5, *[(2, 1, False)] * 2, (3, 2, True), (3, 2, False)))
    shown = picture.take()
    assert shown.shape == (3, 4)
    assert shown[0, 1] == STILL + FULL
    assert shown[1, 2] == STILL - 2
    assert shown[2, 3] == STILL
    assert (picture.take() == STILL).all()


def test_every_level_has_its_own_colour_and_none_is_zero():
    colours = palette()
    assert len(set(colours.values())) == len(colours) == 2 * FULL + 1
    assert 0 not in colours
    assert colours[STILL] == BACKGROUND
    assert colours[STILL + FULL] == BRIGHTER
    assert colours[STILL - FULL] == DARKER


@given(values=st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=200), most=st.integers(1, 40))
def test_thinning_keeps_order_bound_and_real_samples(values, most):
    times = np.arange(len(values), dtype=np.int64)
    t, v = thinned(times, np.array(values), most)
    assert len(t) == min(most, len(values))
    assert (np.diff(t) > 0).all()
    np.testing.assert_array_equal(v, np.array(values)[t])


@given(place=st.integers(0, 199), most=st.integers(2, 40), sign=st.sampled_from([-1.0, 1.0]))
def test_a_lone_peak_is_never_thinned_away(place, most, sign):
    values = np.zeros(200)
    values[place] = sign * 9.0
    t, _ = thinned(np.arange(200, dtype=np.int64), values, most)
    assert place in t


def test_a_curve_that_nobody_takes_is_bounded_and_counts():
    curve = Curve(capacity=3)
    for i in range(5):
        curve.add(i, float(i))
    assert (curve.received, curve.dropped, curve.latest) == (5, 2, 4.0)
    times, _ = curve.take(10)
    assert times.tolist() == [0, 1, 2]
    assert curve.take(10)[0].size == 0


def test_a_backlog_gives_up_the_oldest_and_counts_gaps():
    backlog = PacketBacklog()
    for sequence in range(MOST_PACKETS + 10):
        backlog.add(packet((sequence % 8, 0, True)), sequence)
    backlog.add(packet((0, 0, True)), MOST_PACKETS + 14)
    assert backlog.skipped == 11
    assert backlog.counter.lost == 4
    taken = backlog.take()
    assert len(taken) == MOST_PACKETS
    assert backlog.take() == []
    big = SimpleNamespace(events=array('B', bytes(MOST_BYTES // 2 + 1)))
    backlog.add(big, 1)
    backlog.add(big, 2)
    assert len(backlog.take()) == 1


def filled() -> Received:
    received = Received()
    received.packets.add(packet(*[(1, 2, True)] * 3), 7)
    received.packets.add(packet(*[(5, 4, False)] * 3), 8)
    image = np.arange(12, dtype=np.uint16).reshape(3, 4) * 5000
    received.on_frame(
        SimpleNamespace(
            height=3, width=4, encoding='mono16', is_bigendian=0, step=8, data=image.tobytes()
        )
    )
    for i in range(400):
        received.force.add(i, 1.0)
        received.reference.add(i, 1.25)
    received.on_diagnostics(
        SimpleNamespace(
            status=[SimpleNamespace(name='mixtac/driver', level=b'\x01', message='a|b is late')]
        )
    )
    return received


def test_everything_received_is_drawn_once():
    received, sheet = filled(), Sheet()
    drawing = Drawing(received, sheet)
    drawing.draw(S)
    assert sheet.pictures['events'][2, 1] == STILL + FULL
    assert sheet.pictures['events'][4, 5] == STILL - FULL
    np.testing.assert_array_equal(
        sheet.pictures['frame'], np.rint(np.arange(12).reshape(3, 4) * 5000 / 65535 * 255)
    )
    assert len(sheet.curves['force/estimate'][0][0]) == MOST_SAMPLES
    assert '**1.00 N**' in sheet.texts['state']
    assert '| mixtac/driver | **warning** | a/b is late |' in sheet.texts['state']
    assert not sheet.slip
    sheet.pictures.clear()
    drawing.draw(S + 1)
    assert sheet.pictures == {}


def test_rates_are_per_second_of_the_clock_given():
    received, sheet = Received(), Sheet()
    drawing = Drawing(received, sheet)
    drawing.draw(S)
    for i in range(1000):
        received.force.add(i, 0.0)
    received.packets.add(packet((0, 0, True), (1, 1, True)), 0)
    drawing.draw(3 * S)
    assert sheet.curves['rates/force'][-1][1].tolist() == [500.0]
    assert sheet.curves['rates/events'][-1][1].tolist() == [0.001]


@pytest.mark.parametrize(('slipping', 'word'), [(True, '**SLIP**'), (False, 'stable')])
def test_slip_is_shown_where_it_is_watched(slipping, word):
    received, sheet = Received(), Sheet()
    received.on_slip(SimpleNamespace(count=7, threshold=5.5, slipping=slipping), 3)
    Drawing(received, sheet).draw(S)
    assert sheet.slip
    assert word in sheet.texts['state']
    assert sheet.curves['slip/count'][0][1].tolist() == [7.0]


def test_what_cannot_be_decoded_is_counted_and_the_rest_drawn():
    received, sheet = Received(), Sheet()
    broken = packet((1, 1, True))
    broken.encoding = 'evt9'
    received.packets.add(broken, 0)
    received.packets.add(packet((1, 1, True)), 1)
    received.on_frame(SimpleNamespace(height=2, width=2, encoding='yuv', step=4, data=b'1234'))
    drawing = Drawing(received, sheet)
    drawing.draw(S)
    assert drawing.undecodable == 2
    assert 'events' in sheet.pictures
    assert 'frame' not in sheet.pictures


def test_a_contact_and_a_displacement_are_drawn_on_the_frame():
    received, sheet = Received(), Sheet()
    received.on_contact(
        SimpleNamespace(
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
    )
    moved = np.zeros((2, 3, 2), np.float32)
    moved[0, 0] = (1e-4, 2e-4)
    received.on_field(SimpleNamespace(height=2, width=3, data=moved.tobytes()))
    Drawing(received, sheet).draw(10**9)
    # Twice as high as wide, and upwards is towards lower rows.
    assert np.ptp(sheet.outline, axis=0) == pytest.approx((20.0, 40.0), abs=0.5)
    assert sheet.outline.mean(axis=0) == pytest.approx((100.0, 80.0), abs=1.0)
    assert sheet.starts[0] == pytest.approx((3.5, 3.5))
    assert sheet.vectors[0, 0] == pytest.approx(-0.5 * sheet.vectors[0, 1])
