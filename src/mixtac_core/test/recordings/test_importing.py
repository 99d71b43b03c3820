# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Tables of events and forces as labs bring them become bags, or are refused by what is wrong."""

from __future__ import annotations

import contextlib
import csv
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest
from recording_samples import START_US, assert_equal, read, some_events

from mixtac_core.node.topics import REFERENCE
from mixtac_core.recordings.bag import BagFile, find_bags
from mixtac_core.recordings.dataset import folder_facts
from mixtac_core.recordings.importing import import_recording
from mixtac_core.recordings.recording import RecordingError, Selection
from mixtac_core.recordings.tables import TableOptions

EVENTS = some_events(count=2000, length_us=90_000)
COLUMNS = {'t': EVENTS.t, 'x': EVENTS.x, 'y': EVENTS.y, 'p': EVENTS.polarity}
GREY = np.random.default_rng(7).integers(0, 256, (12, 260, 346))


def events_npz(folder: Path, **changed: np.ndarray) -> Path:
    """Write EVENTS as a table; `changed` replaces columns."""
    np.savez(folder / 'events.npz', **COLUMNS | changed)
    return folder / 'events.npz'


def table(path: Path, heading: str, *columns: np.ndarray, separator: str = ',') -> Path:
    """Write columns as a text."""
    rows = zip(*(column.tolist() for column in columns), strict=True)
    text = ''.join(separator.join(map(str, row)) + '\n' for row in rows)
    path.write_text(heading + text)
    return path


@pytest.mark.parametrize(
    ('heading', 'unit', 'scale', 'separator'),
    [
        ('', 'us', 1, ','),
        ('', '', 1, ' '),
        ('t [ns],x,y,p\n', 'us', 1000, ','),
        ('"t [us, camera clock]",x,y,polarity\n', 's', 1, ','),
        ('# events of a tool\n# t x y p\n', 'ns', 1000, ' '),
        ('T,extra,X,Y,P\n', '', 1, ','),
    ],
)
def test_events_of_text_tables(tmp_path: Path, heading, unit, scale, separator):
    columns = [EVENTS.t * scale, EVENTS.x, EVENTS.y, np.where(EVENTS.polarity, 1, -1)]
    if 'extra' in heading:
        columns[1:1] = [np.zeros(len(EVENTS))]
    path = table(tmp_path / 'events.txt', heading, *columns, separator=separator)
    import_recording(path, tmp_path / 'bag', options=TableOptions(time_unit=unit))
    assert_equal(read(tmp_path / 'bag').events, EVENTS)


def test_seconds_with_dust_behind_the_microsecond(tmp_path: Path):
    since = EVENTS.t - START_US
    path = table(tmp_path / 'x.csv', '', since / 1e6 + 3e-9, EVENTS.x, EVENTS.y, EVENTS.polarity)
    with pytest.raises(RecordingError) as caught:
        import_recording(path, tmp_path / 'bag')
    assert '--time-unit s' in caught.value.remedy
    import_recording(path, tmp_path / 'bag', options=TableOptions(time_unit='s'))
    assert np.array_equal(read(tmp_path / 'bag').events.t, since)


@pytest.mark.parametrize(
    ('text', 'named'),
    [
        ('t,x,y\n1,2,3\n', 'found: t, x, y'),
        ('t,x,y,p\n1,2,3,0\n1.5,2,3,0\n3,2,3,0\n', '1.5'),
        ('t,x,y,p\n5,2,3,0\n4,2,3,0\n', '4 us'),
        ('t,x,y,p\n5,2,300,0\n', '300'),
        ('t,x,y,p\n4,2,3,0\n5,2,a,0\n', 'row 2'),
        ('t,x,y,p\n-5,2,3,0\n', '-5'),
        ('t,x,y,p\n', 'nothing'),
        ('t,x,y,p\n5,nan,3,0\n', 'nan'),
        ('t,x,y,p\n5,2,3,2\n6,2,3,1\n', 'polarity has the values 1, 2'),
        ('t,x,y,p\n5,7.9,3,0\n', '7.9'),
        ('t;x;y;p\n5;2;3;0\n', 't;x;y;p'),
        ('t,x,y,p\n"' + '1' * 200_000, 'no table'),
        ('7,2,1,1\n3,2,1,0\n', '3 us'),
    ],
)
def test_bad_tables_are_refused_and_leave_nothing(tmp_path: Path, text: str, named: str):
    (tmp_path / 'events.csv').write_text(text)
    with pytest.raises(RecordingError) as caught:
        import_recording(tmp_path / 'events.csv', tmp_path / 'bag')
    assert named in caught.value.message
    assert [each.name for each in tmp_path.iterdir()] == ['events.csv']


@pytest.mark.parametrize('heading', ['', '240 180\n', '# made by a tool\n240,180\n'])
def test_a_first_line_with_the_size_is_read(tmp_path: Path, heading: str):
    file = tmp_path / 'events.TXT'
    file.write_text(heading + '0 2 1 1\n4000 3 1 0\n10000 3 2 0\n')
    counts = import_recording(file, tmp_path / 'bag')
    assert (counts.events, counts.grid_us, counts.info.size_known) == (3, 2000, bool(heading))
    assert counts.info.width == (240 if heading else 346)
    assert any('2000' in line for line in counts.warnings())


def imported_forces(folder: Path, path: Path, **options: str) -> tuple[list[int], list[float]]:
    """Return stamps [ns] and normal forces of a table that is imported beside events."""
    source, given = events_npz(folder), TableOptions(**options)
    import_recording(source, folder / 'bag', forces=path, options=given)
    with BagFile(folder / 'bag') as file:
        stamps, found = file.wrenches(REFERENCE)
    return stamps.tolist(), found[:, 2].tolist()


@pytest.mark.parametrize(
    'text',
    [
        't,fz\n0,1.5\n0.5,2.5\n',
        ',T,fx,fy,fz,norm\n0,0,3,4,1.5,9\n1,0.5,3,4,2.5,9\n',
        't [ms],"force_z [N]"\n0,1.5\n500,2.5\n',
        '\n# of the day\n0.0 1.5\n0.5   2.5\n\n',
        '0,7,8,1.5,1,2,3\n0.5,7,8,2.5,1,2,3\n',
        '\ufefft,fz\n0,1.5\n0.5,2.5\n',
    ],
    ids=['plain', 'others beside', 'units', 'without headings', 'vectors', 'byte order mark'],
)
def test_forces_of_text_tables(tmp_path: Path, text: str):
    (tmp_path / 'forces.csv').write_text(text, encoding='utf8')
    assert imported_forces(tmp_path, tmp_path / 'forces.csv') == ([0, 500_000_000], [1.5, 2.5])


def test_vectors_of_forces_in_arrays(tmp_path: Path):
    force = np.array([[0, 0, 1.0], [0, 0, 2.0]])
    np.savez(tmp_path / 'forces.npz', t=np.array([0, 500]), force=force)
    found = imported_forces(tmp_path, tmp_path / 'forces.npz', force_unit='ms')
    assert found == ([0, 500_000_000], [1.0, 2.0])


@pytest.mark.parametrize(
    ('text', 'named'),
    [
        ('', 'empty'),
        ('t [msec],fz\n0,1\n', 'msec'),
        ('t,fz [mN]\n0,1\n', 'mN'),
        ('t,fz,force_z\n0,1,2\n', 'fz'),
        ('t,fz\n1700000000000000000,1\n', '1700000000000000000'),
        ('t,fz\n0,1\n1,nan\n', 'row 2'),
        ('t,fz\n', 'no forces'),
        ('0.1,1.5,2,3,4,5\n', '6 columns'),
        ('Zeit,Kraft\n0,1\n', 'Zeit, Kraft'),
    ],
)
def test_tables_that_could_be_misread_are_refused(tmp_path: Path, text: str, named: str):
    (tmp_path / 'forces.csv').write_text(text)
    with pytest.raises(RecordingError) as caught:
        imported_forces(tmp_path, tmp_path / 'forces.csv')
    assert named in caught.value.message
    assert not (tmp_path / 'bag').exists()


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


def test_forces_of_a_bag_come_along_or_are_replaced(tmp_path: Path):
    (tmp_path / 'forces.csv').write_text('t,fz\n0,1\n1,2\n')
    forces = tmp_path / 'forces.csv'
    import_recording(events_npz(tmp_path), tmp_path / 'bag', forces=forces)
    counts = import_recording(tmp_path / 'bag', tmp_path / 'again')
    assert counts.wrenches == {REFERENCE: 2}
    forces.write_text('t,fz\n0,3\n')
    counts = import_recording(tmp_path / 'bag', tmp_path / 'third', forces=forces)
    assert counts.wrenches == {REFERENCE: 1}


def test_a_rate_that_no_camera_has_is_a_warning(tmp_path: Path):
    options = TableOptions(time_unit='s')
    path = events_npz(tmp_path, t=np.arange(len(EVENTS)))
    counts = import_recording(path, tmp_path / 'bag', options=options)
    assert counts.seconds == pytest.approx(len(EVENTS) - 1)
    assert sum('events per second' in each for each in counts.warnings()) == 1


@pytest.mark.parametrize('order', ['txyp', 'xytp', 'xypt', 'fields'])
def test_one_array_is_a_table(tmp_path: Path, order: str):
    if order == 'fields':
        rows = np.zeros(len(EVENTS), [('x', 'u2'), ('y', 'u2'), ('p', '?'), ('t', 'i8')])
        for name, column in COLUMNS.items():
            rows[name] = column
    else:
        rows = np.stack([COLUMNS[name] for name in order], axis=1)
    np.savez(tmp_path / 'events.npz', any_name=rows)
    import_recording(tmp_path / 'events.npz', tmp_path / 'bag')
    assert_equal(read(tmp_path / 'bag').events, EVENTS)


def test_other_npz_files_are_refused(tmp_path: Path):
    two = np.stack([EVENTS.x, EVENTS.y, EVENTS.y, EVENTS.x], 1)
    contents = {'text': None, 'one array': [np.zeros(3)], 'none that grows': [two], 'zip': []}
    for name, arrays in contents.items():
        path = tmp_path / f'{name}.npz'
        path.write_text('text')
        if arrays:
            np.savez(path, *arrays)
        elif name == 'zip':
            zipfile.ZipFile(path, 'w').writestr('notes.txt', 'no array')
        with pytest.raises(RecordingError) as caught:
            import_recording(path, tmp_path / 'bag')
        assert str(path) in caught.value.message


def test_a_size_that_nothing_states_is_a_warning(tmp_path: Path):
    for size in (None, (640, 480)):
        options = TableOptions(size=size)
        counts = import_recording(events_npz(tmp_path), tmp_path / f'bag{size}', options=options)
        assert (counts.info.width, len(counts.warnings())) == (
            (346, 1) if size is None else (640, 0)
        )


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
    assert np.array_equal(read(tmp_path / 'bag').events.t, expected)


@pytest.mark.parametrize(
    ('kind', 'place'),
    [(None, 'davis/left/events'), (float, 'a/events'), (np.uint64, 'a/b'), (None, '/')],
)
def test_a_group_of_hdf5_is_found_or_chosen(tmp_path: Path, kind: type | None, place: str):
    h5py = pytest.importorskip('h5py', reason='pip install h5py')
    with h5py.File(tmp_path / 'x.h5', 'x') as file:
        if kind:
            file[place] = np.stack([COLUMNS[name] for name in 'xytp'], axis=1).astype(kind)
        else:
            for name, column in COLUMNS.items():
                file[f'{place}/{name}s'] = column
    options = TableOptions(time_unit='us')
    import_recording(tmp_path / 'x.h5', tmp_path / 'one', options=options)
    with h5py.File(tmp_path / 'x.h5', 'a') as file:
        file['davis/right/events'] = np.zeros((3, 4))
    with pytest.raises(RecordingError) as caught:
        import_recording(tmp_path / 'x.h5', tmp_path / 'bag')
    assert f'{place}, davis/right/events' in caught.value.message
    selection = Selection(events=place)
    import_recording(tmp_path / 'x.h5', tmp_path / 'bag', selection=selection, options=options)
    for name in ('one', 'bag'):
        assert_equal(read(tmp_path / name).events, EVENTS)


def frames_npz(folder: Path, image: np.ndarray) -> Path:
    """Write events and frames as a folder of tables."""
    events_npz(folder)
    t = START_US + 5_000 * np.arange(len(image))
    np.savez(folder / 'frames.npz', exposure_start=t, exposure_end=t + 5000, image=image)
    return folder


@pytest.mark.parametrize(('dtype', 'scale'), [(np.uint8, 4), (np.uint16, 1), (np.int64, 1)])
def test_frames_of_several_types_have_ten_bits(tmp_path: Path, dtype, scale: int):
    tables = tmp_path / 'tables'
    tables.mkdir()
    import_recording(frames_npz(tables, GREY.astype(dtype)), tmp_path / 'bag')
    found = read(tmp_path / 'bag').frames
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


@pytest.mark.parametrize(
    ('text', 'count'),
    [
        (f'file,t\n"a.png",{START_US}\n\n \n', 1),
        ('file,exposure_start,exposure_end\n', 0),
        (f'file,t\na.png,{START_US}\na.png\n', None),
        (f'file,t\nb.png,{START_US}\n', None),
    ],
    ids=['blank lines', 'no rows', 'no time', 'no picture'],
)
def test_tables_of_pictures(tmp_path: Path, text: str, count: int | None):
    tables = tmp_path / 'tables'
    tables.mkdir()
    with (tables / 'events.csv').open('w') as file:
        rows = zip(EVENTS.t, EVENTS.x, EVENTS.y, EVENTS.polarity, strict=True)
        csv.writer(file).writerows([('t', 'x', 'y', 'p'), *rows])
    cv2.imwrite(str(tables / 'a.png'), GREY[0].astype(np.uint16) << 6)
    (tables / 'frames.csv').write_text(text)
    if count is None:
        with pytest.raises(RecordingError):
            import_recording(tables, tmp_path / 'bag')
        return
    assert import_recording(tables, tmp_path / 'bag').frames == count
    assert all(np.array_equal(each.image, GREY[0]) for each in read(tmp_path / 'bag').frames)


def test_a_bag_is_described_by_its_folders(tmp_path: Path):
    for name in ('static/one', 'static/test/two', 'train/dynamic/three'):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / 'metadata.yaml').touch()
    found = {bag.name: folder_facts(bag) for bag in find_bags(tmp_path)}
    assert found['two'] == {'profile': 'static', 'split': 'test'}
    assert found['three'] == {'profile': 'dynamic', 'split': 'train'}
    assert found['one']['profile'] == 'static'
