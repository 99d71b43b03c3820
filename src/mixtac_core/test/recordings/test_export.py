# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Recordings exported and imported again hold what they held, in every format."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest
from recording_samples import START_US, Bag, assert_equal, read, some_events

from mixtac_core.events.readings import EdgeKind, Edges, Frame, InertialSamples
from mixtac_core.node.files import FileError
from mixtac_core.node.topics import REFERENCE, REFERENCE_FRAME, REFERENCE_WRENCH, WrenchWriter
from mixtac_core.recordings.bag import BagFile
from mixtac_core.recordings.bag_writer import McapBag
from mixtac_core.recordings.export import WRITERS, export_recording
from mixtac_core.recordings.importing import StreamWriter, import_recording
from mixtac_core.recordings.recording import RecordingError

RNG = np.random.default_rng(5)
EVENTS = some_events(count=3000, length_us=90_000)
PIXELS = RNG.integers(0, 1024, (3, 260, 346)).astype(np.uint16)
FRAMES = [
    Frame(image, 0, 0, t, t, t + 7301, t + 7301, 7301, True)
    for image, t in zip(PIXELS, range(START_US + 1000, START_US + 52_000, 25_000), strict=True)
]
SAMPLES = InertialSamples(
    START_US + 1000 * np.arange(40),
    RNG.normal(0, 9, (40, 3)),
    RNG.normal(0, 2, (40, 3)),
    RNG.normal(40, 1, 40),
)
SAMPLES.acceleration[0, 1] = -0.0
KINDS = [EdgeKind.EXTERNAL_RISING, EdgeKind.EXTERNAL_FALLING, EdgeKind.GENERATOR_RISING]
EDGES = Edges(START_US + np.array([5, 70, 900]), np.array(KINDS, np.uint8))
STAMPS_NS = 1000 * START_US + 5_000_000_000 + 1_250_000 * np.arange(60)
WRENCHES = RNG.normal(0, 1, (60, 6))


@pytest.fixture(scope='module')
def bag(tmp_path_factory) -> Path:
    """Return a bag with everything that a camera and a force sensor send."""
    path = tmp_path_factory.mktemp('bag') / 'bag'
    with McapBag(path) as made:
        writer = StreamWriter(made, (346, 260))
        writer.edges(EDGES, 0, 1000 * START_US)
        writer.samples(SAMPLES, 0, 1000 * START_US)
        for start in range(0, 3000, 250):
            part = EVENTS[start : start + 250]
            writer.events(part, int(part.t[-1]), 1000 * int(part.t[-1]))
        writer.events(EVENTS[:0], START_US + 100_000, 1000 * (START_US + 100_000))
        for frame in FRAMES:
            writer.frame(frame, 0, 1000 * frame.exposure_end_us)
        for stamp, row in zip(STAMPS_NS.tolist(), WRENCHES, strict=True):
            data = WrenchWriter(REFERENCE_FRAME).serialised(stamp, row.tolist())
            writer.put(REFERENCE_WRENCH, 1000 * START_US, data)
    return path


def needs(kind: str) -> None:
    """Skip where the optional package of a format is missing."""
    if kind in {'hdf5', 'aedat4'}:
        package = {'hdf5': 'h5py', 'aedat4': 'dv_processing'}[kind]
        pytest.importorskip(package, reason=f'pip install {package}')


def check(path: Path) -> None:
    found = read(path)
    assert_equal(found.events, EVENTS)
    for frame, sent in zip(found.frames, FRAMES, strict=True):
        assert np.array_equal(frame.image, sent.image)
        assert frame.exposure_start_us == sent.exposure_start_us
        assert frame.exposure_end_us == sent.exposure_end_us
    t, *columns = zip(*found.imu, strict=True)
    assert list(t) == SAMPLES.t.tolist()
    for column, name in zip(
        columns, ('acceleration', 'angular_velocity', 'temperature'), strict=True
    ):
        np.testing.assert_allclose(column, getattr(SAMPLES, name), rtol=1e-5)
    assert found.edges == list(zip(EDGES.t.tolist(), EDGES.kind.tolist(), strict=True))


@pytest.mark.parametrize('kind', WRITERS)
def test_every_column_survives_every_format(bag: Path, tmp_path: Path, kind: str):
    needs(kind)
    counts = export_recording(bag, kind, tmp_path / kind)
    assert (counts.events, counts.frames, counts.samples, counts.edges) == (3000, 3, 40, 3)
    import_recording(tmp_path / kind, tmp_path / 'bag')
    check(tmp_path / 'bag')
    with BagFile(tmp_path / 'bag') as found:
        if kind == 'aedat4':
            assert not found.counts.get(REFERENCE)
        else:
            stamps, forces = found.wrenches(REFERENCE)
            assert np.array_equal(stamps, STAMPS_NS)
            assert np.allclose(forces, WRENCHES, rtol=1e-15)


def test_csv_has_units_and_every_row(bag: Path, tmp_path: Path):
    export_recording(bag, 'csv', tmp_path / 'out')
    with (tmp_path / 'out' / 'events.csv').open() as file:
        heading, *rows = csv.reader(file)
    assert heading[:2] == ['t [us, camera clock]', 'x [px]']
    expected = np.column_stack([EVENTS.t, EVENTS.x, EVENTS.y, EVENTS.polarity])
    assert [[int(value) for value in row] for row in rows] == expected.tolist()
    assert (tmp_path / 'out' / 'imu.csv').read_text().splitlines()[1].split(',')[2] == '0'
    pictures = sorted((tmp_path / 'out' / 'frames').glob('*.png'))
    image = cv2.imread(str(pictures[0]), cv2.IMREAD_UNCHANGED)
    assert np.array_equal(image, FRAMES[0].image << 6)


def test_h5py_reads_the_layout_of_dsec(bag: Path, tmp_path: Path):
    h5py = pytest.importorskip('h5py', reason='pip install h5py')
    export_recording(bag, 'hdf5', tmp_path / 'out')
    with h5py.File(tmp_path / 'out' / 'recording.h5') as file:
        t = file['events/t'][()]
        assert t.dtype == np.uint32
        assert np.array_equal(t + file['t_offset'][()], EVENTS.t)
        assert np.array_equal(file['events/p'][()], EVENTS.polarity.astype(np.uint8))
        first = file['ms_to_idx'][()]
    for millisecond, index in enumerate(first):
        assert t[index] >= 1000 * millisecond
        assert index == 0 or t[index - 1] < 1000 * millisecond


@pytest.mark.parametrize('kind', WRITERS)
def test_frames_of_two_sizes_are_kept_or_refused(tmp_path: Path, kind: str):
    needs(kind)
    with Bag(tmp_path / 'bag') as made:
        made.info(START_US)
        for rows in (2, 3):
            made.image(np.zeros((rows, 4), np.uint16), START_US + 1000 * rows)
    if kind in {'hdf5', 'npz'}:
        with pytest.raises(RecordingError) as error:
            export_recording(tmp_path / 'bag', kind, tmp_path / 'out')
        assert '--to csv' in error.value.remedy
        assert not (tmp_path / 'out').exists()
    else:
        export_recording(tmp_path / 'bag', kind, tmp_path / 'out')
        assert [len(frame.image) for frame in read(tmp_path / 'out').frames] == [2, 3]


def test_an_existing_folder_and_an_unknown_format_are_refused(bag: Path, tmp_path: Path):
    with pytest.raises(FileError):
        export_recording(bag, 'npz', tmp_path)
    with pytest.raises(RecordingError):
        export_recording(bag, 'mat', tmp_path / 'other')


def test_packets_that_are_missing_are_reported(tmp_path: Path):
    with Bag(tmp_path / 'bag') as made:
        made.packet(EVENTS[:10], int(EVENTS.t[10]))
        made.sequence += 7
        made.packet(EVENTS[10:20], int(EVENTS.t[20]))
    counts = export_recording(tmp_path / 'bag', 'csv', tmp_path / 'out')
    assert counts.lost.packets_missing == 7
    assert len(counts.warnings()) == 1
