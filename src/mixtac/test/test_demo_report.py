# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the demo computes from its bag, losses included."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from mixtac.demo import Streams, compare, latency_ms, lost_windows, read_streams
from mixtac_core.events.arrays import Events
from mixtac_core.events.codec import encode
from mixtac_core.node import topics
from mixtac_core.recordings.bag import blank_message
from mixtac_core.recordings.bag_writer import McapBag
from mixtac_core.recordings.importing import StreamWriter


def test_the_streams_of_a_bag_are_read(tmp_path):
    with McapBag(tmp_path / 'bag') as bag:
        writer = StreamWriter(bag, (346, 260))
        for topic in (topics.FORCE, topics.FORCE_QUALITY, topics.REFERENCE_WRENCH):
            writer.put(topic, 7, blank_message(topic.type_name))
        for index in range(3):
            t = np.array([1000 * index], np.int64)
            pixel = np.zeros(1, np.uint16)
            encoded = encode(Events(t, pixel, pixel, np.ones(1, np.bool_)))
            message = blank_message(topics.EVENTS.type_name)
            message.width, message.height, message.seq = 346, 260, index
            message.encoding, message.time_base = encoded.encoding, encoded.time_base
            message.events = np.frombuffer(encoded.payload, np.uint8)
            writer.put(topics.EVENTS, 1_000_000 * index, message)
    streams = read_streams(tmp_path / 'bag', 'mixtac')
    assert streams.event_t_us.tolist() == [0, 1000, 2000]
    assert len(streams.arrival_ns) == len(streams.complete_us) == 3
    assert streams.force_arrival_ns.tolist() == [7]
    assert streams.invalid == 1


def streams_of(force_n, reference_n, complete_us=(), arrival_ns=()) -> Streams:
    """Return a run with a force every 2 ms and a reference every 1 ms."""
    nothing = np.empty(0, np.int64)
    return Streams(
        event_t_us=nothing,
        complete_us=np.array(complete_us, np.int64),
        arrival_ns=np.array(arrival_ns, np.int64),
        invalid=0,
        force_ns=2_000_000 * np.arange(1, len(force_n) + 1),
        force_arrival_ns=nothing,
        force_n=np.asarray(force_n),
        reference_ns=1_000_000 * np.arange(len(reference_n)),
        reference_n=np.asarray(reference_n),
    )


def test_the_latency_begins_with_the_packet_that_completes_the_window():
    streams = replace(
        streams_of([], [], complete_us=[1000, 2000, 3000], arrival_ns=[50, 60, 90]),
        force_ns=np.array([1_500_000, 2_000_000, 9_000_000]),
        force_arrival_ns=np.array([70, 80, 100]),
    )
    assert latency_ms(streams) == pytest.approx([1e-5, 2e-5, 1e-5])


def test_missing_windows_are_counted():
    assert lost_windows(np.array([0, 2, 4, 10]) * 1_000_000) == 2


def test_the_press_calibrates_and_the_drift_of_the_reference_is_removed():
    """A gain, and a zero that drifts along a line, do not appear in the error."""
    t_ms, force_ms = np.arange(10_000), np.arange(2, 10_001, 2)

    def load(at_ms):
        return 0.8 * ((at_ms > 3000) & (at_ms < 5000)) + 0.5 * ((at_ms > 6000) & (at_ms < 7000))

    streams = streams_of(load(force_ms) / 1.25, load(t_ms) + 0.02 + 1e-5 * t_ms)
    taps = [SimpleNamespace(camera_us=us) for us in (1_000_000, 9_000_000)]
    fit = SimpleNamespace(
        anchors=taps,
        to_camera=lambda s: np.rint(1e6 * s).astype(np.int64),
    )
    comparison = compare(streams, fit, (1.5, 4.5))
    assert comparison.zeros_n == pytest.approx((0.033, 0.107))
    assert comparison.gain == pytest.approx(1.25, rel=1e-3)
    assert not comparison.judged[(comparison.time_s > 1.5) & (comparison.time_s < 4.5)].any()
    figures = comparison.figures()
    assert figures['mae_n'] < 1e-3 < figures['mae_uncalibrated_n']
