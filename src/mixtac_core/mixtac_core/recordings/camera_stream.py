# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Open a recording; read events, frames, samples and edges of one camera from a bag.

The camera clock is that of the event packets. This driver stamps frames and samples on it as well.
Other drivers stamp them with host time: they are shifted by the difference between the stamp of the
first event packet and its events, which is correct to within the transport delay.

Bags of ROS 1 may hold arrays of events with a time each. `dvs_msgs`, `dv_ros_msgs` and
`prophesee_event_msgs` have the same fields: a header, rows, columns, and per event 13 bytes with
column, row, seconds, nanoseconds and polarity.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Generator, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import TypeAlias

import numpy as np

from mixtac_core.events.arrays import Events
from mixtac_core.events.codec import StreamDecoder
from mixtac_core.events.errors import MixtacError
from mixtac_core.events.packets import SequenceCounter
from mixtac_core.node import topics
from mixtac_core.node.topics import stamp_to_us
from mixtac_core.recordings import messages as convert
from mixtac_core.recordings.aedat import open_aedat2, open_aedat4
from mixtac_core.recordings.bag import BagFile, is_bag
from mixtac_core.recordings.messages import Message
from mixtac_core.recordings.recording import (
    AEDAT2,
    AEDAT4,
    AEDAT4_FILE,
    DamagedRecordingError,
    Piece,
    ReadCounters,
    RecordingError,
    RecordingInfo,
    Selection,
    Wrenches,
    choose,
    file_format,
    not_a_recording,
)
from mixtac_core.recordings.table_recording import FileRecording, open_table_recording
from mixtac_core.recordings.tables import HDF5_FILE, TableOptions

OTHER_CLOCK_US = 60_000_000
"""Event times that differ by more than this from the stamp of their packet are on another clock."""
EVENT_ARRAYS = tuple(
    f'{package}/msg/EventArray' for package in ('dvs_msgs', 'dv_ros_msgs', 'prophesee_event_msgs')
)
"""Names of the message types, as rosbags gives them."""
_HEADER = struct.Struct('<4I')
_SIZES = struct.Struct('<3I')
_EVENT = np.dtype([('x', '<u2'), ('y', '<u2'), ('s', '<u4'), ('ns', '<u4'), ('polarity', 'u1')])


def read_event_array(data: bytes, counters: ReadCounters) -> Message:
    """Return a serialised message; `events` are `Events` in the sensor, sorted by time [us].

    Args:
        data: The message, as ROS 1 serialises it.
        counters: Counts events that are left out or sorted.

    Raises:
        DamagedRecordingError: It is cut off.
    """
    try:
        seq, seconds, nanoseconds, length = _HEADER.unpack_from(data)
        at = _HEADER.size + length
        height, width, count = _SIZES.unpack_from(data, at)
        rows = np.frombuffer(data, _EVENT, count, at + _SIZES.size)
    except (struct.error, ValueError) as error:
        raise DamagedRecordingError(f'message of {len(data)} bytes is cut off: {error}') from error
    inside = rows[(rows['x'] < width) & (rows['y'] < height)]
    t = inside['s'].astype(np.int64) * 1_000_000 + inside['ns'] // 1000
    order = np.argsort(t, kind='stable')
    rows = inside[order]
    events = Events(t[order], rows['x'].copy(), rows['y'].copy(), rows['polarity'] != 0)
    header = SimpleNamespace(stamp=SimpleNamespace(sec=seconds, nanosec=nanoseconds))
    counters.events_outside += count - len(inside)
    counters.events_unsorted += int(np.count_nonzero(np.diff(t) < 0))
    return SimpleNamespace(header=header, seq=seq, width=width, height=height, events=events)


class BagRecording:
    """A bag of ROS 2 or ROS 1.

    Args:
        path: Folder, or one .mcap, .db3 or .bag file.
        selection: Which of its topics to read; None for the only one of each kind.

    Attributes:
        counters: Losses found so far.

    Raises:
        RecordingError: It cannot be read, holds no camera data, or the choice is ambiguous.
    """

    def __init__(self, path: Path, selection: Selection | None = None) -> None:
        self.counters = ReadCounters()
        self._path = path
        self._bag = BagFile(path)
        self._unreadable: list[str] = []
        self._decoder, self._sequence = StreamDecoder(), SequenceCounter()
        self._offset_us, self._corner = 0, (0, 0)
        self._celsius: dict[int, float] = {}
        try:
            self._choose(selection or Selection())
            self._info = self._inspect()
        except RecordingError:
            self.close()
            raise
        self.counters = ReadCounters()

    @property
    def info(self) -> RecordingInfo:
        """Description; its damage is what has been found so far."""
        damage = filter(None, (self._bag.damage, *self._unreadable))
        return replace(self._info, damage='; '.join(damage))

    def wrenches(self) -> Mapping[str, Wrenches]:
        """Return the recorded forces of each topic, all at once."""
        names = self._bag.topics(topics.REFERENCE_WRENCH.type_name)
        return {name: map(self._bag.wrenches, [name]) for name in names}

    def close(self) -> None:
        """Close the files."""
        self._bag.close()

    def pieces(self) -> Generator[Piece, None, None]:
        """Yield the recorded data in the order in which they were received.

        Raises:
            RecordingError: The bag is damaged, or a packet is in an unknown encoding.
        """
        self._decoder, self._sequence = StreamDecoder(), SequenceCounter()
        named = (self._events, self._images, self._imu, self._exposures, self._edges)
        held: Piece | None = None
        for topic, message in self._messages(*named, self._temperatures):
            if topic == self._temperatures:
                self._celsius = {_stamp_us(message): float(message.temperature)}
                continue
            if topic == self._exposures:
                if held and _stamp_us(message) - self._offset_us == held.start_us:
                    frame = convert.exposed_frame(held.frames[0], message, self._offset_us)
                    yield replace(held, frames=(frame,))
                    held = None
                continue
            piece: Piece | None = self._piece(topic, message)
            if topic == self._images and self._exposures:
                # A frame waits for the message with its exposure, at most until the next frame.
                piece, held = held, piece
            if piece and (topic != self._events or self._decoder.timed):
                yield piece
        if held:
            yield held

    def _messages(self, *wanted: str | None) -> Iterator[tuple[str, Message]]:
        """Yield the messages of some topics: event arrays decoded, images only with a stamp."""
        raw = {topic for topic in wanted if topic and self._bag.types[topic] in EVENT_ARRAYS}
        for topic, _, message in self._bag.messages(*filter(None, wanted), raw=raw):
            is_image = self._bag.types[topic] == topics.IMAGE_RAW.type_name
            if is_image and not _stamp_us(message):
                self.counters.frames_without_time += 1
            else:
                is_array = topic in raw
                yield topic, read_event_array(message, self.counters) if is_array else message

    def _first(self, topic: str | None) -> Message:
        for _, message in self._messages(topic):
            return message
        raise RecordingError(f'{self._path} has no message with a time on {topic}')

    def _choose(self, selection: Selection) -> None:
        path, bag = self._path, self._bag
        events = self._readable(topics.EVENTS.type_name, selection.events, StreamDecoder().decode)
        events += bag.topics(*EVENT_ARRAYS) if bag.is_ros1 else []
        self._events = choose(events, selection.events, kind='events', path=path)
        beside = self._events or ''
        images = self._readable(
            topics.IMAGE_RAW.type_name, selection.image, lambda m: convert.read_frame(m, 0, (0, 0))
        )
        self._images = choose(images, selection.image, kind='image', path=path, beside=beside)
        samples = bag.topics(topics.IMU.type_name)
        self._imu = choose(samples, selection.imu, kind='imu', path=path, beside=beside)
        self._exposures = self._beside(topics.IMAGE_EXPOSURE, self._images)
        self._edges = self._beside(topics.EXTERNAL_EDGES, self._events)
        self._temperatures = self._beside(topics.TEMPERATURE, self._events or self._images)
        # Frames set the pace if there are no events, inertial samples if there is neither.
        self._leader = self._events or self._images or self._imu
        if self._leader is None:
            what = 'no event packets, images or inertial samples that can be read'
            raise RecordingError(
                '; '.join((f'{path} holds {what}', *self._unreadable)),
                remedy='choose a bag of a camera, or check the playback_..._topic parameters',
            )

    def _readable(
        self, type_name: str, wanted: str, check: Callable[[Message], object]
    ) -> list[str]:
        """Return the topics of a type that can be read; note the others, unless one is named."""
        found = []
        for topic in self._bag.topics(type_name):
            try:
                check(self._first(topic))
                found.append(topic)
            except MixtacError as error:
                if topic == wanted:
                    raise RecordingError(f'{self._path}, {topic}: {error}') from error
                self._unreadable.append(f'{topic} is left out: {error}')
        return found

    def _beside(self, kind: topics.Topic, topic: str | None) -> str | None:
        """Return a topic of the type of another one in the namespace of a topic."""
        space = (topic or '').rpartition('/')[0]
        found = (name for name in self._bag.topics(kind.type_name) if topic)
        return next((name for name in found if name.rpartition('/')[0] == space), None)

    def _inspect(self) -> RecordingInfo:
        """Describe the recording, and note the region of its frames and the clock of its stamps."""
        color_filter, size = 0, (0, 0)
        if self._images:
            image = self._first(self._images)
            size = int(image.width), int(image.height)
            if infos := self._beside(topics.CAMERA_INFO, self._images):
                info = self._first(infos)
                size = int(info.width), int(info.height)
                self._corner = int(info.roi.x_offset), int(info.roi.y_offset)
            color_filter = convert.color_filter(image.encoding, *self._corner)
        first = self._first(self._leader)
        start_us = _stamp_us(first)
        if self._events:
            for _, first in self._messages(self._events):
                start_us = self._piece(self._events, first).start_us
                if self._decoder.timed:
                    break
            size = int(first.width), int(first.height)
            apart_us, beside = _stamp_us(first) - start_us, self._images or self._imu
            if beside and abs(apart_us) > OTHER_CLOCK_US:
                # Stamps nearer to the stamps of packets than to the events are host times.
                later_us = _stamp_us(self._first(beside)) - start_us
                self._offset_us = apart_us if abs(later_us - apart_us) < abs(later_us) else 0
        clock = f'{(self._leader or "").rpartition("/")[0]}/{topics.CAMERA_CLOCK.name}'
        known = clock in self._bag.topics(topics.CAMERA_CLOCK.type_name)
        names = (('events', self._events), ('image', self._images), ('imu', self._imu))
        return RecordingInfo(
            path=self._path,
            kind='ROS 1 bag' if self._bag.is_ros1 else 'rosbag2 bag',
            camera=str(self._first(clock).source) if known else '',
            width=size[0],
            height=size[1],
            color_filter=color_filter,
            start_us=start_us,
            length_us=self._bag.duration_ns // 1000,
            contents=tuple((kind, topic) for kind, topic in names if topic),
        )

    def _piece(self, topic: str, message: Message) -> Piece:
        try:
            piece = self._converted(topic, message)
            piece.check()
        except MixtacError as error:
            raise RecordingError(f'{self._path}, {topic}: {error}') from error
        return piece

    def _converted(self, topic: str, message: Message) -> Piece:
        if topic == self._events:
            self.counters.packets_missing += self._sequence.update(message.seq)
            if isinstance(message.events, Events):
                t = message.events.t if len(message.events) else [_stamp_us(message)]
                return Piece(int(t[0]), int(t[-1]), advances=True, events=message.events)
            packet = self._decoder.decode(message)
            start_us, until_us = packet.start_us, packet.complete_until
            return Piece(start_us, until_us, advances=True, events=packet.events)
        stamp_us = _stamp_us(message)
        t_us, advances = stamp_us - self._offset_us, topic == self._leader
        if topic == self._imu:
            imu = convert.read_samples(message, t_us, self._celsius.get(stamp_us, math.nan))
            return Piece(t_us, t_us, advances=advances, imu=imu)
        if topic == self._edges:
            return Piece(t_us, t_us, advances=False, edges=convert.read_edges(message, t_us))
        frame = convert.read_frame(message, t_us, self._corner)
        return Piece(t_us, t_us, advances=advances, frames=(frame,))


Recording: TypeAlias = BagRecording | FileRecording
"""A recording, open for reading."""


def _stamp_us(message: Message) -> int:
    return stamp_to_us(message.header.stamp)


def open_recording(
    path: Path, selection: Selection | None = None, options: TableOptions | None = None
) -> Recording:
    """Open a recording: a bag, an AEDAT file, tables, or a folder that an export made.

    Args:
        path: The file or the folder.
        selection: Which of its topics to read; None for the only one of each kind.
        options: Units of times and size of the camera, for files that do not state them.

    Raises:
        RecordingError: The recording is missing, unreadable or empty, or the choice is ambiguous.
    """
    path, selection = path.expanduser(), selection or Selection()
    options = options or TableOptions()
    if not path.exists():
        raise RecordingError(f'no recording at {path}', remedy='check the path')
    if path.is_dir() and [each.name for each in path.iterdir()] in ([AEDAT4_FILE], [HDF5_FILE]):
        path = next(path.iterdir())
    known = file_format(path) if path.is_file() else None
    if known is AEDAT2:
        return open_aedat2(path, selection, options.size)
    if known is AEDAT4:
        return open_aedat4(path, selection)
    if is_bag(path):
        return BagRecording(path, selection)
    if not (known and known.remedy) and (tables := open_table_recording(path, selection, options)):
        return tables
    raise not_a_recording(path)
