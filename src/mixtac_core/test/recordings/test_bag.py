# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Writing, reading and summarising bags."""

from __future__ import annotations

import array
from pathlib import Path

import numpy as np
import pytest

from mixtac_core.events.arrays import Events
from mixtac_core.events.codec import encode
from mixtac_core.node.topics import TOPICS, message_class
from mixtac_core.recordings.bag import (
    BagFile,
    blank_message,
    custom_data,
    distinct_names,
    find_bags,
    fit_path,
    typestore,
)
from mixtac_core.recordings.bag_writer import BagWriter, McapBag, repair
from mixtac_core.recordings.recording import DamagedRecordingError, RecordingError
from mixtac_core.recordings.summary import summarise

EPOCH_US = 1_790_000_000_000_000
topics_to_compare = sorted({topic.type_name for topic in TOPICS})


def packet(store, seq: int, events: Events):
    encoded = encode(events)
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
    events = writer.add_topic('/mixtac/events', 'event_camera_msgs/msg/EventPacket', latched=False)
    force = writer.add_topic('/mixtac/force', 'geometry_msgs/msg/WrenchStamped', latched=False)
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
    assert forces[:, 2] == pytest.approx([0.1 * i for i in range(10)])
    assert not forces[:, :2].any()


def test_summary_decodes_all_events_and_counts_the_gap(bag: Path):
    events = summarise(bag).events['/mixtac/events']
    assert (events.packets, events.events, events.lost_packets) == (40, 280, 1)
    assert events.backward_steps == 0
    assert 0.038 <= events.duration_s <= 0.040


def test_an_unknown_topic_lists_the_known_ones(bag: Path):
    with BagFile(bag) as opened, pytest.raises(RecordingError):
        opened.wrenches('/mixtac/forces')


def test_a_missing_bag_is_named(tmp_path: Path):
    with pytest.raises(RecordingError):
        BagFile(tmp_path / 'nowhere')


@pytest.mark.parametrize('name', ['folder', 'table.csv', 'empty'])
def test_what_is_no_bag_is_not_called_a_damaged_one(tmp_path: Path, name: str):
    (tmp_path / 'folder').mkdir()
    (tmp_path / 'table.csv').write_text('1,2\n')
    (tmp_path / 'empty').touch()
    with pytest.raises(RecordingError) as caught:
        summarise(tmp_path / name)
    assert not isinstance(caught.value, DamagedRecordingError)


def test_a_bag_without_its_metadata_is_read(bag: Path):
    (bag / 'metadata.yaml').unlink()
    assert summarise(bag).counts == {'/mixtac/events': 40, '/mixtac/force': 10}


def test_a_file_that_is_missing_of_a_bag_is_named(bag: Path):
    path = bag / 'metadata.yaml'
    path.write_text(path.read_text().replace('  - bag.mcap', '  - bag.mcap\n  - bag_1.mcap'))
    assert 'bag_1.mcap' in summarise(bag).damage


def test_an_empty_storage_identifier_does_not_matter(bag: Path):
    path = bag / 'metadata.yaml'
    path.write_text(path.read_text().replace('storage_identifier: mcap', "storage_identifier: ''"))
    assert summarise(bag).counts == {'/mixtac/events': 40, '/mixtac/force': 10}


def test_packets_that_cannot_be_decoded_leave_the_other_topics(bag: Path, monkeypatch):
    monkeypatch.setattr('mixtac_core.events.codec._DECODERS', {})
    found = summarise(bag)
    assert found.events == {}
    assert found.counts == {'/mixtac/events': 40, '/mixtac/force': 10}
    assert '/mixtac/events' in found.damage
    assert 'libcaer_cmp' in found.damage


@pytest.mark.parametrize('name', topics_to_compare)
def test_blank_messages_are_those_of_ros(name: str):
    rclpy = pytest.importorskip('rclpy.serialization', reason='needs ROS 2')
    message = blank_message(name)
    if name.endswith('/Imu'):
        message.orientation.w = 1.0
    data = bytes(typestore().serialize_cdr(message, name))
    assert rclpy.deserialize_message(data, message_class(name)) == message_class(name)()


def test_recording_over_a_bag_is_refused(bag: Path):
    with pytest.raises(RecordingError):
        BagWriter(bag)


def test_array_type_of_ros_is_accepted_as_payload():
    # rclpy hands uint8[] over as array('B'); the reader gets numpy arrays: both have to decode.
    from mixtac_core.events.codec import decode

    some = Events(
        np.array([5, 6], np.int64),
        np.array([1, 2], np.uint16),
        np.array([3, 4], np.uint16),
        np.array([True, False]),
    )
    encoded = encode(some)
    payload = array.array('B', encoded.payload.tobytes())
    assert decode(
        payload, 'libcaer_cmp', encoded.time_base, width=346, height=260
    ).events.t.tolist() == [5, 6]


@pytest.mark.parametrize('backwards', [False, True])
def test_a_clock_that_was_reset_shows_in_the_summary(tmp_path: Path, backwards):
    store, kind = typestore(), 'event_camera_msgs/msg/EventPacket'
    one = np.ones(1, np.uint16)
    with McapBag(tmp_path / 'bag') as writer:
        topic = writer.add_topic('/mixtac/events', kind, latched=False)
        for index in range(4):
            since = 5000 * index if index < 2 or not backwards else index
            some = Events(np.array([EPOCH_US + since]), one, one, np.ones(1, bool))
            writer.write(
                topic, 10**9 + index, store.serialize_cdr(packet(store, index, some), kind)
            )
    assert summarise(tmp_path / 'bag').events['/mixtac/events'].backward_steps == backwards


def test_what_the_writer_of_a_bag_said_of_it_survives_a_repair(bag: Path, tmp_path: Path):
    assert custom_data(bag) == custom_data(tmp_path / 'nowhere') == {}
    said = {'mixtac.simulated': 'true', 'mixtac.trial': '{"profile": "press"}'}
    with McapBag(tmp_path / 'said') as writer:
        writer.custom_data.update(said)
    repair(tmp_path / 'said', tmp_path / 'repaired')
    assert custom_data(tmp_path / 'repaired') == said


def test_the_clock_fit_of_an_earlier_bag_does_not_count_for_a_new_one(bag: Path, tmp_path: Path):
    new = tmp_path / 'new'
    fit_path(new).write_text('{}')
    for make in (lambda out: BagWriter(out).close(), lambda out: repair(bag, out)):
        with pytest.raises(RecordingError) as caught:
            make(new)
        assert str(fit_path(new)) in str(caught.value)
        assert not new.exists()


def test_a_repair_that_is_interrupted_leaves_nothing(bag: Path, tmp_path: Path, monkeypatch):
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    before = sorted(tmp_path.iterdir())
    monkeypatch.setattr(McapBag, 'write', interrupt)
    with pytest.raises(KeyboardInterrupt):
        repair(bag, tmp_path / 'out')
    assert sorted(tmp_path.iterdir()) == before


def test_a_bag_found_from_within_has_its_name(bag: Path, monkeypatch: pytest.MonkeyPatch):
    for place, given in ((bag, '.'), (bag / 'below', '..')):
        place.mkdir(exist_ok=True)
        monkeypatch.chdir(place)
        assert find_bags(Path(given)) == [bag.resolve()]


def test_bags_are_named_after_as_many_folders_as_tell_them_apart():
    paths = ['d/static/a', 'd/dynamic/a', 'd/b', 'e/x/a/c', 'f/x/a/c', 'e/x/a/c']
    names = distinct_names(map(Path, paths))
    assert [names[Path(each)] for each in paths] == [
        'static_a',
        'dynamic_a',
        'b',
        'e_x_a_c',
        'f_x_a_c',
        'e_x_a_c',
    ]
