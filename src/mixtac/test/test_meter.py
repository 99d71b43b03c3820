# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What a recorder counts as missing."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from mixtac.meter import RecordingSummary, TopicMeter
from mixtac_core.node.topics import EVENTS, FORCE, IMAGE_RAW, TOPICS


def stamped(stamp_ns: int) -> bytes:
    return b'\0\1\0\0' + struct.pack('<iI', *divmod(stamp_ns, 10**9)) + bytes(8)


def test_packets_missing_by_number_are_counted(packet):
    meter = TopicMeter(EVENTS, even=False)
    for received, seq in enumerate([5, 6, 9, 10, 0, 1]):
        meter.add(10**9 + received, packet(seq, 'camera', 'libcaer_cmp', 1, 0, big=False))
    assert (meter.messages, meter.missing, meter.backwards) == (6, 2, 1)


def test_frames_missing_by_their_stamps_are_counted():
    meter = TopicMeter(IMAGE_RAW, even=True)
    numbers = [n for n in range(60) if n not in {30, 40, 41}]
    for n in numbers:
        meter.add(n, stamped(10**9 + n * 25_000_000 + (n % 3) * 10_000))
    assert (meter.messages, meter.missing, meter.backwards) == (57, 3, 0)


def test_a_slower_rate_is_learned_and_not_counted_for_ever():
    meter = TopicMeter(IMAGE_RAW, even=True)
    stamps = [n * 25_000_000 for n in range(33)]
    stamps += [stamps[-1] + (n + 1) * 100_000_000 for n in range(200)]
    for stamp in stamps:
        meter.add(stamp, stamped(10**9 + stamp))
    assert 0 < meter.missing <= 3 * 17


def test_a_restart_counts_from_zero():
    meter = TopicMeter(FORCE, even=True)
    for n in range(20):
        meter.add(1 + n, stamped(10**9 + n * 2_000_000))
    meter.restart()
    meter.add(100, stamped(10**9 + 20 * 2_000_000))
    assert (meter.messages, meter.missing, meter.first_ns) == (1, 0, 100)


def test_rate_is_that_of_the_arrivals():
    meter = TopicMeter(FORCE, even=True)
    for n in range(11):
        meter.add(10**9 + n * 2_000_000, stamped(10**9 + n * 2_000_000))
    assert meter.rate_hz == pytest.approx(500.0)


def test_every_topic_says_whether_it_has_a_header():
    pytest.importorskip('rclpy', reason='needs ROS 2')
    from mixtac_core.node.topics import message_class

    for each in TOPICS:
        fields = list(message_class(each.type_name).get_fields_and_field_types())
        assert each.has_header == (fields[0] == 'header'), each.name


def test_the_verdict_names_what_was_lost(packet):
    meter = TopicMeter(EVENTS, even=False)
    nothing = RecordingSummary(1.0, 0, True, '', {})
    assert nothing.missing == 0
    assert 'events' not in nothing.verdict()
    for seq in (0, 4):
        meter.add(1, packet(seq, 'camera', 'libcaer_cmp', 1, 0, big=False))
    summary = RecordingSummary(1.0, 7, True, 'S1', {'events': meter.figures()})
    assert summary.missing == 3
    assert '3 of events' in summary.verdict()
    assert '7 ' in summary.verdict()


@pytest.mark.parametrize('data', [b'', b'\0\1\0\0', bytes(8), b'\0\1\0\0' + b'\xff' * 30])
def test_damaged_packets_are_counted_apart(packet, data):
    meter = TopicMeter(EVENTS, even=False)
    assert not meter.add(10**9, data)
    assert meter.add(10**9, packet(7, 'camera', 'libcaer_cmp', 1, 0, big=False))
    assert (meter.messages, meter.damaged, meter.missing) == (1, 1, 0)


def test_jitter_of_stamps_is_no_loss():
    meter = TopicMeter(FORCE, even=True)
    jitter = np.random.default_rng(0).normal(0.0, 0.1, 4000)
    for n, part in enumerate(jitter):
        meter.add(n, stamped(10**9 + int((n + part) * 1_250_000)))
    assert meter.missing < 10
