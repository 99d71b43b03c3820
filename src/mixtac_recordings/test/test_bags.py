# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Writing, reading and summarising bags."""

from __future__ import annotations

import array
from typing import TYPE_CHECKING

import numpy as np
import pytest

from mixtac_events.arrays import Events
from mixtac_events.codec import encode
from mixtac_recordings.bag import BagFile, typestore
from mixtac_recordings.bag_writer import BagWriter
from mixtac_recordings.recording import BagError
from mixtac_recordings.summary import summarise

if TYPE_CHECKING:
    from pathlib import Path

EPOCH_US = 1_790_000_000_000_000


def packet(store, seq: int, events: Events):
    encoded = encode(events, 'libcaer_cmp')
    header = store.types['std_msgs/msg/Header'](
        stamp=store.types['builtin_interfaces/msg/Time'](sec=1, nanosec=seq), frame_id='camera'
    )
    return store.types['event_camera_msgs/msg/EventPacket'](
        header=header,
        height=260,
        width=346,
        seq=seq,
        time_base=encoded.time_base,
        encoding='libcaer_cmp',
        is_bigendian=False,
        events=encoded.payload,
    )


def wrench(store, stamp_ns: int, force: float):
    vector = store.types['geometry_msgs/msg/Vector3']
    zero = vector(x=0.0, y=0.0, z=0.0)
    return store.types['geometry_msgs/msg/WrenchStamped'](
        header=store.types['std_msgs/msg/Header'](
            stamp=store.types['builtin_interfaces/msg/Time'](
                sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9
            ),
            frame_id='ft',
        ),
        wrench=store.types['geometry_msgs/msg/Wrench'](
            force=vector(x=0.0, y=0.0, z=force), torque=zero
        ),
    )


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Return a bag of 40 event packets, 7 events each, one packet missing, and 10 wrenches."""
    path = tmp_path / 'bag'
    store = typestore()
    writer = BagWriter(path)
    events = writer.add_topic(
        '/mixtac/events', 'event_camera_msgs/msg/EventPacket', reliable=False, latched=False
    )
    force = writer.add_topic(
        '/mixtac/force', 'geometry_msgs/msg/WrenchStamped', reliable=False, latched=False
    )
    rng = np.random.default_rng(1)
    for index in range(40):
        start = EPOCH_US + 1000 * index
        some = Events(
            np.sort(rng.integers(start, start + 1000, 7)),
            rng.integers(0, 346, 7).astype(np.uint16),
            rng.integers(0, 260, 7).astype(np.uint16),
            rng.integers(0, 2, 7).astype(bool),
        )
        seq = index + (index >= 20)
        kind = 'event_camera_msgs/msg/EventPacket'
        writer.write(
            events, 10**9 + index, bytes(store.serialize_cdr(packet(store, seq, some), kind))
        )
    for index in range(10):
        message = wrench(store, 5 * 10**9 + index * 2_000_000, 0.1 * index)
        data = store.serialize_cdr(message, 'geometry_msgs/msg/WrenchStamped')
        writer.write(force, 10**9 + index, bytes(data))
    writer.close()
    assert writer.written == {'/mixtac/events': 40, '/mixtac/force': 10}
    assert writer.dropped == 0
    return path


def test_what_was_written_is_read(bag: Path):
    with BagFile(bag) as opened:
        assert opened.counts == {'/mixtac/events': 40, '/mixtac/force': 10}
        stamps, forces = opened.wrenches('/mixtac/force')
    assert stamps.tolist() == [5 * 10**9 + i * 2_000_000 for i in range(10)]
    assert forces == pytest.approx([0.1 * i for i in range(10)])


def test_summary_decodes_all_events_and_counts_the_gap(bag: Path):
    events = summarise(bag).events['/mixtac/events']
    assert (events.packets, events.events, events.lost_packets) == (40, 280, 1)
    assert events.backward_steps == 0
    assert 0.038 <= events.duration_s <= 0.040


def test_an_unknown_topic_lists_the_known_ones(bag: Path):
    with BagFile(bag) as opened, pytest.raises(BagError, match='/mixtac/events'):
        opened.wrenches('/mixtac/forces')


def test_a_missing_bag_is_named(tmp_path: Path):
    with pytest.raises(BagError, match=r'no bag at .*nowhere'):
        BagFile(tmp_path / 'nowhere')


@pytest.mark.parametrize('kept', [0.0, 0.3, 0.6, 0.95])
def test_a_truncated_bag_is_refused_in_one_line(bag: Path, kept: float):
    data = next(bag.glob('*.mcap'))
    content = data.read_bytes()
    data.write_bytes(content[: int(len(content) * kept)])
    with pytest.raises(BagError) as caught:
        summarise(bag)
    assert len(str(caught.value).splitlines()) == 1


def test_a_bag_without_its_metadata_is_refused(bag: Path):
    (bag / 'metadata.yaml').unlink()
    with pytest.raises(BagError):
        summarise(bag)


def test_recording_over_a_bag_is_refused(bag: Path):
    with pytest.raises(BagError, match='new'):
        BagWriter(bag)


def test_array_type_of_ros_is_accepted_as_payload():
    # rclpy hands uint8[] over as array('B'); the reader gets numpy arrays: both have to decode.
    from mixtac_events.codec import decode

    some = Events(
        np.array([5, 6], np.int64),
        np.array([1, 2], np.uint16),
        np.array([3, 4], np.uint16),
        np.array([True, False]),
    )
    encoded = encode(some, 'libcaer_cmp')
    payload = array.array('B', encoded.payload.tobytes())
    assert decode(payload, 'libcaer_cmp', encoded.time_base).events.t.tolist() == [5, 6]
