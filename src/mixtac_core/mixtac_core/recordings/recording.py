# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The interface of recordings: pieces of a camera's stream in recorded order.

Readers of a format are in `camera_stream` (bags), `aedat` and `table_recording` beside this module.
The table `FORMATS` lists the known file formats.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_core.events.errors import MixtacError
from mixtac_core.events.readings import NO_EDGES, NO_SAMPLES, Edges, Frame, InertialSamples


class RecordingError(MixtacError):
    """A recording that is missing, unreadable or unwritable, or lacks the topics asked for."""


class DamagedRecordingError(RecordingError):
    """Recorded data that violate their format."""


def reason(error: Exception) -> str:
    """Return the text of an error of a library in one line; its type where it has none."""
    return ' '.join(str(error).split()) or type(error).__name__


AEDAT4_SUFFIX = '.aedat4'
AEDAT4_FILE = f'recording{AEDAT4_SUFFIX}'
"""Name of the file that an export as AEDAT4 makes."""
BAG_SUFFIXES = ('.mcap', '.db3')
ROS1_SUFFIX = '.bag'
HDF5_SUFFIXES = ('.h5', '.hdf5')
NPZ_SUFFIX = '.npz'
TEXT_SUFFIXES = ('.csv', '.txt')


class FileFormat(NamedTuple):
    """A file format that people bring.

    Attributes:
        name: As shown to users.
        magic: First bytes of its files; empty where they have none.
        suffixes: Suffixes of its files.
        remedy: What to do with a file of it; empty where it is read.
    """

    name: str
    magic: bytes
    suffixes: tuple[str, ...]
    remedy: str = ''


_EXPORT = 'export events as csv with columns t, x, y, p and run `mixtac import` on them'
_METAVISION = f'with metavision_file_to_csv {_EXPORT}'
AEDAT4 = FileFormat('AEDAT4', b'#!AER-DAT4', (AEDAT4_SUFFIX,))
AEDAT2 = FileFormat('AEDAT 2', b'#!AER-DAT2', ('.aedat',))
ZSTD = FileFormat('zstd', b'\x28\xb5\x2f\xfd', ('.zst', '.zstd'), 'expand it with `zstd -d`')
FORMATS = (
    FileFormat('rosbag2 (MCAP)', b'\x89MCAP0\r\n', BAG_SUFFIXES[:1]),
    FileFormat('rosbag2 (sqlite3)', b'SQLite format 3\0', BAG_SUFFIXES[1:]),
    FileFormat('ROS 1 bag', b'#ROSBAG V2', (ROS1_SUFFIX,)),
    AEDAT4,
    AEDAT2,
    FileFormat('HDF5', b'\x89HDF', HDF5_SUFFIXES),
    FileFormat('NPZ', b'PK\x03\x04', (NPZ_SUFFIX,)),
    FileFormat('csv', b'', TEXT_SUFFIXES),
    FileFormat('AEDAT 1', b'#!AER-DAT1', ('.aedat',), f'open it in jAER, {_EXPORT}'),
    FileFormat('AEDAT 3', b'#!AER-DAT3', ('.aedat',), f'open it in DV, {_EXPORT}'),
    FileFormat('Prophesee DAT', b'% Data file', ('.dat',), _METAVISION),
    FileFormat('Prophesee RAW', b'% ', ('.raw',), _METAVISION),
    FileFormat('Event Stream', b'Event Stream', ('.es',), f'with the package loris {_EXPORT}'),
    FileFormat('pointer of git-lfs', b'version https://git-lfs', (), 'run `git lfs pull`'),
    FileFormat('gzip', b'\x1f\x8b', ('.gz',), 'expand it with `gzip -d`'),
    ZSTD,
)
"""File formats by name: those that are read, and others with what to do."""


def file_format(path: Path) -> FileFormat | None:
    """Return the format of a file, by its first bytes or else its suffix; None if it is unknown."""
    try:
        with path.open('rb') as file:
            begin = file.read(32)
    except OSError:
        begin = b''
    found = [each for each in FORMATS if each.magic and begin.startswith(each.magic)]
    found += [each for each in FORMATS if path.suffix.lower() in each.suffixes]
    return found[0] if found else None


def not_a_recording(path: Path) -> RecordingError:
    """Return the error for a path that is not read as a recording, with what to do with it."""
    known = file_format(path) if path.is_file() else None
    if known is None:
        what = 'folder without .mcap or .db3 files' if path.is_dir() else 'file of unknown format'
        remedy = '`mixtac inspect --formats` lists the formats that are read'
        return RecordingError(f'{path} is no recording: a {what}', remedy=remedy)
    remedy = known.remedy or f'run `mixtac import` on it as {path.stem}{known.suffixes[0]}'
    return RecordingError(f'{path} is of the format {known.name}', remedy=remedy)


LATEST_US = (1 << 31) * 1_000_000 - 1
"""Latest time of a ROS stamp [us]."""


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """A stretch of recorded data; times [us] are on the recorded camera clock.

    Attributes:
        start_us: Earliest time in it.
        until_us: Latest time in it.
        advances: True where nothing before `until_us` follows it. False for what may be recorded
            ahead of events of the same time (frames, samples, edges beside events).
        events: Events.
        frames: Frames.
        imu: Inertial samples.
        edges: Edges of the external input and the generator.
    """

    start_us: int
    until_us: int
    advances: bool
    events: Events = field(default_factory=Events.empty)
    frames: tuple[Frame, ...] = ()
    imu: InertialSamples = NO_SAMPLES
    edges: Edges = NO_EDGES

    def check(self) -> None:
        """Check that all times fit into ROS stamps.

        Raises:
            DamagedRecordingError: A time is negative or too large.
        """
        t = np.append(self.events.t, (self.start_us, self.until_us))
        if t.min() < 0 or t.max() > LATEST_US:
            raise DamagedRecordingError(
                f'a time of {t.min()} .. {t.max()} us is outside 0 .. {LATEST_US}'
            )


@dataclass(frozen=True, slots=True)
class RecordingInfo:
    """Description of a recording, known when it is opened.

    Attributes:
        path: File or folder.
        kind: Format, as shown to users.
        width: Columns of the camera.
        height: Rows of the camera.
        camera: Serial number of the camera, or its name as in AEDAT4 files (`DAVIS346_SERIAL`);
            empty where none is recorded.
        color_filter: Colour filter of the camera, 0 for none; see `messages.BAYER`.
        start_us: Time of the first event, or of the first piece of a recording without events [us,
            recorded camera clock].
        length_us: Length [us], to within the time that data took to reach the recorder; 0 where it
            is not known before the recording is read.
        contents: What is read: kind of data and name of its topic or stream.
        size_known: False where the recording does not state the size of the camera.
        damage: What is missing because the file is incomplete, or a topic that cannot be read;
            empty for a sound recording.
    """

    path: Path
    kind: str
    width: int
    height: int
    camera: str = ''
    color_filter: int = 0
    start_us: int = 0
    length_us: int = 0
    contents: tuple[tuple[str, str], ...] = ()
    size_known: bool = True
    damage: str = ''


@dataclass(slots=True)
class ReadCounters:
    """Losses found while reading.

    Attributes:
        packets_missing: Event packets that are missing by their numbers.
        events_outside: Events left out because they lie outside the sensor.
        events_unsorted: Events that were older than the one before in their message; sorted.
        frames_without_time: Frames left out because their stamp is zero.
        frames_incomplete: Frames in AEDAT 2 with missing pixels, which are left out.
        other_words: Words of inertial samples and edges in AEDAT 2.
    """

    packets_missing: int = 0
    events_outside: int = 0
    events_unsorted: int = 0
    frames_without_time: int = 0
    frames_incomplete: int = 0
    other_words: int = 0

    def warnings(self) -> list[str]:
        """Return the missing parts, one line for each."""
        texts = {
            'packets_missing': 'packets missing',
            'events_outside': 'events outside of the sensor left out',
            'events_unsorted': 'events out of order in their message, sorted',
            'frames_without_time': 'images with the stamp zero left out',
            'frames_incomplete': 'frames left out because pixels are missing',
            'other_words': 'words of inertial samples and edges of AEDAT 2 left out',
        }
        return [f'{getattr(self, key)} {text}' for key, text in texts.items() if getattr(self, key)]


Wrenches = Iterator[tuple[NDArray[np.int64], NDArray[np.float64]]]
"""Stamps [ns, clock of the topic], int64 [n], and force [N] and torque [N m], float64 [n, 6]."""


NONE = 'none'
"""Instead of the name of a topic: do not read this kind of data."""


@dataclass(frozen=True, slots=True)
class Selection:
    """Which topics of a bag, or streams of an AEDAT4 file, to read.

    Of each kind: a name, empty for the only one, or `NONE`.

    Attributes:
        events: Event packets.
        image: Frames.
        imu: Inertial samples.
    """

    events: str = ''
    image: str = ''
    imu: str = ''


def choose(
    found: Sequence[str], wanted: str, *, kind: str, path: object, beside: str = ''
) -> str | None:
    """Return the name of the topic to read, or None for none of them.

    Args:
        found: Topics that hold such data.
        wanted: A name, empty or `NONE`, as in `Selection`.
        kind: Kind of data, as in `Selection`: events, image or imu.
        path: The recording, for messages.
        beside: A topic; of several, the one that is highest in its namespace is taken.

    Raises:
        RecordingError: The wanted one is missing, or there are several and none was named.
    """
    if wanted == NONE:
        return None
    names = [name for name in found if wanted in ('', name)]
    if len(names) > 1:
        # What the driver publishes without lens distortion lies beside what it comes from.
        names = [name for name in names if not name.endswith('_rect')] or names
    if len(names) > 1 and beside:
        space = f'{beside.rpartition("/")[0]}/'
        names = [name for name in names if name.startswith(space)]
        # Samples are a level below: imu/data_raw.
        names = [name for name in names if name.count('/') == min(n.count('/') for n in names)]
    if len(names) == 1 or not (found or wanted):
        return names[0] if names else None
    remedy = (
        f'choose one of {", ".join(found)}, or none, with --{kind} of `mixtac export` or `import`'
        f' (playback_{kind}_topic of the driver)'
    )
    what = f'no {kind} {wanted!r}' if wanted else f'several {kind} topics'
    raise RecordingError(f'{path} has {what}', remedy=remedy if found else '')
