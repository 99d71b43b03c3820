# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Tables of any program: csv, NPZ and HDF5 files, read some rows at a time.

Tables are named and laid out as `mixtac_recordings.sinks` writes them; of files of others, the
usual names of columns are understood (`COLUMNS`), and HDF5 files in the layout of the DSEC data set
(`events/p, x, y, t` and `t_offset`).
"""

from __future__ import annotations

import codecs
import contextlib
import csv
import itertools
import math
import re
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, Final

import cv2
import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from mixtac_recordings.messages import BIT_SHIFT
from mixtac_recordings.recording import RecordingError
from mixtac_recordings.sinks import HDF5_SUFFIXES, UNITS_FILE, open_hdf5

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
    'torque': ('Nm', 'N m'),
    'acceleration': ('m/s^2',),
    'angular_velocity': ('rad/s',),
}
"""Units of other columns; headings are compared with their first words."""
NAMELESS: Final = ('f', 'force')
"""Headings that mean the normal force where no other does."""
ROWS: Final = 100_000
"""Rows that are read at once."""
_MOST_GREY = 1023
_SUFFIX = re.compile(r'(.+)_(ns|us|ms|s)')
_HEADING = re.compile(r'\s*"?([^"\[(]*?)\s*(?:[\[(]\s*(\w+)[^\])]*[\])])?"?\s*')
Rows = dict[str, NDArray[Any]]


class Tables:
    """Tables of a file or a folder: rows in the order in which they are stored.

    Attributes:
        path: As given.
        names: Names of the tables.
        exported: Whether they are arrays in the units of `mixtac_recordings.sinks`.
        headings: Headings of a table as they are in the file, by its name; arrays have none.
    """

    def __init__(self, path: Path, names: set[str], *, exported: bool = False) -> None:
        self.path, self.names, self.exported = path, names, exported
        self.headings: dict[str, list[str]] = {}

    def close(self) -> None:
        """Close the files."""

    def rows(
        self, name: str, unit: str, default: str = 'us', wanted_ns: int = 1000
    ) -> Iterator[Rows]:
        """Yield the columns of a table, some rows at a time; frames are of 10 bits.

        Args:
            name: The table.
            unit: Unit of its times where no heading says it; empty for that of exported tables,
                or `default`.
            default: Unit where nothing else says it; times must be whole numbers then, unless it is
                longer than the wanted one.
            wanted_ns: Unit of the times that are returned [ns].

        Raises:
            RecordingError: It cannot be read, columns or numbers are missing, or the times have
                another unit.
        """
        needed = {
            'events': ('t', 'x', 'y', 'polarity'),
            'frames': ('exposure_start', 'exposure_end', 'image'),
            'edges': ('t', 'kind'),
        }.get(name, ('t',))
        for rows, units in self._rows(name):
            if name == 'frames' and 'exposure_start' not in rows and 't' in rows:
                rows['exposure_start'] = rows['exposure_end'] = rows['t']
            if missing := [each for each in needed if each not in rows]:
                there = ', '.join(self.headings.get(name, rows)) or 'nothing that is known'
                raise RecordingError(
                    f'{self.path}: {name} has no column {missing[0]}, only {there}',
                    remedy=f'name the columns {", ".join(needed)}',
                )
            for key in needed:
                self._check_numbers(name, key, rows[key])
            for key in set(TIMES).intersection(rows):
                given = units.get(key) or unit
                if not given and self.exported and rows[key].dtype.kind in 'iu':
                    given = 'ns' if 'force' in rows else 'us'
                rows[key] = self._scaled(name, rows[key], given, default, wanted_ns)
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
            raise RecordingError(
                f'{self.path}: {name} has {key} = {column[~finite].flat[0]}: a missing value',
                remedy='remove the rows without a number',
            )
        if key in {'x', 'y'} and column.dtype.kind == 'f' and (between := column % 1 != 0).any():
            raise RecordingError(
                f'{self.path}: {name} has {key} = {column[between][0]}, between two pixels',
                remedy='give events as the camera sent them, without rectification',
            )

    def _scaled(
        self, name: str, t: NDArray[Any], given: str, default: str, wanted_ns: int
    ) -> NDArray[np.int64]:
        """Return times in the wanted unit."""
        unit_ns = UNITS[given or default]
        if np.abs(t.astype(np.float64)).max(initial=0) >= 2.0**31 * 1e9 / unit_ns:
            raise RecordingError(
                f'{self.path}: {name} has times of {t.min()} to {t.max()} {given or default},'
                ' which no stamp of ROS holds',
                remedy='give the unit of the times',
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
            return image.astype(np.uint16) << np.uint16(2)
        if image.dtype.kind not in 'iu':
            raise RecordingError(
                f'{self.path}: frames are of type {image.dtype}',
                remedy='store them as uint8, or as uint16 of 0 .. 1023',
            )
        least, most = int(image.min(initial=0)), int(image.max(initial=0))
        if least < 0 or most > _MOST_GREY:
            raise RecordingError(
                f'{self.path}: frames have values of {least} to {most}',
                remedy=f'scale them to 0 .. {_MOST_GREY}',
            )
        return image.astype(np.uint16)

    def _rows(self, name: str) -> Iterator[tuple[Rows, dict[str, str]]]:
        raise NotImplementedError


def open_tables(path: Path, name: str = 'events') -> Tables | None:
    """Return the tables of a path; None for an AEDAT4 file, a bag or what is no table.

    Args:
        path: File or folder.
        name: Name of the table in a csv or NPZ file.
    """
    if path.is_file() and path.suffix.lower() in HDF5_SUFFIXES:
        return _Hdf5Tables(path)
    for suffixes, cls in ((('.csv', '.txt'), _CsvTables), (('.npz',), _NpzTables)):
        if path.is_dir():
            files = {each.stem: each for each in path.glob(f'*{suffixes[0]}')}
        else:
            files = {name: path} if path.is_file() and path.suffix.lower() in suffixes else {}
        if files:
            return cls(path, files)
    return None


class _CsvTables(Tables):
    """CSV files, with headings or in the order t, x, y, p; t, fz; or t, forces, torques."""

    def __init__(self, path: Path, files: dict[str, Path]) -> None:
        super().__init__(path, set(files))
        self._files = files

    def _rows(self, name: str) -> Iterator[tuple[Rows, dict[str, str]]]:
        path = self._files[name]
        with path.open('rb') as file:
            wide = file.read(2) in {codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE}
        encoding = 'utf-16' if wide else 'utf-8-sig'
        try:
            with path.open(encoding=encoding, errors='replace') as file:
                lines: Iterator[str] = filter(str.strip, file)
                first = next((line for line in lines if line.strip(' #\r\n')), '').lstrip('#')
                if not first:
                    raise RecordingError(f'{path} is empty')
                separator = _separator(first)
                cells = _cells(first, separator)
                if _is_number(cells[0]):
                    names, units = _unnamed(path, cells), dict[str, str]()
                    lines = itertools.chain([first], lines)
                else:
                    names, units = _headings(path, cells)
                    self.headings[name] = cells
                if 'file' in names:
                    yield from _picture_rows(path, names, units, lines, separator)
                    return
                while part := list(itertools.islice(lines, ROWS)):
                    yield _parsed(path, names, part, separator), units
        except (csv.Error, UnicodeError) as error:
            raise RecordingError(f'{path} is no table: {error}') from error


_SEPARATORS: Final = ';,\t'
_ASIDE = re.compile(r'"[^"]*"|\[[^\]]*\]|\([^)]*\)')
"""Parts of a heading that may hold other separators: units, and what is quoted."""


def _separator(line: str) -> str:
    """Return what separates the columns of a table by its first line; a space for white space."""
    bare = _ASIDE.sub('', line)
    return next((each for each in _SEPARATORS if each in bare), ' ')


def _cells(line: str, separator: str) -> list[str]:
    """Return the cells of a line."""
    if separator == ' ':
        return line.split()
    # Units may hold commas, but are quoted then.
    (cells,) = csv.reader([line.strip('\r\n')], delimiter=separator, skipinitialspace=True)
    return cells


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(',', '.'))
    except ValueError:
        return False
    return True


def _headings(path: Path, cells: list[str]) -> tuple[list[str], dict[str, str]]:
    """Return names and units of columns.

    Raises:
        RecordingError: Two columns have one meaning, or the unit of one is not known.
    """
    names: list[str] = []
    units: dict[str, str] = {}
    for cell in cells:
        match = _HEADING.fullmatch(cell)
        name = (match[1] if match else cell).strip().lower().replace(' ', '_')
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
    if unit and known and unit not in [re.split(r'\W', each)[0] for each in known]:
        raise RecordingError(
            f'{path}: the unit of {name} is {unit}, not {" or ".join(known)}',
            remedy=f'convert the column to {known[-1]}',
        )


def _unnamed(path: Path, cells: list[str]) -> list[str]:
    """Return the names of columns without headings, by their number."""
    vectors = [f'{name}_{axis}' for name in ('force', 'torque') for axis in AXES]
    layouts = (['t', 'force_z'], ['t', 'x', 'y', 'polarity'], ['t', *vectors])
    for names in layouts:
        if len(names) == len(cells):
            return names
    raise RecordingError(
        f'{path} has {len(cells)} columns and no headings', remedy='add a line of headings'
    )


def _parsed(path: Path, names: list[str], lines: list[str], separator: str) -> Rows:
    wanted = {name: index for index, name in enumerate(names) if name in KNOWN}
    if not wanted:
        return {}
    if separator == ';':
        # Commas are decimal points.
        lines = [line.replace(',', '.') for line in lines]
    delimiter = None if separator == ' ' else separator
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
    lines: list[str], delimiter: str | None, wanted: dict[str, int], whole: set[str]
) -> NDArray[Any]:
    """Return columns by name, some of them as integers."""
    layout = np.dtype([(name, np.int64 if name in whole else np.float64) for name in wanted])
    columns = list(wanted.values())
    with warnings.catch_warnings():
        # NumPy would cut fractions off with a warning.
        warnings.simplefilter('error', DeprecationWarning)
        return np.loadtxt(lines, layout, delimiter=delimiter, usecols=columns, ndmin=1)


def _whole(lines: list[str], delimiter: str | None, index: int) -> bool:
    """Return whether the first and the last number of a column are integers."""
    cells = (line.split(delimiter)[index : index + 1] for line in (lines[0], lines[-1]))
    return all(cell and cell[0].strip().lstrip('+-').isdecimal() for cell in cells)


def _picture_rows(
    path: Path, names: list[str], units: dict[str, str], lines: Iterator[str], separator: str
) -> Iterator[tuple[Rows, dict[str, str]]]:
    """Yield one frame at a time: pictures named in a table, 8 bits or 16 left-aligned."""
    where = names.index('file')
    rest = [name for name in names if name != 'file']
    for line in lines:
        cells = _cells(line, separator)
        if len(cells) < len(names):
            raise RecordingError(
                f'{path}: {line.strip()!r} has {len(cells)} of {len(names)} columns',
                remedy='complete or remove the row',
            )
        picture = path.parent / cells.pop(where)
        image: Any = None
        # Pictures that claim more than 2^30 pixels.
        with contextlib.suppress(cv2.error):
            image = cv2.imread(str(picture), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
        if image is None:
            raise RecordingError(f'{picture} of {path} cannot be read', remedy='check the paths')
        rows = _parsed(path, rest, [separator.join(cells)], separator)
        if 'x' in rows:
            rows['origin'] = np.stack([rows.pop('x'), rows.pop('y')], axis=1).astype(np.int64)
        yield (
            {**rows, 'image': (image >> BIT_SHIFT if image.dtype == np.uint16 else image)[None]},
            units,
        )


class _NpzTables(Tables):
    """NPZ files, one per table, and what describes exported ones."""

    def __init__(self, path: Path, files: dict[str, Path]) -> None:
        folder = path if path.is_dir() else path.parent
        super().__init__(path, set(files), exported=(folder / UNITS_FILE).exists())
        self._files = files

    def _rows(self, name: str) -> Iterator[tuple[Rows, dict[str, str]]]:
        path = self._files[name]
        try:
            with zipfile.ZipFile(path) as archive:
                members = [each for each in archive.namelist() if each.endswith('.npy')]
                columns = {each[:-4]: _npz_column(archive, each) for each in members}
                for rows in _sliced(columns, name):
                    yield rows, {}
        # Archives that are encrypted or packed in another way: RuntimeError.
        except (
            OSError,
            ValueError,
            EOFError,
            OverflowError,
            RuntimeError,
            zipfile.BadZipFile,
            zlib.error,
        ) as error:
            raise RecordingError(f'{path} is no NPZ file of arrays: {error}') from error


def _npz_column(archive: zipfile.ZipFile, name: str) -> Any:  # noqa: ANN401
    """Return an array of an NPZ file; one whose rows are stored one after another is not loaded."""
    column = _StoredRows(archive.open(name))
    if not column.fortran_order:
        return column
    with archive.open(name) as file:
        return npy.read_array(file, allow_pickle=False)


class _StoredRows:
    """An array in a file, whose rows are read in their order, once.

    Args:
        file: The file, in the format `.npy`.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        readers = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
        version = npy.read_magic(file)
        if version not in readers:
            raise ValueError(f'an array in version {version} of the format')
        self.shape, self.fortran_order, self.dtype = readers[version](file)
        self.ndim = len(self.shape)
        if self.dtype.hasobject:
            raise ValueError('an array of objects')

    def __len__(self) -> int:
        return int(self.shape[0])

    def __getitem__(self, rows: slice) -> NDArray[Any]:
        """Return the next rows; the beginning of the slice must be where the last one ended."""
        count = len(range(len(self))[rows])
        size = count * self.dtype.itemsize * math.prod(self.shape[1:])
        return np.frombuffer(self._file.read(size), self.dtype).reshape(count, *self.shape[1:])


def _sliced(columns: Any, name: str) -> Iterator[Rows]:  # noqa: ANN401
    """Yield columns of equal length, arrays or data sets, some rows at a time."""
    columns = {
        COLUMNS.get(key.lower(), key.lower()) if np.ndim(each) == 1 else key: each
        for key, each in columns.items()
    }
    key = next((key for key in ('t', 'exposure_start') if key in columns), '')
    count = len(columns[key]) if key and np.ndim(columns[key]) else 0
    used = {key: each for key, each in columns.items() if np.ndim(each) and len(each) == count}
    rows = 10 if name == 'frames' else ROWS
    for start in range(0, count, rows):
        yield {key: np.asarray(each[start : start + rows]) for key, each in used.items()}


class _Hdf5Tables(Tables):
    """An HDF5 file: groups are tables; times of events count from `t_offset`."""

    def __init__(self, path: Path) -> None:
        self._file = open_hdf5(path, 'r')
        groups = {key for key, each in self._file.items() if hasattr(each, 'items')}
        super().__init__(path, groups, exported='units' in self._file.attrs)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _rows(self, name: str) -> Iterator[tuple[Rows, dict[str, str]]]:
        group = self._file[name]
        offset = np.asarray(self._file['t_offset'][()] if 't_offset' in self._file else 0)
        try:
            for rows in _sliced(group, name):
                if name == 'events' and 't' in rows:
                    rows['t'] = _signed(rows['t']) + _signed(offset)
                yield rows, {}
        except OSError as error:
            raise RecordingError(
                f'{self.path}, {name}: {error}',
                remedy='pip install hdf5plugin, which reads compressed data of DSEC',
            ) from error


def _signed(numbers: NDArray[Any]) -> NDArray[Any]:
    """Return integers as `int64`, which a sum with others keeps; fractions as they are."""
    return numbers if numbers.dtype.kind == 'f' else numbers.astype(np.int64)
