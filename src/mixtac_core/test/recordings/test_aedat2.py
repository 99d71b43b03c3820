# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Events of AEDAT 2.0 files, where frames, inertial samples and edges share their stream."""

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
APS = 1 << 31 | 5 << 22 | 7 << 12 | 1 << 10 | 300
IMU = 1 << 31 | 1 << 28 | 1000 << 12 | 3 << 10
EDGE = 9 << 22 | 9 << 12 | 1 << 10


def write(path, events, chip='Davis346blue', width=346, others=()):
    """Write events, and after each event the words of others."""
    lines = ['#!AER-DAT2.0', '# AEFile of Jürgen\t', f'# AEChip: eu.seebetter.{chip}']
    x, y, on = (np.asarray(each, np.int64) for each in (events.x, events.y, events.polarity))
    address = y << 22 | (width - 1 - x) << 12 | on << 11
    columns = [address, *(np.full(len(address), each) for each in others)]
    words = np.stack([np.stack([each, events.t & 0xFFFFFFFF], 1) for each in columns], 1)
    path.write_bytes(
        ''.join(f'{each}\r\n' for each in lines).encode() + words.astype('>u4').tobytes()
    )
    return path


@pytest.mark.parametrize(('chip', 'size'), CHIPS.items())
@pytest.mark.parametrize('start_us', [1000, (1 << 32) - 20_000], ids=['early', 'rolls over'])
def test_no_pixel_of_a_frame_becomes_an_event(tmp_path, chip, size, start_us):
    events = some_events(size=size, start_us=start_us, count=12_000)
    path = write(tmp_path / 'x.aedat', events, chip, size[0], (*[APS] * 8, IMU, EDGE))
    found = read(path)
    assert_equal(found.events, events)
    assert (found.info.width, found.info.height) == size
    assert (found.info.start_us, found.counters.other_words) == (start_us, 10 * len(events))
    assert found.counters.frames_not_read == 96_000 // (size[0] * size[1])
    counts = import_recording(path, tmp_path / 'bag')
    assert (counts.events, len(counts.warnings())) == (len(events), 2)
    assert_equal(read(tmp_path / 'bag').events, events)


def test_events_outside_of_the_sensor_are_left_out_and_counted(tmp_path):
    events = some_events(start_us=5)
    small = (events.x >= 346 - 240) & (events.y < 180)
    path = write(tmp_path / 'x.aedat', events, 'DAVIS240C')
    expected = Events(events.t, events.x - 106, events.y, events.polarity)[small]
    assert_equal(read(path).events, expected)
    assert summarise(path).events['events'].lost.events_outside == len(events) - len(expected)


def test_the_size_of_an_unknown_chip_is_given(tmp_path):
    events = some_events(start_us=5)
    path = write(tmp_path / 'x.aedat', events, 'Other')
    with pytest.raises(RecordingError) as error:
        import_recording(path, tmp_path / 'bag')
    assert '--size' in error.value.remedy
    import_recording(path, tmp_path / 'bag', options=TableOptions(size=(346, 260)))
    assert_equal(read(tmp_path / 'bag').events, events)


def test_a_file_without_events_is_refused(tmp_path):
    with pytest.raises(RecordingError):
        read(write(tmp_path / 'x.aedat', Events.empty()))
