# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Streams for the tests of the decoder, and what the decoder makes of them beside the oracle."""

from __future__ import annotations

from itertools import chain

import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from mixtac_driver.davis346.model import Geometry
from mixtac_driver.decode.decoder import StreamDecoder

SETTINGS = settings(max_examples=150, suppress_health_check=list(HealthCheck))


def geometries():
    def build(dvs_inverted, aps_inverted, flip_x, flip_y):
        dvs = (260, 346) if dvs_inverted else (346, 260)
        aps = (260, 346) if aps_inverted else (346, 260)
        return Geometry(*dvs, dvs_inverted, *aps, aps_inverted, flip_x, flip_y)

    return st.builds(build, *[st.booleans()] * 4)


def stamps(low=1, high=0x7FFF):
    return st.integers(low, high).map(lambda t: [0x8000 | t])


def region_words(x0, y0, x1, y1):
    return [w for v in (x0, y0, x1, y1) for w in (0x5100 | v >> 8, 0x5200 | v & 0xFF)]


@st.composite
def frames(draw):
    """A small frame, usually sound, for any orientation, seldom with a word lost."""
    x0, y0 = draw(st.integers(0, 340)), draw(st.integers(0, 255))
    width, height = draw(st.integers(1, 5)), draw(st.integers(1, 4))
    inverted = draw(st.booleans())
    columns, rows = (height, width) if inverted else (width, height)
    sample = st.integers(0, 1023).map(lambda v: 0x4000 | v)

    def column(kind):
        return [kind, *draw(st.lists(sample, min_size=rows, max_size=rows)), 13]

    resets = [column(11) for _ in range(columns)]
    signals = [column(12) for _ in range(columns)]
    if draw(st.booleans()):
        body = [8, *chain(*resets), *draw(stamps()), 14, *draw(stamps()), 15, *chain(*signals)]
    else:
        pairs = zip(resets, signals, strict=True)
        body = [9, 14, *(w for pair in pairs for w in pair[0] + pair[1]), 15]
    exposure = [0x6000 | draw(st.integers(0, 1023)) for _ in range(3)]
    region = region_words(x0, y0, x0 + width - 1, y0 + height - 1)
    words = [body[0], *exposure, *region, *body[1:], 10]
    if draw(st.integers(0, 4)) == 0:
        del words[draw(st.integers(0, len(words) - 1))]
    return words


@st.composite
def imu_samples(draw):
    info = draw(st.integers(0, 255))
    length = 6 * bool(info & 0x80) + 2 * bool(info & 0x20) + 6 * bool(info & 0x40)
    length += draw(st.sampled_from([0, 0, 0, 0, -1, 1]))
    payload = draw(st.lists(st.integers(0, 255), min_size=max(length, 0), max_size=max(length, 0)))
    return [5, 0x5300 | info, *(0x5000 | b for b in payload), *draw(stamps()), 7]


def event_rows():
    columns = st.integers(0, 270).flatmap(lambda a: st.sampled_from([0x2000 | a, 0x3000 | a]))
    return st.builds(
        lambda row, xs: [0x1000 | row, *xs], st.integers(0, 350), st.lists(columns, max_size=9)
    )


def chunks():
    wraps = st.integers(0, 5).map(lambda n: [0x7000 | n])
    edges = st.sampled_from([[2], [3], [4], [16], [17]])
    resets = st.just([1])
    garbage = st.lists(st.integers(0, 0xFFFF), max_size=6)
    special = st.integers(0, 20).map(lambda w: [w])
    return st.one_of(
        event_rows(), event_rows(), stamps(), stamps(), wraps, edges, frames(), frames(),
        imu_samples(), resets, garbage, special,
    )  # fmt: skip


def streams():
    return st.lists(chunks(), max_size=40).map(lambda parts: [w for part in parts for w in part])


class Collected:
    """All that a decoder put out, as the oracle lists it."""

    def __init__(self, decoder):
        self.decoder = decoder
        self.events, self.frames, self.samples, self.edges, self.times = [], [], [], [], []

    def take(self, batches):
        for batch in batches:
            e, k = batch.events, batch.resets
            columns = (e.t.tolist(), e.x.tolist(), e.y.tolist(), e.polarity.tolist())
            self.events += [(k, *row) for row in zip(*columns, strict=True)]
            for f in batch.frames:
                times = (f.frame_start_us, f.exposure_start_us, f.exposure_end_us, f.frame_end_us)
                self.frames.append(
                    (k, times, (f.x, f.y), f.global_shutter, f.exposure_cycles, f.image.tolist())
                )
            m = batch.imu
            for i in range(len(m.t)):
                self.samples.append(
                    (k, m.t[i], m.acceleration[i], m.angular_velocity[i], m.temperature[i])
                )
            edges = zip(batch.edges.t.tolist(), batch.edges.kind.tolist(), strict=True)
            self.edges += [(k, *edge) for edge in edges]
            self.times.append((k, batch.time_us))
        return self


def decode(words, geometry=None, cuts=(), capacity=64, held_us=0):
    """Decode words that come in pieces, cut after some numbers of words."""
    data = np.asarray(words, '<u2').tobytes()
    collected = Collected(StreamDecoder(geometry or Geometry(), capacity=capacity))
    limits = sorted({min(2 * c, len(data)) for c in cuts})
    for start, end in zip([0, *limits], [*limits, len(data)], strict=True):
        until_us = collected.decoder.time_us + held_us
        collected.take(collected.decoder.push(data[start:end], until_us=until_us))
    if collected.decoder.waiting:
        collected.take(collected.decoder.push(b''))
    return collected


def assert_same(found, oracle):
    assert found.events == oracle.events
    assert found.frames == oracle.frames
    assert found.edges == oracle.edges
    assert [s[:2] for s in found.samples] == [s[:2] for s in oracle.samples]
    for mine, theirs in zip(found.samples, oracle.samples, strict=True):
        for a, b in zip(mine[2:], theirs[2:], strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-12)
    counters = found.decoder.counters
    assert counters.frames_dropped == oracle.dropped_frames
    assert counters.imu_dropped == oracle.dropped_imu
    assert found.times[-1][0] == oracle.resets
    assert counters.words_unexpected == oracle.unexpected
    assert found.decoder.time_us == oracle.t
