# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Exported files, read by our own reader, by NumPy and by dv-processing."""

from __future__ import annotations

import contextlib
import csv
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from recording_samples import START_US as BAG_US
from recording_samples import Bag, read, some_events

from mixtac_events.arrays import Events
from mixtac_events.readings import EdgeKind, Edges, Frame, InertialSamples
from mixtac_node.files import FileError
from mixtac_node.topics import REFERENCE_WRENCH
from mixtac_recordings.aedat4 import events_packet, frame_packet, samples_packet
from mixtac_recordings.aedat4_file import Aedat4File, Aedat4Writer
from mixtac_recordings.bag import blank_message
from mixtac_recordings.camera_stream import open_recording
from mixtac_recordings.export import FORMATS, PACKET_US, export_recording
from mixtac_recordings.recording import RecordingError, RecordingInfo
from mixtac_recordings.sinks import Aedat4Sink, CsvSink, GrowingNpz, NpzSink

START_US = 1_790_000_000_000_000
CLIENT = Path(__file__).with_name('aedat4_reader.py')
RNG = np.random.default_rng(5)
T = np.sort(RNG.integers(START_US, START_US + 90_000, 3000))
EVENTS = Events(
    T,
    RNG.integers(0, 346, 3000).astype(np.uint16),
    RNG.integers(0, 260, 3000).astype(np.uint16),
    RNG.integers(0, 2, 3000).astype(bool),
)
FRAMES = [
    Frame(
        image=RNG.integers(0, 1024, (260, 346)).astype(np.uint16),
        x=0,
        y=0,
        frame_start_us=t - 100,
        exposure_start_us=t,
        exposure_end_us=t + 7301,
        frame_end_us=t + 9000,
        exposure_cycles=7301,
        global_shutter=True,
    )
    for t in (START_US + 1000, START_US + 26_000, START_US + 51_000)
]
SAMPLES = InertialSamples(
    START_US + 1000 * np.arange(40),
    RNG.normal(0, 9, (40, 3)),
    RNG.normal(0, 2, (40, 3)),
    RNG.normal(40, 1, 40),
)
KINDS = [EdgeKind.EXTERNAL_RISING, EdgeKind.EXTERNAL_FALLING, EdgeKind.GENERATOR_RISING]
EDGES = Edges(START_US + np.array([5, 70, 900]), np.array(KINDS, np.uint8))


def fill(sink):
    for start in range(0, 3000, 250):
        sink.events(EVENTS[start : start + 250])
    for frame in FRAMES:
        sink.frame(frame)
    sink.samples(SAMPLES)
    sink.edges(EDGES)
    sink.close()


@pytest.fixture(scope='module')
def aedat4(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp('aedat4')
    info = RecordingInfo(folder, 'test', 'DAVIS <1>', 346, 260, 0, START_US, 90_000, ())
    fill(Aedat4Sink(folder, info))
    return folder / 'recording.aedat4'


def read_back(path: Path):
    recording = open_recording(path)
    try:
        pieces = list(recording.pieces(START_US - 1000))
        return recording.info, pieces
    finally:
        recording.close()


def joined(pieces, kind: str, name: str):
    return np.concatenate([getattr(getattr(piece, kind), name) for piece in pieces])


def test_our_own_reader_finds_what_was_written(aedat4: Path):
    info, pieces = read_back(aedat4)
    assert (info.camera, info.width, info.height) == ('DAVIS <1>', 346, 260)
    for name in ('t', 'x', 'y', 'polarity'):
        assert np.array_equal(joined(pieces, 'events', name), getattr(EVENTS, name))
    frames = [frame for piece in pieces for frame in piece.frames]
    assert [f.exposure_start_us for f in frames] == [f.exposure_start_us for f in FRAMES]
    assert all(np.array_equal(a.image, b.image) for a, b in zip(frames, FRAMES, strict=True))
    assert joined(pieces, 'edges', 'kind').tolist() == KINDS
    assert np.allclose(joined(pieces, 'imu', 'acceleration'), SAMPLES.acceleration, rtol=1e-6)


def test_dv_processing_finds_what_was_written(aedat4: Path, tmp_path: Path):
    python = os.environ.get('MIXTAC_CLIENT_PYTHON', sys.executable)
    found = subprocess.run([python, '-c', 'import dv_processing'], check=False, capture_output=True)
    if found.returncode:
        pytest.skip('no dv-processing: name an interpreter that has it in MIXTAC_CLIENT_PYTHON')
    out = tmp_path / 'found.npz'
    subprocess.run([python, str(CLIENT), str(aedat4), str(out)], check=True, timeout=120)
    read = np.load(out)
    for name in ('t', 'x', 'y', 'polarity'):
        assert np.array_equal(read[name], getattr(EVENTS, name))
    assert read['frame_t'].tolist() == [f.exposure_start_us for f in FRAMES]
    assert set(read['frame_exposure'].tolist()) == {7301}
    assert np.array_equal(read['frame_image'] >> 6, np.stack([f.image for f in FRAMES]))
    assert read['imu_t'].tolist() == SAMPLES.t.tolist()
    assert np.allclose(read['imu_acceleration'] * 9.80665, SAMPLES.acceleration, rtol=1e-5)
    assert np.allclose(np.deg2rad(read['imu_rotation']), SAMPLES.angular_velocity, rtol=1e-5)
    assert read['trigger'].tolist() == [
        [START_US + 5, 1],
        [START_US + 70, 2],
        [START_US + 900, 4],
    ]


def test_csv_has_units_and_every_row(tmp_path: Path):
    fill(CsvSink(tmp_path))
    with (tmp_path / 'events.csv').open() as file:
        heading, *rows = csv.reader(file)
    assert heading[0] == 't [us, camera clock]'
    assert [[int(value) for value in row] for row in rows] == np.column_stack(
        [EVENTS.t, EVENTS.x, EVENTS.y, EVENTS.polarity]
    ).tolist()
    assert len(list((tmp_path / 'frames').glob('*.png'))) == 3
    with (tmp_path / 'imu.csv').open() as file:
        heading, *rows = csv.reader(file)
    values = np.array(rows, float)
    assert np.allclose(values[:, 1:4], SAMPLES.acceleration, rtol=1e-8)


def test_npz_arrays_grow_to_what_was_written(tmp_path: Path):
    fill(NpzSink(tmp_path))
    events = np.load(tmp_path / 'events.npz')
    for name in ('t', 'x', 'y', 'polarity'):
        assert np.array_equal(events[name], getattr(EVENTS, name))
        assert events[name].dtype == getattr(EVENTS, name).dtype
    images = np.load(tmp_path / 'frames.npz')['image']
    assert np.array_equal(images, np.stack([frame.image for frame in FRAMES]))
    assert sorted(path.suffix for path in tmp_path.iterdir()) == ['.npz'] * 4 + ['.txt']


def test_rows_of_another_shape_are_refused(tmp_path: Path):
    growing = GrowingNpz(tmp_path / 'a.npz')
    growing.append('image', np.zeros((1, 2, 3)))
    with pytest.raises(RecordingError):
        growing.append('image', np.zeros((1, 2, 4)))
    growing.discard()
    assert not list(tmp_path.iterdir())


def test_buffers_are_aligned():
    # Readers of FlatBuffers may take numbers of 8 bytes in place.
    for data in (frame_packet(FRAMES[0]), samples_packet(SAMPLES)):
        assert len(data) % 4 == 0
        assert int.from_bytes(data[:4], 'little') == len(data) - 4


def test_an_aedat4_file_can_be_exported_again(aedat4: Path, tmp_path: Path):
    counts = export_recording(aedat4, 'npz', tmp_path / 'out')
    assert (counts.events, counts.frames, counts.samples, counts.edges) == (3000, 3, 40, 3)
    with pytest.raises(FileError):
        export_recording(aedat4, 'npz', tmp_path / 'out')
    with pytest.raises(RecordingError):
        export_recording(aedat4, 'mat', tmp_path / 'other')


@pytest.mark.parametrize('kind', FORMATS)
def test_an_interrupted_export_leaves_nothing(aedat4: Path, tmp_path: Path, kind: str):
    if kind == 'hdf5':
        pytest.importorskip('h5py', reason='pip install h5py')

    def interrupt(_done: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export_recording(aedat4, kind, tmp_path / 'out', interrupt)
    assert not list(tmp_path.iterdir())


def test_an_export_that_fails_leaves_nothing(aedat4: Path, tmp_path: Path):
    data = bytearray(aedat4.read_bytes())
    with contextlib.closing(Aedat4File(aedat4)) as file:
        middle = file.index()[6]
    at = int(middle['offset']) + int(middle['size']) // 2
    data[at : at + 8] = bytes(each ^ 255 for each in data[at : at + 8])
    damaged = tmp_path / 'damaged.aedat4'
    damaged.write_bytes(data)
    with pytest.raises(RecordingError):
        export_recording(damaged, 'npz', tmp_path / 'out')
    assert list(tmp_path.iterdir()) == [damaged]


def packet_spans(path: Path, stream: int) -> np.ndarray:
    """Return first and last time [us] of the packets of a stream, by its number."""
    with contextlib.closing(Aedat4File(path)) as file:
        packets = file.index()
    chosen = packets[packets['stream'] == stream]
    return np.stack([chosen['start_us'], chosen['end_us']], 1)


def test_packets_stay_short_where_the_clock_goes_back(tmp_path: Path):
    with Bag(tmp_path / 'bag') as bag:
        bag.events(some_events(start_us=100_000_000), stamp_us=200_000_000)
        bag.events(some_events(start_us=5_000_000, seed=2), stamp_us=200_100_000)
    export_recording(tmp_path / 'bag', 'aedat4', tmp_path / 'out')
    spans = packet_spans(tmp_path / 'out' / 'recording.aedat4', 0)
    assert len(spans) >= 10
    assert np.diff(spans).min() >= 0
    assert np.diff(spans).max() <= PACKET_US


def test_inertial_samples_share_packets(tmp_path: Path):
    with Bag(tmp_path / 'bag') as bag:
        bag.events(some_events())
        for number in range(50):
            bag.imu(BAG_US + 1000 * number, (0.5, number, 9.8), (0.1, 0.2, 0.3))
    counts = export_recording(tmp_path / 'bag', 'aedat4', tmp_path / 'out')
    assert counts.samples == 50
    spans = packet_spans(tmp_path / 'out' / 'recording.aedat4', 2)
    assert len(spans) <= 6
    found = read(tmp_path / 'out' / 'recording.aedat4').imu
    assert [sample[0] for sample in found] == [BAG_US + 1000 * n for n in range(50)]


def test_topics_of_like_names_have_files_of_their_own(tmp_path: Path):
    topics = {'/a/b': 1.0, '/a_b': 2.0, '/events': 3.0, '/ft/sensor_wrench': 4.0}
    topics |= {'/ft_sensor/wrench': 5.0}
    kind = REFERENCE_WRENCH.type_name
    with Bag(tmp_path / 'bag') as bag:
        bag.events(some_events())
        for topic, newtons in topics.items():
            message = blank_message(kind)
            message.wrench.force.z = newtons
            bag.write(topic, kind, BAG_US, message)
    export_recording(tmp_path / 'bag', 'npz', tmp_path / 'out')
    files = {path.stem: np.load(path) for path in (tmp_path / 'out').glob('*.npz')}
    assert len(files.pop('events')['x']) == len(some_events())
    assert sorted(each['force'][0, 2] for each in files.values()) == list(topics.values())
    assert files['ft_sensor_wrench']['force'][0, 2] == 5.0


def test_what_is_left_out_or_missing_is_counted(tmp_path: Path):
    events = some_events()
    path = tmp_path / 'small.aedat4'
    with contextlib.closing(Aedat4Writer(path, (100, 100), 'camera')) as writer:
        span = (int(events.t[0]), int(events.t[-1]))
        writer.write('EVTS', events_packet(events), len(events), *span)
    counts = export_recording(path, 'csv', tmp_path / 'csv')
    outside = np.count_nonzero((events.x >= 100) | (events.y >= 100))
    assert counts.lost.events_outside == outside
    assert len(counts.warnings()) == 1
    with Bag(tmp_path / 'bag') as bag:
        bag.packet(events[:10], int(events.t[10]))
        bag.sequence += 7
        bag.packet(events[10:20], int(events.t[20]))
    counts = export_recording(tmp_path / 'bag', 'csv', tmp_path / 'other')
    assert counts.lost.packets_missing == 7
    assert len(counts.warnings()) == 1
