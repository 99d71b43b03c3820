# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What every recording offers, whatever its format: pieces of a camera's stream in recorded order.

Readers of a format are in `mixtac_recordings.camera_stream` (bags) and `mixtac_recordings.aedat4`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

from mixtac_events.arrays import Events
from mixtac_events.errors import MixtacError
from mixtac_events.readings import NO_EDGES, NO_SAMPLES, Edges, Frame, InertialSamples
from mixtac_node.parameters import parameter

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable, Iterator, Sequence
    from pathlib import Path


class RecordingError(MixtacError):
    """A recording that cannot be played; opening it again does not help."""


class DamagedRecordingError(RecordingError):
    """Recorded data that are not what their format demands."""


class BagError(MixtacError):
    """A recording that is missing, damaged, or without the topics asked for."""


RESTART_US = 1_000_000
"""Time that goes back by more than this is a clock that was reset, not a late packet."""
LATEST_US = (1 << 31) * 1_000_000 - 1
"""End of what a ROS stamp can hold."""


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """Something recorded; times [us] are on the recorded camera clock.

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
        """Refuse times that no stamp can hold.

        Raises:
            DamagedRecordingError: As said.
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
    """What is known of a recording when it is opened.

    Attributes:
        path: File or folder.
        kind: Format, for people.
        camera: Name of the camera, as far as recorded.
        width: Columns of the camera.
        height: Rows of the camera.
        color_filter: Colour filter of the camera, as in `identity.Features`.
        start_us: Time of the first event, or of the first piece of a recording without events [us,
            recorded camera clock].
        length_us: Length [us], to within the time that data took to reach the recorder.
        contents: What is played: kind of data and name of its topic or stream.
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


@dataclass(slots=True)
class ReadCounters:
    """What was found amiss while reading.

    Attributes:
        packets_missing: Event packets that the recorder did not get.
        events_outside: Events dropped because they lie outside the sensor.
    """

    packets_missing: int = 0
    events_outside: int = 0


class Recording(Protocol):
    """A recording, open for reading."""

    info: RecordingInfo
    counters: ReadCounters

    def pieces(self, from_us: int) -> Generator[Piece, None, None]:
        """Yield what was recorded, in order, reading as it goes.

        Args:
            from_us: Time to begin at [us, recorded camera clock]; earlier pieces may come first.

        Raises:
            RecordingError: The data are damaged.
        """

    def close(self) -> None:
        """Give the file back."""


def from_time(pieces: Iterable[Piece], from_us: int) -> Iterator[Piece]:
    """Yield pieces without what lies before a time.

    Once a recorded clock was reset, everything counts as later.

    Args:
        pieces: Pieces in recorded order.
        from_us: The time [us, recorded camera clock].
    """
    skipping, latest_us = True, 0
    for piece in pieces:
        if skipping and piece.advances:
            skipping = piece.start_us < from_us and piece.until_us >= latest_us - RESTART_US
            latest_us = max(latest_us, piece.until_us)
        if not skipping or piece.start_us >= from_us:
            yield piece
        elif piece.until_us >= from_us:
            yield _clipped(piece, from_us)


def _clipped(piece: Piece, from_us: int) -> Piece:
    keep = piece.imu.t >= from_us
    imu = InertialSamples(
        piece.imu.t[keep],
        piece.imu.acceleration[keep],
        piece.imu.angular_velocity[keep],
        piece.imu.temperature[keep],
    )
    late = piece.edges.t >= from_us
    return Piece(
        start_us=from_us,
        until_us=piece.until_us,
        advances=piece.advances,
        events=piece.events[piece.events.t >= from_us],
        frames=tuple(frame for frame in piece.frames if frame.middle_us >= from_us),
        imu=imu,
        edges=Edges(piece.edges.t[late], piece.edges.kind[late]),
    )


NO_SEEK = -1.0
NONE = 'none'
"""Name of a topic that stands for: do not play this kind of data."""
_WHICH = 'empty takes the only one, none plays none'


@dataclass(frozen=True)
class PlaybackParameters:
    """How a recording is played."""

    playback_rate: float = parameter(
        1.0,
        'Speed of a recording: 1 is real time, 0 as fast as its subscribers allow',
        minimum=0.0,
        maximum=1000.0,
    )
    playback_loop: bool = parameter(
        False,
        'A recording starts again at its end; stamps go on by its length and 1 ms',
    )
    playback_paused: bool = parameter(False, 'A recording stands still')
    playback_start: float = parameter(
        0.0,
        'Where in a recording to begin, also when looping',
        unit='s',
        minimum=0.0,
        maximum=1e9,
        read_only=True,
    )
    playback_seek: float = parameter(
        NO_SEEK,
        'A new value jumps there, counted from the first event; stamps never go back: after a jump '
        'to an earlier place they go on 1 ms after the latest; -1 does nothing; without effect '
        'once a recording has ended',
        unit='s',
        minimum=NO_SEEK,
        maximum=1e9,
    )
    playback_restamp: bool = parameter(
        False,
        'Stamps are moved to the time of playing (at the start, at loops and jumps) instead of '
        'being those recorded',
        read_only=True,
    )
    playback_clock: bool = parameter(
        False,
        'The recorded camera clock is published on /clock, for nodes with use_sim_time; the driver '
        'itself stays on the host clock',
        read_only=True,
    )
    playback_events_topic: str = parameter(
        '', f'Which topic or stream of events to play; {_WHICH}', read_only=True
    )
    playback_image_topic: str = parameter(
        '', f'Which topic or stream of frames to play; {_WHICH}', read_only=True
    )
    playback_imu_topic: str = parameter(
        '', f'Which topic or stream of inertial samples to play; {_WHICH}', read_only=True
    )


def choose(
    found: Sequence[str], wanted: str, *, kind: str, path: object, beside: str = ''
) -> str | None:
    """Return the name of the topic to play, or None for none of them.

    Args:
        found: Topics that hold such data.
        wanted: The parameter: a name, empty or `none`.
        kind: What it holds, as in the name of the parameter: events, image or imu.
        path: The recording, for messages.
        beside: A topic; of several, one in its namespace is taken if it is the only one there.

    Raises:
        RecordingError: The wanted one is not there, or several are and none was named.
    """
    listed = ', '.join(found) or 'none'
    if wanted == NONE:
        return None
    if wanted and wanted not in found:
        raise RecordingError(
            f'{path} has no {kind} {wanted!r}; it has {listed}: change playback_{kind}_topic'
        )
    if wanted or not found:
        return wanted or None
    if len(found) == 1:
        return found[0]
    space = beside.rpartition('/')[0]
    near = [name for name in found if beside and name.rpartition('/')[0] == space]
    if len(near) == 1:
        return near[0]
    raise RecordingError(
        f'{path} has several {kind} topics: choose one of {listed} with playback_{kind}_topic'
    )
