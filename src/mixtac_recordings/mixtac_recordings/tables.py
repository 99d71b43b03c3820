# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Tables of any program: csv, NPZ and HDF5 files, read some rows at a time.

Tables are named and laid out as `mixtac_recordings.export` writes them; of files of others, the
usual names of columns are understood (`COLUMNS`), and HDF5 files in the layout of the DSEC data set
(`events/p, x, y, t` and `t_offset`).
"""

from __future__ import annotations

import contextlib
import csv
import itertools
import re
import warnings
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from mixtac_recordings.export import HDF5_SUFFIXES, open_hdf5
from mixtac_recordings.messages import BIT_SHIFT
from mixtac_recordings.recording import RecordingError

AXES: Final = 'xyz'
VECTORS: Final = ('force', 'torque', 'acceleration', 'angular_velocity')
COLUMNS: Final = {
    **dict.fromkeys(('time', 'timestamp', 'timestamps', 'stamp', 'ts'), 't'),
    **dict.fromkeys(('p', 'pol'), 'polarity'),
    **dict.fromkeys(('force', 'fz', 'f'), 'force_z'),
    'fx': 'force_x',
    'fy': 'force_y',
    'tx': 'torque_x',
    'ty': 'torque_y',
    'tz': 'torque_z',
}
"""Other names of columns, in lower case, and what they mean."""
KNOWN: Final = frozenset(
    (
        *('t', 'x', 'y', 'polarity', 'kind', 'force', 'temperature'),
        *('file', 'exposure_start', 'exposure_end'),
        *(f'{name}_{axis}' for name in VECTORS for axis in AXES),
    )
)
"""Columns that are read; all others are passed over."""
TIMES: Final = ('t', 'exposure_start', 'exposure_end')
"""Columns of times."""
UNITS: Final = {'ns': 1, 'us': 1_000, 'ms': 1_000_000, 's': 1_000_000_000}
"""Units of time [ns]."""
OTHER_UNITS: Final = {
    'force': ('N',),
    'torque': ('N', 'Nm'),
    'acceleration': ('m',),
    'angular_velocity': ('rad',),
}
"""Units that a heading may name for other columns, by their first word."""
NAMELESS: Final = ('f', 'force')
"""Headings that mean the normal force where no other does."""
ROWS: Final = 100_000
"""Rows that are read at once."""
_SUFFIX = re.compile(r'(.+)_(ns|us|ms|s)')
_HEADING = re.compile(r'\s*"?([^"\[(]*?)\s*(?:[\[(]\s*(\w+)[^\])]*[\])])?"?\s*')
Rows = dict[str, NDArray[Any]]


class Tables:
    """Tables of a file or a folder: rows in the order in which they are stored.

    Attributes:
        path: As given.
        names: Names of the tables.
    """

    def __init__(self, path: Path, names: set[str]) -> None:
        self.path, self.names = path, names

    def close(self) -> None:
        """Close the files."""

    def rows(self, name: str, unit: str, wanted_ns: int = 1000) -> Iterator[Rows]:
        """Yield the columns of a table, some rows at a time.

        Args:
            name: The table.
            unit: Unit of its times where it does not say so.
            wanted_ns: Unit of the times that are returned [ns].

        Raises:
            RecordingError: It cannot be read, or columns are missing.
        """
        for rows, units in self._rows(name):
            if name == 'frames' and 'exposure_start' not in rows and 't' in rows:
                rows['exposure_start'] = rows['exposure_end'] = rows['t']
            needed = {
                'events': ('t', 'x', 'y', 'polarity'),
                'frames': ('exposure_start', 'exposure_end', 'image'),
            }.get(name, ('t',))
            if missing := [each for each in needed if each not in rows]:
                raise RecordingError(
                    f'{self.path}: {name} has no column {missing[0]}, only {", ".join(rows)}',
                    remedy=f'name the columns {", ".join(needed)}',
                )
            for key in TIMES:
                if key in rows:
                    scale = UNITS[units.get(key, unit)]
                    if not _fits(rows[key], scale):
                        raise RecordingError(
                            f'{self.path}: {name} has times of {rows[key].min()} to '
                            f'{rows[key].max()} {units.get(key, unit)}',
                            remedy='give the unit of the times',
                        )
                    rows[key] = _scaled(rows[key], scale, wanted_ns)
            if name == 'frames' and 'origin' not in rows:
                rows['origin'] = np.zeros((len(rows['image']), 2), np.int64)
            if len(rows[needed[0]]):
                yield rows

    def _rows(self, name: str) -> Iterator[tuple[Rows, dict[str, str]]]:
        raise NotImplementedError


def _fits(t: NDArray[Any], unit_ns: int) -> bool:
    """Return whether all times are numbers that a stamp of ROS can hold."""
    largest = 2.0**31 * 1e9 / unit_ns
    return bool(np.isfinite(t).all() and np.abs(t.astype(np.float64)).max(initial=0) < largest)


def _scaled(t: NDArray[Any], unit_ns: int, wanted_ns: int) -> NDArray[np.int64]:
    if t.dtype.kind == 'f':
        return np.rint(t * (unit_ns / wanted_ns)).astype(np.int64)
    if unit_ns >= wanted_ns:
        return t.astype(np.int64) * (unit_ns // wanted_ns)
    return t.astype(np.int64) // (wanted_ns // unit_ns)


def open_tables(path: Path, name: str = 'events') -> Tables | None:
    """Return the tables of a path; None for an AEDAT4 file, a bag or what is no table.

    Args:
        path: File or folder.
        name: Name of the table in a csv or NPZ file.
    """
    if path.is_file() and path.suffix in HDF5_SUFFIXES:
        return _Hdf5Tables(path)
    for suffixes, cls in ((('.csv', '.txt'), _CsvTables), (('.npz',), _NpzTables)):
        if path.is_dir():
            files = {each.stem: each for each in path.glob(f'*{suffixes[0]}')}
        else:
            files = {name: path} if path.is_file() and path.suffix in suffixes else {}
        if files:
            return cls(path, files)
    return None


class _CsvTables(Tables):
    """CSV files, with headings or in the order t, x, y, p and t, fz."""

    def __init__(self, path: Path, files: dict[str, Path]) -> None:
        super().__init__(path, set(files))
        self._files = files

    def _rows(self, name: str) -> Iterator[tuple[Rows, dict[str, str]]]:
        path = self._files[name]
        with path.open(encoding='utf8', errors='replace') as file:
            first = next((line for line in file if line.strip(' \ufeff#\r\n')), '').lstrip(
                '\ufeff#'
            )
            if not first:
                raise RecordingError(f'{path} is empty')
            names, units = _headings(path, first)
            lines: Iterator[str] = file
            if names is None:
                names, lines = _unnamed(first), itertools.chain([first], file)
            if 'file' in names:
                yield from _picture_rows(path, names, units, lines)
                return
            while part := list(itertools.islice(lines, ROWS)):
                yield _parsed(path, names, part), units


def _delimiter(line: str) -> str:
    return next((each for each in ',;\t' if each in re.sub(r'"[^"]*"', '', line)), ',')


def _headings(path: Path, line: str) -> tuple[list[str] | None, dict[str, str]]:
    """Return names and units of columns, None for a row of numbers.

    Raises:
        RecordingError: Two columns have one meaning, or the unit of one is not known.
    """
    # Units may hold commas, but are quoted then; an index without a heading is a column, too.
    (parts,) = csv.reader([line.strip('\r\n')], delimiter=_delimiter(line), skipinitialspace=True)
    with contextlib.suppress(ValueError):
        float(parts[0])
        return None, {}
    names: list[str] = []
    units: dict[str, str] = {}
    for part in parts:
        match = _HEADING.fullmatch(part)
        name = (match[1] if match else part).strip().lower().replace(' ', '_')
        unit = match[2] if match else None
        if unit is None and (suffix := _SUFFIX.fullmatch(name)):
            name, unit = suffix[1], suffix[2]
        names.append(name)
        if unit:
            units[name] = unit
    meant = {name: COLUMNS.get(name, name) for name in names}
    for name in NAMELESS:
        if list(meant.values()).count('force_z') > 1 and name in meant:
            meant[name] = f'{name} beside force_z'
    for name, meaning in meant.items():
        if meaning in KNOWN and list(map(meant.get, names)).count(meaning) > 1:
            raise RecordingError(f'{path}: two columns mean {meaning}', remedy=f'rename {name}')
        _check_unit(path, name, meaning, units.get(name))
    named = {meant[name]: unit for name, unit in units.items()}
    return [meant[name] for name in names], named


def _check_unit(path: Path, name: str, meaning: str, unit: str | None) -> None:
    vector = OTHER_UNITS.get(re.sub('_[xyz]$', '', meaning))
    known = tuple(UNITS) if meaning in TIMES else vector
    if unit and known and unit not in known:
        raise RecordingError(
            f'{path}: the unit of {name} is {unit}, not {" or ".join(known)}',
            remedy='convert the column, or leave the unit out',
        )


def _unnamed(line: str) -> list[str]:
    count = len(re.split(r'[,;\t]', line))
    return ['t', 'x', 'y', 'polarity'] if count == 4 else ['t', 'force_z']


def _parsed(path: Path, names: list[str], lines: list[str]) -> Rows:
    delimiter = _delimiter(lines[0])
    wanted = {name: index for index, name in enumerate(names) if name in KNOWN}
    # Times of more digits than a float64 holds stay integers.
    whole = {name for name, index in wanted.items() if _whole(lines, delimiter, index)}
    try:
        found = _loaded(lines, delimiter, wanted, whole)
    except (ValueError, IndexError, DeprecationWarning):
        # A column may have fractions between whole numbers.
        try:
            found = _loaded(lines, delimiter, wanted, whole.intersection(TIMES))
        except (ValueError, IndexError, DeprecationWarning) as error:
            raise RecordingError(
                f'{path} is no table of numbers: {error}',
                remedy='write fractions of times in every row or none',
            ) from error
    return {name: np.ascontiguousarray(found[name]) for name in wanted}


def _loaded(
    lines: list[str], delimiter: str, wanted: dict[str, int], whole: set[str]
) -> NDArray[Any]:
    """Return columns by name, some of them as integers."""
    layout = np.dtype([(name, np.int64 if name in whole else np.float64) for name in wanted])
    columns = list(wanted.values())
    with warnings.catch_warnings():
        # NumPy would cut fractions off with a warning.
        warnings.simplefilter('error', DeprecationWarning)
        return np.loadtxt(lines, layout, delimiter=delimiter, usecols=columns, ndmin=1)


def _whole(lines: list[str], delimiter: str, index: int) -> bool:
    """Return whether the first and the last number of a column are integers."""
    cells = (line.split(delimiter)[index : index + 1] for line in (lines[0], lines[-1]))
    return all(cell and cell[0].strip().lstrip('+-').isdecimal() for cell in cells)


def _picture_rows(
    path: Path, names: list[str], units: dict[str, str], lines: Iterator[str]
) -> Iterator[tuple[Rows, dict[str, str]]]:
    """Yield one frame at a time: pictures named in a table, 8 bits or 16 left-aligned."""
    where = names.index('file')
    for line in lines:
        cells = line.strip().split(',')
        if len(cells) < len(names):
            continue
        picture = path.parent / cells[where].strip('"')
        image: Any = cv2.imread(str(picture), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
        if image is None:
            raise RecordingError(f'{picture} of {path} cannot be read', remedy='check the paths')
        ten = image >> BIT_SHIFT if image.dtype == np.uint16 else image.astype(np.uint16) << 2
        rest = [name for name in names if name != 'file']
        values = [cell for index, cell in enumerate(cells) if index != where]
        rows = _parsed(path, rest, [','.join(values)])
        if 'x' in rows:
            rows['origin'] = np.stack([rows.pop('x'), rows.pop('y')], axis=1).astype(np.int64)
        yield {**rows, 'image': ten[None]}, units


class _NpzTables(Tables):
    """NPZ files, one per table."""

    def __init__(self, path: Path, files: dict[str, Path]) -> None:
        super().__init__(path, set(files))
        self._files = files

    def _rows(self, name: str) -> Iterator[tuple[Rows, dict[str, str]]]:
        path = self._files[name]
        try:
            with np.load(path, allow_pickle=False) as file:
                columns = {key: file[key] for key in file.files}
        # A .npy file is an array, no context manager: AttributeError before Python 3.11.
        except (AttributeError, OSError, ValueError, TypeError, zipfile.BadZipFile) as error:
            raise RecordingError(f'{path} is no NPZ file of arrays: {error}') from error
        yield from _sliced(columns, name)


def _sliced(columns: Any, name: str) -> Iterator[tuple[Rows, dict[str, str]]]:  # noqa: ANN401
    """Yield columns of equal length, arrays or data sets, some rows at a time.

    Exported tables are in the units of `mixtac_recordings.export`.
    """
    columns = {
        COLUMNS.get(key.lower(), key.lower()) if np.ndim(each) == 1 else key: each
        for key, each in columns.items()
    }
    units = dict.fromkeys(('exposure_start', 'exposure_end'), 'us')
    exported = any(
        np.ndim(each) == 2 for key, each in columns.items() if key in {'force', 'acceleration'}
    )
    # Seconds are fractions.
    if exported and np.asarray(columns.get('t', ())[:1]).dtype.kind in 'iu':
        units['t'] = 'ns' if 'force' in columns else 'us'
    key = next((key for key in ('t', 'exposure_start') if key in columns), '')
    count = len(columns[key]) if key else 0
    used = {key: each for key, each in columns.items() if np.ndim(each) and len(each) == count}
    rows = 10 if name == 'frames' else ROWS
    for start in range(0, count, rows):
        yield {key: np.asarray(each[start : start + rows]) for key, each in used.items()}, units


class _Hdf5Tables(Tables):
    """An HDF5 file: groups are tables; times of events count from `t_offset`."""

    def __init__(self, path: Path) -> None:
        self._file = open_hdf5(path, 'r')
        super().__init__(path, {key for key, each in self._file.items() if hasattr(each, 'items')})

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _rows(self, name: str) -> Iterator[tuple[Rows, dict[str, str]]]:
        group = self._file[name]
        offset = np.int64(self._file['t_offset'][()]) if 't_offset' in self._file else np.int64(0)
        try:
            for rows, units in _sliced(group, name):
                if name == 'events' and 't' in rows:
                    rows['t'] = rows['t'].astype(np.int64) + offset
                yield rows, units
        except OSError as error:
            raise RecordingError(
                f'{self.path}, {name}: {error}',
                remedy='pip install hdf5plugin, which reads compressed data of DSEC',
            ) from error
