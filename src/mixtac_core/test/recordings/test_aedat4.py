# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""AEDAT4 files written by dv-processing come out as they went in."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from recording_samples import START_US, assert_equal, read, some_events

from mixtac_core.events.readings import EdgeKind
from mixtac_core.recordings.aedat import write_aedat4
from mixtac_core.recordings.recording import DamagedRecordingError, RecordingError, RecordingInfo

dv = pytest.importorskip('dv_processing', reason='pip install dv-processing')
EVENTS = some_events(count=3000)
RNG = np.random.default_rng(7)
IMU = RNG.normal(0, 10, (150, 7)).astype(np.float32)
IMU_US = START_US + 333 * np.arange(150)
PICTURES = RNG.integers(0, 256, (3, 26, 34)).astype(np.uint8)
EDGES = {
    1: EdgeKind.EXTERNAL_RISING,
    2: EdgeKind.EXTERNAL_FALLING,
    3: EdgeKind.EXTERNAL_PULSE,
    4: EdgeKind.GENERATOR_RISING,
    5: EdgeKind.GENERATOR_FALLING,
}


def write_with_dv(path, compression='LZ4'):
    config = dv.io.MonoCameraWriter.Config(
        'DAVIS346_V0000042', getattr(dv.CompressionType, compression)
    )
    config.addEventStream((346, 260))
    config.addFrameStream((346, 260))
    config.addImuStream()
    config.addTriggerStream()
    writer = dv.io.MonoCameraWriter(str(path), config)
    writer.setPackagingCount(64)
    for start in range(0, len(EVENTS), 700):
        part, store = EVENTS[start : start + 700], dv.EventStore()
        for event in zip(
            *(c.tolist() for c in (part.t, part.x, part.y, part.polarity)), strict=True
        ):
            store.push_back(*event)
        writer.writeEvents(store)
    for number, picture in enumerate(PICTURES):
        t_us, source = START_US + 20_000 * number, dv.FrameSource.SENSOR
        writer.writeFrame(dv.Frame(t_us, 4000 + number, 3, 5, picture, source))
    for t_us, row in zip(IMU_US.tolist(), IMU.tolist(), strict=True):
        writer.writeImu(dv.IMU(t_us, *row, 0.0, 0.0, 0.0))
    for number in range(40):
        writer.writeTrigger(dv.Trigger(START_US + 1000 * number, dv.TriggerType(number % 10)))
    return path


@pytest.fixture(scope='module')
def file(tmp_path_factory):
    return write_with_dv(tmp_path_factory.mktemp('aedat4') / 'x.aedat4')


@pytest.mark.parametrize('compression', ['NONE', 'LZ4', 'ZSTD'])
def test_what_dv_processing_wrote_comes_out(tmp_path, compression):
    found = read(write_with_dv(tmp_path / 'x.aedat4', compression))
    assert found.info.camera == 'DAVIS346_V0000042'
    assert (found.info.width, found.info.height) == (346, 260)
    assert_equal(found.events, EVENTS)
    for number, (frame, picture) in enumerate(zip(found.frames, PICTURES, strict=True)):
        start_us = START_US + 20_000 * number
        assert (frame.exposure_start_us, frame.x, frame.y) == (start_us, 3, 5)
        assert frame.exposure_end_us == start_us + 4000 + number
        np.testing.assert_array_equal(frame.image, picture.astype(int) * 4)
    assert [sample[0] for sample in found.imu] == IMU_US.tolist()
    temperature, acceleration, rotation = np.split(IMU, [1, 4], 1)
    np.testing.assert_allclose([s[1] for s in found.imu], acceleration * 9.80665, rtol=1e-6)
    np.testing.assert_allclose([s[2] for s in found.imu], np.deg2rad(rotation), rtol=1e-6)
    np.testing.assert_array_equal([s[3] for s in found.imu], temperature[:, 0])
    kinds = [(START_US + 1000 * n, EDGES[n % 10]) for n in range(40) if n % 10 in EDGES]
    assert found.edges == kinds
    assert (np.diff(found.times) >= 0).all()


def test_events_that_go_back_cannot_be_written(tmp_path):
    info = RecordingInfo(tmp_path, 'test', 346, 260)
    events = {name: getattr(EVENTS, name)[::-1] for name in ('t', 'x', 'y', 'polarity')}
    with pytest.raises(RecordingError) as error:
        write_aedat4(tmp_path, info, iter([('events', events)]))
    assert '--to csv' in error.value.remedy


def test_streams_and_cameras_are_chosen(file):
    found = read(file, events='none', imu='none')
    assert (len(found.events), len(found.frames), len(found.imu)) == (0, 3, 0)
    assert len(read(file, events='DAVIS346_V0000042').events) == len(EVENTS)
    for names in ({'events': 'other'}, {'events': 'none', 'image': 'none', 'imu': 'none'}):
        with pytest.raises(RecordingError):
            read(file, **names)


@pytest.mark.parametrize('keep', [0.0, 0.01, 0.9])
def test_a_file_that_was_cut_off_gives_one_line_with_its_name(file, tmp_path, keep):
    whole = file.read_bytes()
    path = tmp_path / 'cut.aedat4'
    path.write_bytes(whole[: int(len(whole) * keep)])
    with pytest.raises(DamagedRecordingError) as error:
        read(path)
    assert str(path) in str(error.value)
    assert '\n' not in str(error.value)


def test_damage_ends_in_one_line_or_is_harmless(file, tmp_path, monkeypatch):
    # From this damage dv-processing never returns.
    monkeypatch.setattr('mixtac_core.recordings.aedat.PATIENCE_S', 2.0)
    data, rng = bytearray(file.read_bytes()), np.random.default_rng(0)
    at = int(rng.integers(3000, len(data) // 2))
    data[at : at + 7] = rng.bytes(7)
    path = tmp_path / 'x.aedat4'
    path.write_bytes(data)
    try:
        read(path)
    except RecordingError as error:
        assert str(path) in str(error)  # noqa: PT017  (it may be harmless)


def test_without_dv_processing_the_package_is_named(file, monkeypatch):
    monkeypatch.setitem(sys.modules, 'dv_processing', None)
    with pytest.raises(RecordingError) as error:
        read(file)
    assert 'pip install dv-processing' in error.value.remedy
