# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The stream decoder against an independent one, on proper streams and on garbage."""

from __future__ import annotations

from itertools import chain

import numpy as np
import pytest
from davis_oracle import Oracle
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mixtac_driver.decoder import StreamDecoder
from mixtac_driver.errors import DriverError
from mixtac_driver.identity import Geometry
from mixtac_driver.wrap_count import Gap, gap_of

SETTINGS = settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))


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


def decode(words, geometry=None, cuts=(), capacity=64):
    data = np.asarray(words, '<u2').tobytes()
    collected = Collected(StreamDecoder(geometry or Geometry(), capacity=capacity))
    limits = sorted({min(c, len(data)) for c in cuts})
    for start, end in zip([0, *limits], [*limits, len(data)], strict=True):
        collected.take(collected.decoder.push(data[start:end], short_packet=False))
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
    assert counters.resets == oracle.resets
    assert found.decoder.time_us == oracle.t


@SETTINGS
@given(streams(), geometries(), st.lists(st.integers(0, 4000), max_size=8), st.integers(1, 40))
def test_streams_in_any_pieces_decode_as_the_oracle_says(words, geometry, cuts, capacity):
    found = decode(words, geometry, cuts, capacity)
    assert_same(found, Oracle(geometry).words(words))


@SETTINGS
@given(st.binary(max_size=3000), geometries())
def test_garbage_decodes_as_the_oracle_says_and_stays_inside_the_array(data, geometry):
    words = np.frombuffer(data[: len(data) // 2 * 2], '<u2')
    found = decode(words, geometry)
    assert_same(found, Oracle(geometry).words(words))
    width, height = geometry.event_size
    assert all(x < width and y < height for _, _, x, y, _ in found.events)


@SETTINGS
@given(streams(), geometries())
def test_every_word_is_counted_once(words, geometry):
    found = decode(words, geometry)
    counters = found.decoder.counters
    assert counters.words == len(words)
    assert counters.events == len(found.events)
    assert counters.frames == len(found.frames)
    assert counters.imu == len(found.samples)
    assert counters.edges == len(found.edges)


@SETTINGS
@given(streams())
def test_time_never_goes_back_between_resets(words):
    found = decode(words, cuts=range(0, 8000, 100))
    for rows in (found.events, found.times):
        keys = [row[:2] for row in rows]
        assert keys == sorted(keys)


def test_wrap_count_above_one_is_multiplied():
    words = [0x800A, 0x1000, 0x2000, 0x7003, 0x8005, 0x2001]
    assert [e[1] for e in decode(words).events] == [10, 3 * 32768 + 5]


def test_time_runs_on_past_31_bits():
    found = decode([0x7FFF] * 20 + [0x8001, 0x1000, 0x2000])
    assert found.events[0][1] == 20 * 4095 * 32768 + 1


def test_reset_drops_the_frame_and_the_sample_in_progress():
    frame = [8, *region_words(0, 0, 0, 0), 11, 0x4200, 13, 1, 12, 0x4100, 13, 10]
    imu = [5, 0x5320, 0x5001, 1, 0x5002, 7]
    found = decode(frame + imu)
    assert not found.frames
    assert not found.samples
    counters = found.decoder.counters
    assert (counters.frames_dropped, counters.imu_dropped, counters.resets) == (1, 1, 2)


@pytest.mark.parametrize('code', range(8))
def test_full_frames_in_every_orientation(code):
    geometry = Geometry(
        *((260, 346) if code & 4 else (346, 260)),
        bool(code & 4),
        *((260, 346) if code & 4 else (346, 260)),
        bool(code & 4),
        bool(code & 2),
        bool(code & 1),
    )
    rng = np.random.default_rng(code)
    columns, rows = geometry.aps_columns, geometry.aps_rows
    reset = rng.integers(300, 1024, (columns, rows))
    signal = rng.integers(0, 1024, (columns, rows))
    words = [8, 0x6001, 0x6002, 0x6003, *region_words(0, 0, 345, 259)]
    for kind, samples in ((11, reset), (12, signal)):
        for column in samples:
            words += [kind, *(0x4000 | column), 13]
    words += [10]
    difference = np.clip(reset - signal, 0, 1023)
    difference[(reset < 384) | (signal == 0)] = 1023
    image = difference[:, ::-1] if code & 1 else difference
    image = image[::-1] if code & 2 else image
    image = image if code & 4 else image.T
    found = decode(words, geometry, cuts=range(0, 400_000, 8192))
    assert len(found.frames) == 1
    assert found.frames[0][4] == 1 | 2 << 10 | 3 << 20
    np.testing.assert_array_equal(np.array(found.frames[0][5]), image)


def test_bursts_beyond_the_capacity_come_in_several_batches():
    words = [0x1000, *([0x2000] * 100)]
    decoder = StreamDecoder(Geometry(), capacity=16)
    sizes = [len(b.events) for b in decoder.push(np.array(words, '<u2'))]
    assert sum(sizes) == 100
    assert max(sizes) <= 16


def test_floods_of_edges_and_samples_are_all_kept():
    imu = [5, 0x5320, 0x5001, 0x5002, 7]
    found = decode([3] * 1000 + imu * 600)
    assert len(found.edges) == 1000
    assert len(found.samples) == 600


def test_odd_byte_waits_for_its_half_after_a_full_transfer_and_goes_after_a_short_one():
    data = np.array([0x1005, 0x2007], '<u2').tobytes()
    decoder = StreamDecoder(Geometry())
    collected = Collected(decoder)
    collected.take(decoder.push(data[:3], short_packet=False))
    collected.take(decoder.push(data[3:], short_packet=False))
    assert collected.events == [(0, 0, 5, 7, False)]
    collected.take(decoder.push(data[:3], short_packet=True))
    collected.take(decoder.push(data[2:], short_packet=True))
    assert len(collected.events) == 2
    assert decoder.counters.bytes_dropped == 1


def test_next_transfer_is_refused_while_batches_wait():
    decoder = StreamDecoder(Geometry())
    batches = decoder.push(b'')
    next(batches)
    with pytest.raises(DriverError, match='all be taken'):
        next(decoder.push(b''))


@SETTINGS
@given(st.lists(st.integers(0, 0xFFFF), max_size=300), st.integers(0, 300), st.integers(0, 300))
def test_lost_bytes_keep_the_time_and_do_not_mix_what_they_part(words, a, b):
    first, last = sorted((a, b))
    lost = np.array(words[first:last], '<u2').tobytes()
    decoder = StreamDecoder(Geometry())
    collected = Collected(decoder)
    collected.take(decoder.push(np.array(words[:first], '<u2')))
    decoder.skip(gap_of(lost[: len(lost) // 4 * 2]) + gap_of(lost[len(lost) // 4 * 2 :]))
    collected.take(decoder.push(np.array([*words[last:], 0x7001], '<u2')))
    oracle = Oracle(Geometry()).words([*words, 0x7001])
    assert decoder.time_us == oracle.t
    assert collected.times[-1][0] == oracle.resets
    assert decoder.counters.bytes_lost == len(lost)


def test_gap_sums_wraps_since_the_last_reset():
    assert Gap(2, 5, 0) + Gap(4, 3, 0) == Gap(6, 8, 0)
    assert Gap(2, 5, 1) + Gap(4, 3, 1) == Gap(6, 3, 2)
    assert gap_of(np.array([0x7002, 1, 0x7003, 0x8001], '<u2').tobytes()) == Gap(8, 3, 1)


def long_stream(rng, geometry, chunk_count=1500):
    """Sound chunks in random order, then a few words lost, doubled or altered."""

    def region():
        x0, y0 = int(rng.integers(0, 340)), int(rng.integers(0, 255))
        x1, y1 = x0 + int(rng.integers(0, 5)), y0 + int(rng.integers(0, 4))
        return (x0, y0, x1, y1)

    def frame():
        x0, y0, x1, y1 = region()
        size = (x1 + 1 - x0, y1 + 1 - y0)
        columns, rows = size[::-1] if geometry.aps_inverted else size
        parts = [
            [kind, *(0x4000 | rng.integers(0, 1024, rows)), 13]
            for kind in [11] * columns + [12] * columns
        ]
        exposure = 0x6000 | rng.integers(0, 1024, 3)
        return [8, *exposure, *region_words(x0, y0, x1, y1), *chain(*parts), 14, 15, 10]

    def imu():
        info = int(rng.integers(32, 256))
        length = 6 * bool(info & 0x80) + 2 * bool(info & 0x20) + 6 * bool(info & 0x40)
        return [5, 0x5300 | info, *(0x5000 | rng.integers(0, 256, length)), 7]

    def row():
        columns = rng.integers(0, 262, rng.integers(0, 6))
        return [0x1000 | int(rng.integers(0, 348)), *(columns | rng.choice([0x2000, 0x3000]))]

    makers = (frame, imu, imu, row, row, row, lambda: [0x7001], lambda: [int(rng.integers(18))])
    words, tick = [], 0
    for k in rng.integers(0, len(makers), chunk_count):
        tick = 0 if makers[k] is makers[6] else min(tick + 1, 0x7FFF)
        words += [*([0x8000 | tick] if tick else []), *makers[k]()]
    words = np.array(words)
    words = np.delete(words, rng.integers(0, len(words), len(words) // 400))
    words = np.insert(words, rng.integers(0, len(words), len(words) // 400), words[5])
    altered = rng.integers(0, len(words), len(words) // 400)
    words[altered] ^= 1 << rng.integers(0, 16, len(altered))
    return words


@pytest.mark.parametrize('seed', range(6))
def test_long_damaged_streams_in_small_pieces(seed):
    rng = np.random.default_rng(seed)
    flags = [bool(b) for b in rng.integers(0, 2, 4)]
    sizes = [(260, 346) if flag else (346, 260) for flag in flags[:2]]
    geometry = Geometry(*sizes[0], flags[0], *sizes[1], *flags[1:])
    words = long_stream(rng, geometry)
    oracle = Oracle(geometry).words(words)
    assert len(oracle.frames) > 20
    assert len(oracle.samples) > 50
    assert oracle.dropped_imu > 5
    cuts = np.cumsum(rng.integers(1, 60, len(words) // 10)).tolist()
    assert_same(decode(words, geometry, cuts, capacity=int(rng.integers(1, 50))), oracle)


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
    assert found.decoder.counters.roi_outside == (
        region[0] > 340 or region[1] > 259 or 400 in region
    )


def test_events_after_lost_bytes_wait_for_a_row():
    decoder = StreamDecoder(Geometry())
    collected = Collected(decoder)
    collected.take(decoder.push(np.array([0x1003, 0x2004], '<u2')))
    decoder.skip(Gap(10))
    collected.take(decoder.push(np.array([0x2005, 0x1006, 0x2007], '<u2')))
    assert [e[2:4] for e in collected.events] == [(3, 4), (6, 7)]
    assert decoder.counters.events_without_row == 1
