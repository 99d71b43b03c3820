# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bags made of other files hold what these held."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from mixtac_events.arrays import Events
from mixtac_events.readings import Frame, InertialSamples
from mixtac_node.topics import REFERENCE
from mixtac_recordings.bag import BagFile, find_bags, fit_path
from mixtac_recordings.camera_stream import open_recording
from mixtac_recordings.dataset import folder_facts
from mixtac_recordings.export import Aedat4Sink, CsvSink, Hdf5Sink, NpzSink
from mixtac_recordings.importing import TableOptions, import_recording
from mixtac_recordings.recording import RecordingError, RecordingInfo

START_US = 1_790_000_000_000_000
RNG = np.random.default_rng(7)
COUNT = 4000
EVENTS = Events(
    np.sort(RNG.integers(START_US, START_US + 90_000, COUNT)),
    RNG.integers(0, 346, COUNT).astype(np.uint16),
    RNG.integers(0, 260, COUNT).astype(np.uint16),
    RNG.integers(0, 2, COUNT).astype(bool),
)
FRAMES = [
    Frame(
        image=RNG.integers(0, 1024, (260, 346)).astype(np.uint16),
        x=0,
        y=0,
        frame_start_us=t,
        exposure_start_us=t,
        exposure_end_us=t + 7301,
        frame_end_us=t + 7301,
        exposure_cycles=7301,
        global_shutter=True,
    )
    for t in (START_US + 1000, START_US + 40_000)
]
SAMPLES = InertialSamples(
    START_US + 1000 * np.arange(40),
    RNG.normal(0, 9, (40, 3)),
    RNG.normal(0, 2, (40, 3)),
    np.ones(40),
)
STAMPS_NS = 5_000_000_000 + 1_250_000 * np.arange(60)
WRENCHES = RNG.normal(0, 1, (60, 6))


def fill(sink, *, forces: bool = True):
    for start in range(0, COUNT, 500):
        sink.events(EVENTS[start : start + 500])
    for frame in FRAMES:
        sink.frame(frame)
    sink.samples(SAMPLES)
    if forces:
        sink.wrenches(REFERENCE, STAMPS_NS, WRENCHES)
    sink.close()


def read_back(path: Path):
    with contextlib.closing(open_recording(path)) as recording:
        pieces = list(recording.pieces(0))
        return Events.concatenate([p.events for p in pieces]), [f for p in pieces for f in p.frames]


def check(bag: Path, *, frames: int = 2):
    events, found = read_back(bag)
    for name in ('t', 'x', 'y', 'polarity'):
        assert np.array_equal(getattr(events, name), getattr(EVENTS, name))
    assert [f.exposure_start_us for f in found] == [f.exposure_start_us for f in FRAMES[:frames]]
    assert all(np.array_equal(a.image, b.image) for a, b in zip(found, FRAMES, strict=False))


def forces(bag: Path):
    with BagFile(bag) as file:
        stamps, found = file.wrenches(REFERENCE)
        return stamps, found[:, 2]


@pytest.mark.parametrize('make', [CsvSink, NpzSink, Hdf5Sink])
def test_what_was_exported_comes_back(tmp_path: Path, make):
    if make is Hdf5Sink:
        pytest.importorskip('h5py', reason='pip install -r requirements/hdf5.txt')
    tables = tmp_path / 'tables'
    tables.mkdir()
    fill(make(tables))
    source = tables / 'recording.h5' if make is Hdf5Sink else tables
    counts = import_recording(source, tmp_path / 'bag')
    assert (counts.events, counts.frames, counts.samples) == (COUNT, 2, 40)
    check(tmp_path / 'bag')
    stamps, force = forces(tmp_path / 'bag')
    assert np.array_equal(stamps, STAMPS_NS)
    assert np.allclose(force, WRENCHES[:, 2])


def test_h5py_reads_the_layout_of_dsec(tmp_path: Path):
    h5py = pytest.importorskip('h5py', reason='pip install -r requirements/hdf5.txt')
    fill(Hdf5Sink(tmp_path))
    with h5py.File(tmp_path / 'recording.h5') as file:
        t = file['events/t'][()]
        assert t.dtype == np.uint32
        assert np.array_equal(t + file['t_offset'][()], EVENTS.t)
        assert np.array_equal(file['events/p'][()], EVENTS.polarity.astype(np.uint8))
        first = file['ms_to_idx'][()]
    for millisecond, index in enumerate(first):
        assert t[index] >= 1000 * millisecond
        assert index == 0 or t[index - 1] < 1000 * millisecond


def test_a_lab_brings_an_aedat4_file_and_a_csv_of_forces(tmp_path: Path):
    info = RecordingInfo(tmp_path, 'test', 'DAVIS', 346, 260, 0, START_US, 90_000, ())
    fill(Aedat4Sink(tmp_path, info), forces=False)
    table = tmp_path / 'forces.csv'
    rows = zip(STAMPS_NS.tolist(), WRENCHES[:, 2].tolist(), strict=True)
    lines = '\n'.join(f'{1e-9 * ns:.9f};{newtons:.6f};"ok"' for ns, newtons in rows)
    table.write_text(f'Time (s);Fz [N];state\n{lines}\n')
    import_recording(tmp_path / 'recording.aedat4', tmp_path / 'bag', forces=table)
    check(tmp_path / 'bag')
    stamps, force = forces(tmp_path / 'bag')
    assert np.abs(stamps - STAMPS_NS).max() <= 1
    assert np.allclose(force, WRENCHES[:, 2], atol=1e-6)


@pytest.mark.parametrize(
    ('heading', 'unit', 'scale'),
    [('', 'us', 1), ('timestamp_ns,x,y,p\n', 'us', 1000), ('# ts,x,y,pol\n', 'ns', 1000)],
)
def test_events_of_other_tables(tmp_path: Path, heading: str, unit: str, scale: int):
    columns = (EVENTS.t * scale, EVENTS.x, EVENTS.y, np.where(EVENTS.polarity, 1, -1))
    rows = zip(*(column.tolist() for column in columns), strict=True)
    text = heading + ''.join(','.join(map(str, row)) + '\n' for row in rows)
    (tmp_path / 'events.csv').write_text(text)
    options = TableOptions(time_unit=unit)
    import_recording(tmp_path / 'events.csv', tmp_path / 'bag', options=options)
    check(tmp_path / 'bag', frames=0)


@pytest.mark.parametrize(
    'text',
    [
        't,x,y\n1,2,3\n',
        't,x,y,p\n1,2,3,0\n1.5,2,3,0\n3,2,3,0\n',
        't,x,y,p\n5,2,3,0\n4,2,3,0\n',
        't,x,y,p\n5,2,300,0\n',
        't,x,y,p\n5,2,a,0\n',
        't,x,y,p\n-5,2,3,0\n',
        't,x,y,p\n',
    ],
    ids=['column', 'fractions', 'backwards', 'outside', 'letters', 'negative', 'empty'],
)
def test_bad_tables_are_refused_and_leave_nothing(tmp_path: Path, text: str):
    (tmp_path / 'events.csv').write_text(text)
    with pytest.raises(RecordingError):
        import_recording(tmp_path / 'events.csv', tmp_path / 'bag')
    assert [each.name for each in tmp_path.iterdir()] == ['events.csv']


def imported_forces(folder: Path, table: Path, **options: str) -> tuple[np.ndarray, np.ndarray]:
    """Return stamps [ns] and normal forces of a table that is imported beside events."""
    info = RecordingInfo(folder, 'test', 'DAVIS', 346, 260, 0, START_US, 90_000, ())
    fill(Aedat4Sink(folder, info), forces=False)
    bag = folder / 'bag'
    given = TableOptions(**options)
    import_recording(folder / 'recording.aedat4', bag, forces=table, options=given)
    return forces(bag)


@pytest.mark.parametrize(
    'text',
    [
        ',t,fz\n0,0,1.5\n1,0.5,2.5\n',
        't,,fz\n0,7,1.5\n0.5,8,2.5\n',
        't,fx,fy,fz,f\n0,3,4,1.5,9\n0.5,3,4,2.5,9\n',
        'f;t (ms)\n1.5;0\n2.5;500\n',
        '\n\nt,"force_z [N]"\n0,1.5\n0.5,2.5\n',
    ],
    ids=['index', 'blank heading', 'norm beside', 'force alone', 'blank lines'],
)
def test_columns_are_found_by_their_headings(tmp_path: Path, text: str):
    (tmp_path / 'forces.csv').write_text(text)
    stamps, force = imported_forces(tmp_path, tmp_path / 'forces.csv')
    assert stamps.tolist() == [0, 500_000_000]
    assert force.tolist() == [1.5, 2.5]


def test_whole_numbers_at_both_ends_of_a_column_are_no_rule(tmp_path: Path):
    (tmp_path / 'forces.csv').write_text('t,fz\n0,0\n0.5,0.25\n1.0,0\n')
    assert imported_forces(tmp_path, tmp_path / 'forces.csv')[1].tolist() == [0.0, 0.25, 0.0]


def test_vectors_of_forces_in_seconds_stay_in_seconds(tmp_path: Path):
    t = np.array([0.0, 0.25, 0.5])
    np.savez(tmp_path / 'forces.npz', t=t, force=np.array([[0, 0, f] for f in (1.0, 2.0, 3.0)]))
    stamps, force = imported_forces(tmp_path, tmp_path / 'forces.npz', force_unit='s')
    assert stamps.tolist() == [0, 250_000_000, 500_000_000]
    assert force.tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    'text',
    [
        '',
        'Time (msec),fz\n0,1\n',
        't,fz [mN]\n0,1\n',
        't,fz,force_z\n0,1,2\n',
        't,fz\n1700000000000000000,1\n',
        't,fz\nnan,1\n',
    ],
    ids=['empty', 'unit of time', 'unit of force', 'twice', 'nanoseconds', 'no number'],
)
def test_tables_that_could_be_misread_are_refused(tmp_path: Path, text: str):
    (tmp_path / 'forces.csv').write_text(text)
    with pytest.raises(RecordingError):
        imported_forces(tmp_path, tmp_path / 'forces.csv')


def test_the_clock_fit_of_an_earlier_bag_is_not_taken_over(tmp_path: Path):
    fit_path(tmp_path / 'bag').write_text('{}')
    with pytest.raises(RecordingError) as caught:
        import_recording(tmp_path / 'any.csv', tmp_path / 'bag')
    assert str(fit_path(tmp_path / 'bag')) in str(caught.value)


def test_an_array_that_is_no_npz_is_refused(tmp_path: Path):
    path = tmp_path / 'events.npz'
    with path.open('wb') as file:
        np.save(file, np.zeros(3))
    with pytest.raises(RecordingError):
        import_recording(path, tmp_path / 'bag')


def test_a_bag_is_described_by_its_folders(tmp_path: Path):
    for name in ('static/one', 'static/test/two', 'train/dynamic/three'):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / 'metadata.yaml').touch()
    found = {bag.name: folder_facts(bag) for bag in find_bags(tmp_path)}
    assert found['two'] == {'profile': 'static', 'split': 'test'}
    assert found['three'] == {'profile': 'dynamic', 'split': 'train'}
    assert found['one']['profile'] == 'static'
