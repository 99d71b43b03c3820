# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What a recorder counts as missing."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac.meter import RecordingSummary, TopicMeter
from mixtac_core.node.topics import EVENTS, FORCE


def test_packets_missing_by_number_are_counted(packet):
    meter = TopicMeter(EVENTS)
    for received, seq in enumerate([5, 6, 9, 10, 0, 1]):
        meter.add(10**9 + received, packet(seq, 'camera', 'libcaer_cmp', 1, 0, big=False))
    assert (meter.messages, meter.missing, meter.backwards) == (6, 2, 1)


def test_a_topic_without_numbers_shows_rate_and_longest_gap_but_no_loss():
    meter = TopicMeter(FORCE)
    jitter = np.random.default_rng(0).uniform(0.0, 3e6, 1000)
    arrivals = [10**9 + n * 2_000_000 + int(part) for n, part in enumerate(jitter) if n != 500]
    for received_ns in sorted(arrivals):
        meter.add(received_ns, bytes(64))
    assert (meter.messages, meter.missing) == (999, 0)
    assert meter.rate_hz == pytest.approx(500.0, rel=0.01)
    assert meter.longest_gap_ns == np.diff(sorted(arrivals)).max()
    meter.restart()
    meter.add(100, bytes(64))
    assert (meter.messages, meter.longest_gap_ns, meter.first_ns) == (1, 0, 100)


def test_the_verdict_names_what_was_lost(packet):
    meter = TopicMeter(EVENTS)
    nothing = RecordingSummary(1.0, 0, True, '', {})
    assert nothing.missing == 0
    for seq in (0, 4):
        meter.add(1, packet(seq, 'camera', 'libcaer_cmp', 1, 0, big=False))
    summary = RecordingSummary(1.0, 7, True, 'S1', {'events': meter.figures()})
    assert summary.missing == 3
    assert '3 of events' in summary.verdict()
    assert '7 ' in summary.verdict()


@pytest.mark.parametrize('data', [b'', b'\0\1\0\0', bytes(8), b'\0\1\0\0' + b'\xff' * 30])
def test_damaged_packets_are_counted_apart(packet, data):
    meter = TopicMeter(EVENTS)
    assert not meter.add(10**9, data)
    assert meter.add(10**9, packet(7, 'camera', 'libcaer_cmp', 1, 0, big=False))
    assert (meter.messages, meter.damaged, meter.missing) == (1, 1, 0)
