# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A pattern, read word by word: what it says it sends is what comes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from usb_oracle import decode

from mixtac_lab.bench.pattern import MARKER, MARKER_US, PatternPlayer, make_pattern


@pytest.fixture(scope='module')
def pattern():
    return make_pattern(
        200_000, events_per_row=2.0, frame_interval_us=30_000, reading_interval_us=5000
    )


@pytest.fixture(scope='module')
def events_only():
    return make_pattern(50_000, events_per_row=2.0)


def rows(events):
    return list(
        zip(
            events.t.tolist(),
            events.x.tolist(),
            events.y.tolist(),
            events.polarity.tolist(),
            strict=True,
        )
    )


@settings(max_examples=20)
@given(st.lists(st.integers(0, 90_000), min_size=1, max_size=5))
def test_however_often_it_is_asked_every_event_comes_once_with_its_time(events_only, pauses):
    pattern = events_only
    player, now, words = PatternPlayer(pattern), 0, []
    for pause in [*pauses, 2 * pattern.period_us]:
        now += pause
        words.append(player.due(now))
    got = decode(np.concatenate(words)).events
    whole = [
        (t + k * pattern.period_us, x, y, p)
        for k in range(now // pattern.period_us + 1)
        for t, x, y, p in rows(pattern.events)
    ]
    assert [tuple(event) for event in got] == whole[: len(got)]
    assert whole[len(got)][0] >= now - 64


def test_it_holds_the_frames_and_samples_it_says(pattern):
    found = decode(pattern.words)
    assert len(found.regions) == pattern.frames == 2
    assert sum(code == 5 for code, _ in found.specials) == pattern.readings == 14


def test_only_the_marker_is_at_its_pixel(pattern):
    at_marker = (pattern.events.x == MARKER[0]) & (pattern.events.y == MARKER[1])
    assert pattern.events.t[at_marker].tolist() == [MARKER_US]


def test_time_that_goes_back_starts_it_anew(pattern):
    player = PatternPlayer(pattern)
    player.due(50_000)
    got = decode(player.due(10_000)).events
    assert got[0][0] == MARKER_US


def test_words_without_room_leave_their_time(pattern):
    player = PatternPlayer(pattern)
    words = player.due(3 * pattern.period_us)
    instead = player.refused(words)
    assert instead.tolist() == [0x7000 | 3 * pattern.period_us // 32768]
    assert player.periods_lost == 1
