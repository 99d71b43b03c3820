# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Events and time: dense streams, everything out of range, and times of many days."""

from __future__ import annotations

import numpy as np
import pytest
from davis_oracle import Oracle
from decoder_cases import SETTINGS, assert_same, decode, geometries
from hypothesis import given
from hypothesis import strategies as st

from mixtac_driver.davis346.model import Geometry
from mixtac_driver.decode.events import BLOCK

UNUSUAL = [0, 1, 3, 6, 18, 0x0FFF, 0x4123, 0x5012, 0x5412, 0x6400, 0x7000, 0x7003, 0x1FFF, 0x2FFF]


def both(words, geometry=None, *, capacity=1000, **how):
    geometry = geometry or Geometry()
    found = decode(words, geometry, capacity=capacity, **how)
    assert_same(found, Oracle(geometry).words(words))
    return found


def dense(rng, geometry, size, *, sound=False):
    """Rows, columns and stamps in any order; times go on where `sound`, else also back."""
    kinds = rng.choice([1, 2, 3, 8], size, p=[0.25, 0.35, 0.35, 0.05])
    stamps = 0x8000 | rng.integers(0, 0x8000, size)
    if sound:
        stamps = np.sort(stamps)
    rows = 0x1000 | rng.integers(0, geometry.dvs_rows, size)
    columns = kinds << 12 | rng.integers(0, geometry.dvs_columns, size)
    return np.select([kinds == 8, kinds == 1], [stamps, rows], columns)


@pytest.mark.parametrize('sound', [False, True])
@pytest.mark.parametrize('capacity', [1, 100, BLOCK - 1, BLOCK, BLOCK + 1, 4096])
def test_dense_streams(capacity, sound):
    rng = np.random.default_rng(capacity)
    for inverted in (False, True):
        size = (260, 346) if inverted else (346, 260)
        geometry = Geometry(*size, inverted)
        words = [0x1001, *dense(rng, geometry, 3000, sound=sound)]
        found = both(words, geometry, capacity=capacity, cuts=range(0, 3000, 751))
        assert len(found.events) > 1500
        assert (found.decoder.counters.words_unexpected > 0) != sound


@pytest.mark.parametrize('unusual', UNUSUAL)
def test_unusual_word_at_the_edges_of_blocks_in_a_dense_stream(unusual):
    rng = np.random.default_rng(unusual)
    for place in (1, BLOCK - 1, BLOCK, BLOCK + 1, 2 * BLOCK - 1, 2 * BLOCK, 2 * BLOCK + 1):
        words = [0x1003, *dense(rng, Geometry(), 3 * BLOCK + 10)]
        words.insert(place, unusual)
        both(words)


@SETTINGS
@given(st.integers(0, 0xFFFF), geometries())
def test_every_word_among_usual_ones(word, geometry):
    for before in (1, BLOCK):
        both(
            [0x8005, *[0x1003, 0x2004] * before, word, *[0x2005] * BLOCK, 0x8006, 0x3006], geometry
        )


def test_times_of_twenty_days_are_exact():
    day_us = 24 * 3600 * 10**6
    wraps = 20 * day_us // 32768
    words = [0x7FFF] * (wraps // 0xFFF) + [0x7000 | wraps % 0xFFF]
    assert wraps % 0xFFF
    found = both([*words, 0x9234, 0x1001, *[0x2001] * 100])
    assert {e[1] for e in found.events} == {wraps * 32768 + 0x1234}
    assert found.events[0][1] > 19 * day_us > 1 << 40
