# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The interface of recordings: pieces of a camera's stream in recorded order.

Readers of a format are in `mixtac_recordings.camera_stream` (bags) and `mixtac_recordings.aedat4`.
"""

from __future__ import annotations

import sys
from collections.abc import Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import lz4.frame

from mixtac_events.arrays import Events
from mixtac_events.errors import MixtacError
from mixtac_events.readings import NO_EDGES, NO_SAMPLES, Edges, Frame, InertialSamples
from mixtac_events.windows import RESTART_US

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd


class RecordingError(MixtacError):
    """A recording that is missing, unreadable or unwritable, or lacks the topics asked for."""


class DamagedRecordingError(RecordingError):
    """Recorded data that violate their format."""


LARGEST_EXPANDED = 1 << 28
"""Most bytes that a packet, chunk or message may hold or expand to: 16 million events."""


def expand(compression: str, data: bytes, size: int = LARGEST_EXPANDED) -> bytes:
    """Return compressed data expanded, to at most `LARGEST_EXPANDED` bytes.

    Args:
        compression: `lz4` or `zstd`.
        data: One frame of it.
        size: Most bytes of the result.

    Raises:
        DamagedRecordingError: The data are damaged or cut off, or expand to more.
    """
    limit = min(size, LARGEST_EXPANDED)
    unpacker: Any = (
        lz4.frame.LZ4FrameDecompressor() if compression == 'lz4' else zstd.ZstdDecompressor()
    )
    try:
        # One byte more: the end of a frame is found only when its last block has been taken.
        found: bytes = unpacker.decompress(data, limit + 1)
    except (RuntimeError, EOFError, zstd.ZstdError) as error:
        raise DamagedRecordingError(f'compressed data are damaged: {error}') from error
    if not unpacker.eof or len(found) > limit:
        raise DamagedRecordingError(
            f'compressed data are cut off, or expand to more than {limit} bytes'
        )
    return found


AEDAT4_SUFFIX = '.aedat4'
BAG_SUFFIXES = ('.mcap', '.db3')
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
        times = [self.start_us, self.until_us]
        if len(self.events):
            times += [int(self.events.t.min()), int(self.events.t.max())]
        if min(times) < 0 or max(times) > LATEST_US:
            raise DamagedRecordingError(
                f'a time of {min(times)} .. {max(times)} us is outside 0 .. {LATEST_US}'
            )


@dataclass(frozen=True, slots=True)
class RecordingInfo:
    """Description of a recording, known when it is opened.

    Attributes:
        path: File or folder.
        kind: Format, as shown to users.
        camera: Serial number of the camera, or its name as in AEDAT4 files (`DAVIS346_SERIAL`);
            empty where none is recorded.
        width: Columns of the camera.
        height: Rows of the camera.
        color_filter: Colour filter of the camera, 0 for none; see `messages.BAYER`.
        start_us: Time of the first event, or of the first piece of a recording without events [us,
            recorded camera clock].
        length_us: Length [us], to within the time that data took to reach the recorder.
        contents: What is read: kind of data and name of its topic or stream.
        damage: What is missing because the file is incomplete, or a topic that cannot be read;
            empty for a sound recording.
    """

    path: Path
    kind: str
    camera: str
    width: int
    height: int
    color_filter: int
    start_us: int
    length_us: int
    contents: tuple[tuple[str, str], ...]
    damage: str = ''


@dataclass(slots=True)
class ReadCounters:
    """Losses found while reading.

    Attributes:
        packets_missing: Event packets that are missing by their numbers.
        events_outside: Events dropped because they lie outside the sensor.
    """

    packets_missing: int = 0
    events_outside: int = 0


class Recording(Protocol):
    """A recording, open for reading."""

    info: RecordingInfo
    counters: ReadCounters

    def pieces(self, from_us: int) -> Generator[Piece, None, None]:
        """Yield the recorded data in order, reading as they are needed.

        Args:
            from_us: Time to begin at [us, recorded camera clock]; earlier pieces may come first.

        Raises:
            RecordingError: The data are damaged.
        """

    def close(self) -> None:
        """Close the file."""


def from_time(pieces: Iterable[Piece], from_us: int) -> Iterator[Piece]:
    """Yield pieces without the data before a time.

    Once a recorded clock was reset, everything counts as later. What was recorded before the first
    packet of the new clock comes after it.

    Args:
        pieces: Pieces in recorded order.
        from_us: The time [us, recorded camera clock].
    """
    skipping, latest_us = True, 0
    held: list[Piece] = []
    for piece in pieces:
        behind = piece.until_us < latest_us - RESTART_US
        if not piece.advances:
            if behind:
                held.append(piece)
            else:
                yield from _from_time(piece, from_us, skipping=skipping)
            continue
        skipping = skipping and piece.start_us < from_us and not behind
        latest_us = piece.until_us if behind else max(latest_us, piece.until_us)
        for each in (piece, *held):
            yield from _from_time(each, from_us, skipping=skipping)
        held.clear()
    for each in held:
        yield from _from_time(each, from_us, skipping=skipping)


def _from_time(piece: Piece, from_us: int, *, skipping: bool) -> Iterator[Piece]:
    if not skipping or piece.start_us >= from_us:
        yield piece
    elif piece.until_us >= from_us:
        yield replace(
            piece,
            start_us=from_us,
            events=piece.events[piece.events.t >= from_us],
            frames=tuple(frame for frame in piece.frames if frame.middle_us >= from_us),
            imu=piece.imu[piece.imu.t >= from_us],
            edges=piece.edges[piece.edges.t >= from_us],
        )


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
    remedy = (
        f'choose one of {", ".join(found)}, or none, with --{kind} of `mixtac export` or `import`'
        f' (playback_{kind}_topic of the driver)'
    )
    if wanted and wanted not in found:
        raise RecordingError(f'{path} has no {kind} {wanted!r}', remedy=remedy if found else '')
    if not wanted and len(found) > 1:
        # What the driver publishes without lens distortion lies beside what it comes from.
        found = [name for name in found if not name.endswith('_rect')] or found
    if wanted or len(found) < 2:
        return wanted or next(iter(found), None)
    space = f'{beside.rpartition("/")[0]}/'
    # Samples are a level below: imu/data_raw.
    depths = {name: name.count('/') for name in found if beside and name.startswith(space)}
    near = [name for name, depth in depths.items() if depth == min(depths.values())]
    if len(near) == 1:
        return near[0]
    raise RecordingError(f'{path} has several {kind} topics', remedy=remedy)
