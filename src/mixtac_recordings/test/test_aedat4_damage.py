# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""AEDAT4 files that are damaged or incomplete, written by our own writer."""

from __future__ import annotations

import contextlib
import struct

import lz4.frame
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from recording_samples import assert_equal, read, some_events

from mixtac_events.arrays import Events
from mixtac_recordings import aedat4, aedat4_file, recording
from mixtac_recordings.aedat4_file import Aedat4Writer
from mixtac_recordings.recording import DamagedRecordingError, RecordingError

EVENTS = some_events(count=3000)
PACKET = 300


def write(path, *, counts=True) -> None:
    """Write EVENTS in ten packets."""
    with contextlib.closing(Aedat4Writer(path, (346, 260), 'camera')) as writer:
        for start in range(0, len(EVENTS), PACKET):
            part = EVENTS[start : start + PACKET]
            span = (int(part.t[0]), int(part.t[-1]))
            writer.write('EVTS', aedat4.events_packet(part), len(part) if counts else 0, *span)


def test_a_table_without_counts_is_replaced_by_a_scan(tmp_path):
    write(tmp_path / 'x.aedat4', counts=False)
    found = read(tmp_path / 'x.aedat4')
    assert_equal(found.events, EVENTS)
    assert found.info.damage == ''


@pytest.mark.parametrize('keep', [0.3, 0.6, 0.8])
def test_a_file_cut_inside_a_packet_is_read_up_to_it(tmp_path, keep):
    path = tmp_path / 'x.aedat4'
    write(path)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(len(whole) * keep)])
    found = read(path)
    count = len(found.events)
    assert count
    assert count % PACKET == 0
    assert count < len(EVENTS)
    assert_equal(found.events, EVENTS[:count])
    assert found.info.damage


def test_what_a_packet_expands_to_is_bounded(tmp_path, monkeypatch):
    path = tmp_path / 'x.aedat4'
    write(path)
    bomb = lz4.frame.compress(bytes(1 << 20))
    data = path.read_bytes()
    monkeypatch.setattr(recording, 'LARGEST_EXPANDED', 1 << 16)
    path.write_bytes(data + struct.pack('<ii', 0, len(bomb)) + bomb)
    assert len(read(path).events) == len(EVENTS)
    file = aedat4_file.Aedat4File(path)
    entry = np.zeros(1, aedat4_file.ENTRY)[0]
    entry['offset'], entry['size'] = len(data) + 8, len(bomb)
    with contextlib.closing(file), pytest.raises(DamagedRecordingError):
        file.packet(entry)


@pytest.mark.parametrize('counts', [True, False], ids=['by its table', 'scanned'])
def test_a_damaged_packet_is_left_out_and_named(tmp_path, counts):
    path = tmp_path / 'x.aedat4'
    write(path, counts=counts)
    with contextlib.closing(aedat4_file.Aedat4File(path)) as file:
        entry = file.index()[4]
    data = bytearray(path.read_bytes())
    at = int(entry['offset'])
    data[at : at + 4] = b'....'
    path.write_bytes(data)
    if counts:
        with pytest.raises(DamagedRecordingError):
            read(path)
    with contextlib.closing(aedat4.Aedat4Recording(path, whole=True)) as found:
        events = Events.concatenate([piece.events for piece in found.pieces(0)])
        assert str(at - 8) in found.info.damage
    assert_equal(events, Events.concatenate([EVENTS[: 4 * PACKET], EVENTS[5 * PACKET :]]))


@pytest.mark.parametrize('rest', [bytes(8), struct.pack('<ii', 0, 1) + b'.'], ids=['zeros', 'junk'])
def test_what_is_said_of_a_long_damaged_end_is_short(tmp_path, rest):
    path = tmp_path / 'x.aedat4'
    write(path, counts=False)
    with contextlib.closing(aedat4_file.Aedat4File(path)) as file:
        last = file.index()[-1]
    end = int(last['offset'] + last['size'])
    # The place of the table is unknown, as in a file whose writer was killed.
    data = path.read_bytes()[:end].replace(struct.pack('<q', end), struct.pack('<q', -1), 1)
    path.write_bytes(data + 1000 * rest)
    found = read(path)
    assert_equal(found.events, EVENTS)
    assert str(end) in found.info.damage
    assert len(found.info.damage) < 2000


@pytest.mark.parametrize(
    ('before', 'more'),
    [
        (b'<dv version', b'<?xml version="1.0" encoding="none"?>'),
        (b'<dv version', b'<?xml version="1.0" encoding="utf-7"?>'),
        (b'0"', b'9' * 5000),
    ],
    ids=['unknown encoding', 'encoding of several bytes', 'digits'],
)
def test_a_description_that_cannot_be_read_is_refused(tmp_path, before, more):
    path = tmp_path / 'x.aedat4'
    with contextlib.closing(Aedat4Writer(path, (346, 260), 'x' * 6000)):
        pass
    data = path.read_bytes()
    place = data.index(before, data.index(b'<node name="0') if before == b'0"' else 0)
    # In place of a part of the name of the camera.
    path.write_bytes(data[:place] + more + data[place:].replace(b'x' * len(more), b'', 1))
    with pytest.raises(DamagedRecordingError):
        aedat4_file.Aedat4File(path)


def test_a_camera_larger_than_events_can_say_has_no_size(tmp_path):
    path = tmp_path / 'x.aedat4'
    with contextlib.closing(Aedat4Writer(path, (10**12, 260), 'camera')) as writer:
        span = (int(EVENTS.t[0]), int(EVENTS.t[-1]))
        writer.write('EVTS', aedat4.events_packet(EVENTS), len(EVENTS), *span)
    with pytest.raises(RecordingError):
        read(path)


@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(near_end=st.booleans(), at=st.integers(0, 3000), octets=st.binary(min_size=1, max_size=8))
def test_damage_anywhere_is_an_error_or_harmless(tmp_path, near_end, at, octets):
    path = tmp_path / 'damaged.aedat4'
    path.unlink(missing_ok=True)
    write(path)
    data = bytearray(path.read_bytes())
    at = len(data) - len(octets) - at if near_end else at
    data[at : at + len(octets)] = octets
    path.write_bytes(data)
    try:
        found = read(path)
    except RecordingError as error:
        assert str(path) in str(error)  # noqa: PT017  (it may be harmless)
    else:
        assert len(found.events) <= len(EVENTS)
