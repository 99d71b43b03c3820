# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A recording as a source: nothing is lost, time never goes back, and playback obeys."""

from __future__ import annotations

import itertools
import shutil
import threading
import time
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from playing import play
from recording_samples import START_US, Bag, assert_equal, some_events

from mixtac_core.events.arrays import Events
from mixtac_core.events.readings import Frame
from mixtac_core.recordings.recording import Piece, RecordingError
from mixtac_driver.errors import EndOfStream
from mixtac_driver.parameters import DriverParameters
from mixtac_driver.playback import RecordedSource, Timeline, from_time

LENGTH_US = 50_000
EVENTS = some_events(length_us=LENGTH_US)


def piece(events, start_us=None):
    start_us = int(events.t[0]) if start_us is None else start_us
    return Piece(start_us, int(events.t[-1]), advances=True, events=events)


def frame_at(t_us):
    frame = Frame(np.zeros((2, 2), np.uint16), 0, 0, t_us, t_us, t_us, t_us, 0, True)
    return Piece(t_us, t_us, advances=False, frames=(frame,))


def run(pieces, step_us=1000):
    timeline = Timeline(START_US)
    return timeline, list(timeline.steps(pieces, lambda: step_us))


def joined(steps):
    return Events.concatenate([step.decoded.events.shifted(step.offset_us) for step in steps])


@given(
    gaps=st.lists(st.integers(0, 20_000), min_size=1, max_size=60),
    cuts=st.sets(st.integers(1, 59), max_size=10),
    step_us=st.sampled_from([0, 1000, 3000]),
)
def test_every_event_leaves_once_in_steps_that_never_go_back(gaps, cuts, step_us):
    t = START_US + np.cumsum(gaps).astype(np.int64)
    zeros = np.zeros(len(t), np.uint16)
    events = Events(t, np.arange(len(t), dtype=np.uint16), zeros, zeros.astype(np.bool_))
    edges = sorted({0, len(t), *(cut for cut in cuts if cut < len(t))})
    timeline, steps = run([piece(events[a:b]) for a, b in pairwise(edges)], step_us)
    assert_equal(joined(steps), events)
    position_us = START_US
    for step in steps:
        inside = step.decoded.events.t
        assert step.due_us == step.decoded.time_us >= position_us
        assert not len(inside) or position_us <= inside[0] <= inside[-1] <= step.due_us
        assert not step_us or step.due_us - position_us <= step_us
        position_us = step.due_us
    assert (timeline.out_of_order, timeline.resets) == (0, 0)


def test_late_events_are_dropped_unsorted_ones_sorted_and_both_counted():
    first, second = some_events(1, 100, 5000), some_events(2, 100, 5000)
    timeline, steps = run([piece(first), piece(second)])
    late = int(np.count_nonzero(second.t < first.t[-1]))
    assert timeline.out_of_order == late == 200 - len(joined(steps))
    assert (np.diff(joined(steps).t) >= 0).all()
    events = some_events(count=3, length_us=3000)
    order = [0, 2, 1]
    mixed = Events(events.t[order], events.x[order], events.y[order], events.polarity[order])
    timeline, steps = run([piece(mixed, START_US)])
    assert_equal(joined(steps), events)
    assert timeline.out_of_order == 1


@pytest.mark.parametrize('from_us', [0, START_US + 500])
def test_time_goes_on_where_the_recorded_clock_was_reset(from_us):
    early, late = 5_000_000, 5_001_500
    before, after = some_events(1, 10, 1000), some_events(2, 10, 1000, start_us=early)
    pieces = [piece(before), frame_at(early), piece(after), frame_at(late), frame_at(early - 1)]
    timeline, steps = run(from_time(pieces, from_us))
    assert timeline.resets == 1
    assert timeline.offset_us % 1000 == 0
    t = joined(steps).t[-20:]
    assert t[-10] - t[-11] in range(1000, 2001)
    np.testing.assert_array_equal(np.diff(t[-10:]), np.diff(after.t))
    assert (np.diff([step.due_us for step in steps if not step.decoded.frames]) >= 0).all()
    frames = [step for step in steps if step.decoded.frames]
    # The first frame was recorded before the first packet of the new clock.
    assert [step.decoded.frames[0].middle_us for step in frames] == [late, early - 1]
    assert {step.offset_us for step in frames} == {timeline.offset_us}


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    path = tmp_path_factory.mktemp('source') / 'bag'
    with Bag(path) as bag:
        bag.events(EVENTS)
        for t_us in range(START_US, START_US + LENGTH_US, 10_000):
            bag.image(np.zeros((260, 346), np.uint16), t_us)
    return path


def source_of(path, *, now_ns=time.time_ns, **parameters):
    p = DriverParameters(device=str(path), **{'playback_rate': 0.0, **parameters})
    source = RecordedSource(p, now_ns=now_ns)
    source.open()
    return source


def test_it_ends_once_and_its_figures_remain(bag):
    source = source_of(bag)
    assert source.control is None
    source.start()
    with pytest.raises(EndOfStream):
        for _ in source.batches():
            pass
    source.close()
    status = source.status()
    assert not status.is_open
    assert status.figures['playback'] == 'ended'
    assert status.figures['recorded events'] == '/mixtac/events'
    assert status.figures['playback position [s]'] == pytest.approx(0.05, abs=0.001)
    assert (status.identity.chip, status.identity.serial) == ('rosbag2 bag', '')


def test_loops_repeat_the_events_shifted_by_length_and_gap(bag):
    source = source_of(bag, playback_loop=True)
    found, count = play(source, batches=3 * 60), len(EVENTS)
    assert source.status().figures['playback loops'] >= 2
    assert (np.diff(found.times) >= 0).all()
    assert (np.diff(found.events.t) >= 0).all()
    for loop in range(2):
        part = found.events[loop * count : (loop + 1) * count]
        # Its length on the grid of packets, the gap of 1 ms, both in whole milliseconds.
        assert_equal(part, EVENTS.shifted(loop * 52_000))


def test_frames_that_outlast_the_events_are_in_time_when_it_loops(tmp_path):
    with Bag(tmp_path / 'bag') as long:
        long.events(EVENTS)
        for t_us in range(START_US, START_US + 9 * LENGTH_US, 10_000):
            long.image(np.zeros((260, 346), np.uint16), t_us)
    played = play(source_of(tmp_path / 'bag', playback_loop=True), batches=300)
    assert len(played.frames) > 2 * 45
    assert (np.diff(played.frame_times) > 0).all()


@settings(max_examples=30)
@given(offset_us=st.integers(0, LENGTH_US - 1))
def test_playing_from_an_offset_leaves_out_exactly_what_is_before(bag, offset_us):
    source = source_of(bag, playback_start=offset_us / 1e6)
    found = play(source)
    source.close()
    assert_equal(found.events, EVENTS[EVENTS.t >= START_US + offset_us])
    frames = range(START_US, START_US + LENGTH_US, 10_000)
    assert found.frame_times == [t for t in frames if t >= START_US + offset_us]


@pytest.mark.parametrize('loop', [False, True])
def test_a_start_beyond_the_end_is_an_error_also_when_looping(bag, loop):
    source = source_of(bag, playback_start=60.0, playback_loop=loop)
    source.start()
    with pytest.raises(RecordingError):
        next(source.batches())


def test_stamps_are_moved_to_now_if_wanted(bag):
    now_us = 2_000_000_000_000_000
    found = play(source_of(bag, playback_restamp=True, now_ns=lambda: now_us * 1000))
    assert now_us - found.times[0] in range(1000)
    np.testing.assert_array_equal(np.diff(found.events.t), np.diff(EVENTS.t))
    assert found.frame_times[1] - found.events.t[0] == 10_000


def test_in_real_time_steps_are_short_and_feed_the_clock_map(bag):
    source = source_of(bag, playback_rate=1.0)
    began_s = time.monotonic()
    found = play(source)
    # Never early: playback lasts as long as the recording.
    assert time.monotonic() - began_s >= (LENGTH_US - 1000) / 1e6
    assert_equal(found.events, EVENTS)
    assert np.diff(found.times[:-1]).max() <= 1000
    assert source.status().clock.ready
    assert abs(source.status().clock.estimate().skew_ppm) < 1000


def test_parameters_change_while_it_plays(bag):
    source = source_of(bag, playback_rate=1.0, playback_paused=True)
    source.start()
    assert source.status().figures['playback'] == 'paused'
    got = []
    thread = threading.Thread(
        daemon=True, target=lambda: got.extend(itertools.islice(source.batches(), 200))
    )
    thread.start()
    # Nothing comes while it is paused.
    assert got == []
    source.apply(DriverParameters(playback_rate=0.0, playback_loop=True))
    thread.join(60)
    assert len(got) == 200
    assert source.status().figures['playback loops'] >= 1


@pytest.mark.parametrize('paused', [False, True])
def test_it_stops_at_once_in_the_middle_of_a_wait(tmp_path, paused):
    with Bag(tmp_path / 'bag') as bag:
        bag.image(np.zeros((4, 4), np.uint16), START_US)
        bag.image(np.zeros((4, 4), np.uint16), START_US + 3_600_000_000)
    source = source_of(tmp_path / 'bag', playback_rate=1.0, playback_paused=paused)
    source.start()
    got = []
    thread = threading.Thread(daemon=True, target=lambda: got.extend(source.batches()))
    thread.start()
    while not paused and source.status().origin is None:
        time.sleep(0.01)
    source.request_stop()
    thread.join(60)
    assert not thread.is_alive()
    source.close()


def test_a_recording_that_is_cut_off_is_played_with_a_warning(bag, tmp_path):
    shutil.copytree(bag, tmp_path / 'cut')
    (path,) = (tmp_path / 'cut').glob('*.mcap')
    path.write_bytes(path.read_bytes()[:-100])
    source = source_of(tmp_path / 'cut')
    assert path.name in source.status().trouble
    assert_equal(play(source).events, EVENTS)
