# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bags of ROS 1, as drivers of DAVIS and Prophesee cameras record them."""

from __future__ import annotations

import numpy as np
import pytest
from recording_samples import START_US, assert_equal, read, some_events
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mixtac_core.events.codec import encode
from mixtac_core.node.files import share
from mixtac_core.recordings.bag_writer import repair
from mixtac_core.recordings.camera_stream import EVENT_ARRAYS
from mixtac_core.recordings.importing import import_recording
from mixtac_core.recordings.recording import RecordingError
from mixtac_core.recordings.summary import summarise

EVENTS = some_events(count=600)


def write_ros1(path, kind, events=EVENTS, size=(346, 260), pictures=2):
    """Write a bag of event arrays of 200 events and some images with the library."""
    types = get_typestore(Stores.ROS1_NOETIC)
    package = kind.partition('/')[0]
    types.register(
        get_types_from_msg('uint16 x\nuint16 y\ntime ts\nbool polarity\n', f'{package}/msg/Event')
    )
    text = f'std_msgs/Header header\nuint32 height\nuint32 width\n{package}/Event[] events\n'
    types.register(get_types_from_msg(text, kind))
    time, header = types.types['builtin_interfaces/msg/Time'], types.types['std_msgs/msg/Header']

    def stamp(t_us):
        return time(int(t_us // 1_000_000), int(t_us % 1_000_000) * 1000)

    with Writer(path) as writer:
        topic = writer.add_connection('/dvs/events', kind, typestore=types)
        image = writer.add_connection('/dvs/image_raw', 'sensor_msgs/msg/Image', typestore=types)
        for seq, start in enumerate(range(0, len(events), 200)):
            part = events[start : start + 200]
            columns = (part.x.tolist(), part.y.tolist(), part.t.tolist(), part.polarity.tolist())
            rows = [
                types.types[f'{package}/msg/Event'](x, y, stamp(t), p)
                for x, y, t, p in zip(*columns, strict=True)
            ]
            last_us = int(part.t[-1])
            message = types.types[kind](header(seq, stamp(last_us), 'dvs'), size[1], size[0], rows)
            writer.write(topic, 1000 * last_us, types.serialize_ros1(message, kind))
        for number in range(pictures):
            t_us, octets = START_US + 10_000 * number, np.full(12, number, np.uint8)
            kinds = types.types['sensor_msgs/msg/Image']
            message = kinds(header(number, stamp(t_us), 'dvs'), 3, 4, 'mono8', 0, 4, octets)
            data = types.serialize_ros1(message, 'sensor_msgs/msg/Image')
            writer.write(image, 1000 * t_us, data)
    return path


@pytest.mark.parametrize('kind', EVENT_ARRAYS)
def test_events_and_images_come_out_as_they_went_in(tmp_path, kind):
    path = write_ros1(tmp_path / 'x.bag', kind)
    found = read(path)
    assert_equal(found.events, EVENTS)
    assert (found.info.width, found.info.height, found.info.kind) == (346, 260, 'ROS 1 bag')
    assert [frame.middle_us for frame in found.frames] == [START_US, START_US + 10_000]
    assert int(found.frames[1].image.max()) == 4
    summary = summarise(path).events['/dvs/events']
    assert (summary.events, summary.lost.packets_missing) == (600, 0)
    counts = import_recording(path, tmp_path / 'bag')
    assert (counts.events, counts.frames, counts.warnings()) == (600, 2, [])
    assert_equal(read(tmp_path / 'bag').events, EVENTS)


def test_events_that_step_back_in_a_message_are_sorted_and_counted(tmp_path):
    order = np.arange(600).reshape(-1, 2)[:, ::-1].ravel()
    path = write_ros1(tmp_path / 'x.bag', EVENT_ARRAYS[0], EVENTS[order])
    found = read(path)
    np.testing.assert_array_equal(found.events.t, EVENTS.t)
    backwards = sum(
        np.count_nonzero(np.diff(EVENTS.t[order][n : n + 200]) < 0) for n in (0, 200, 400)
    )
    assert summarise(path).events['/dvs/events'].lost.events_unsorted == backwards
    assert len(import_recording(path, tmp_path / 'bag').warnings()) == 1


def test_events_outside_of_the_sensor_are_left_out_and_counted(tmp_path):
    path = write_ros1(tmp_path / 'x.bag', EVENT_ARRAYS[0], size=(100, 100))
    inside = EVENTS[(EVENTS.x < 100) & (EVENTS.y < 100)]
    assert_equal(read(path).events, inside)
    assert summarise(path).events['/dvs/events'].lost.events_outside == 600 - len(inside)


def test_event_packets_of_ros_1_are_read(tmp_path):
    types, kind = get_typestore(Stores.ROS1_NOETIC), 'event_camera_msgs/msg/EventPacket'
    text = (share('event_camera_msgs') / 'msg' / 'EventPacket.msg').read_text()
    types.register(get_types_from_msg(text, kind))
    until_us = int(EVENTS.t[-1])
    encoded = encode(EVENTS, complete_until=until_us)
    time = types.types['builtin_interfaces/msg/Time'](until_us // 10**6, until_us % 10**6 * 1000)
    header = types.types['std_msgs/msg/Header'](1, time, '')
    fields = (260, 346, 1, encoded.time_base, 'libcaer_cmp', False, encoded.payload)
    with Writer(tmp_path / 'x.bag') as writer:
        topic = writer.add_connection('/camera/events', kind, typestore=types)
        data = types.serialize_ros1(types.types[kind](header, *fields), kind)
        writer.write(topic, 1000 * until_us, data)
    assert_equal(read(tmp_path / 'x.bag').events, EVENTS)
    assert summarise(tmp_path / 'x.bag').events['/camera/events'].events == len(EVENTS)
    with pytest.raises(RecordingError):
        repair(tmp_path / 'x.bag', tmp_path / 'out')


@pytest.mark.parametrize('keep', [0.1, 0.9])
def test_a_damaged_one_is_refused_in_one_line(tmp_path, keep):
    path = write_ros1(tmp_path / 'x.bag', EVENT_ARRAYS[0])
    data = path.read_bytes()
    path.write_bytes(data[: int(keep * len(data))])
    with pytest.raises(RecordingError) as error:
        read(path)
    assert 'rosbag reindex' in error.value.remedy
    assert '\n' not in str(error.value)
