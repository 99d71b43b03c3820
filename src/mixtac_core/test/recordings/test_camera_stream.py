# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bags: what was put in comes out, at the times it was put in; damage gives one clear line."""

from __future__ import annotations

import numpy as np
import pytest
from recording_samples import START_US, Bag, assert_equal, read, scene, some_events
from rosbags.rosbag2 import StoragePlugin

from mixtac_core.events.codec import encode
from mixtac_core.events.packets import EncodedPacket
from mixtac_core.recordings.recording import RecordingError
from mixtac_core.recordings.summary import summarise


@pytest.mark.parametrize('encoding', ['libcaer_cmp', 'libcaer'])
@pytest.mark.parametrize('plugin', StoragePlugin)
def test_events_come_out_as_they_went_in(tmp_path, encoding, plugin):
    events = some_events()
    with Bag(tmp_path / 'bag', plugin) as bag:
        bag.events(events, encoding=encoding)
    assert_equal(read(tmp_path / 'bag').events, events)


def test_frames_and_samples_come_with_their_exact_times(tmp_path):
    events, frames = scene(tmp_path / 'bag')
    found = read(tmp_path / 'bag')
    assert_equal(found.events, events)
    assert found.frame_times == [START_US + 5000, START_US + 25_000]
    for frame, sent in zip(found.frames, frames, strict=True):
        np.testing.assert_array_equal(frame.image, sent)
    assert [sample[0] for sample in found.imu] == [START_US + 1000 * n for n in range(3)]
    np.testing.assert_array_equal(found.imu[2][1], (0.5, 2, 9.8))
    np.testing.assert_array_equal(found.imu[2][2], (0.1, 0.2, 0.3))
    assert np.isnan(found.imu[2][3])


def test_edges_have_their_times_and_samples_the_temperature_of_their_stamp(tmp_path):
    with Bag(tmp_path / 'bag') as bag:
        bag.events(some_events())
        bag.edge(START_US + 1234, 3)
        bag.edge(START_US + 5678, 2)
        for number, celsius in enumerate((31.5, None, 33.25)):
            if celsius is not None:
                bag.temperature(START_US + 1000 * number, celsius)
            bag.imu(START_US + 1000 * number, (0.5, 0, 9.8))
    found = read(tmp_path / 'bag')
    assert found.edges == [(START_US + 1234, 3), (START_US + 5678, 2)]
    np.testing.assert_array_equal([sample[3] for sample in found.imu], [31.5, np.nan, 33.25])


@pytest.mark.parametrize('later_us', [0, 5000, 100_000])
def test_frames_get_the_exposure_that_was_recorded_after_them(tmp_path, later_us):
    pixels = np.zeros((260, 346), np.uint16)
    with Bag(tmp_path / 'bag') as bag:
        bag.events(some_events(length_us=200_000))
        for number, shutter in enumerate((0, 1)):
            t_us = START_US + 80_000 * number + 5000
            bag.image(pixels, t_us, t_us + 3000)
            times = (t_us - 2500, t_us - 2000, t_us + 2001, t_us + 9000)
            bag.exposure(t_us, times, shutter, t_us + 3001 + later_us)
        bag.image(pixels, START_US + 199_000)
    found = read(tmp_path / 'bag')
    for number, frame in enumerate(found.frames[:2]):
        # A frame waits until the next one, at 80 and 194 ms.
        known = later_us < 80_000 or number == 1
        t_us = START_US + 80_000 * number + 5000
        assert found.frame_times[number] == t_us
        assert frame.exposure_start_us == (t_us - 2000 if known else t_us)
        assert frame.exposure_end_us == (t_us + 2001 if known else t_us)
        assert frame.frame_end_us == (t_us + 9000 if known else t_us)
        assert frame.global_shutter == (not known or number == 0)
    assert found.frame_times[2] == START_US + 199_000


def test_a_bag_of_frames_only_takes_its_size_from_camera_info(tmp_path):
    with Bag(tmp_path / 'bag') as bag:
        bag.info(START_US, corner=(100, 51))
        for number in range(4):
            pixels = np.full((20, 30), 37 << 6, np.uint16)
            bag.image(pixels, START_US + 40_000 * number, encoding='bayer_gbrg16')
    found = read(tmp_path / 'bag')
    assert (found.info.width, found.info.height) == (346, 260)
    # An odd first row: the pattern of the whole array begins with the other pair of rows.
    assert found.info.color_filter == 1
    assert found.frame_times == [START_US + 40_000 * number for number in range(4)]
    assert (found.frames[0].x, found.frames[0].y) == (100, 51)
    assert len(found.events) == 0


@pytest.mark.parametrize('apart_us', [0, 61_000_000, -61_000_000])
def test_stamps_on_the_camera_clock_stay_whatever_the_host_clock_says(tmp_path, apart_us):
    events = some_events(length_us=20_000)
    with Bag(tmp_path / 'bag') as bag:
        for start in range(START_US, START_US + 20_000, 10_000):
            part = events.between(start, start + 10_000)
            bag.packet(part, start + 9999, stamp_us=start + apart_us)
        bag.image(np.zeros((260, 346), np.uint16), START_US + 8000)
    assert read(tmp_path / 'bag').frame_times == [START_US + 8000]


def test_host_stamps_of_other_drivers_are_moved_to_the_camera_clock(tmp_path):
    events = some_events(start_us=5000, length_us=20_000)
    with Bag(tmp_path / 'bag') as bag:
        for start in range(5000, 25_000, 10_000):
            part = events.between(start, start + 10_000)
            bag.packet(part, start + 9999, encoding='libcaer', stamp_us=START_US + start)
        bag.image(np.zeros((260, 346), np.uint16), START_US + 8000)
    found = read(tmp_path / 'bag')
    assert_equal(found.events, events)
    # The first packet is stamped by the host START_US + 5000, and begins with the event at 5000.
    assert found.frame_times == [8000]


@pytest.mark.parametrize(('skipped', 'missing'), [(3, 3), (-20, 0)], ids=['lost', 'restarted'])
def test_packets_missing_by_their_numbers_are_counted(tmp_path, skipped, missing):
    with Bag(tmp_path / 'bag') as bag:
        for number, end_us in enumerate(range(START_US + 1000, START_US + 50_000, 1000)):
            bag.sequence += skipped if number == 20 else 0
            bag.packet(some_events(length_us=10, count=2, start_us=end_us - 500), end_us)
    assert read(tmp_path / 'bag').counters.packets_missing == missing


def test_a_topic_in_an_unknown_encoding_leaves_the_others(tmp_path):
    events = some_events()
    encoded = EncodedPacket(START_US * 1000, np.zeros(8, np.uint8), 'evt2')
    with Bag(tmp_path / 'bag') as bag:
        bag.packet(None, START_US, encoding='evt2', encoded=encoded, topic='/other/events')
        bag.events(events)
        bag.image(np.zeros((4, 12), np.uint8), START_US, encoding='bgr8')
        bag.imu(START_US, (0.5, 1.0, 9.8))
    found = read(tmp_path / 'bag')
    assert_equal(found.events, events)
    assert (len(found.frames), len(found.imu)) == (0, 1)
    assert all(each in found.info.damage for each in ('/other/events', 'evt2', 'bgr8'))


def test_an_evt3_recording_begins_with_the_first_time_that_is_known(tmp_path):
    time_low, time_high, event = 0x6000, 0x8000, 0x2000
    start_us = 0x4C5 << 12
    with Bag(tmp_path / 'bag') as bag:
        for late_us, words in (
            (-1000, [time_low | 0xC18, event]),
            (1, [time_high | 0x4C5, time_low | 1, event]),
        ):
            payload = np.array(words, np.uint16).view(np.uint8)
            encoded = EncodedPacket(0, payload, 'evt3')
            bag.packet(None, START_US + late_us, encoding='evt3', encoded=encoded)
        pixels = np.zeros((4, 4), np.uint8)
        bag.image(pixels, START_US + 500, encoding='mono8', topic='/mixtac/image')
    found = read(tmp_path / 'bag')
    assert found.events.t.tolist() == [start_us + 1]
    assert found.info.start_us == start_us + 1
    assert [frame.middle_us for frame in found.frames] == [start_us + 500]


def test_topics_are_chosen_by_name_where_there_are_several(tmp_path):
    left, right = some_events(1, 100), some_events(2, 200)
    with Bag(tmp_path / 'bag') as bag:
        bag.events(left, topic='/left/events')
        bag.events(right, topic='/right/events')
        for side in ('left', 'right'):
            pixels = np.zeros((4, 4), np.uint8)
            bag.image(pixels, START_US, encoding='mono8', topic=f'/{side}/image')
        bag.imu(START_US, (0, 0, 0))
    with pytest.raises(RecordingError) as error:
        read(tmp_path / 'bag')
    assert '/left/events, /right/events' in str(error.value)
    found = read(tmp_path / 'bag', events='/right/events')
    assert_equal(found.events, right)
    assert len(found.frames) == 1
    assert len(found.imu) == 1
    with pytest.raises(RecordingError):
        read(tmp_path / 'bag', events='/middle/events')
    found = read(tmp_path / 'bag', events='none', image='/left/image', imu='none')
    assert (len(found.events), len(found.frames), len(found.imu)) == (0, 1, 0)


@pytest.mark.parametrize(
    ('own', 'other'), [('/left', '/right'), ('', '/right'), ('/hand', '/hand/b')]
)
def test_samples_and_frames_are_those_of_the_camera_of_the_events(tmp_path, own, other):
    with Bag(tmp_path / 'bag') as bag:
        for number, space in enumerate((own, other)):
            bag.events(some_events(number, 100), topic=f'{space}/events')
            pixels = np.full((4, 4), number, np.uint8)
            bag.image(pixels, START_US, encoding='mono8', topic=f'{space}/image_raw')
            bag.imu(START_US, (number, 0, 0), topic=f'{space}/imu/data_raw')
    found = read(tmp_path / 'bag', events=f'{own}/events')
    assert [int(frame.image.max()) for frame in found.frames] == [0]
    assert [acceleration.tolist() for _, acceleration, *_ in found.imu] == [[0, 0, 0]]


def test_a_damaged_packet_ends_the_playing_with_its_topic(tmp_path):
    events = some_events()
    good = encode(events.between(START_US, START_US + 1000), complete_until=START_US + 1000)
    bad = EncodedPacket(good.time_base, np.full(7, 0xFF, np.uint8))
    with Bag(tmp_path / 'bag') as bag:
        bag.packet(None, START_US, encoded=good)
        bag.packet(None, START_US + 5, encoded=bad)
    with pytest.raises(RecordingError) as error:
        read(tmp_path / 'bag')
    assert '/mixtac/events' in str(error.value)


@pytest.mark.parametrize('stamp_us', [0, START_US + 5])
def test_images_without_a_stamp_are_left_out(tmp_path, stamp_us):
    with Bag(tmp_path / 'bag') as bag:
        bag.events(some_events())
        for t_us in (0, 0, stamp_us):
            bag.image(np.zeros((4, 4), np.uint8), t_us, START_US + 5, encoding='mono8')
    found = read(tmp_path / 'bag')
    assert found.frame_times == ([stamp_us] if stamp_us else [])
    assert found.counters.frames_without_time == (2 if stamp_us else 0)
    assert ('/mixtac/image_raw' in found.info.damage) == (not stamp_us)
    (warning,) = summarise(tmp_path / 'bag').warnings
    assert f'/mixtac/image_raw: {2 if stamp_us else 3}' in warning


def test_what_is_no_recording_is_refused_by_its_format(tmp_path):
    begins = {
        '#!AER-DAT3.1': 'AEDAT 3',
        'version https://git-lfs.github.com/spec/v1': 'git-lfs',
        'Event Stream': 'Event Stream',
        'notes': 'unknown',
    }
    for begin, name in begins.items():
        path = tmp_path / 'file'
        path.write_text(begin)
        with pytest.raises(RecordingError) as error:
            read(path)
        assert name in error.value.message
        assert error.value.remedy
    with Bag(tmp_path / 'bag') as bag:
        bag.info(START_US)
    for path in (tmp_path, tmp_path / 'missing.mcap', tmp_path / 'bag'):
        with pytest.raises(RecordingError):
            read(path)
