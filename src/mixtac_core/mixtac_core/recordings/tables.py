# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Tables of events, frames, inertial samples and forces in CSV, NPZ and HDF5 files.

Columns have documented names (`COLUMNS`). CSV files are separated by commas, or by white space if
their lines contain no comma; lines that begin with `#` are comments, and a first line of two
integers before lines of four columns is the size of the camera. HDF5 files may have the layout of
the DSEC data set (`events/p, x, y, t` and `t_offset`); events may be one array of four columns.
"""

from __future__ import annotations

import contextlib
import csv
import itertools
import re
import zipfile
from collections.abc import Callable, Iterator
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
from mixtac_core.recordings.writers import AXES, UNITS, open_hdf5

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
NEEDED: Final = {
    'events': ('t', 'x', 'y', 'polarity'),
    'frames': ('exposure_start', 'exposure_end', 'image'),
    'edges': ('t', 'kind'),
}
"""Columns that a table must have; others need `t`."""
UNNAMED: Final = {
    2: ('t', 'force_z'),
    4: ('t', 'x', 'y', 'polarity'),
    7: ('t', *(f'{name}_{axis}' for name in ('force', 'torque') for axis in AXES)),
}
"""Columns of a CSV file without headings, by their number."""
ORDERS: Final = (
    ('t', 'x', 'y', 'polarity'),
    ('x', 'y', 't', 'polarity'),
    ('x', 'y', 'polarity', 't'),
)
"""Columns of an array without names: the one that grows is the time."""
ROWS: Final = 100_000
"""Rows that are read at once."""
FRAME_ROWS: Final = 10
"""Frames that are read at once."""
MOST_GREY: Final = 1023
Rows = dict[str, NDArray[Any]]


DAVIS346: Final = (346, 260)


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

    def __post_init__(self) -> None:
        """Check the units.

        Raises:
            RecordingError: One is unknown.
        """
        for unit in (self.time_unit, self.force_unit):
            if unit and unit not in TIME_UNITS:
                raise RecordingError(
                    f'unknown unit of time {unit!r}', remedy=f'use one of {", ".join(TIME_UNITS)}'
                )


class Block(NamedTuple):
    """Some rows of a table.

    Attributes:
        rows: Columns by name.
        headings: All headings of the file, for messages.
        unit: Unit of times that the file states; empty for none.
        size: Width and height of the camera that the file states; None for none.
    """

    rows: Rows
    headings: str
    unit: str = ''
    size: tuple[int, int] | None = None


class Tables:
    """Tables of a file or a folder: rows in the order in which they are stored.

    Args:
        path: As shown in errors.
        blocks: What reads each table, by its name.
        close: Closes the files.

    Attributes:
        path: As given.
        names: Names of the tables.
        size: Width and height of the camera, known when a table that states it is read.
    """

    size: tuple[int, int] | None = None

    def __init__(
        self,
        path: Path,
        blocks: dict[str, Callable[[], Iterator[Block]]],
        close: Callable[[], None] = lambda: None,
    ) -> None:
        self.path, self.names, self.close = path, set(blocks), close
        self._blocks = blocks

    def rows(
        self, name: str, unit: str, default: str = 'us', wanted_ns: int = 1000
    ) -> Iterator[Rows]:
        """Yield the columns of a table, some rows at a time; frames are of 10 bits.

        Args:
            name: The table.
            unit: Unit of its times where the file states none; empty for `default`.
            default: Unit where nothing else gives it; times must be whole numbers then, unless it
                is longer than the wanted one.
            wanted_ns: Unit of the times that are returned [ns].

        Raises:
            RecordingError: It cannot be read, columns or numbers are missing, or the times have
                another unit.
        """
        needed = NEEDED.get(name, ('t',))
        for rows, headings, stated, size in self._blocks[name]():
            self.size = size or self.size
            if name == 'frames' and 't' in rows:
                rows['exposure_start'] = rows['exposure_end'] = rows['t']
            if missing := [each for each in needed if each not in rows]:
                raise RecordingError(
                    f'{self.path}: {name} has no column {missing[0]}; found: {headings}',
                    remedy=f'name the columns {", ".join(needed)}',
                )
            for key in needed:
                self._check_numbers(name, key, rows[key])
            for key in set(TIMES).intersection(rows):
                rows[key] = self._scaled(name, rows[key], stated or unit, default, wanted_ns)
            if name == 'events':
                rows['polarity'] = self._polarity(rows['polarity'])
            if name == 'frames':
                rows['image'] = self._ten_bits(rows['image'])
                rows.setdefault('origin', np.zeros((len(rows['image']), 2), np.int64))
            if len(rows[needed[0]]):
                yield rows

    def _check_numbers(self, name: str, key: str, column: NDArray[Any]) -> None:
        dimensions = 3 if key == 'image' else 1
        if column.ndim != dimensions or column.dtype.kind not in 'biuf':
            raise RecordingError(
                f'{self.path}: {key} of {name} is of type {column.dtype} and shape {column.shape}',
                remedy=f'store numbers in {dimensions} dimensions',
            )
        if column.dtype.kind == 'f' and not (finite := np.isfinite(column)).all():
            row = int(np.argmin(finite)) + 1
            raise RecordingError(
                f'{self.path}: {name} has {key} = {column[row - 1]} in row {row}',
                remedy='remove the rows without a number',
            )
        if key in {'x', 'y'} and column.dtype.kind == 'f' and (between := column % 1 != 0).any():
            raise RecordingError(
                f'{self.path}: {name} has {key} = {column[between][0]}, between two pixels',
                remedy='give events as the camera sent them, without rectification',
            )

    def _polarity(self, column: NDArray[Any]) -> NDArray[np.bool_]:
        values = np.unique(column)
        if not (set(values.tolist()) <= {0, 1} or set(values.tolist()) <= {-1, 1}):
            shown = ', '.join(map(str, values[:5].tolist()))
            raise RecordingError(
                f'{self.path}: polarity has the values {shown}',
                remedy='write 0 and 1, -1 and 1, or true and false',
            )
        return column > 0

    def _scaled(
        self, name: str, t: NDArray[Any], given: str, default: str, wanted_ns: int
    ) -> NDArray[np.int64]:
        """Return times in the wanted unit."""
        unit_ns = TIME_UNITS[given or default]
        if np.abs(t.astype(np.float64)).max(initial=0) >= 2.0**31 * 1e9 / unit_ns:
            raise RecordingError(
                f'{self.path}: {name} has times of {t.min()} to {t.max()} {given or default},'
                ' which no stamp of ROS holds',
                remedy='give the unit of the times with --time-unit or --force-unit',
            )
        if t.dtype.kind == 'f':
            if not given and unit_ns <= wanted_ns and (fractions := t % 1 != 0).any():
                raise RecordingError(
                    f'{self.path}: times of {name} have fractions ({t[fractions][0]}), and nothing'
                    ' gives their unit',
                    remedy='give --time-unit s',
                )
            return np.rint(t * (unit_ns / wanted_ns)).astype(np.int64)
        if unit_ns >= wanted_ns:
            return t.astype(np.int64) * (unit_ns // wanted_ns)
        return t.astype(np.int64) // (wanted_ns // unit_ns)

    def _ten_bits(self, image: NDArray[Any]) -> NDArray[np.uint16]:
        """Return grey values of 0 .. 1023; 8 bits become the upper ones."""
        if image.dtype == np.uint8:
            return ten_bits(image)
        if (
            image.dtype.kind not in 'iu'
            or image.min(initial=0) < 0
            or image.max(initial=0) > MOST_GREY
        ):
            raise RecordingError(
                f'{self.path}: frames are {image.dtype} of {image.min(initial=0)} to'
                f' {image.max(initial=0)}',
                remedy=f'store them as uint8, or as integers of 0 to {MOST_GREY}',
            )
        return image.astype(np.uint16)


def open_tables(path: Path, name: str = 'events', group: str = '') -> Tables | None:
    """Return the tables of a path; None for AEDAT4, a bag, or a file that is no table.

    Args:
        path: File or folder.
        name: Name of the table in a CSV or NPZ file.
        group: Group of an HDF5 file with the events; empty for `events`.

    Raises:
        RecordingError: The file cannot be opened, or has no such group.
    """
    if path.is_file() and path.suffix.lower() in HDF5_SUFFIXES:
        return _hdf5_tables(path, group)
    for suffixes, read in ((TEXT_SUFFIXES, _csv_blocks), ((NPZ_SUFFIX,), _npz_blocks)):
        if path.is_dir():
            files = {each.stem: each for each in path.glob(f'*{suffixes[0]}')}
        else:
            files = {name: path} if path.is_file() and path.suffix.lower() in suffixes else {}
        if files:
            return Tables(path, {key: partial(read, each) for key, each in files.items()})
    return None


def _heading(path: Path, cell: str) -> tuple[str, str]:
    """Return meaning and stated unit of a heading such as `t [us, camera clock]`.

    Raises:
        RecordingError: The unit is another one than that of the column.
    """
    name, _, unit = cell.partition('[')
    name, unit = name.strip().lower(), (re.match(r'\s*([\w/^]*)', unit) or [''])[1]
    meaning = COLUMNS.get(name, name)
    known = UNITS.get(meaning, UNITS.get(re.sub('_[xyz]$', '', meaning), ''))
    allowed = list(TIME_UNITS) if meaning in TIMES else re.findall(r'[\w/^]+', known)[:1]
    if unit and allowed and unit not in allowed:
        raise RecordingError(
            f'{path}: the unit of {name} is {unit}', remedy=f'convert it to {" or ".join(allowed)}'
        )
    return meaning, unit


def _csv_blocks(path: Path) -> Iterator[Block]:
    with path.open(encoding='utf-8-sig', errors='replace') as file:
        lines = (line for line in file if line.strip() and not line.startswith('#'))
        first = next(lines, '')
        if not first:
            raise RecordingError(f'{path} is empty', remedy='give a table with rows')
        rows = _cells(itertools.chain([first], lines))
        cells = next(rows)
        stated, camera, unnamed = '', None, False
        if len(cells) == 2 and all(each.strip().isdecimal() for each in cells):
            following = next(rows, [])
            if len(following) == 4:
                camera, cells = (int(cells[0]), int(cells[1])), following
            elif following:
                rows = itertools.chain([following], rows)
        if _is_number(cells[0]):
            if len(cells) not in UNNAMED:
                raise RecordingError(
                    f'{path} has {len(cells)} columns and no headings: {first.strip()!r}',
                    remedy='add a line of headings: t, x, y, p; or t, fz',
                )
            names, rows = list(UNNAMED[len(cells)]), itertools.chain([cells], rows)
            unnamed = len(cells) == 4
        else:
            found = [_heading(path, cell) for cell in cells]
            names = [meaning for meaning, _ in found]
            stated = next((unit for meaning, unit in found if meaning in TIMES), '')
            if len(set(names)) < len(names):
                raise RecordingError(f'{path}: two columns have one name: {", ".join(cells)}')
        start, size = 1, 1 if 'file' in names else ROWS
        while part := list(itertools.islice(rows, size)):
            columns = _columns(path, names, part, start)
            if unnamed and (columns['t'][1:] < columns['t'][:-1]).any():
                raise RecordingError(
                    f'{path} has no headings, and the first column does not grow',
                    remedy='name the columns in a first line, for example x,y,p,t; if they are'
                    ' t,x,y,p, sort the rows by time',
                )
            yield Block(columns, ', '.join(cells), stated, camera)
            start += len(part)


def _cells(lines: Iterator[str]) -> Iterator[list[str]]:
    """Yield the cells of lines, separated by commas, or by white space if the first has none."""
    first = next(lines)
    every = itertools.chain([first], lines)
    if ',' in first:
        yield from csv.reader(every, skipinitialspace=True)
    else:
        yield from (line.split() for line in every)


def _is_number(cell: str) -> bool:
    with contextlib.suppress(ValueError):
        float(cell)
        return True
    return False


def _columns(path: Path, names: list[str], rows: list[list[str]], start: int) -> Rows:
    """Return the columns of some rows; `start` is the number of the first one."""
    for number, row in enumerate(rows, start):
        if len(row) != len(names):
            raise RecordingError(
                f'{path}, row {number}: {len(row)} cells, not {len(names)} ({", ".join(names)})',
                remedy='complete or remove the row',
            )
    found: Rows = {}
    for name, cells in zip(names, zip(*rows, strict=True), strict=True):
        if name == 'file':
            found['image'] = np.stack([_picture(path, each) for each in cells])
        elif name in KNOWN:
            found[name] = _numbers(path, name, cells, start)
    if 'image' in found and {'x', 'y'} <= found.keys():
        found['origin'] = np.stack([found.pop('x'), found.pop('y')], axis=1)
    return found


KNOWN: Final = frozenset(UNITS) | frozenset(
    f'{name}_{axis}'
    for name in ('force', 'torque', 'acceleration', 'angular_velocity')
    for axis in AXES
)
"""Columns that are read; all others are passed over."""
_TRUTH: Final = {'true': '1', 'false': '0'}


def _numbers(path: Path, name: str, cells: tuple[str, ...], start: int) -> NDArray[Any]:
    """Return a column: integers where all are, so that times of many digits stay exact."""
    if cells[0].strip().lower() in _TRUTH:
        cells = tuple(_TRUTH.get(each.strip().lower(), each) for each in cells)
    text = np.array(cells)
    with contextlib.suppress(ValueError, OverflowError):
        return text.astype(np.int64)
    with contextlib.suppress(ValueError):
        return text.astype(np.float64)
    row = next(number for number, cell in enumerate(cells) if not _is_number(cell))
    raise RecordingError(
        f'{path}, row {start + row}: {name} is {cells[row]!r}',
        remedy='write a number, or remove the row',
    )


def _picture(path: Path, name: str) -> NDArray[np.uint16]:
    """Return the pixels of a picture that a table names, 8 bits or 16 left-aligned, as 10 bits."""
    image: Any = None
    # Pictures that claim more than 2^30 pixels.
    with contextlib.suppress(cv2.error):
        flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH
        image = cv2.imread(str(path.parent / name), flags)
    if image is None:
        raise RecordingError(
            f'{path.parent / name} of {path} cannot be read', remedy='check the paths'
        )
    return ten_bits(image)


def _npz_blocks(path: Path) -> Iterator[Block]:
    try:
        with path.open('rb') as file, np.lib.npyio.NpzFile(file) as archive:
            arrays = {name: archive[name] for name in archive.files}
    # Archives that are encrypted or packed in another way: RuntimeError.
    except (OSError, ValueError, EOFError, RuntimeError, zipfile.BadZipFile) as error:
        raise RecordingError(f'{path} is no NPZ file of arrays: {reason(error)}') from error
    units = str(arrays.pop('units', ''))
    named = {COLUMNS.get(key.lower(), key.lower()) for key in arrays}
    whole = [] if named.intersection(TIMES) else list(filter(_is_table, arrays.values()))
    for columns in _split(path, whole[0]) if len(whole) == 1 else (arrays,):
        yield from _sliced(columns, path.stem == 'frames', units)


def _is_table(array: Any) -> bool:  # noqa: ANN401  (an array or a data set)
    """Return whether an array holds a whole table: fields, or four columns."""
    return bool(array.dtype.names) or (array.ndim == 2 and array.shape[1] == 4)


def _split(path: Path, array: Any) -> Iterator[Rows]:  # noqa: ANN401
    """Yield the columns of an array with fields, or of one with four columns."""
    order: tuple[str, ...] = array.dtype.names or ()
    for start in range(0, len(array), ROWS):
        rows = np.asarray(array[start : start + ROWS])
        order = order or _order(path, rows)
        parts = [rows[name] for name in order] if rows.dtype.names else rows.T
        yield dict(zip(order, parts, strict=True))


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


def _sliced(columns: Any, frames: bool, units: str) -> Iterator[Block]:  # noqa: ANN401
    """Yield columns of equal length, arrays or data sets, some rows at a time."""
    named = {COLUMNS.get(key.lower(), key.lower()): each for key, each in columns.items()}
    if not any(key in named for key in TIMES):
        yield Block({}, ', '.join(columns))
        return
    count = len(next(named[key] for key in TIMES if key in named))
    used = {key: each for key, each in named.items() if np.ndim(each) and len(each) == count}
    stated = re.search(r'(?:^|, )(?:t|exposure_start) \[(\w+)', units)
    size = FRAME_ROWS if frames or 'image' in used else ROWS
    for start in range(0, count, size):
        rows = {key: np.asarray(each[start : start + size]) for key, each in used.items()}
        yield Block(rows, ', '.join(columns), stated[1] if stated else '')


def _hdf5_tables(path: Path, group: str) -> Tables:
    """Return the tables of an HDF5 file: its groups; times of events count from `t_offset`."""
    file = open_hdf5(path, 'r')
    groups = {key: each for key, each in file.items() if hasattr(each, 'items')}
    if group or 'events' not in groups:
        found = _event_groups(file)
        if group not in file and len(found) != 1:
            raise RecordingError(
                f'{path} has no group {group or "events"}; events are in'
                f' {", ".join(found) or "none"}',
                remedy='choose the group of the events with --events',
            )
        groups['events'] = file[group or found[0]]
    offset = np.asarray(file['t_offset'][()] if 't_offset' in file else 0)

    def blocks(name: str) -> Iterator[Block]:
        table = groups[name]
        try:
            units = str(table.attrs.get('units', ''))
            parts = (table,) if hasattr(table, 'items') else _split(path, table)
            for block in (
                each for part in parts for each in _sliced(part, name == 'frames', units)
            ):
                if name == 'events' and 't' in block.rows:
                    block.rows['t'] = _signed(block.rows['t']) + _signed(offset)
                yield block
        except OSError as error:
            raise RecordingError(
                f'{path}, {name}: {reason(error)}',
                remedy='pip install hdf5plugin, which reads compressed data of DSEC',
            ) from error

    return Tables(path, {name: partial(blocks, name) for name in groups}, file.close)


def _event_groups(file: Any) -> list[str]:  # noqa: ANN401
    """Return the groups and data sets of an HDF5 file with all columns of events."""
    found = []

    def visit(name: str, each: Any) -> None:  # noqa: ANN401
        keys = {COLUMNS.get(key.lower(), key.lower()) for key in getattr(each, 'keys', list)()}
        if keys.issuperset(NEEDED['events']) or (hasattr(each, 'dtype') and _is_table(each)):
            found.append(name)

    file.visititems(visit)
    return found


def _signed(numbers: NDArray[Any]) -> NDArray[Any]:
    """Return integers as `int64`, which a sum with others keeps; fractions as they are."""
    return numbers if numbers.dtype.kind == 'f' else numbers.astype(np.int64)
