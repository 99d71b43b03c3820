# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bags that cannot be played: one clear line each, which names what is at fault."""

from __future__ import annotations

import numpy as np
import pytest
from recording_samples import START_US, Bag, read, scene, some_events
from rosbags.rosbag2 import StoragePlugin

from mixtac_events.codec import encode
from mixtac_events.packets import EncodedPacket
from mixtac_recordings.camera_stream import open_recording
from mixtac_recordings.recording import DamagedRecordingError, RecordingError


@pytest.mark.parametrize('encoding', ['evt2', 'jpeg'])
def test_an_unknown_encoding_of_events_is_named(tmp_path, encoding):
    with Bag(tmp_path / 'bag') as bag:
        encoded = EncodedPacket(encoding, START_US * 1000, np.zeros(8, np.uint8))
        bag.packet(None, START_US, encoding=encoding, encoded=encoded)
    with pytest.raises(RecordingError) as error:
        read(tmp_path / 'bag')
    assert '/mixtac/events' in str(error.value)
    assert str(tmp_path / 'bag') in str(error.value)


def test_colour_images_are_refused_by_name(tmp_path):
    with Bag(tmp_path / 'bag') as bag:
        bag.image(np.zeros((4, 12), np.uint8), START_US, encoding='bgr8')
    with pytest.raises(RecordingError):
        read(tmp_path / 'bag')


def test_a_damaged_packet_ends_the_playing_with_its_topic(tmp_path):
    events = some_events()
    good = encode(events.between(START_US, START_US + 1000), complete_until=START_US + 1000)
    bad = EncodedPacket('libcaer_cmp', good.time_base, np.full(7, 0xFF, np.uint8))
    with Bag(tmp_path / 'bag') as bag:
        bag.packet(None, START_US, encoded=good)
        bag.packet(None, START_US + 5, encoded=bad)
    with pytest.raises(RecordingError):
        read(tmp_path / 'bag')


def test_a_bag_without_anything_to_play_says_so(tmp_path):
    with Bag(tmp_path / 'bag') as bag:
        bag.info(START_US)
    with pytest.raises(RecordingError):
        read(tmp_path / 'bag')


@pytest.mark.parametrize('plugin', [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize('keep', [0.0, 0.3, 0.7, 0.99])
def test_a_bag_cut_off_is_read_as_far_as_it_goes_or_refused_in_one_line(tmp_path, plugin, keep):
    scene(tmp_path / 'bag', plugin=plugin)
    (file,) = (each for each in (tmp_path / 'bag').iterdir() if each.suffix != '.yaml')
    whole = file.read_bytes()
    file.write_bytes(whole[: int(len(whole) * keep)])
    try:
        recording = open_recording(tmp_path / 'bag')
        found = list(recording.pieces(START_US))
    except DamagedRecordingError as error:
        assert str(tmp_path / 'bag') in str(error)  # noqa: PT017  (either may happen)
        assert '\n' not in str(error)  # noqa: PT017
    else:
        assert keep > 0
        assert found
        assert recording.info.damage


def test_a_folder_that_is_no_bag_says_what_to_give(tmp_path):
    with pytest.raises(RecordingError):
        read(tmp_path)
    with pytest.raises(RecordingError):
        read(tmp_path / 'missing.mcap')
    (tmp_path / 'notes.txt').write_text('no recording')
    with pytest.raises(RecordingError):
        read(tmp_path / 'notes.txt')
