# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Frames: every orientation, region and shutter, and what is missing from them."""

from __future__ import annotations

from itertools import chain

import numpy as np
import pytest
from davis_oracle import Oracle
from decoder_cases import assert_same, decode, region_words

from mixtac_driver.davis346.model import Geometry

SMALL = (7, 4)  # width and height of frames in tests that take many


def oriented(code, *, dvs_inverted=False):
    dvs = (260, 346) if dvs_inverted else (346, 260)
    aps = (260, 346) if code & 4 else (346, 260)
    return Geometry(*dvs, dvs_inverted, *aps, bool(code & 4), bool(code & 2), bool(code & 1))


def frame(rng, geometry, origin=(0, 0), size=SMALL, *, delay=None, between=list):
    """A sound frame; signals come `delay` columns after the resets, or after all of them."""
    (x, y), (width, height) = origin, size
    columns, rows = (height, width) if geometry.aps_inverted else (width, height)
    delay = columns if delay is None else delay

    def column(kind):
        words = [kind, *(0x4000 | rng.integers(0, 1024, rows)), 13]
        return list(chain.from_iterable([*between(), int(w)] for w in words))

    body = []
    for k in range(columns + delay):
        body += column(11) if k < columns else []
        body += [14] if k == delay else []
        body += column(12) if k >= delay else []
    region = region_words(x, y, x + width - 1, y + height - 1)
    start = 8 if delay == columns else 9
    return [start, *(0x6000 | rng.integers(0, 1024, 3)), *region, *body, 15, 10]


def both(words, geometry, **how):
    found, oracle = decode(words, geometry, **how), Oracle(geometry).words(words)
    assert_same(found, oracle)
    return found


@pytest.mark.parametrize(
    ('region', 'place', 'size'),
    [
        ((0, 0, 345, 0), (0, 0), (346, 1)),
        ((400, 3, 1, 3), (0, 3), (2, 1)),
        ((340, 3, 400, 3), (340, 3), (6, 1)),
        ((344, 3, 2, 3), (344, 3), (2, 1)),
        ((9, 300, 9, 259), (9, 0), (1, 260)),
    ],
)
def test_regions_that_leave_the_array_are_cut_to_it(region, place, size):
    width, height = size
    columns = [[kind, *[0x4200] * width, 13] for kind in [11] * height + [12] * height]
    found = decode([8, *region_words(*region), *chain(*columns), 10])
    assert len(found.frames) == 1
    assert found.frames[0][2] == place
    assert np.shape(found.frames[0][5]) == size[::-1]


@pytest.mark.parametrize('dvs_inverted', [False, True])
@pytest.mark.parametrize('code', range(8))
def test_regions_in_every_orientation_among_events(code, dvs_inverted):
    rng = np.random.default_rng(code)
    geometry = oriented(code, dvs_inverted=dvs_inverted)

    def events():
        if rng.random() < 0.97:
            return []
        return [0x8000 | int(rng.integers(0x8000)), 0x1000 | int(rng.integers(300)), 0x3007]

    words = []
    for delay in (None, 0, 3):
        origin = (int(rng.integers(0, 240)), int(rng.integers(0, 190)))
        words += frame(rng, geometry, origin, (100, 60), delay=delay, between=events)
    found = both(words, geometry, cuts=range(1, 100_000, 2049))
    assert len(found.frames) == 3
    assert [f[3] for f in found.frames] == [True, False, False]
    assert len(found.events) > 20


@pytest.mark.parametrize('delay', [None, 1])
def test_frame_that_lost_a_word_is_dropped_or_still_whole(delay):
    geometry = oriented(2)
    words = frame(np.random.default_rng(1), geometry, delay=delay)
    (whole,) = both(words, geometry).frames
    for k in range(len(words)):
        found = both(words[:k] + words[k + 1 :], geometry)
        if found.frames:
            assert found.frames[0][5] == whole[5]
            assert words[k] >> 12 == 6 or words[k] in {0x5100, 14, 15}
        else:
            assert found.decoder.counters.frames_dropped == (0 < k < len(words) - 1)


def test_frame_without_exposure_marks_lasts_from_start_to_end():
    words = frame(np.random.default_rng(1), oriented(0))
    words = [0x8003, *(w for w in words[:-1] if w not in {14, 15}), 0x8007, 10]
    found = both(words, oriented(0))
    assert found.frames[0][1] == (3, 3, 7, 7)
