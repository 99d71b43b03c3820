# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Steps of recorded time: nothing lost, nothing early, time never back."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recording_samples import START_US, assert_equal, some_events

from mixtac_driver.playback.player import Disorder, Timeline
from mixtac_events.arrays import Events
from mixtac_events.readings import Frame
from mixtac_recordings.recording import Piece, from_time


def piece(events, until_us=None):
    until_us = int(events.t[-1]) if until_us is None else until_us
    return Piece(int(events.t[0]), until_us, advances=True, events=events)


def frame_at(t_us):
    frame = Frame(np.zeros((2, 2), np.uint16), 0, 0, t_us, t_us, t_us, t_us, 0, True)
    return Piece(t_us, t_us, advances=False, frames=(frame,))


def run(pieces, start_us=START_US, step_us=1000):
    timeline = Timeline(start_us, step_us, Disorder())
    return timeline, [step for each in pieces for step in timeline.steps(each)]


def joined(steps):
    return Events.concatenate([step.decoded.events.shifted(step.offset_us) for step in steps])


@given(
    gaps=st.lists(st.integers(0, 20_000), min_size=1, max_size=60),
    cuts=st.sets(st.integers(1, 59), max_size=10),
    step_us=st.sampled_from([0, 1000, 3000]),
)
def test_every_event_leaves_once_in_steps_that_never_go_back(gaps, cuts, step_us):
    t = START_US + np.cumsum(gaps).astype(np.int64)
    count = len(t)
    events = Events(
        t,
        np.arange(count, dtype=np.uint16),
        np.zeros(count, np.uint16),
        np.zeros(count, np.bool_),
    )
    edges = sorted({0, count, *(cut for cut in cuts if cut < count)})
    parts = [events[a:b] for a, b in pairwise(edges)]
    timeline, steps = run([piece(part) for part in parts], step_us=step_us)
    assert_equal(joined(steps), events)
    position_us = START_US
    for step in steps:
        inside = step.decoded.events.t
        assert step.due_us == step.decoded.time_us >= position_us
        if len(inside):
            assert position_us <= inside[0]
            assert inside[-1] <= step.due_us
        if step_us:
            assert step.due_us - position_us <= step_us
        position_us = step.due_us
    assert (timeline.disorder.late_events, timeline.disorder.resets) == (0, 0)


def test_silence_passes_in_steps_too():
    events = some_events(count=2, length_us=10_001)
    _, steps = run([piece(events)])
    assert [s.due_us - START_US for s in steps[:2]] == [544, 1544]
    assert len(steps) == 11
    _, steps = run([piece(events)], step_us=0)
    assert len(steps) == 1


def test_what_comes_behind_its_time_is_dropped_and_counted():
    first, second = some_events(1, 100, 5000), some_events(2, 100, 5000)
    timeline, steps = run([piece(first), piece(second)])
    late = int(np.count_nonzero(second.t < first.t[-1]))
    assert timeline.disorder.late_events == late
    assert len(joined(steps)) == 200 - late
    assert (np.diff(joined(steps).t) >= 0).all()


def test_unsorted_events_are_sorted_and_counted():
    events = some_events(count=3, length_us=3000)
    mixed = Events(events.t[[0, 2, 1]], events.x[[0, 2, 1]], events.y[[0, 2, 1]], events.polarity)
    timeline, steps = run([Piece(START_US, int(events.t[-1]), advances=True, events=mixed)])
    np.testing.assert_array_equal(joined(steps).t, events.t)
    assert timeline.disorder.unsorted_events == 1


def test_time_goes_on_where_the_recorded_clock_was_reset():
    first, second = some_events(1, 100, 5000), some_events(2, 100, 5000, start_us=77)
    timeline, steps = run([piece(first), piece(second)])
    found = joined(steps)
    assert len(found) == 200
    assert found.t[100] - found.t[99] in range(1000, 2001)
    np.testing.assert_array_equal(np.diff(found.t[100:]), np.diff(second.t))
    assert (np.diff([step.due_us for step in steps]) >= 0).all()
    assert timeline.disorder.resets == 1
    assert timeline.offset_us % 1000 == 0
    assert {step.decoded.resets for step in steps} == {0, 1}


def test_frames_wait_for_their_time_but_do_not_advance_that_of_events():
    first, second = some_events(1, 10, 1000), some_events(2, 10, 5000, start_us=START_US + 1000)
    pieces = [piece(first), frame_at(START_US + 3000), piece(second)]
    timeline, steps = run(pieces)
    (frame_step,) = (step for step in steps if step.decoded.frames)
    assert frame_step.due_us == START_US + 3000
    assert frame_step.decoded.time_us == START_US + 999
    assert timeline.disorder.late_events == 0
    assert len(joined(steps)) == 20


def test_a_stamp_of_another_clock_does_not_hold_up_everything():
    events = some_events(1, 10, 1000)
    _, steps = run([piece(events), frame_at(START_US * 2)])
    assert steps[-1].due_us == START_US + 999


def test_from_time_cuts_within_a_piece_and_leaves_the_rest():
    events = some_events(count=1000, length_us=10_000)
    pieces = [piece(events[a : a + 100]) for a in range(0, 1000, 100)]
    from_us = int(events.t[457])
    found = list(from_time([frame_at(START_US + 1), *pieces, frame_at(START_US)], from_us))
    whole = Events.concatenate([each.events for each in found])
    assert_equal(whole, events[events.t >= from_us])
    # The frame before is left out; what was recorded after the place belongs to it.
    assert sum(len(each.frames) for each in found) == 1


def test_from_time_counts_everything_after_a_reset_as_later():
    first, second = some_events(1, 100, 5000), some_events(2, 100, 5000, start_us=77)
    found = list(from_time([piece(first), piece(second)], START_US + 10**9))
    assert [each.start_us for each in found] == [77]


@pytest.mark.parametrize('from_us', [0, START_US + 500])
def test_what_precedes_the_first_packet_after_a_reset_follows_it(from_us):
    early, late = 5_000_000, 5_001_500
    before, after = some_events(1, 10, 1000), some_events(2, 10, 1000, start_us=early)
    pieces = [piece(before), frame_at(early), piece(after), frame_at(late), frame_at(early - 1)]
    timeline, steps = run(list(from_time(pieces, from_us)))
    assert timeline.disorder.resets == 1
    frames = [
        (step.decoded.frames[0].middle_us, step.offset_us) for step in steps if step.decoded.frames
    ]
    assert [t_us for t_us, _ in frames] == [early, late, early - 1]
    assert {offset_us for _, offset_us in frames} == {timeline.offset_us}


def test_a_frame_after_the_last_packet_is_not_lost_where_its_clock_was_reset():
    found = list(from_time([piece(some_events(1, 10, 1000)), frame_at(77)], 0))
    assert len(found[-1].frames) == 1
