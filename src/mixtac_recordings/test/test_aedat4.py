# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""AEDAT4 files written by dv-processing, and what damage does to them."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from recording_samples import START_US, assert_equal, read, some_events

from mixtac_events.readings import EdgeKind
from mixtac_recordings import flatbuffer
from mixtac_recordings.aedat4_file import MAGIC, Aedat4File
from mixtac_recordings.camera_stream import open_recording
from mixtac_recordings.recording import RecordingError

COMPRESSIONS = ('NONE', 'LZ4', 'LZ4_HIGH', 'ZSTD', 'ZSTD_HIGH')
CLIENT = Path(__file__).parent / 'aedat4_client.py'
EVENTS = some_events(count=3000)
EDGES = {
    1: EdgeKind.EXTERNAL_RISING,
    2: EdgeKind.EXTERNAL_FALLING,
    3: EdgeKind.EXTERNAL_PULSE,
    4: EdgeKind.GENERATOR_RISING,
    5: EdgeKind.GENERATOR_FALLING,
}


def arrays():
    rng = np.random.default_rng(7)
    imu = np.zeros((150, 8))
    imu[:, 0] = START_US + 333 * np.arange(150)
    imu[:, 1:] = rng.normal(0, 10, (150, 7)).astype(np.float32)
    triggers = [(START_US + 1000 * n, n % 10) for n in range(40)]
    return {
        't': EVENTS.t,
        'x': EVENTS.x,
        'y': EVENTS.y,
        'p': EVENTS.polarity,
        'frame_t': START_US + 20_000 * np.arange(3),
        'frame_exposure': np.array([4000, 5001, 0]),
        'frame_image': rng.integers(0, 256, (3, 26, 34)).astype(np.uint8),
        'imu': imu,
        'triggers': np.array(triggers, np.int64),
    }


SENT = arrays()


@pytest.fixture(scope='module')
def files(tmp_path_factory):
    """One file per compression, by name."""
    python = os.environ.get('MIXTAC_CLIENT_PYTHON', sys.executable)
    found = subprocess.run([python, '-c', 'import dv_processing'], check=False, capture_output=True)
    if found.returncode:
        pytest.skip('no dv-processing: name an interpreter that has it in MIXTAC_CLIENT_PYTHON')
    folder = tmp_path_factory.mktemp('aedat4')
    np.savez(folder / 'sent.npz', **SENT)
    command = [python, str(CLIENT), str(folder / 'sent.npz'), *COMPRESSIONS]
    subprocess.run(command, check=True, timeout=120)
    return {path.stem: path for path in folder.glob('*.aedat4')}


def assert_is_what_was_sent(found):
    assert_equal(found.events, EVENTS)
    middles = SENT['frame_t'] + SENT['frame_exposure'] // 2
    assert found.frame_times == middles.tolist()
    for frame, image, t, exposure in zip(
        found.frames, SENT['frame_image'], SENT['frame_t'], SENT['frame_exposure'], strict=True
    ):
        np.testing.assert_array_equal(frame.image, image.astype(int) * 4)
        assert (frame.x, frame.y) == (3, 5)
        assert (frame.exposure_start_us, frame.exposure_end_us) == (t, t + exposure)
    assert [sample[0] for sample in found.imu] == SENT['imu'][:, 0].astype(int).tolist()
    temperature, acceleration, rotation = np.split(SENT['imu'][:, 1:], [1, 4], 1)
    np.testing.assert_allclose([each[1] for each in found.imu], acceleration * 9.80665)
    np.testing.assert_allclose([each[2] for each in found.imu], rotation * np.pi / 180)
    np.testing.assert_allclose([each[3] for each in found.imu], temperature[:, 0])
    known = [(t, EDGES[kind]) for t, kind in SENT['triggers'].tolist() if kind in EDGES]
    assert found.edges == known


@pytest.mark.parametrize('name', COMPRESSIONS)
def test_what_dv_processing_wrote_comes_out(files, name):
    found = read(files[name])
    assert found.info.camera == 'DAVIS346_V0000042'
    assert (found.info.width, found.info.height) == (346, 260)
    assert_is_what_was_sent(found)
    assert (np.diff(found.events.t) >= 0).all()
    assert (np.diff(found.times) >= 0).all()


def without_table(path, target, *, cut=0):
    """Copy a file as it is when its recorder was killed: no table of packets, nor where it is."""
    data = bytearray(path.read_bytes())
    file = Aedat4File(path)
    table_at = file._table_at
    header = np.frombuffer(data, np.uint8)[len(MAGIC) :]
    where = int(flatbuffer.fields(header, flatbuffer.root(header), 1)[0])
    struct.pack_into('<q', data, len(MAGIC) + where, -1)
    file.close()
    target.write_bytes(data[: table_at - cut])


@pytest.mark.parametrize('name', ['NONE', 'LZ4', 'ZSTD'])
def test_a_recording_without_its_table_plays_too(files, tmp_path, name):
    path = tmp_path / 'killed.aedat4'
    without_table(files[name], path)
    assert_is_what_was_sent(read(path))


@pytest.mark.parametrize('cut', [1, 300])
def test_a_recording_that_ends_within_a_packet_plays_up_to_it(files, tmp_path, cut):
    path = tmp_path / 'killed.aedat4'
    without_table(files['LZ4'], path, cut=cut)
    recording = open_recording(path)
    pieces = list(recording.pieces(START_US))
    assert recording.info.damage
    assert sum(len(piece.events) for piece in pieces) >= 2000


@pytest.mark.parametrize('keep', [0.0, 0.001, 0.01])
def test_a_file_without_a_whole_packet_gives_one_line_with_its_name(files, tmp_path, keep):
    whole = files['LZ4'].read_bytes()
    path = tmp_path / 'cut.aedat4'
    path.write_bytes(whole[: int(len(whole) * keep)])
    with pytest.raises(RecordingError) as error:
        read(path)
    assert str(path) in str(error.value)
    assert '\n' not in str(error.value)


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    name=st.sampled_from(['NONE', 'LZ4', 'ZSTD']),
    near_end=st.booleans(),
    at=st.integers(0, 5000),
    octets=st.binary(min_size=1, max_size=8),
)
def test_damage_anywhere_is_an_error_or_harmless(files, tmp_path, name, near_end, at, octets):
    data = bytearray(files[name].read_bytes())
    at = len(data) - len(octets) - at if near_end else at
    data[at : at + len(octets)] = octets
    path = tmp_path / 'damaged.aedat4'
    path.write_bytes(data)
    try:
        read(path)
    except RecordingError as error:
        assert str(path) in str(error)  # noqa: PT017 - it may as well be harmless


@settings(max_examples=20)
@given(offset_us=st.integers(0, 49_999))
def test_playing_from_an_offset_leaves_out_exactly_what_is_before(files, offset_us):
    found = read(files['LZ4'], START_US + offset_us)
    assert_equal(found.events, EVENTS[EVENTS.t >= START_US + offset_us])
    samples = SENT['imu'][:, 0].astype(int)
    expected = samples[samples >= START_US + offset_us].tolist()
    assert [sample[0] for sample in found.imu] == expected


def test_streams_can_be_left_out(files):
    found = read(files['LZ4'], events='none', imu='none')
    assert (len(found.events), len(found.frames), len(found.imu)) == (0, 3, 0)
    with pytest.raises(RecordingError):
        read(files['LZ4'], events='other')
    with pytest.raises(RecordingError):
        read(files['LZ4'], events='none', image='none', imu='none')


def test_another_file_of_that_name_is_refused(tmp_path):
    path = tmp_path / 'text.aedat4'
    path.write_text('not a recording')
    with pytest.raises(RecordingError):
        read(path)
