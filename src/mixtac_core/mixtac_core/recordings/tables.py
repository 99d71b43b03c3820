# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Tables of events, frames, inertial samples and forces in CSV, NPZ and HDF5 files.

Columns have documented names (`COLUMNS`). CSV files are separated by commas, or by white space if
their first line contains no comma; lines that begin with `#` are comments, and a first line of two
integers before lines of four columns is the size of the camera. HDF5 files may have the layout of
the DSEC data set (`events/p, x, y, t` and `t_offset`, https://dsec.ifi.uzh.ch/data-format/); events
may be one array of four columns.
"""

from __future__ import annotations

import contextlib
import csv
import importlib
import itertools
import re
import zipfile
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mixtac_core.recordings.messages import ten_bits
from mixtac_core.recordings.recording import (
    HDF5_SUFFIXES,
    NPZ_SUFFIX,
    TEXT_SUFFIXES,
    RecordingError,
    reason,
)

HDF5_FILE: Final = 'recording.h5'
"""Name of the file that an export as HDF5 makes."""
TABLES: Final = ('events', 'frames', 'imu', 'edges')
"""Tables of the camera; others hold forces."""
AXES: Final = 'xyz'
"""Names of the columns of a vector in CSV, after the name of the vector and `_`."""
CAMERA_TIME: Final = 'us, camera clock'
TOPIC_TIME: Final = 'ns, clock of the topic'
UNITS: Final = {
    't': CAMERA_TIME,
    'exposure_start': CAMERA_TIME,
    'exposure_end': CAMERA_TIME,
    'x': 'px',
    'y': 'px',
    'polarity': '1 = brighter',
    'p': '1 = brighter',
    'image': '0 .. 1023',
    'origin': 'px',
    'acceleration': 'm/s^2',
    'angular_velocity': 'rad/s',
    'temperature': 'degC',
    'kind': '2 falling, 3 rising, 4 pulse, 16 and 17 generator',
    'force': 'N',
    'torque': 'N m',
}
"""Units of the columns; the times of force topics are in `TOPIC_TIME`."""
TIME_UNITS: Final = {'ns': 1, 'us': 1_000, 'ms': 1_000_000, 's': 1_000_000_000}
"""Units of time [ns]."""
TIMES: Final = ('t', 'exposure_start', 'exposure_end')
"""Columns of times."""
COLUMNS: Final = {
    **{f'{name}s': name for name in 'txy'},
    **dict.fromkeys(('p', 'ps'), 'polarity'),
    **{f'f{axis}': f'force_{axis}' for axis in AXES},
    **{f't{axis}': f'torque_{axis}' for axis in AXES},
}
"""Short names of columns, and those of event_cnn files, and what they mean."""
EVENT_COLUMNS: Final = ('t', 'x', 'y', 'polarity')
UNNAMED: Final = {
    2: ('t', 'force_z'),
    4: EVENT_COLUMNS,
    7: ('t', *(f'{name}_{axis}' for name in ('force', 'torque') for axis in AXES)),
}
"""Columns of a CSV file without headings, by their number."""
ORDERS: Final = (EVENT_COLUMNS, ('x', 'y', 't', 'polarity'), ('x', 'y', 'polarity', 't'))
"""Columns of an array without names: the one that grows is the time."""
ROWS: Final = 100_000
"""Rows that are read at once."""
FRAME_ROWS: Final = 10
"""Frames that are read at once."""
Rows = dict[str, NDArray[Any]]


@dataclass(frozen=True, slots=True)
class TableOptions:
    """How to read tables that do not say it themselves.

    Attributes:
        time_unit: Unit of the times of camera data where the file states none, one of
            `TIME_UNITS`; empty for `us`.
        force_unit: Unit of the times of forces, likewise; empty for `s`.
        size: Width and height of the camera; None for that of its frames, else 346 x 260.
    """

    time_unit: str = ''
    force_unit: str = ''
    size: tuple[int, int] | None = None


class Block(NamedTuple):
    """Some rows of a table.

    Attributes:
        rows: Columns by name.
        headings: All headings of the file, for messages.
        unit: Unit of times that the file states; empty for none.
    """

    rows: Rows
    headings: str
    unit: str


Tables = dict[str, Callable[[], Iterator[Block]]]
"""What reads each table of a file or a folder, by the name of the table."""


def topic_file(topic: str) -> str:
    """Return the name under which a topic is exported."""
    return topic.strip('/').replace('/', '_')


def optional_module(name: str, remedy: str) -> Any:  # noqa: ANN401
    """Return a module of a package that only some formats need.

    Raises:
        RecordingError: It is not installed.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise RecordingError(f'{name} is not installed ({error})', remedy=remedy) from error


def open_hdf5(path: Path, mode: str) -> Any:  # noqa: ANN401
    """Return an HDF5 file, an `h5py.File`, opened to read (`r`) or newly made (`x`).

    Raises:
        RecordingError: h5py is not installed, or the file cannot be opened.
    """
    h5py = optional_module('h5py', 'python3 tools/setup.py --with hdf5, or pip install h5py')
    with contextlib.suppress(ImportError):
        # Registers the compression of DSEC where it is installed.
        import hdf5plugin  # noqa: F401
    try:
        return h5py.File(path, mode)
    except OSError as error:
        raise RecordingError(f'{path} cannot be opened as HDF5: {error}') from error


def find_tables(path: Path, name: str = 'events', group: str = '') -> Tables:
    """Return the tables of a path; none for AEDAT4, a bag, or a file that is no table.

    Args:
        path: File or folder.
        name: Name of the table in a CSV or NPZ file.
        group: Group of an HDF5 file with the events; empty for `events`.

    Raises:
        RecordingError: The file cannot be opened, or has no such group.
    """
    if path.is_file() and path.suffix.lower() in HDF5_SUFFIXES:
        groups = _groups(path, group).items()
        return {each: partial(_read_hdf5, path, each, place) for each, place in groups}
    # Of two tables of one name, the csv counts: it comes last.
    paths = sorted(path.iterdir(), reverse=True) if path.is_dir() else [path]
    readable = [each for each in paths if each.is_file() and each.suffix.lower() in _READERS]
    return {
        each.stem if path.is_dir() else name: partial(_READERS[each.suffix.lower()], each)
        for each in readable
    }


def _meaning(name: str) -> str:
    return COLUMNS.get(name.strip().lower(), name.strip().lower())


def _columns(path: Path, headings: Iterable[str]) -> tuple[list[str], str]:
    """Return the columns that headings such as `t [us, camera clock]` name, and the unit of times.

    Raises:
        RecordingError: Two name one column, or a unit is another one than that of the column.
    """
    headings, names, stated = list(headings), [], ''
    for heading in headings:
        short, _, unit = heading.partition('[')
        name = _meaning(short)
        unit = re.findall(r'[\w/^]*', unit.strip())[0]
        known = UNITS.get(re.sub('_[xyz]$', '', name), '')
        allowed = [*TIME_UNITS] if name in TIMES else re.findall(r'[\w/^]+', known)[:1]
        if unit and allowed and unit not in allowed:
            raise RecordingError(
                f'{path}: the unit of {short.strip()} is {unit}',
                remedy=f'convert it to {" or ".join(allowed)}',
            )
        if name in TIMES:
            stated = stated or unit
        names.append(name)
    if len(set(names)) < len(names):
        raise RecordingError(f'{path}: two columns have one name: {", ".join(headings)}')
    return names, stated


def _lines(path: Path) -> Generator[str, None, None]:
    """Yield the lines of a text file that are neither empty nor comments."""
    with path.open(encoding='utf-8-sig', errors='replace') as file:
        yield from (line for line in file if line.strip() and not line.startswith('#'))


def stated_size(path: Path) -> tuple[int, int] | None:
    """Return width and height of the camera if they are the first line of a text file, else None.

    Args:
        path: File of events, or a folder with such a file.
    """
    paths = [each for each in path.iterdir() if each.stem == 'events'] if path.is_dir() else [path]
    texts = (each for each in paths if each.is_file() and each.suffix.lower() in TEXT_SUFFIXES)
    return next(
        filter(None, (_size_in(*itertools.islice(_lines(each), 2)) for each in texts)), None
    )


def _size_in(first: str = '', second: str = '') -> tuple[int, int] | None:
    """Return width and height if they are the first of two lines, before one of four columns."""
    rows = [each.replace(',', ' ').split() for each in (first, second)]
    if [len(row) for row in rows] == [2, 4] and ''.join(rows[0]).isdigit():
        return int(rows[0][0]), int(rows[0][1])
    return None


def _read_csv(path: Path) -> Iterator[Block]:
    with contextlib.closing(_lines(path)) as lines:
        head = list(itertools.islice(lines, 2))
        rest = itertools.chain(head[1 if _size_in(*head) else 0 :], lines)
        first = next(rest, '')
        if not first:
            raise RecordingError(f'{path} is empty', remedy='give a table with rows')
        separator = ',' if ',' in first else None
        cells = next(csv.reader([first], skipinitialspace=True)) if separator else first.split()
        if not _is_number(cells[0]):
            names, stated = _columns(path, cells)
        elif len(cells) in UNNAMED:
            names, stated, rest = [*UNNAMED[len(cells)]], '', itertools.chain([first], rest)
        else:
            raise RecordingError(
                f'{path} has {len(cells)} columns and no headings: {first.strip()!r}',
                remedy='add a line of headings: t, x, y, p; or t, fz',
            )
        # Pictures may differ in size.
        start, size = 1, 1 if 'file' in names else ROWS
        while part := list(itertools.islice(rest, size)):
            split = csv.reader(part, skipinitialspace=True) if separator else map(str.split, part)
            table = _table(path, split, names, start)
            start += len(table)
            rows = {
                name: _numbers(column)
                for name, column in zip(names, table.T, strict=True)
                if re.sub('_[xyz]$', '', name) in UNITS
            }
            if 'file' in names:
                rows['image'] = _picture(path, str(table[0, names.index('file')]))[None]
                if {'x', 'y'} <= rows.keys():
                    rows['origin'] = np.stack([rows.pop('x'), rows.pop('y')], axis=1)
            yield Block(rows, ', '.join(cells), stated)


def _table(
    path: Path, split: Iterable[list[str]], names: list[str], start: int
) -> NDArray[np.str_]:
    """Return the cells of rows as an array, [n, columns]; `start` is the number of the first."""
    try:
        rows = list(split)
    except csv.Error as error:
        raise RecordingError(f'{path} is no table: {error}', remedy='export it again') from error
    for number, row in enumerate(rows, start):
        if len(row) != len(names):
            raise RecordingError(
                f'{path}, row {number}: {len(row)} cells, not {len(names)} ({", ".join(names)})',
                remedy='complete or remove the row',
            )
    return np.array(rows)


def _is_number(cell: str) -> bool:
    with contextlib.suppress(ValueError):
        float(cell)
        return True
    return False


def _numbers(text: NDArray[np.str_]) -> NDArray[Any]:
    """Return a column: integers where all are, so that times of many digits stay exact.

    True and false are 1 and 0; what is no number becomes NaN.
    """
    if text[0].strip().lower() in {'true', 'false'}:
        small = np.char.lower(np.char.strip(text))
        text = np.where(small == 'true', '1', np.where(small == 'false', '0', text))
    for kind in (np.int64, np.float64):
        with contextlib.suppress(ValueError, OverflowError):
            return text.astype(kind)
    return np.array([float(cell) if _is_number(cell) else np.nan for cell in text.tolist()])


def _picture(path: Path, name: str) -> NDArray[np.uint16]:
    """Return the pixels of a picture that a table names, 8 bits or 16 left-aligned, as 10 bits."""
    flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH
    image: Any = cv2.imread(str(path.parent / name), flags)
    if image is None:
        raise RecordingError(
            f'{path.parent / name} of {path} cannot be read', remedy='check the paths'
        )
    return ten_bits(image)


def _read_npz(path: Path) -> Iterator[Block]:
    try:
        with path.open('rb') as file, np.lib.npyio.NpzFile(file) as archive:
            arrays = {name: np.asarray(archive[name]) for name in archive.files}
    # Archives that are encrypted or packed in another way: RuntimeError.
    except (OSError, ValueError, EOFError, RuntimeError, zipfile.BadZipFile) as error:
        raise RecordingError(f'{path} is no NPZ file of arrays: {reason(error)}') from error
    units = str(arrays.pop('units', ''))
    whole = [array for array in arrays.values() if _is_table(array)]
    timed = any(_meaning(key) in TIMES for key in arrays)
    yield from _blocks(path, whole[0] if len(whole) == 1 and not timed else arrays, units)


_READERS: Final[dict[str, Callable[[Path], Iterator[Block]]]] = {
    **dict.fromkeys(TEXT_SUFFIXES, _read_csv),
    NPZ_SUFFIX: _read_npz,
}


def _is_table(array: Any) -> bool:  # noqa: ANN401  (an array or a data set)
    """Return whether an array holds a whole table: fields, or four columns."""
    return bool(array.dtype.names) or (array.ndim == 2 and array.shape[1] == 4)


def _holds_events(place: Any) -> bool:  # noqa: ANN401  (a group or a data set)
    """Return whether a place in an HDF5 file holds all columns of events."""
    if hasattr(place, 'dtype'):
        return _is_table(place)
    return {_meaning(key) for key in place}.issuperset(EVENT_COLUMNS)


def _blocks(path: Path, source: Any, units: str = '') -> Iterator[Block]:  # noqa: ANN401
    """Yield the rows of columns of equal length, arrays or data sets, or of one whole table."""
    if hasattr(source, 'dtype'):
        order: tuple[str, ...] = source.dtype.names or ()
        for start in range(0, len(source), ROWS):
            part = np.asarray(source[start : start + ROWS])
            order = order or _order(path, part)
            parts = [part[name] for name in order] if part.dtype.names else part.T
            yield from _blocks(path, dict(zip(order, parts, strict=True)))
        return
    stated = dict(re.findall(r'(\w+) (\[[^\]]*)', units))
    names, unit = _columns(path, (f'{key} {stated.get(key, "")}' for key in source))
    columns = dict(zip(names, source.values(), strict=True))
    shapes: dict[str, tuple[int, ...]] = {
        key: getattr(each, 'shape', ()) for key, each in columns.items()
    }
    count = next((shapes[key][0] for key in TIMES if shapes.get(key)), 0)
    used = [key for key, shape in shapes.items() if shape[:1] == (count,)]
    headings = ', '.join(
        f'{key} {shape}' for key, shape in zip(source, shapes.values(), strict=True)
    )
    size = FRAME_ROWS if 'image' in used else ROWS
    for start in range(0, max(count, 1), size):
        yield Block(
            {key: np.asarray(columns[key][start : start + size]) for key in used}, headings, unit
        )


def _order(path: Path, rows: NDArray[Any]) -> tuple[str, ...]:
    """Return the names of four columns by the only one that grows, which is the time.

    Raises:
        RecordingError: No column grows, or several do.
    """
    times = [rows[:, order.index('t')] for order in ORDERS]
    grows = [(t[1:] >= t[:-1]).all() and len(np.unique(t)) > 2 for t in times]
    if sum(grows) != 1:
        raise RecordingError(
            f'{path}: of the four columns of an array, {sum(grows)} grow as times do',
            remedy='save arrays named t, x, y, p, sorted by time',
        )
    return ORDERS[grows.index(True)]


def _groups(path: Path, group: str) -> dict[str, str]:
    """Return the places of the tables of an HDF5 file, by their names."""
    with open_hdf5(path, 'r') as file:
        groups = {key: key for key, each in file.items() if hasattr(each, 'items')}
        if not group and 'events' in groups:
            return groups
        found = ['/'] if _holds_events(file) else []
        file.visititems(lambda name, each: found.append(name) if _holds_events(each) else None)
        if group not in file if group else len(found) != 1:
            raise RecordingError(
                f'{path} has no group {group or "events"}; events are in'
                f' {", ".join(found) or "none"}',
                remedy='choose the group of the events with --events',
            )
    return groups | {'events': group or found[0]}


def _read_hdf5(path: Path, name: str, place: str) -> Iterator[Block]:
    """Yield the rows of a table; times of events count from `t_offset`."""
    with open_hdf5(path, 'r') as file:
        table, offset = file[place], file['t_offset'][()].item() if 't_offset' in file else 0
        try:
            for block in _blocks(path, table, str(table.attrs.get('units', ''))):
                if name == 'events' and 't' in block.rows:
                    kind = np.float64 if block.rows['t'].dtype.kind == 'f' else np.int64
                    block.rows['t'] = block.rows['t'].astype(kind) + offset
                yield block
        except OSError as error:
            raise RecordingError(
                f'{path}, {place}: {reason(error)}',
                remedy='pip install hdf5plugin, which reads compressed data of DSEC',
            ) from error
