# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bags made of other files hold what these held."""

from __future__ import annotations

import contextlib
import csv
import struct
import zipfile
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from recording_samples import write_aedat4

from mixtac_events.arrays import Events
from mixtac_events.readings import Frame, InertialSamples
from mixtac_node.files import FileError
from mixtac_node.topics import REFERENCE
from mixtac_recordings.aedat4 import events_packet, frame_packet
from mixtac_recordings.bag import BagFile, find_bags, fit_path
from mixtac_recordings.camera_stream import open_recording
from mixtac_recordings.dataset import folder_facts
from mixtac_recordings.export import export_recording
from mixtac_recordings.importing import TableOptions, import_recording
from mixtac_recordings.recording import (
    DamagedRecordingError,
    RecordingError,
    RecordingInfo,
    Selection,
)
from mixtac_recordings.sinks import Aedat4Sink, CsvSink, Hdf5Sink, NpzSink
from mixtac_recordings.summary import summarise

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
        pytest.importorskip('h5py', reason='pip install h5py')
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
    h5py = pytest.importorskip('h5py', reason='pip install h5py')
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
        't,x,y,p\n0.5,2,3,0\n1.5,2,3,0\n',
        't,x,y,p\n5,nan,3,0\n',
        't,x,y,p\n5,2,3,inf\n',
        't,x,y,p\n5,7.9,3,0\n',
        't,x,y,p\n5,2,3,0\nnan,2,3,0\n',
        '1,2,3\n',
    ],
    ids=[
        *('column', 'fractions', 'backwards', 'outside', 'letters', 'negative', 'empty'),
        *('seconds', 'no coordinate', 'no polarity', 'between pixels', 'no time', 'three columns'),
    ],
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
        'Time (s);Fz [N];state\n0;1,5;1\n0,5;2,5;1\n',
        '0;1,5\n0,5;2,5\n',
        'Time (s);Fz (N, calibrated)\n0;1.5\n0.5;2.5\n',
        '# t fz\n0.0 1.5\n0.5   2.5\n\n',
        '0,7,8,1.5,1,2,3\n0.5,7,8,2.5,1,2,3\n',
        '\ufefft,fz\n0,1.5\n0.5,2.5\n',
    ],
    ids=[
        *('index', 'blank heading', 'norm beside', 'force alone', 'blank lines'),
        *('decimal commas', 'without headings', 'comma in a unit', 'spaces', 'vectors', 'UTF-16'),
    ],
)
def test_columns_are_found_by_their_headings(tmp_path: Path, text: str):
    encoding = 'utf-16-le' if text[0] == '\ufeff' else 'utf8'
    (tmp_path / 'forces.csv').write_text(text, encoding=encoding)
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
        't,fz\n',
        't,fz\n\n\n',
        '0.1,1.5,2,3,4,5\n',
        'Zeit,Kraft\n0,1\n',
    ],
    ids=[
        *('empty', 'unit of time', 'unit of force', 'twice', 'nanoseconds', 'no number'),
        *('no rows', 'blank rows', 'six columns', 'other headings'),
    ],
)
def test_tables_that_could_be_misread_are_refused(tmp_path: Path, text: str):
    (tmp_path / 'forces.csv').write_text(text)
    with pytest.raises(RecordingError):
        imported_forces(tmp_path, tmp_path / 'forces.csv')
    assert not (tmp_path / 'bag').exists()


def test_a_unit_of_force_is_not_to_be_left_out(tmp_path: Path):
    (tmp_path / 'forces.csv').write_text('t,fz [mN]\n0,1\n')
    with pytest.raises(RecordingError) as caught:
        imported_forces(tmp_path, tmp_path / 'forces.csv')
    assert 'leave' not in caught.value.remedy


def test_forces_of_another_time_are_not_of_the_clock_of_the_camera(tmp_path: Path):
    (tmp_path / 'events.csv').write_text('t,x,y,p\n' + ''.join(f'{k},1,1,1\n' for k in range(9)))
    for start, count in ((0, 2), (1_700_000_000, 0)):
        (tmp_path / 'forces.csv').write_text(f't,fz\n{start},0\n{start + 1},1\n')
        with pytest.raises(RecordingError) if not count else contextlib.nullcontext():
            import_recording(
                tmp_path / 'events.csv',
                tmp_path / f'bag_{start}',
                forces=tmp_path / 'forces.csv',
                same_clock=True,
            )
        assert len(find_bags(tmp_path)) == 1


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


@pytest.mark.parametrize('shape', [(3,), (1 << 70,)], ids=['encrypted', 'of no size'])
def test_an_npz_that_cannot_be_unpacked_is_refused(tmp_path: Path, shape: tuple[int, ...]):
    path = tmp_path / 'events.npz'
    with zipfile.ZipFile(path, 'w') as archive, archive.open('t.npy', 'w') as file:
        header = {'descr': '<i8', 'fortran_order': False, 'shape': shape}
        np.lib.format.write_array_header_1_0(file, header)
    if shape == (3,):
        data = bytearray(path.read_bytes())
        data[6] = data[data.index(b'PK\x01\x02') + 8] = 1
        path.write_bytes(data)
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


def test_forces_that_are_not_there_are_named(tmp_path: Path):
    texts = []
    for make in (lambda: None, (tmp_path / 'forces').touch):
        make()
        with pytest.raises(RecordingError) as caught:
            imported_forces(tmp_path, tmp_path / 'forces')
        (tmp_path / 'recording.aedat4').unlink()
        texts.append(str(caught.value))
    assert texts[0] != texts[1]


def test_a_unit_that_is_named_counts_for_vectors_of_forces(tmp_path: Path):
    force = np.array([[0, 0, f] for f in (1.0, 2.0)])
    np.savez(tmp_path / 'forces.npz', t=np.array([0, 500]), force=force)
    stamps, _ = imported_forces(tmp_path, tmp_path / 'forces.npz', force_unit='ms')
    assert stamps.tolist() == [0, 500_000_000]


def events_npz(folder: Path, **changed: np.ndarray) -> Path:
    """Write EVENTS as a table; `changed` replaces columns."""
    columns = {'t': EVENTS.t, 'x': EVENTS.x, 'y': EVENTS.y, 'p': EVENTS.polarity} | changed
    np.savez(folder / 'events.npz', **columns)
    return folder / 'events.npz'


def test_fractions_of_seconds_need_their_unit(tmp_path: Path):
    path = events_npz(tmp_path, t=(EVENTS.t - START_US) / 1e6)
    with pytest.raises(RecordingError) as caught:
        import_recording(path, tmp_path / 'bag')
    assert '--time-unit s' in caught.value.remedy
    import_recording(path, tmp_path / 'bag', options=TableOptions(time_unit='s'))
    assert np.array_equal(read_back(tmp_path / 'bag')[0].t, EVENTS.t - START_US)


@pytest.mark.parametrize('offset', [np.int64(3_000_000), np.uint64(3_000_000), np.float64(3e6)])
def test_event_times_of_hdf5_may_be_fractions(tmp_path: Path, offset: np.generic):
    h5py = pytest.importorskip('h5py', reason='pip install h5py')
    with h5py.File(tmp_path / 'x.h5', 'x') as file:
        for name in ('x', 'y', 'polarity'):
            file[f'events/{name}'] = getattr(EVENTS, name)
        file['events/t'] = (EVENTS.t - START_US) / 1e3
        file['t_offset'] = offset
    import_recording(tmp_path / 'x.h5', tmp_path / 'bag', options=TableOptions(time_unit='ms'))
    expected = EVENTS.t - START_US + 1000 * int(offset)
    assert np.array_equal(read_back(tmp_path / 'bag')[0].t, expected)


def frames_npz(folder: Path, image: np.ndarray) -> Path:
    """Write events and frames as a folder of tables."""
    events_npz(folder)
    t = START_US + 40_000 * np.arange(len(image))
    np.savez(folder / 'frames.npz', exposure_start=t, exposure_end=t + 5000, image=image)
    return folder


GREY = RNG.integers(0, 256, (23, 260, 346))


@pytest.mark.parametrize(('dtype', 'scale'), [(np.uint8, 4), (np.uint16, 1), (np.int64, 1)])
@pytest.mark.parametrize('order', ['C', 'F'])
def test_frames_of_several_types_have_ten_bits(tmp_path: Path, dtype, scale: int, order: str):
    tables = tmp_path / 'tables'
    tables.mkdir()
    import_recording(frames_npz(tables, GREY.astype(dtype, order=order)), tmp_path / 'bag')
    _, found = read_back(tmp_path / 'bag')
    assert np.array_equal([frame.image for frame in found], GREY * scale)


@pytest.mark.parametrize(
    'image',
    [GREY.astype(np.uint16) * 64, GREY - 1, GREY / 255, GREY.astype(np.uint8)[..., None]],
    ids=['16 bits', 'negative', 'fractions', 'channels'],
)
def test_frames_of_other_values_are_refused(tmp_path: Path, image: np.ndarray):
    with pytest.raises(RecordingError):
        import_recording(frames_npz(tmp_path, image), tmp_path / 'bag')
    assert not (tmp_path / 'bag').exists()


def test_a_table_of_edges_needs_their_kind(tmp_path: Path):
    events_npz(tmp_path)
    np.savez(tmp_path / 'edges.npz', t=EVENTS.t[:3])
    with pytest.raises(RecordingError):
        import_recording(tmp_path, tmp_path / 'bag')


def pictures(folder: Path, text: str) -> Path:
    """Write a picture, the table of frames that names it, and events as a folder of tables."""
    rows = zip(EVENTS.t, EVENTS.x, EVENTS.y, EVENTS.polarity, strict=True)
    with (folder / 'events.csv').open('w') as file:
        csv.writer(file).writerows(
            [('t', 'x', 'y', 'p'), *((t, x, y, int(p)) for t, x, y, p in rows)]
        )
    cv2.imwrite(str(folder / 'a.png'), FRAMES[0].image << 6)
    (folder / 'frames.csv').write_text(text)
    return folder


@pytest.mark.parametrize(
    ('text', 'count'),
    [
        (f'file;t\na.png;{START_US}\n', 1),
        (f'file,t\n"a.png",{START_US}\n\n \n', 1),
        ('file,exposure_start,exposure_end\n', 0),
    ],
    ids=['semicolons', 'blank lines', 'no rows'],
)
def test_tables_of_pictures(tmp_path: Path, text: str, count: int):
    tables = tmp_path / 'tables'
    tables.mkdir()
    assert import_recording(pictures(tables, text), tmp_path / 'bag').frames == count


def test_a_row_without_all_cells_is_refused(tmp_path: Path):
    with pytest.raises(RecordingError):
        import_recording(pictures(tmp_path, f'file,t\na.png,{START_US}\na.png\n'), tmp_path / 'bag')


def test_a_picture_that_claims_to_be_enormous_is_refused(tmp_path: Path):
    folder = pictures(tmp_path, f'file,t\na.png,{START_US}\n')
    data = bytearray((folder / 'a.png').read_bytes())
    struct.pack_into('>II', data, 16, 60_000, 60_000)
    struct.pack_into('>I', data, 29, zlib.crc32(data[12:29]))
    (folder / 'a.png').write_bytes(data)
    with pytest.raises(RecordingError) as caught:
        import_recording(folder, tmp_path / 'bag')
    assert str(folder / 'a.png') in str(caught.value)


def test_an_empty_table_of_frames_gives_no_size(tmp_path: Path):
    tables = tmp_path / 'tables'
    tables.mkdir()
    frames_npz(tables, np.zeros((0, 260, 346), np.uint16))
    assert import_recording(tables, tmp_path / 'bag').frames == 0


def test_forces_of_a_bag_come_along_or_are_said_to_be_left_out(tmp_path: Path):
    fill(CsvSink(tmp_path))
    import_recording(tmp_path, tmp_path / 'bag')
    counts = import_recording(tmp_path / 'bag', tmp_path / 'again')
    assert counts.wrenches == {REFERENCE: len(STAMPS_NS)}
    assert counts.warnings() == []
    for found, expected in zip(forces(tmp_path / 'again'), forces(tmp_path / 'bag'), strict=True):
        assert np.array_equal(found, expected)
    (tmp_path / 'forces.csv').write_text('t,fz\n0,1\n')
    counts = import_recording(tmp_path / 'bag', tmp_path / 'third', forces=tmp_path / 'forces.csv')
    assert counts.wrenches == {REFERENCE: 1}
    assert counts.forces_replaced
    assert len(counts.warnings()) == 1


@pytest.mark.parametrize('make', [Aedat4Sink, Hdf5Sink])
def test_the_folder_of_an_exported_file_is_enough(tmp_path: Path, make):
    folder = tmp_path / 'out'
    folder.mkdir()
    if make is Hdf5Sink:
        pytest.importorskip('h5py', reason='pip install h5py')
        fill(Hdf5Sink(folder))
    else:
        info = RecordingInfo(tmp_path, 'test', 'DAVIS', 346, 260, 0, START_US, 90_000, ())
        fill(Aedat4Sink(folder, info))
    import_recording(folder, tmp_path / 'bag')
    check(tmp_path / 'bag')


def test_upper_case_suffixes_are_known(tmp_path: Path):
    info = RecordingInfo(tmp_path, 'test', 'DAVIS', 346, 260, 0, START_US, 90_000, ())
    fill(Aedat4Sink(tmp_path, info))
    path = (tmp_path / 'recording.aedat4').rename(tmp_path / 'X.AEDAT4')
    import_recording(path, tmp_path / 'bag')
    check(tmp_path / 'bag')
    assert summarise(path).events['events'].events == COUNT


def test_a_place_above_a_new_folder_is_refused(tmp_path: Path):
    path = events_npz(tmp_path)
    with pytest.raises(FileError):
        import_recording(path, tmp_path / 'new' / '..')
    assert list(tmp_path.iterdir()) == [path]


def two_cameras(path: Path) -> Path:
    """Write a file of two cameras, each with half of EVENTS and one of FRAMES."""
    packets = [
        ('EVTS', 'A', events_packet(EVENTS[::2])),
        ('EVTS', 'B', events_packet(EVENTS[1::2])),
        ('FRME', 'A', frame_packet(FRAMES[0])),
        ('FRME', 'B', frame_packet(FRAMES[1])),
    ]
    write_aedat4(path, packets)
    return path


@pytest.mark.parametrize('camera', [0, 1])
def test_one_of_two_cameras_is_chosen_by_its_events(tmp_path: Path, camera: int):
    path = two_cameras(tmp_path / 'two.aedat4')
    with pytest.raises(RecordingError):
        import_recording(path, tmp_path / 'bag')
    selection = Selection(events=f'EVTS of {"AB"[camera]}')
    import_recording(path, tmp_path / 'bag', selection=selection)
    events, (frame,) = read_back(tmp_path / 'bag')
    assert np.array_equal(events.t, EVENTS.t[camera::2])
    assert np.array_equal(frame.image, FRAMES[camera].image)
    counts = export_recording(path, 'npz', tmp_path / 'npz', selection=selection)
    assert (counts.events, counts.frames) == (COUNT // 2, 1)


def test_nothing_can_be_chosen_of_tables(tmp_path: Path):
    with pytest.raises(RecordingError):
        import_recording(events_npz(tmp_path), tmp_path / 'bag', selection=Selection(events='a'))


def test_inspecting_lists_every_camera(tmp_path: Path):
    found = summarise(two_cameras(tmp_path / 'two.aedat4'))
    assert sorted(found.counts.values()) == [1, 1, 1, 1]
    assert [each.events for each in found.events.values()] == [COUNT // 2, COUNT // 2]


def test_an_empty_folder_is_no_damaged_bag(tmp_path: Path):
    (tmp_path / 'empty').mkdir()
    with pytest.raises(RecordingError) as caught:
        import_recording(tmp_path / 'empty', tmp_path / 'bag')
    assert not isinstance(caught.value, DamagedRecordingError)
