# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the demo computes from its bag, losses included."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from mixtac.demo import Run, compare, latency_ms, lost_windows, read_run
from mixtac_core.events.arrays import Events
from mixtac_core.events.codec import encode
from mixtac_core.node import topics
from mixtac_core.recordings.bag import blank_message
from mixtac_core.recordings.bag_writer import McapBag
from mixtac_core.recordings.stream_writer import StreamWriter


def test_the_streams_of_a_bag_are_read(tmp_path):
    with McapBag(tmp_path / 'bag') as bag:
        writer = StreamWriter(bag, (346, 260))
        for topic in (topics.FORCE, topics.REFERENCE_WRENCH):
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
    run = read_run(tmp_path / 'bag', 'mixtac')
    assert run.packets[:, 2].tolist() == [1, 1, 1]
    assert run.forces_ns.tolist() == [[0, 7]]


def run_of(force_n, reference_n, packets=(), forces_ns=()) -> Run:
    """Return a run with a force every 2 ms and a reference every 1 ms."""
    ends_ns = 2_000_000 * np.arange(1, len(force_n) + 1)
    return Run(
        packets=np.array(packets, np.int64),
        forces_ns=np.array(forces_ns or np.stack([ends_ns, ends_ns], axis=1), np.int64),
        force_n=np.asarray(force_n),
        reference_ns=1_000_000 * np.arange(len(reference_n)),
        reference_n=np.asarray(reference_n),
    )


def test_the_latency_begins_with_the_packet_that_completes_the_window():
    packets = [(1000, 50, 9), (2000, 60, 9), (3000, 90, 9)]
    forces_ns = [(1_500_000, 70), (2_000_000, 80), (9_000_000, 100)]
    run = run_of([], [], packets, forces_ns)
    assert latency_ms(run) == pytest.approx([1e-5, 2e-5, 1e-5])


def test_missing_windows_are_counted():
    assert lost_windows(np.array([0, 2, 4, 10]) * 1_000_000) == 2


def test_the_press_calibrates_and_the_drift_of_the_reference_is_removed():
    """A gain, and a zero that drifts along a line, do not appear in the error."""
    t_ms, force_ms = np.arange(10_000), np.arange(2, 10_001, 2)

    def load(at_ms):
        return 0.8 * ((at_ms > 3000) & (at_ms < 5000)) + 0.5 * ((at_ms > 6000) & (at_ms < 7000))

    run = run_of(load(force_ms) / 1.25, load(t_ms) + 0.02 + 1e-5 * t_ms)
    taps = [SimpleNamespace(camera_us=us) for us in (1_000_000, 9_000_000)]
    fit = SimpleNamespace(
        anchors=taps,
        to_camera=lambda s: np.rint(1e6 * s).astype(np.int64),
    )
    figures = compare(run, fit, (1.5, 4.5)).figures
    assert figures['gain'] == pytest.approx(1.25, rel=1e-3)
    assert figures['mae_n'] < 1e-3 < figures['mae_uncalibrated_n']
