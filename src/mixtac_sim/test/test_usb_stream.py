# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The virtual camera's data stream, read back by an independent decoder written from the table."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixtac_events.arrays import Events
from mixtac_sim.usb.device import VirtualDavis346
from mixtac_sim.usb.errors import UsbTimeout
from mixtac_sim.usb.imu_words import ImuReading
from mixtac_sim.usb.registers import Board

MUX, DVS, APS, IMU, USB = 0, 1, 2, 3, 9


@dataclass
class Decoded:
    """What a plain reading of the protocol table gives."""

    events: list = field(default_factory=list)
    specials: list = field(default_factory=list)
    columns: list = field(default_factory=list)
    regions: list = field(default_factory=list)
    exposures: list = field(default_factory=list)
    imu: list = field(default_factory=list)
    wraps: list = field(default_factory=list)
    stamps: list = field(default_factory=list)


def decode(words, *, inverted=True):
    """Decode word by word in plain Python."""
    out = Decoded()
    base = t = row = 0
    for word in (int(w) for w in words):
        kind, payload = word >> 12, word & 0xFFF
        if word & 0x8000:
            t = base + (word & 0x7FFF)
            out.stamps.append(t)
        elif kind == 0:
            out.specials.append((payload, t))
            if payload == 1:
                base = t = 0
            elif payload in {11, 12}:
                out.columns.append((payload, []))
            elif payload in {8, 9}:
                out.regions.append([])
                out.exposures.append([])
            elif payload == 5:
                out.imu.append([])
            elif payload == 7:
                out.imu[-1].append(t)
        elif kind == 1:
            row = payload
        elif kind in {2, 3}:
            x, y = (row, payload) if inverted else (payload, row)
            out.events.append((t, x, y, kind == 3))
        elif kind == 4:
            out.columns[-1][1].append(payload & 0x3FF)
        elif kind == 5:
            code, data = payload >> 8, payload & 0xFF
            {0: out.imu, 3: out.imu, 1: out.regions, 2: out.regions}[code][-1].append(data)
        elif kind == 6:
            out.exposures[-1].append(payload & 0x3FF)
        else:
            out.wraps.append(payload)
            base += payload * 0x8000
            t = base
    return out


@dataclass
class Frame:
    """A frame as the simulation hands it over."""

    frame_start_us: int
    exposure_start_us: int
    exposure_end_us: int
    frame_end_us: int
    reset: np.ndarray
    signal: np.ndarray


def write(device, *settings):
    data = b''.join(struct.pack('>BBI', *setting) for setting in settings)
    device.control(0x40, 0xC2, len(settings), 0, data)


def camera(**options):
    """Return a camera on a clock that stands at zero, running, with every source switched on."""
    now = options.pop('now', [0])
    device = VirtualDavis346('V0000001', clock=lambda: now[0], **options)
    write(device, (MUX, 3, 1), (USB, 0, 1), (MUX, 1, 1), (MUX, 0, 1), (USB, 1, 0))
    write(device, (DVS, 3, 1), (APS, 4, 1), (IMU, 2, 1), (IMU, 3, 1), (IMU, 4, 1))
    return device


def drain(device):
    data = b''
    while True:
        try:
            data += device.read_bulk(0x82, 1 << 20, 0.0)
        except UsbTimeout:
            return np.frombuffer(data, '<u2')


def events_of(rows):
    t, x, y, p = (list(c) for c in zip(*rows, strict=True)) if rows else ([], [], [], [])
    return Events(
        np.array(t, np.int64), np.array(x, np.uint16), np.array(y, np.uint16), np.array(p, bool)
    )


def tuples(events):
    columns = (events.t, events.x, events.y, events.polarity)
    return list(zip(*(c.tolist() for c in columns), strict=True))


def some_frame(start=1000, seed=0):
    rng = np.random.default_rng(seed)
    reset = rng.integers(500, 1024, (260, 346)).astype(np.uint16)
    signal = rng.integers(1, 500, (260, 346)).astype(np.uint16)
    return Frame(start, start + 5000, start + 9000, start + 14_000, reset, signal)


event_rows = st.lists(
    st.tuples(st.integers(0, 200_000), st.integers(0, 345), st.integers(0, 259), st.booleans()),
    max_size=60,
).map(sorted)


@settings(max_examples=60, deadline=None)
@given(event_rows, st.lists(st.integers(0, 200_000), max_size=6), st.booleans())
def test_events_come_back_exactly_however_time_is_cut(rows, cuts, inverted):
    device = camera(board=Board(dvs_inverted=inverted))
    device.submit(events_of(rows))
    for cut in [*sorted(cuts), 200_001]:
        device.advance(cut)
    decoded = decode(drain(device), inverted=inverted)
    assert decoded.events == rows
    assert decoded.wraps == [1] * (200_001 // 0x8000)
    # A stamp only when the time changed, never for a time that a wrap has just set.
    assert all(later > earlier for earlier, later in pairwise(decoded.stamps))
    assert not any(t % 0x8000 == 0 for t in decoded.stamps)


def test_idle_camera_sends_a_wrap_every_32768_us_and_nothing_else():
    device = camera()
    for t in range(0, 100_001, 1000):
        device.advance(t)
    assert drain(device).tolist() == [0x7001] * 3


def test_events_of_one_row_and_time_share_a_row_word():
    device = camera()
    device.submit(events_of([(5, 7, 1, True), (5, 7, 2, False), (5, 8, 3, True), (6, 8, 4, True)]))
    device.advance(10)
    words = [0x8005, 0x1007, 0x3001, 0x2002, 0x1008, 0x3003, 0x8006, 0x1008, 0x3004]
    assert drain(device).tolist() == words
    assert device.register(DVS, 82) == 3
    assert device.register(DVS, 84) == 4


@pytest.mark.parametrize('orientation', range(8))
def test_frame_columns_follow_the_orientation_registers(orientation):
    device = camera(board=Board(aps_orientation=orientation))
    frame = some_frame()
    device.submit(frames=[frame])
    for t in range(0, 20_001, 500):
        device.advance(t)
    decoded = decode(drain(device))
    samples = {11: [], 12: []}
    for kind, column in decoded.columns:
        samples[kind].append(column)
    for kind, picture in ((11, frame.reset), (12, frame.signal)):
        seen = np.zeros_like(picture)
        columns = np.array(samples[kind])
        for (cx, cy), value in np.ndenumerate(columns):
            x = columns.shape[0] - 1 - cx if orientation & 2 else cx
            y = columns.shape[1] - 1 - cy if orientation & 1 else cy
            x, y = (y, x) if orientation & 4 else (x, y)
            seen[y, x] = value
        np.testing.assert_array_equal(seen, picture)


def test_frame_words_times_and_region():
    device = camera()
    write(device, (APS, 8, 10), (APS, 9, 20), (APS, 10, 300), (APS, 11, 219), (APS, 12, 120_960))
    frame = some_frame()
    # Events must come between the words of the frame, each at its own time.
    rows = [(t, 3, 4, True) for t in range(0, 20_000, 7)]
    device.submit(events_of(rows), [frame])
    for t in range(0, 20_001, 250):
        device.advance(t)
    decoded = decode(drain(device))
    assert decoded.events == rows
    marks = {code: t for code, t in decoded.specials if code in {8, 14, 15, 10}}
    assert marks == {8: 1000, 14: 6000, 15: 10_000, 10: 15_000}
    assert decoded.regions == [[0, 10, 0, 20, 300 >> 8, 300 & 255, 0, 219]]
    low, middle, high = decoded.exposures[0]
    assert low | middle << 10 | high << 20 == 120_960
    resets = np.array([c for kind, c in decoded.columns if kind == 11])
    np.testing.assert_array_equal(resets, frame.reset[20:220, 10:301])
    order = [code for code, _ in decoded.specials if code in {11, 12, 14, 15}]
    assert order == [11] * 200 + [14, 15] + [12] * 200


def test_rolling_shutter_takes_reset_and_signal_columns_in_turns():
    device = camera()
    write(device, (APS, 7, 0))
    picture = some_frame()
    frame = Frame(1000, 1100, 3000, 8000, picture.reset, picture.signal)
    device.submit(frames=[frame])
    for t in range(0, 40_001, 250):
        device.advance(t)
    decoded = decode(drain(device))
    order = [code for code, _ in decoded.specials]
    assert order[0] == 9
    assert order[-1] == 10
    columns = [code for code in order if code in {11, 12, 13}]
    # A column ends before the next begins.
    assert columns[1::2] == [13] * 520
    starts = columns[::2]
    assert starts[200:210] == [11, 12] * 5 or starts[200:210] == [12, 11] * 5
    for kind, pixels in ((11, frame.reset), (12, frame.signal)):
        read = np.array([column for code, column in decoded.columns if code == kind])
        np.testing.assert_array_equal(read, pixels)


def test_imu_sample_bytes_and_info():
    device = camera()
    write(device, (IMU, 7, 1), (IMU, 10, 2))
    reading = ImuReading(123, (0.5, -1.0, 99.0), (100.0, -250.0, 0.0), 31.0)
    device.submit(readings=[reading])
    device.advance(200)
    ((info, *data, end),) = decode(drain(device)).imu
    assert info == 0b111_0_01_10
    assert end == 123
    values = struct.unpack('>7h', bytes(data))
    # 4 g and 1000 deg/s full scale; 99 g saturates; 333.87 per kelvin above 21.
    assert values == (4096, -8192, 32767, 3339, 3277, -8192, 0)
    write(device, (IMU, 2, 0), (IMU, 4, 0))
    device.submit(readings=[ImuReading(300, (0, 0, 1), (1, 2, 3), 30.0)])
    device.advance(400)
    ((info, *data, end),) = decode(drain(device)).imu
    assert (info, len(data)) == (0b010_0_01_10, 6)


def test_events_frames_and_inertial_samples_share_the_stream():
    device = camera()
    frame = some_frame()
    rows = [(t, 9, 8, False) for t in range(0, 20_000, 13)]
    readings = [ImuReading(t, (0, 0, 1), (1, 2, 3), 30.0) for t in range(0, 20_000, 500)]
    for t in range(0, 20_001, 1000):
        device.submit(
            events_of([row for row in rows if t <= row[0] < t + 1000]),
            [frame] if t == 0 else [],
            [reading for reading in readings if t <= reading.t_us < t + 1000],
        )
        device.advance(t)
    decoded = decode(drain(device))
    assert decoded.events == rows
    assert [sample[-1] for sample in decoded.imu] == [reading.t_us for reading in readings]
    assert {len(sample) for sample in decoded.imu} == {16}
    signals = np.array([column for kind, column in decoded.columns if kind == 12])
    np.testing.assert_array_equal(signals, frame.signal)


def test_event_filters():
    rows = [(t, x, y, t % 2 == 0) for t, (x, y) in enumerate([(5, 5), (6, 5), (7, 9), (345, 259)])]
    device = camera()

    def sent(t0, *settings):
        write(device, *settings)
        device.submit(events_of([(t + t0, x, y, p) for t, x, y, p in rows]))
        device.advance(t0 + 100)
        return [(t - t0, x, y, p) for t, x, y, p in decode(drain(device)).events]

    assert sent(100) == rows
    assert sent(300, (DVS, 41, 6), (DVS, 42, 5), (DVS, 43, 7), (DVS, 44, 9)) == rows[1:3]
    assert sent(500, (DVS, 13, 9), (DVS, 14, 7)) == rows[1:2]
    assert device.register(DVS, 88) == 1
    write(device, (DVS, 41, 0), (DVS, 42, 0), (DVS, 43, 345), (DVS, 44, 259), (DVS, 13, 260))
    assert sent(700, (DVS, 62, 1), (DVS, 63, 1)) == [r for r in rows if not r[3]]
    assert sent(900, (DVS, 62, 0), (DVS, 61, 1)) == [(t, x, y, False) for t, x, y, _ in rows]
    assert sent(1100, (DVS, 3, 0)) == []


def test_timestamp_reset_restarts_time_at_zero():
    now = [0]
    device = camera(now=now)
    device.submit(events_of([(10, 1, 2, True), (50_000, 3, 4, True), (50_500, 5, 6, False)]))
    device.advance(49_000)
    now[0] = 50_200
    write(device, (MUX, 2, 1), (MUX, 2, 0))
    device.advance(51_000)
    words = drain(device)
    at = words.tolist().index(1)
    assert decode(words[:at]).events == [(10, 1, 2, True)]
    # What came before the reset was not read out in time and is lost, as with real resets.
    assert decode(words[at:]).events == [(300, 5, 6, False)]
    assert device.clock_origin_us == 50_200


def test_camera_clock_runs_at_its_own_speed():
    device = camera(skew_ppm=100.0)
    device.submit(events_of([(1_000_000, 1, 2, True)]))
    device.advance(2_000_000)
    decoded = decode(drain(device))
    assert decoded.events == [(1_000_100, 1, 2, True)]
    assert len(decoded.wraps) == 2_000_200 // 0x8000


@pytest.mark.parametrize('bit', [(MUX, 0), (MUX, 1), (USB, 0)])
def test_no_data_unless_every_run_bit_is_set(bit):
    device = camera()
    write(device, (*bit, 0))
    device.submit(events_of([(10, 1, 2, True)]))
    device.advance(100_000)
    assert len(drain(device)) == 0
    write(device, (*bit, 1))
    device.submit(events_of([(150_000, 1, 2, True)]))
    device.advance(200_000)
    assert len(decode(drain(device)).events) == 1


def test_snapshot_gives_one_frame():
    device = camera()
    write(device, (APS, 4, 0))
    device.submit(frames=[some_frame(1000)])
    device.advance(30_000)
    before = [code for code, _ in decode(drain(device)).specials].count(10)
    write(device, (APS, 4, 1), (APS, 4, 0))
    device.submit(frames=[some_frame(41_000), some_frame(81_000)])
    device.advance(120_000)
    after = [code for code, _ in decode(drain(device)).specials].count(10)
    # The camera was on before the first frame was due, so that one is still owed.
    assert (before, after) == (1, 1)


@pytest.mark.parametrize(('at_mux', 'register'), [(1, (MUX, 84)), (0, (DVS, 86))])
def test_full_buffer_drops_events_and_counts_them(at_mux, register):
    device = camera(fifo_bytes=4096)
    write(device, (MUX, 5, at_mux))
    sent = 0
    for t in range(0, 200_000, 1000):
        device.submit(events_of([(t + 2 * k, k, 7, True) for k in range(20)]))
        device.advance(t + 1000)
        sent += 20
    decoded = decode(drain(device))
    assert 0 < len(decoded.events) < sent
    assert device.register(*register) == sent - len(decoded.events)
    assert device.losses['events_dropped'] == sent - len(decoded.events)
    # Time goes on all the while.
    assert sum(decoded.wraps) == 200_000 // 0x8000


def test_time_survives_a_buffer_that_cannot_even_hold_wraps():
    device = camera(fifo_bytes=64)
    device.submit(frames=[some_frame(1000)])
    for t in range(0, 4_000_001, 1000):
        device.advance(t)
    assert device.losses['frames_dropped'] == 1
    first = decode(drain(device))
    device.submit(events_of([(4_500_000, 9, 9, True)]))
    device.advance(4_600_000)
    second = decode(np.concatenate((drain(device),)))
    total = (sum(first.wraps) + sum(second.wraps)) * 0x8000
    assert total == 4_600_000 // 0x8000 * 0x8000
    # The wraps that were missed come as one word with a count.
    assert max(second.wraps) > 1
    t, *rest = second.events[0]
    assert (t + sum(first.wraps) * 0x8000, *rest) == (4_500_000, 9, 9, True)
