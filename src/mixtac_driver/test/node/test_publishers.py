# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What is published for whom, with a node that keeps messages."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip('event_camera_msgs.msg')
pytest.importorskip('mixtac_msgs.msg')

from davis_fake import FakeBackend, FakeCamera

from mixtac_core.events.arrays import Events
from mixtac_core.events.codec import decode_message
from mixtac_core.events.packets import read_packet
from mixtac_core.events.readings import (
    NO_EDGES,
    NO_SAMPLES,
    DecodedBatch,
    Edges,
    Frame,
    InertialSamples,
)
from mixtac_core.node import topics
from mixtac_core.node.topics import stamp_to_us
from mixtac_driver.camera import CameraBatch, Davis346
from mixtac_driver.clock import Origin
from mixtac_driver.node import publishers
from mixtac_driver.node.publishers import EventPublisher, ReadingPublisher
from mixtac_driver.node.status import DriverMeters
from mixtac_driver.parameters import DriverParameters

ORIGIN_US = 1_760_000_000_000_000


class Publisher:
    """Keeps what is published."""

    def __init__(self):
        self.listeners = 0
        self.sent = []

    def get_subscription_count(self):
        return self.listeners

    def publish(self, message):
        self.sent.append(message)


class Node:
    """Makes publishers that keep messages."""

    def __init__(self):
        self.topics = {}

    def publish_topic(self, topic):
        return self.topics.setdefault(topic.name, Publisher())

    def create_publisher(self, _kind, name, _qos):
        return self.topics.setdefault(name, Publisher())


@pytest.fixture
def node():
    return Node()


@pytest.fixture
def meters():
    return DriverMeters()


@pytest.fixture
def publisher(node, meters):
    return ReadingPublisher(node, DriverParameters(), meters, lambda info: info)


@pytest.fixture(scope='module')
def identity():
    with Davis346(backend=FakeBackend(FakeCamera())) as camera:
        return camera.identity


def batch(time_us):
    decoded = DecodedBatch(Events.empty(), (), NO_SAMPLES, NO_EDGES, time_us, 1)
    return CameraBatch(decoded, Origin(ORIGIN_US * 1000, 0), (ORIGIN_US + time_us) * 1000)


def edges(count):
    t = np.arange(count, dtype=np.int64)
    return Edges(t, np.full(count, 3, np.uint8))


def test_too_many_edges_are_dropped_and_counted(node, publisher, meters, monkeypatch):
    now_s = [0.0]
    monkeypatch.setattr(publishers.time, 'monotonic', lambda: now_s[0])
    topic = node.topics['external_edges']
    publisher.edges(edges(7), ORIGIN_US)
    assert topic.sent == []
    topic.listeners = 1
    publisher.edges(edges(3), ORIGIN_US)
    assert [message.seq for message in topic.sent] == [7, 8, 9]
    assert [stamp_to_us(m.header.stamp) - ORIGIN_US for m in topic.sent] == [0, 1, 2]
    assert meters.edges_dropped == 0
    publisher.edges(edges(10_000), ORIGIN_US)
    assert len(topic.sent) == publishers.MOST_EDGES
    assert meters.edges_dropped == 10_003 - publishers.MOST_EDGES
    now_s[0] = publishers.EDGES_PERIOD_S
    publisher.edges(edges(100), ORIGIN_US)
    assert len(topic.sent) == publishers.MOST_EDGES + 100
    assert topic.sent[-1].seq == 10 + 10_000 + 99
    assert meters.edges == 10_110


def samples(count, temperature=30.0):
    t = np.arange(count, dtype=np.int64) * 1000
    return InertialSamples(
        t, np.zeros((count, 3)), np.zeros((count, 3)), np.full(count, temperature)
    )


def test_temperature_comes_ten_times_a_second(node, publisher):
    node.topics['temperature'].listeners = 1
    for k in range(50):
        publisher.samples(samples(10), ORIGIN_US + 10_000 * k)
    sent = node.topics['temperature'].sent
    times = [stamp_to_us(message.header.stamp) for message in sent]
    assert np.diff(times).tolist() == [100_000] * 4
    assert sent[0].temperature == 30.0
    assert node.topics['imu/data_raw'].sent == []
    publisher.samples(samples(1, np.nan), ORIGIN_US + 10**7)
    assert len(sent) == 5


FRAME_TOPICS = {'image_raw', 'camera_info', 'image_exposure'}


@pytest.mark.parametrize(
    'wanted', [*({each} for each in sorted(FRAME_TOPICS)), set(), FRAME_TOPICS]
)
def test_frames_are_published_only_for_those_who_listen(node, publisher, identity, wanted):
    for name, topic in node.topics.items():
        topic.listeners = name in wanted
    image = np.zeros((260, 346), np.uint16)
    publisher.frame(Frame(image, 0, 0, 0, 10, 20, 30, 0, global_shutter=True), ORIGIN_US, identity)
    assert {name for name, topic in node.topics.items() if topic.sent} == wanted
    headers = [topic.sent[0].header for topic in node.topics.values() if topic.sent]
    assert all(stamp_to_us(header.stamp) == ORIGIN_US + 15 for header in headers)


def test_packets_after_a_pause_begin_where_the_stream_is(node, meters):
    publisher = EventPublisher(node, DriverParameters(), topics.EVENTS, meters)
    topic = node.topics['events']

    def publish(start_us):
        for t_us in range(start_us, start_us + 5000, 500):
            xy = np.array([1], np.uint16)
            events = Events(np.array([t_us]), xy, xy, np.array([True]))
            publisher.publish(events, batch(t_us + 400), (346, 260))

    publish(0)
    assert not topic.sent
    topic.listeners = 1
    publish(10_000)
    before = len(topic.sent)
    publisher.restart()
    publish(10**6)
    packets = [read_packet(message) for message in topic.sent]
    decoded = [decode_message(packet) for packet in packets]
    assert [packet.seq for packet in packets] == list(range(len(packets)))
    assert decoded[before].events.t[0] == ORIGIN_US + 10**6
    ends = [each.complete_until for each in decoded]
    assert ends == sorted(ends)
    assert meters.packets.total == len(topic.sent)
