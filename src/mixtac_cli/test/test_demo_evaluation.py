# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the demo reads from its bag, losses included."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from mixtac_cli.demo.evaluation import (
    Comparison,
    Streams,
    compare,
    host_time,
    peak_error,
    read_streams,
)
from mixtac_events.arrays import Events
from mixtac_events.codec import encode
from mixtac_node import topics
from mixtac_recordings.bag import blank_message
from mixtac_recordings.bag_writer import McapBag
from mixtac_recordings.stream_writer import StreamWriter


@pytest.mark.parametrize(
    ('numbers', 'lost'),
    [((5, 6, 9), 2), ((5, 6, 0, 1), 0), ((5, 8, 0, 1, 3), 3)],
    ids=['gap', 'restart', 'gaps around a restart'],
)
def test_lost_packets_with_a_restart_of_the_driver(tmp_path, numbers, lost):
    forces = (
        *(topics.FORCE, topics.FORCE_QUALITY),
        *(topics.REFERENCE_WRENCH, topics.TRUTH_WRENCH),
    )
    with McapBag(tmp_path / 'bag') as bag:
        writer = StreamWriter(bag, (346, 260))
        for topic in forces:
            writer.put(topic, 0, blank_message(topic.type_name))
        for index, number in enumerate(numbers):
            t = np.array([1000 * index], np.int64)
            pixel = np.zeros(1, np.uint16)
            encoded = encode(Events(t, pixel, pixel, np.ones(1, np.bool_)))
            message = blank_message(topics.EVENTS.type_name)
            message.width, message.height, message.seq = 346, 260, number
            message.encoding, message.time_base = encoded.encoding, encoded.time_base
            message.events = np.frombuffer(encoded.payload, np.uint8)
            writer.put(topics.EVENTS, 1_000_000 * index, message)
    streams = read_streams(tmp_path / 'bag', 'mixtac')
    assert len(streams.arrival_ns) == len(streams.complete_us) == len(numbers)
    assert streams.lost_packets == lost


def _normal(force_n):
    """Return a normal force with nothing along x and y."""
    return np.pad(np.reshape(force_n, (-1, 1)), ((0, 0), (2, 0)))


def streams_of(force_n, ages_ms, complete_us=(), arrival_ns=()) -> Streams:
    """Return a run with a force every 2 ms, and the age of the frame at each."""
    end_ns = 2_000_000 * np.arange(1, len(force_n) + 1)
    nothing = np.empty(0, np.int64)
    return Streams(
        event_t_us=nothing,
        lost_packets=0,
        complete_us=np.array(complete_us, np.int64),
        arrival_ns=np.array(arrival_ns, np.int64),
        force_ns=end_ns,
        force_n=_normal(force_n),
        sideways_ns=nothing,
        frame_ages=np.stack([end_ns, 1_000_000 * np.array(ages_ms)], axis=1),
        invalid=0,
        reference_ns=nothing,
        reference_n=np.empty(0),
        truth_ns=nothing,
        truth_n=_normal(()),
    )


def test_host_times_follow_the_arrival_of_packets_when_time_stopped():
    streams = streams_of([0.0], [1], complete_us=[1000, 2000, 3000], arrival_ns=[50, 60, 90])
    found = host_time(streams, np.array([1_500_000, 2_000_000, 9_000_000]), None)
    assert found.tolist() == [60, 60, 90]
    pairs = np.array([[1_000_000, 0], [1_000_200, 100]])
    assert host_time(streams, np.array([50]), pairs).tolist() == [1_000_100]


def test_the_error_of_the_peak_is_that_of_the_impact():
    comparison = Comparison(
        fit=None,
        start_us=0,
        time_s=np.array([0.0, 1.0, 2.0, 3.0]),
        estimate_n=np.array([9.0, 1.1, 2.2, 0.0]),
        reference_n=np.array([9.0, 1.5, 1.0, 0.0]),
        sample_s=np.array([0.0, 1.0, 1.4, 2.0, 3.0]),
        sample_n=np.array([9.0, 1.5, 2.0, 1.0, 0.0]),
        zeros_n=(0.0, 0.0),
        rmse_n=0.0,
        constant_mae_n=0.0,
    )
    name = 'impact of a dropped weight'
    assert peak_error(comparison, [(name, 0.5, 3.0)]) == pytest.approx(0.1)
    assert peak_error(comparison, [('oscillation', 0.5, 3.0)]) is None


def test_the_drift_of_the_reference_is_taken_off_between_the_impulses():
    t_ms = np.arange(100, 9900)
    drift = 0.02 + 1e-5 * t_ms
    load = np.where((t_ms > 3000) & (t_ms < 6000), 0.8, 0.0)
    truth = np.where((np.arange(2, 10_001, 2) > 3000) & (np.arange(2, 10_001, 2) < 6000), 0.8, 0.0)
    streams = dataclasses.replace(
        streams_of(truth, np.ones(len(truth))),
        reference_ns=1_000_000 * t_ms,
        reference_n=load + drift,
    )
    taps = [SimpleNamespace(camera_us=us) for us in (1_000_000, 9_000_000)]
    fit = SimpleNamespace(anchors=taps, to_camera=lambda s: np.rint(1e6 * s).astype(np.int64))
    comparison = compare(streams, fit)
    assert comparison.zeros_n == pytest.approx((0.033, 0.107))
    between = (comparison.time_s > 0.5) & (comparison.time_s < 7.5)
    error = comparison.reference_n[between] - comparison.estimate_n[between]
    assert error == pytest.approx(np.zeros(between.sum()), abs=1e-9)
