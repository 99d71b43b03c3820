# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""AEDAT4 files, as DV and dv-processing write them, as recordings.

The file is read as it is played. Every stream lies in it in packets of its own size (often half a
second of inertial samples beside 10 ms of events): they are cut up and merged by time.
"""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING

import numpy as np

from mixtac_driver.errors import DamagedRecordingError, RecordingError
from mixtac_driver.recordings import aedat4_readings as readings
from mixtac_driver.recordings.aedat4_file import Aedat4File, StreamInfo
from mixtac_driver.recordings.pieces import Piece, ReadCounters, RecordingInfo
from mixtac_driver.recordings.topics import choose

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator
    from pathlib import Path
    from typing import Any

    from numpy.typing import NDArray

    from mixtac_driver.recordings.flatbuffer import Octets
    from mixtac_driver.recordings.playback_parameters import PlaybackParameters

SUFFIX = '.aedat4'
_KINDS = {'EVTS': 'events', 'FRME': 'image', 'IMUS': 'imu', 'TRIG': 'triggers'}


class Aedat4Recording:
    """An AEDAT4 file.

    Args:
        path: The file.
        parameters: Which of its streams to play. Triggers always are, those of the camera that
            the events are from.

    Attributes:
        info: What is known of it.
        counters: What was found amiss so far.

    Raises:
        RecordingError: It cannot be read, is empty, or leaves a choice of streams.
    """

    def __init__(self, path: Path, parameters: PlaybackParameters) -> None:
        self.counters = ReadCounters()
        self._path = path
        self._file = Aedat4File(path)
        try:
            self._chosen = self._choose(parameters)
            index = self._file.index()
            self._packets = {
                s.identifier: index[index['stream'] == s.number] for s in self._chosen.values()
            }
            self._packets = {name: each for name, each in self._packets.items() if len(each)}
            self.info = self._info()
        except RecordingError:
            self.close()
            raise

    def close(self) -> None:
        """Give the file back."""
        self._file.close()

    def pieces(self, from_us: int) -> Generator[Piece, None, None]:
        """Yield what was recorded, merged by time.

        Args:
            from_us: Time to begin at [us]; earlier pieces may come first.

        Raises:
            RecordingError: The file is damaged.
        """
        readers: dict[str, Callable[[Octets], Iterator[Piece]]] = {
            'EVTS': self._events,
            'FRME': self._frames,
            'IMUS': self._samples,
            'TRIG': self._edges,
        }
        streams = [
            self._stream(packets[packets['end_us'] >= from_us], readers[identifier])
            for identifier, packets in self._packets.items()
        ]
        yield from heapq.merge(*streams, key=lambda piece: piece.start_us)

    def _stream(
        self, packets: NDArray[Any], reader: Callable[[Octets], Iterator[Piece]]
    ) -> Iterator[Piece]:
        for packet in packets:
            data = self._file.packet(packet)
            try:
                for piece in reader(data):
                    piece.check()
                    yield piece
            except DamagedRecordingError as error:
                raise self._file.damaged(str(error)) from error
            except RecordingError as error:
                raise RecordingError(f'{self._path}: {error}') from error

    def _events(self, data: Octets) -> Iterator[Piece]:
        for events in readings.events(data):
            inside = (events.x < self.info.width) & (events.y < self.info.height)
            self.counters.events_outside += int(np.count_nonzero(~inside))
            start_us, until_us = int(events.t[0]), int(events.t[-1])
            kept = events if inside.all() else events[inside]
            yield Piece(start_us, until_us, advances=True, events=kept)

    def _frames(self, data: Octets) -> Iterator[Piece]:
        frame = readings.frame(data)
        t_us = frame.exposure_end_us
        yield Piece(t_us, t_us, advances=self._alone, frames=(frame,))

    def _samples(self, data: Octets) -> Iterator[Piece]:
        for imu in readings.samples(data):
            yield Piece(int(imu.t[0]), int(imu.t[-1]), advances=self._alone, imu=imu)

    def _edges(self, data: Octets) -> Iterator[Piece]:
        for edges in readings.edges(data):
            yield Piece(int(edges.t[0]), int(edges.t[-1]), advances=self._alone, edges=edges)

    @property
    def _alone(self) -> bool:
        return 'EVTS' not in self._packets

    def _choose(self, parameters: PlaybackParameters) -> dict[str, StreamInfo]:
        wanted = {
            'EVTS': parameters.playback_events_topic,
            'FRME': parameters.playback_image_topic,
            'IMUS': parameters.playback_imu_topic,
        }
        chosen: dict[str, StreamInfo] = {}
        for identifier, name in wanted.items():
            found = {s.name: s for s in self._file.streams if s.identifier == identifier}
            kind = _KINDS[identifier]
            taken = choose(list(found), name, kind=kind, path=self._path)
            if taken is not None:
                chosen[identifier] = found[taken]
        if 'EVTS' in chosen:
            source = chosen['EVTS'].source
            for stream in self._file.streams:
                if (stream.identifier, stream.source) == ('TRIG', source):
                    chosen['TRIG'] = stream
        return chosen

    def _info(self) -> RecordingInfo:
        if not self._packets:
            raise RecordingError(
                f'{self._path} holds no events, frames or inertial samples to play: record it again'
            )
        every = list(self._packets.values())
        first = self._packets.get('EVTS')
        starts = [int(each['start_us'].min()) for each in every]
        start_us = int(first['start_us'][0]) if first is not None else min(starts)
        camera = next(iter(self._chosen.values()))
        sized = [s for s in self._chosen.values() if s.width and s.height]
        if not sized:
            raise RecordingError(f'{self._path} does not say how large its camera is')
        return RecordingInfo(
            path=self._path,
            kind='AEDAT4 file',
            camera=camera.source,
            width=sized[0].width,
            height=sized[0].height,
            color_filter=0,
            start_us=start_us,
            length_us=max(int(each['end_us'].max()) for each in every) - start_us,
            contents=tuple((_KINDS[key], self._chosen[key].name) for key in self._packets),
        )
