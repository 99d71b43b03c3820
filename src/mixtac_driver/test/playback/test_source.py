# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A recording as a source: loops, jumps, pauses, stamps, its end, and being stopped."""

from __future__ import annotations

import contextlib
import itertools
import shutil
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from playing import play, until_end
from recording_samples import START_US, Bag, assert_equal, some_events

from mixtac_driver.errors import EndOfStream
from mixtac_driver.parameters import DriverParameters
from mixtac_driver.playback.source import RecordedSource, replayed_identity
from mixtac_events.arrays import Events
from mixtac_events.codec import decode
from mixtac_events.packetizer import Packetizer
from mixtac_recordings.camera_stream import open_recording
from mixtac_recordings.recording import RecordingError

LENGTH_US = 50_000
EVENTS = some_events(length_us=LENGTH_US)


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    path = tmp_path_factory.mktemp('source') / 'bag'
    with Bag(path) as bag:
        bag.events(EVENTS)
        for t_us in range(START_US, START_US + LENGTH_US, 10_000):
            bag.image(np.zeros((260, 346), np.uint16), t_us)
    return path


def source_of(path, *, now_ns=time.time_ns, **parameters):
    values = {'playback_rate': 0.0, **parameters}
    p = DriverParameters(device=str(path), **values)
    source = RecordedSource(p, now_ns=now_ns)
    source.open()
    return source


def test_it_ends_once_and_says_so(bag):
    source = source_of(bag)
    source.start()
    with pytest.raises(EndOfStream):
        for _ in source.batches():
            pass
    assert source.status().figures['playback'] == 'ended'
    source.close()
    assert not source.status().is_open
    identity = source.status().identity
    assert (identity.chip, identity.serial) == ('rosbag2 bag', '')


def test_the_camera_is_the_recorded_one(tmp_path):
    with Bag(tmp_path / 'bag') as named:
        named.events(EVENTS)
        named.clock(START_US, '00000042')
        named.clock(START_US, 'gps', topic='/gps/camera_clock')
        named.clock(START_US, 'gps', topic='/mixtac/a_receiver')
    with contextlib.closing(open_recording(tmp_path / 'bag')) as recording:
        info = recording.info
    assert replayed_identity(info).serial == '00000042'
    assert replayed_identity(replace(info, camera='DAVIS346_00000043')).serial == '00000043'


def test_its_last_packet_is_not_held_back(bag):
    source = source_of(bag)
    source.start()
    packetizer, packets = Packetizer('libcaer_cmp', 100_000, 1 << 20), []
    for batch in until_end(source):
        events = batch.decoded.events.shifted(batch.origin.us)
        packets += packetizer.push(events, batch.time_us, batch.arrival_ns)
    parts = [p.encode() for p in packets]
    found = [
        decode(each.payload, each.encoding, each.time_base, width=346, height=260) for each in parts
    ]
    assert_equal(Events.concatenate([each.events for each in found]), EVENTS)


def test_played_again_after_a_restart_time_goes_on(bag):
    source = source_of(bag)
    first = play(source)
    source.close()
    source.open()
    second = play(source)
    assert second.events.t[0] > first.times[-1]
    np.testing.assert_array_equal(np.diff(second.events.t), np.diff(EVENTS.t))


def test_loops_repeat_the_events_shifted_by_length_and_gap(bag):
    source = source_of(bag, playback_loop=True)
    found = play(source, batches=3 * 60)
    assert source.status().figures['playback loops'] >= 2
    count = len(EVENTS)
    assert (np.diff(found.times) >= 0).all()
    assert (np.diff(found.events.t) >= 0).all()
    for loop in range(2):
        part = found.events[loop * count : (loop + 1) * count]
        shift_us = int(part.t[0] - EVENTS.t[0])
        assert_equal(part, EVENTS.shifted(shift_us))
        assert shift_us % 1000 == 0
        # Its length on the grid of packets, the gap of 1 ms, both in whole milliseconds.
        assert shift_us == loop * 52_000


@settings(max_examples=30)
@given(offset_us=st.integers(0, LENGTH_US - 1))
def test_playing_from_an_offset_leaves_out_exactly_what_is_before(bag, offset_us):
    source = source_of(bag, playback_start=offset_us / 1e6)
    found = play(source)
    source.close()
    assert_equal(found.events, EVENTS[EVENTS.t >= START_US + offset_us])
    assert [t for t in range(0, LENGTH_US, 10_000) if t >= offset_us] == [
        t - START_US for t in found.frame_times
    ]


@settings(max_examples=30)
@given(
    jumps=st.lists(st.integers(0, 2 * LENGTH_US), min_size=1, max_size=5), every=st.integers(1, 9)
)
def test_jumps_land_where_they_should_and_time_goes_on(bag, jumps, every):
    source = source_of(bag)
    source.start()
    waiting, parts, times = list(jumps), [[]], []
    for number, batch in enumerate(until_end(source), 1):
        parts[-1].append((batch.decoded.events, batch.origin.us))
        times.append(batch.time_us)
        if waiting and number % every == 0:
            source.seek(waiting.pop(0) / 1e6)
            parts.append([])
    assert (np.diff(times) >= 0).all()
    landed = [0, *jumps]
    for offset_us, part in zip(landed, parts, strict=False):
        found = Events.concatenate([events for events, _ in part])
        expected = EVENTS[EVENTS.t >= START_US + offset_us]
        assert_equal(found, expected[: len(found)])
    published = [events.t + origin for part in parts for events, origin in part]
    assert (np.diff(np.concatenate(published)) >= 0).all()
    source.close()


def test_a_jump_ahead_keeps_the_recorded_times(bag):
    source = source_of(bag)
    source.start()
    batches = source.batches()
    next(batches)
    source.seek(0.03)
    assert next(batches).origin.us == 0
    source.seek(0.01)
    back = next(batches)
    assert back.origin.us > 0
    assert back.origin.us % 1000 == 0


def test_a_jump_over_a_long_silence_in_a_long_bag(tmp_path):
    with Bag(tmp_path / 'bag') as bag:
        for second in (0, 1, 100, 3000, 3001):
            events = some_events(second, 10, 1000, start_us=START_US + second * 1_000_000)
            bag.events(events)
    for offset_s, expected in ((0.5, 1), (50.0, 100), (1000.0, 3000), (3000.5, 3001)):
        source = source_of(tmp_path / 'bag', playback_start=offset_s)
        found = play(source)
        assert found.events.t[0] == START_US + expected * 1_000_000
        source.close()


def test_receipt_that_drifts_away_from_the_camera_clock(tmp_path):
    """The recorder's clock runs at half speed: a jump must still find its place."""
    parts = [some_events(n, 10, 1000, start_us=START_US + n * 10_000_000) for n in range(40)]
    with Bag(tmp_path / 'bag') as bag:
        for number, part in enumerate(parts):
            bag.packet(part, int(part.t[-1]), stamp_us=START_US + number * 5_000_000)
    source = source_of(tmp_path / 'bag', playback_start=300.0)
    assert_equal(play(source).events, Events.concatenate(parts[30:]))


def test_frames_that_outlast_the_events_are_in_time_when_it_loops(tmp_path):
    with Bag(tmp_path / 'bag') as long:
        long.events(EVENTS)
        for t_us in range(START_US, START_US + 9 * LENGTH_US, 10_000):
            long.image(np.zeros((260, 346), np.uint16), t_us)
    source = source_of(tmp_path / 'bag', playback_loop=True)
    played = play(source, batches=300)
    assert len(played.frames) > 2 * 45
    assert (np.diff(played.frame_times) > 0).all()


def test_at_another_rate_there_is_no_clock_map(bag):
    source = source_of(bag, playback_rate=1.0, playback_loop=True)
    source.start()
    batches = source.batches()
    next(each for each in batches if source.status().clock.ready)
    source.apply(DriverParameters(playback_rate=4.0, playback_loop=True))
    next(batches)
    next(batches)
    assert not source.status().clock.ready
    source.close()


def test_a_start_beyond_the_end_is_an_error_also_when_looping(bag):
    for loop in (False, True):
        source = source_of(bag, playback_start=60.0, playback_loop=loop)
        source.start()
        with pytest.raises(RecordingError):
            next(source.batches())


def test_stamps_are_moved_to_now_if_wanted(bag):
    now_us = 2_000_000_000_000_000
    source = source_of(bag, playback_restamp=True, now_ns=lambda: now_us * 1000)
    found = play(source)
    assert now_us - found.times[0] in range(1000)
    np.testing.assert_array_equal(np.diff(found.events.t), np.diff(EVENTS.t))
    assert found.frame_times[1] - found.events.t[0] == 10_000


def test_camera_settings_are_taken_and_change_nothing(bag):
    source = source_of(bag)
    source.apply(DriverParameters(playback_rate=0.0, aps_exposure=1))
    assert_equal(play(source).events, EVENTS)


def test_a_recording_takes_no_requests(bag):
    source = source_of(bag)
    assert source.control is None
    assert source.attached() == frozenset()


def test_figures_outlive_the_end(bag):
    source = source_of(bag)
    assert source.status().figures == {}
    play(source)
    source.close()
    figures = source.status().figures
    assert figures['playback'] == 'ended'
    assert figures['recorded events'] == '/mixtac/events'
    assert figures['playback position [s]'] == pytest.approx(0.05, abs=0.001)


def test_parameters_change_while_it_plays(bag):
    source = source_of(bag, playback_rate=1.0, playback_paused=True)
    source.start()
    assert source.status().figures['playback'] == 'paused'
    got = []
    thread = threading.Thread(
        daemon=True, target=lambda: got.extend(itertools.islice(source.batches(), 200))
    )
    thread.start()
    # Paused: whatever was handed on by now is all there is.
    assert got == []
    source.apply(DriverParameters(playback_rate=0.0, playback_loop=True, playback_seek=0.02))
    thread.join(20)
    assert len(got) == 200
    assert source.status().figures['playback loops'] >= 1
    first = next(batch for batch in got if len(batch.decoded.events))
    assert first.decoded.events.t[0] >= START_US + 20_000


@pytest.mark.parametrize('paused', [False, True])
def test_it_stops_at_once_in_the_middle_of_a_wait(tmp_path, paused):
    with Bag(tmp_path / 'bag') as bag:
        bag.image(np.zeros((4, 4), np.uint16), START_US)
        bag.image(np.zeros((4, 4), np.uint16), START_US + 3_600_000_000)
    source = source_of(tmp_path / 'bag', playback_rate=1.0, playback_paused=paused)
    source.start()
    got = []

    def take():
        for batch in source.batches():
            got.append(batch)  # noqa: PERF402 - one by one, for the thread that waits

    thread = threading.Thread(daemon=True, target=take)
    thread.start()
    while not paused and not any(batch.decoded.frames for batch in tuple(got)):
        time.sleep(0.01)
    source.request_stop()
    thread.join(10)
    assert not thread.is_alive()
    source.close()


def test_not_open_says_so(tmp_path):
    source = RecordedSource(DriverParameters(device=str(tmp_path / 'x.mcap')))
    with pytest.raises(RecordingError) as error:
        source.start()
    assert 'x.mcap' in str(error.value)
    assert source.status().identity is None
    source.close()


def test_in_real_time_steps_are_short_and_feed_the_clock_map(bag):
    source = source_of(bag, playback_rate=1.0)
    found = play(source)
    assert_equal(found.events, EVENTS)
    assert np.diff(found.times[:-1]).max() <= 1000
    assert source.status().clock.ready
    assert abs(source.status().clock.estimate().skew_ppm) < 1000


def test_an_incomplete_recording_is_reported(bag, tmp_path):
    shutil.copytree(bag, tmp_path / 'cut')
    (path,) = (tmp_path / 'cut').glob('*.mcap')
    path.write_bytes(path.read_bytes()[:-100])
    source = source_of(tmp_path / 'cut')
    assert path.name in source.status().trouble
    assert_equal(play(source).events, EVENTS)
