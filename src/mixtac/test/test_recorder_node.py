# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A recording over real topics, read by rosbags alone and decoded by the format's own rules."""

from __future__ import annotations

import struct
import time
from typing import TYPE_CHECKING

import numpy as np
import pytest
import yaml

rclpy = pytest.importorskip('rclpy', reason='needs ROS 2')

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue  # noqa: E402
from rosbags.highlevel import AnyReader  # noqa: E402

from mixtac.recorder_node import TopicMeter, verdict  # noqa: E402
from mixtac_core.events.arrays import Events  # noqa: E402
from mixtac_core.events.codec import encode  # noqa: E402
from mixtac_core.node.base_node import QOS_EVENTS  # noqa: E402
from mixtac_core.node.topics import EVENTS, FORCE, IMAGE_RAW  # noqa: E402

if TYPE_CHECKING:
    from pathlib import Path

RECORDER = 'mixtac.recorder_node'
PACKETS = 1500
START_US = 1_790_000_000_000_000


def words_to_events(payload: np.ndarray, time_base_ns: int) -> list[tuple[int, int, int, int]]:
    """Decode libcaer_cmp word by word as event_camera_codecs documents it."""
    found = []
    high = low = column = base = base_polarity = 0
    for word in payload.view('<u2').tolist():
        code, value = word >> 12, word & 0xFFF
        now = time_base_ns // 1000 + (high << 12 | low)
        if code == 0:
            high = value
        elif code == 1:
            low = value
        elif code == 2:
            column = value & 0x7FF
        elif code == 3:
            found.append((now, column, value & 0x7FF, value >> 11))
        elif code == 4:
            base, base_polarity = value & 0x7FF, value >> 11
        elif code == 5:
            found += [(now, column, base + i, base_polarity) for i in range(8) if value >> i & 1]
            base += 8
    return found


def make_events(index: int) -> Events:
    rng = np.random.default_rng(index)
    start, count = START_US + 1000 * index, index % 40
    return Events(
        np.sort(rng.integers(start, start + 1000, count)),
        rng.integers(0, 346, count).astype(np.uint16),
        rng.integers(0, 260, count).astype(np.uint16),
        rng.integers(0, 2, count).astype(bool),
    )


def publish_all(graph, topic: str) -> None:
    from event_camera_msgs.msg import EventPacket

    publisher = graph.node.create_publisher(EventPacket, topic, QOS_EVENTS)
    graph.spin_until(publisher.get_subscription_count)
    time.sleep(1.0)
    for index in range(PACKETS):
        packed = encode(make_events(index), complete_until=START_US + 1000 * (index + 1))
        message = EventPacket(
            height=260, width=346, seq=index, encoding='libcaer_cmp', time_base=packed.time_base
        )
        message.header.frame_id = 'camera'
        message.events.frombytes(packed.payload)
        publisher.publish(message)
        time.sleep(0.001)
    time.sleep(0.5)


@pytest.fixture(scope='module')
def recorded(module_node_under_test, tmp_path_factory) -> Path:
    bag = tmp_path_factory.mktemp('bags') / 'one'
    graph = module_node_under_test
    graph.start(RECORDER, f'output:={bag}', remap=('__ns:=/here',))
    publish_all(graph, '/here/events')
    status, output = graph.stop()
    assert status == 0, output
    return bag


@pytest.mark.dds
def test_rosbags_alone_reads_every_packet_and_the_events_are_those_sent(recorded: Path):
    numbers = []
    with AnyReader([recorded]) as reader:
        chosen = [c for c in reader.connections if c.topic == '/here/events']
        for connection, _, data in reader.messages(chosen):
            message = reader.deserialize(data, connection.msgtype)
            numbers.append(message.seq)
            sent = make_events(message.seq)
            rows = zip(sent.t, sent.x, sent.y, sent.polarity, strict=True)
            wanted = sorted(tuple(int(value) for value in row) for row in rows)
            assert sorted(words_to_events(message.events, message.time_base)) == wanted
    assert numbers == sorted(set(numbers))
    # The first ones may leave before the subscription is matched; on a loaded machine some get
    # lost on the way, which the recorder has to know.
    assert len(numbers) > PACKETS // 2
    missing = numbers[-1] - numbers[0] + 1 - len(numbers)
    described = yaml.safe_load((recorded.parent / 'dataset.yaml').read_text())['trials'][0]
    assert described['topics']['events']['missing'] == missing
    assert described['topics']['events']['messages'] == len(numbers)
    assert described['not_written'] == 0


@pytest.mark.dds
@pytest.mark.parametrize(
    ('remap', 'namespace'), [((), 'mixtac'), (('__ns:=/left',), 'left'), (('__ns:=/',), '')]
)
def test_the_recorder_is_in_the_namespace_of_the_sensor(
    node_under_test, tmp_path, remap, namespace
):
    recorder, driver = (f'{namespace}/{name}'.lstrip('/') for name in ('recorder', 'driver'))
    node_under_test.listen(DiagnosticArray, '/diagnostics', 10)
    node_under_test.start(RECORDER, f'output:={tmp_path}/bag', remap=remap)
    node_under_test.spin_until(lambda: node_under_test.diagnostics(recorder))
    assert node_under_test.diagnostics(recorder)['messages dropped'] == '0'
    publisher = node_under_test.node.create_publisher(DiagnosticArray, '/diagnostics', 10)
    node_under_test.spin_until(lambda: publisher.get_subscription_count() == 3)
    simulated = [KeyValue(key='simulated', value='True')]
    for serial, name in (('0042', driver), ('0043', f'other/{driver}')):
        status = DiagnosticStatus(name=name, hardware_id=serial, values=simulated)
        publisher.publish(DiagnosticArray(status=[status]))
    node_under_test.spin_until(lambda: int(node_under_test.diagnostics(recorder)['messages']) >= 4)
    status, output = node_under_test.stop()
    assert status == 0, output
    (described,) = yaml.safe_load((tmp_path / 'dataset.yaml').read_text())['trials']
    assert (described['serial'], described['simulated']) == ('0042', True)


def stamped(stamp_ns: int) -> bytes:
    return b'\0\1\0\0' + struct.pack('<iI', *divmod(stamp_ns, 10**9)) + bytes(8)


def test_packets_missing_by_number_are_counted(packet):
    meter = TopicMeter(EVENTS)
    for received, seq in enumerate([5, 6, 9, 10, 0, 1]):
        meter.add(10**9 + received, packet(seq, 'camera', 'libcaer_cmp', 1, 0, big=False))
    assert (meter.messages, meter.missing) == (6, 2)


def test_topics_without_numbers_show_their_longest_gap():
    meter = TopicMeter(IMAGE_RAW)
    for n in (0, 1, 2, 5, 6):
        meter.add(10**9 + n * 25_000_000, stamped(10**9))
    assert (meter.messages, meter.missing) == (5, 0)
    assert meter.figures()['longest_gap_s'] == pytest.approx(0.075)


def test_a_restart_counts_from_zero():
    meter = TopicMeter(FORCE)
    for n in range(20):
        meter.add(1 + n, stamped(10**9 + n * 2_000_000))
    meter.restart()
    meter.add(100, stamped(10**9 + 20 * 2_000_000))
    assert (meter.messages, meter.missing, meter.rate_hz) == (1, 0, 0.0)


def test_rate_is_that_of_the_arrivals():
    meter = TopicMeter(FORCE)
    for n in range(11):
        meter.add(10**9 + n * 2_000_000, stamped(10**9 + n * 2_000_000))
    assert meter.rate_hz == pytest.approx(500.0)


def test_the_verdict_names_what_was_lost(packet):
    meter = TopicMeter(EVENTS)
    for seq in (0, 4):
        meter.add(1, packet(seq, 'camera', 'libcaer_cmp', 1, 0, big=False))
    nothing = {'seconds': 1.0, 'not_written': 0, 'stopped': '', 'topics': {}}
    assert 'no losses' in verdict(nothing)
    said = verdict(nothing | {'not_written': 7, 'topics': {'events': meter.figures()}})
    assert '3 of events' in said
    assert '7 ' in said


@pytest.mark.parametrize('data', [b'', b'\0\1\0\0', bytes(8), b'\0\1\0\0' + b'\xff' * 30])
def test_damaged_packets_are_lost(packet, data):
    meter = TopicMeter(EVENTS)
    assert not meter.add(10**9, data)
    assert meter.add(10**9, packet(7, 'camera', 'libcaer_cmp', 1, 0, big=False))
    assert (meter.messages, meter.missing) == (1, 1)
