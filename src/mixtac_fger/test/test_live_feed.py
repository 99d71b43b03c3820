# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the node does with message fields, and the status and diagnosis that it reports."""

from __future__ import annotations

from array import array
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from mixtac_core.events.arrays import Events
from mixtac_core.events.codec import encode
from mixtac_core.node.diagnostics import ERROR, OK, WARN
from mixtac_fger.fger_net import FgerEstimator
from mixtac_fger.live_feed import WATCHED, LiveFeed, feed_diagnosis
from mixtac_fger.streaming import ForceEstimator
from mixtac_fger.validity import Reason

SIZE = (346, 260)


@pytest.fixture
def feed(model, trial):
    feed = feed_of(model)
    image = array('B', trial.frames[0].tobytes())
    for index in range(5):
        feed.image(picture(image, 'mono16', SIZE, 692), index * 40_000)
        feed.estimator.drain()
    yield feed
    feed.close()


def feed_of(model) -> LiveFeed:
    return LiveFeed(ForceEstimator(FgerEstimator(model), background_frames=True))


def picture(data, encoding, size, step) -> SimpleNamespace:
    return SimpleNamespace(
        width=size[0],
        height=size[1],
        encoding=encoding,
        is_bigendian=0,
        step=step,
        data=data,
    )


def message(sequence, encoding, time_base, payload, size=SIZE) -> SimpleNamespace:
    return SimpleNamespace(
        seq=sequence,
        width=size[0],
        height=size[1],
        encoding=encoding,
        time_base=time_base,
        is_bigendian=False,
        events=array('B', bytes(payload)),
    )


def packet(feed: LiveFeed, sequence: int, until_us: int, age_ns: int = 0) -> list:
    events = Events(
        np.arange(until_us - 900, until_us, 100, dtype=np.int64),
        np.full(9, 5, np.uint16),
        np.full(9, 5, np.uint16),
        np.ones(9, np.bool_),
    )
    encoded = encode(events, complete_until=until_us)
    fields = message(sequence, encoded.encoding, encoded.time_base, encoded.payload)
    return feed.packet(fields, age_ns)


def test_packets_become_forces_and_losses_are_counted(feed):
    forces = []
    for sequence in (7, 8, 11, 12):
        forces += packet(feed, sequence, 200_000 + 1000 * sequence)
    assert [end for end, *_ in forces] == [208_000, 212_000]
    # Packets of other drivers.
    for sequence, offset_ns in ((13, 213_500_000), (14, 215_000_000)):
        forces += feed.packet(message(sequence, 'libcaer', offset_ns, bytes([1] + [0] * 7)))
    assert forces[-1].end_us == 214_000
    status = feed.status()
    assert (status.values['lost_packets'], status.values['bad_messages']) == (2, 0)


def test_a_packet_that_comes_twice_counts_once(feed):
    for sequence in (7, 8, 8, 9, 10):
        forces = packet(feed, sequence, 200_000 + 1000 * sequence)
        assert all(estimate.complete for estimate in forces[1:])
    status = feed.status()
    assert status.values['repeated_packets'] == 1
    assert status.lately == {'repeated_packets': 1}
    assert status.values['lost_packets'] == 0


def test_a_packet_that_could_not_be_read_leaves_a_hole(feed):
    packet(feed, 1, 300_000)
    packet(feed, 2, 302_000)
    feed.refuse('damaged')
    found = packet(feed, 4, 308_000)
    # Nothing reports 302 to 307.1 ms.
    assert [(estimate.end_us, estimate.complete) for estimate in found] == [(308_000, False)]
    assert feed.status().estimator.withheld == 2


@pytest.mark.parametrize(('age_s', 'refused'), [(0.0, 1), (2.0, 0), (-1.0, 1), (1e6, 1)])
def test_a_frame_may_be_ahead_of_events_by_their_age_where_clocks_compare(
    feed, trial, age_s, refused
):
    packet(feed, 1, 200_000)
    feed.image(picture(array('B', trial.frames[0].tobytes()), 'mono16', SIZE, 692), 2_000_000)
    feed.estimator.drain()
    packet(feed, 2, 202_000, age_ns=round(1e9 * age_s))
    assert feed.status().estimator.frames_off_clock == refused


def test_late_forces_are_counted_where_clocks_compare(model):
    feed = LiveFeed(ForceEstimator(FgerEstimator(model)), deadline_s=0.002)
    for age_ns in (1_000_000, 3_000_000, -5, 10**12):
        feed.published(2, 10**18, 10**18 + age_ns)
    status = feed.status()
    feed.close()
    assert status.values['late'] == 2
    assert status.lately['late'] == 2
    assert status.values['age_p50_ms'] == 2.0


@pytest.mark.parametrize(
    ('encoding', 'size', 'data', 'text'),
    [
        ('evt3', SIZE, bytes(8), 'evt3'),
        ('libcaer_cmp', (640, 480), bytes(8), '640'),
        ('libcaer_cmp', SIZE, bytes(7), ''),
    ],
)
def test_bad_packets_are_counted_and_explained(feed, encoding, size, data, text):
    assert feed.packet(message(1, encoding, 0, data, size)) == []
    status = feed.status()
    assert status.values['bad_messages'] == 1
    assert text in status.problem
    assert status.lately['bad_messages'] == 1
    assert packet(feed, 2, 203_000) == []
    assert packet(feed, 3, 204_000)
    later = feed.status()
    assert (later.problem, later.lately) == ('', {})


def test_bad_images_are_counted_and_explained(feed):
    feed.image(picture(array('B', bytes(12)), 'yuv422', (2, 2), 6), 0)
    assert 'yuv422' in feed.status().problem
    feed.image(picture(array('B', bytes(12)), 'mono8', (4, 3), 4), 0)
    feed.estimator.drain()
    status = feed.status()
    assert (status.estimator.bad_frames, status.values['bad_messages']) == (1, 1)
    assert packet(feed, 1, 205_000) == []
    assert packet(feed, 2, 206_500)


@pytest.mark.parametrize('kind', ['jpeg', 'png'])
def test_compressed_frames_are_read_and_damaged_ones_are_counted(model, trial, kind):
    feed = feed_of(model)
    found, coded = cv2.imencode(f'.{kind}', (trial.frames[0] >> 2).astype(np.uint8))
    assert found
    data, name = coded.tobytes(), f'mono8; {kind} compressed'
    for index, octets in enumerate((data, data[:-2000], b'', bytes(100), data)):
        feed.image(SimpleNamespace(format=name, data=bytes(octets)), 40_000 * index)
        feed.estimator.drain()
    assert feed.estimator.reference.progress >= 2
    assert feed.status().estimator.bad_frames >= 2
    colours = np.repeat((trial.frames[0] >> 2).astype(np.uint8)[:, :, None], 3, axis=2)
    feed.image(picture(array('B', colours.tobytes()), 'rgb8', SIZE, 3 * SIZE[0]), 0)
    feed.close()
    assert feed.status().values['bad_messages'] == 0


@pytest.fixture(scope='module')
def good(model):
    feed = LiveFeed(ForceEstimator(FgerEstimator(model)))
    feed.close()
    status = feed.status()
    estimator = replace(status.estimator, reason='')
    return status._replace(estimator=estimator, rate_hz=500.0)


def test_the_diagnosis_begins_with_the_reason_for_no_force(good):
    assert feed_diagnosis(good) == (OK, 'estimating')
    level, text = feed_diagnosis(good._replace(rate_hz=0.0))
    assert level == WARN
    assert 'no event packets arrive' in text
    estimator = replace(good.estimator, reason='waiting for a frame')
    found = good._replace(estimator=estimator, rate_hz=0.0, lately={'lost_packets': 3})
    level, text = feed_diagnosis(found)
    assert level == WARN
    assert text.startswith('waiting for a frame; ')
    assert '3 lost packets' in text


@pytest.mark.parametrize('reason', [each for each in Reason if each is not Reason.TRUSTED])
def test_a_force_that_cannot_be_trusted_is_an_error_with_its_reason(good, reason):
    invalid = good._replace(estimator=replace(good.estimator, validity=reason.name))
    level, text = feed_diagnosis(invalid)
    assert level == (WARN if reason is Reason.ZERO_UNKNOWN else ERROR)
    assert reason.text in text


def test_every_watched_counter_warns(good):
    assert set(WATCHED) <= set(good.values)
    for name in WATCHED:
        level, text = feed_diagnosis(good._replace(lately={name: 7}))
        assert level == WARN
        assert f'7 {name.replace("_", " ")}' in text
