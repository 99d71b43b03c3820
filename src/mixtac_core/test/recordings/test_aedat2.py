# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""AEDAT 2.0 files, where events, pixels of frames, inertial samples and edges share one stream."""

from __future__ import annotations

import numpy as np
import pytest
from recording_samples import assert_equal, read, some_events

from mixtac_core.events.arrays import Events
from mixtac_core.recordings.importing import import_recording
from mixtac_core.recordings.recording import RecordingError
from mixtac_core.recordings.summary import summarise
from mixtac_core.recordings.tables import TableOptions

CHIPS = {'Davis346blue': (346, 260), 'DAVIS240C': (240, 180)}
IMU = 1 << 31 | 1 << 28 | 1000 << 12 | 3 << 10
EDGE = 9 << 22 | 9 << 12 | 1 << 10
COLUMN_US = 10
RNG = np.random.default_rng(2)


def event_words(events, width=346):
    x, y, on = (np.asarray(each, np.int64) for each in (events.x, events.y, events.polarity))
    return np.stack([y << 22 | (width - 1 - x) << 12 | on << 11, events.t], 1)


def frame_words(reads, start_us, first, lag):
    """Return the words of a frame, whose pixels are read column by column from a corner.

    Args:
        reads: Values before and after the exposure, [2, rows, columns].
        start_us: Time of the first column; each takes `COLUMN_US`.
        first: Column and row of the first pixel.
        lag: Columns that are read for the first time before the first one is read again.
    """
    _, height, width = reads.shape
    x, y = (np.abs(np.arange(n) - at) for n, at in zip((width, height), first, strict=True))
    found = []
    for turn, kind, number in sorted((n + k * lag, k, n) for n in range(width) for k in (0, 1)):
        address = 1 << 31 | y << 22 | int(x[number]) << 12 | kind << 10
        t = np.full(height, start_us + COLUMN_US * turn)
        found.append(np.stack([address | reads[kind, y, x[number]], t], 1))
    return np.concatenate(found)


def write(path, *parts, chip='Davis346blue'):
    """Write words of events, pixels and others in the order of their times."""
    lines = ['#!AER-DAT2.0', '# AEFile of Jürgen\t', f'# AEChip: eu.seebetter.{chip}']
    words = np.concatenate(parts)
    words = words[np.argsort(words[:, 1], kind='stable')]
    words[:, 1] &= 0xFFFFFFFF
    path.write_bytes(
        ''.join(f'{each}\r\n' for each in lines).encode() + words.astype('>u4').tobytes()
    )
    return path


@pytest.mark.parametrize(('chip', 'size'), CHIPS.items())
@pytest.mark.parametrize('start_us', [10_000, (1 << 32) - 20_000], ids=['early', 'rolls over'])
@pytest.mark.parametrize(
    ('corner', 'lag', 'cut'), [((1, 1), 400, 0.2), ((0, 0), 400, 0.8), ((1, 0), 30, 0.5)]
)
def test_frames_lie_between_the_events(tmp_path, chip, size, start_us, corner, lag, cut):
    events = some_events(size=size, start_us=start_us, count=12_000)
    reads = RNG.integers(0, 1024, (4, 2, *size[::-1]))
    length_us = COLUMN_US * (size[0] + lag)
    starts = start_us + np.array([-cut * length_us, 8000, 24_000, 50_000 - cut * length_us])
    starts = starts.astype(np.int64)
    first = corner[0] * (size[0] - 1), corner[1] * (size[1] - 1)
    words = [frame_words(each, t, first, lag) for each, t in zip(reads, starts, strict=True)]
    words[0] = words[0][words[0][:, 1] >= start_us]
    words[3] = words[3][words[3][:, 1] < start_us + 50_000]
    others = np.array([(word, t) for t in events.t[::100].tolist() for word in (IMU, EDGE)])
    path = write(tmp_path / 'x.aedat', event_words(events, size[0]), *words, others, chip=chip)
    found = read(path)
    assert_equal(found.events, events)
    assert (found.info.width, found.info.height) == size
    assert (found.counters.other_words, found.counters.frames_incomplete) == (len(others), 2)
    for frame, (reset, signal), part in zip(found.frames, reads[1:3], words[1:3], strict=True):
        np.testing.assert_array_equal(frame.image, np.maximum(reset - signal, 0))
        is_signal = part[:, 0] >> 10 & 1 == 1
        if lag > size[0]:
            assert frame.exposure_start_us == part[~is_signal, 1].max()
            assert frame.exposure_end_us == part[is_signal, 1].min()
        assert abs(frame.middle_us - part[:, 1].mean()) <= COLUMN_US
    counts = import_recording(path, tmp_path / 'bag')
    assert (counts.events, counts.frames, len(counts.warnings())) == (len(events), 2, 2)
    again = read(tmp_path / 'bag')
    assert_equal(again.events, events)
    assert again.frame_times == found.frame_times


def test_events_or_frames_are_left_out(tmp_path):
    words = frame_words(np.ones((2, 260, 346), np.int64), 2000, (0, 0), 400)
    path = write(tmp_path / 'x.aedat', event_words(some_events(start_us=5)), words)
    for wanted, expected in (('events', (0, 1)), ('image', (5000, 0))):
        found = read(path, **{wanted: 'none'})
        assert (len(found.events), len(found.frames)) == expected
    assert found.info.contents == (('events', 'events'),)
    assert len(read(write(tmp_path / 'y.aedat', words)).times) == 1
    with pytest.raises(RecordingError):
        read(write(tmp_path / 'z.aedat', words[:0]))


def test_events_outside_of_the_sensor_are_left_out_and_counted(tmp_path):
    events = some_events(start_us=5)
    small = (events.x >= 346 - 240) & (events.y < 180)
    path = write(tmp_path / 'x.aedat', event_words(events), chip='DAVIS240C')
    expected = Events(events.t, events.x - 106, events.y, events.polarity)[small]
    assert_equal(read(path).events, expected)
    assert summarise(path).events['events'].lost.events_outside == len(events) - len(expected)


def test_the_size_of_an_unknown_chip_is_given(tmp_path):
    events = some_events(start_us=5)
    path = write(tmp_path / 'x.aedat', event_words(events), chip='Other')
    with pytest.raises(RecordingError) as error:
        import_recording(path, tmp_path / 'bag')
    assert '--size' in error.value.remedy
    import_recording(path, tmp_path / 'bag', options=TableOptions(size=(346, 260)))
    assert_equal(read(tmp_path / 'bag').events, events)
