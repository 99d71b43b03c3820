# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The readout queue: pace, order, rows, blocks."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mixtac_sim.pixels.noise import Readout, pack

# Service time, latency and jitter [ns].
QUEUE = (80, 20_000, 15_000.0)


def keys(times, pixels):
    times, pixels = np.asarray(times, np.int64), np.asarray(pixels, np.int64)
    return pack(times, pixels, np.ones_like(pixels))


class Still(np.random.Generator):
    """Draws no jitter."""

    def __init__(self):
        super().__init__(np.random.PCG64(0))

    def normal(self, *args, **kwargs):
        return np.zeros(args[2])


def test_simultaneous_events_take_80_ns_each_row_by_row():
    pixels = np.random.default_rng(0).permutation(89_960)[:10_000]
    events = Readout(*QUEUE).read(keys(np.zeros(10_000), pixels), 0, 4_000_000, Still())
    assert len(events) == 10_000
    assert events.t[-1] - events.t[0] == 10_000 * 80 // 1000
    assert np.all(np.diff(events.t) >= 0)
    assert np.all(np.diff(events.y.astype(int)) >= 0)


def test_full_flash_never_exceeds_the_pace():
    readout, rng = Readout(*QUEUE), np.random.default_rng(1)
    everyone = keys(np.zeros(89_960), np.arange(89_960))
    parts = [readout.read(everyone, 0, 4_000_000, rng)]
    parts += [readout.read(keys([], []), k * 4_000_000, 4_000_000, rng) for k in (1, 2)]
    t = np.concatenate([part.t for part in parts])
    assert len(t) == 89_960
    assert np.bincount(t // 1000).max() <= 12_501
    assert t[-1] - t[0] >= 7_190


def test_lone_events_come_after_the_latency():
    rng = np.random.default_rng(2)
    times = np.arange(1_000) * 3_000
    events = Readout(*QUEUE).read(keys(times, np.arange(1_000)), 0, 4_000_000, rng)
    late = events.t - times[np.argsort(events.x + 346 * events.y.astype(int))] // 1000
    order = np.argsort(events.x.astype(int) + 346 * events.y.astype(int))
    late = events.t[order] - times // 1000
    assert late.min() >= 20
    assert 25 < late.mean() < 40


def test_pixel_that_waits_cannot_fire_again():
    readout = Readout(*QUEUE)
    crowd = keys(np.zeros(20_000), np.arange(20_000))
    again = keys([500_000], [19_999])
    events = readout.read(np.concatenate([crowd, again]), 0, 4_000_000, Still())
    assert len(events) == 20_000
    assert readout.lost == 1


@settings(max_examples=30)
@given(
    st.lists(st.tuples(st.integers(0, 7_999_999), st.integers(0, 89_959)), max_size=200),
    st.integers(0, 1_000),
)
def test_blocks_join_without_disorder(requests, seed):
    readout = Readout(*QUEUE)
    rng = np.random.default_rng(seed)
    parts = []
    for block in (0, 1, 2):
        mine = [(t - block * 4_000_000, p) for t, p in requests if t // 4_000_000 == block]
        packed = keys([t for t, _ in mine], [p for _, p in mine])
        parts.append(readout.read(packed, block * 4_000_000, 4_000_000, rng))
    t = np.concatenate([part.t for part in parts])
    assert len(t) + readout.lost == len(requests)
    assert np.all(np.diff(t) >= 0)
