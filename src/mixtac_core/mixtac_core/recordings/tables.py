# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Tables of events, frames, inertial samples and forces in CSV, NPZ and HDF5 files.

Columns have documented names (`COLUMNS`). CSV files are separated by commas, or by white space
where their lines hold none; lines that begin with `#` are comments. HDF5 files may have the layout
of the DSEC data set (`events/p, x, y, t` and `t_offset`).
"""

from __future__ import annotations

import contextlib
import csv
import itertools
import re
import zipfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from mixtac_core.recordings.messages import ten_bits
from mixtac_core.recordings.recording import RecordingError, reason
from mixtac_core.recordings.writers import AXES, HDF5_SUFFIXES, UNITS, open_hdf5

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
ROWS: Final = 100_000
"""Rows that are read at once."""
FRAME_ROWS: Final = 10
"""Frames that are read at once."""
MOST_GREY: Final = 1023
Rows = dict[str, NDArray[Any]]
Block = tuple[Rows, str, str]
"""Columns by name, the unit of times that the file states, empty for none, and all its headings."""


class Tables:
    """Tables of a file or a folder: rows in the order in which they are stored.

    Args:
        path: As shown in errors.
        blocks: What reads each table, by its name.
        close: Closes the files.

    Attributes:
        path: As given.
        names: Names of the tables.
    """

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
        for rows, stated, headings in self._blocks[name]():
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
    """Return the tables of a path; None for an AEDAT4 file, a bag or what is no table.

    Args:
        path: File or folder.
        name: Name of the table in a CSV or NPZ file.
        group: Group of an HDF5 file with the events; empty for `events`.

    Raises:
        RecordingError: The file cannot be opened, or has no such group.
    """
    if path.is_file() and path.suffix.lower() in HDF5_SUFFIXES:
        return _hdf5_tables(path, group)
    for suffixes, read in ((('.csv', '.txt'), _csv_blocks), (('.npz',), _npz_blocks)):
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
        stated = ''
        if _is_number(cells[0]):
            if len(cells) not in UNNAMED:
                raise RecordingError(
                    f'{path} has {len(cells)} columns and no headings: {first.strip()!r}',
                    remedy='add a line of headings: t, x, y, p; or t, fz',
                )
            names, rows = list(UNNAMED[len(cells)]), itertools.chain([cells], rows)
        else:
            found = [_heading(path, cell) for cell in cells]
            names = [meaning for meaning, _ in found]
            stated = next((unit for meaning, unit in found if meaning in TIMES), '')
            if len(set(names)) < len(names):
                raise RecordingError(f'{path}: two columns have one name: {", ".join(cells)}')
        start, size = 1, 1 if 'file' in names else ROWS
        while part := list(itertools.islice(rows, size)):
            yield _columns(path, names, part, start), stated, ', '.join(cells)
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
_TRUTH: Final = {'true': 1, 'false': 0}


def _numbers(path: Path, name: str, cells: tuple[str, ...], start: int) -> NDArray[Any]:
    """Return a column: integers where all are, so that times of many digits stay exact."""
    if cells[0].lower() in _TRUTH:
        cells = tuple(str(_TRUTH.get(each.lower(), each)) for each in cells)
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
    if len(arrays) == 1 and (only := next(iter(arrays.values()))).dtype.names:
        arrays = {name: only[name] for name in only.dtype.names}
    units = str(arrays.pop('units', ''))
    yield from _sliced(arrays, path.stem == 'frames', units)


def _sliced(columns: Any, frames: bool, units: str) -> Iterator[Block]:  # noqa: ANN401
    """Yield columns of equal length, arrays or data sets, some rows at a time."""
    named = {COLUMNS.get(key.lower(), key.lower()): each for key, each in columns.items()}
    if not any(key in named for key in TIMES):
        yield {}, '', ', '.join(columns)
        return
    count = len(next(named[key] for key in TIMES if key in named))
    used = {key: each for key, each in named.items() if np.ndim(each) and len(each) == count}
    stated = re.search(r'(?:^|, )(?:t|exposure_start) \[(\w+)', units)
    size = FRAME_ROWS if frames or 'image' in used else ROWS
    for start in range(0, count, size):
        rows = {key: np.asarray(each[start : start + size]) for key, each in used.items()}
        yield rows, stated[1] if stated else '', ', '.join(columns)


def _hdf5_tables(path: Path, group: str) -> Tables:
    """Return the tables of an HDF5 file: its groups; times of events count from `t_offset`."""
    file = open_hdf5(path, 'r')
    groups = {key: each for key, each in file.items() if hasattr(each, 'items')}
    if group:
        if group not in file or not hasattr(file[group], 'items'):
            raise RecordingError(f'{path} has no group {group}; it has {", ".join(groups)}')
        groups['events'] = file[group]
    offset = np.asarray(file['t_offset'][()] if 't_offset' in file else 0)

    def blocks(name: str) -> Iterator[Block]:
        try:
            for rows, stated, headings in _sliced(
                groups[name], name == 'frames', str(groups[name].attrs.get('units', ''))
            ):
                if name == 'events' and 't' in rows:
                    rows['t'] = _signed(rows['t']) + _signed(offset)
                yield rows, stated, headings
        except OSError as error:
            raise RecordingError(
                f'{path}, {name}: {reason(error)}',
                remedy='pip install hdf5plugin, which reads compressed data of DSEC',
            ) from error

    return Tables(path, {name: partial(blocks, name) for name in groups}, file.close)


def _signed(numbers: NDArray[Any]) -> NDArray[Any]:
    """Return integers as `int64`, which a sum with others keeps; fractions as they are."""
    return numbers if numbers.dtype.kind == 'f' else numbers.astype(np.int64)
