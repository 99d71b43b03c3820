# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Open a recording; read events, frames, samples and edges of one camera from a bag.

The camera clock is that of the event packets. This driver stamps frames and samples on it as well.
Other drivers stamp them with host time: they are shifted by the difference between the stamp of the
first event packet and its events, which is correct to within the transport delay.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Generator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mixtac_core.events.codec import READABLE, StreamDecoder
from mixtac_core.events.packets import CodecError
from mixtac_core.events.sequence import SequenceCounter
from mixtac_core.node import topics
from mixtac_core.node.stamps import stamp_to_ns, stamp_to_us
from mixtac_core.recordings import messages as convert
from mixtac_core.recordings.aedat import open_aedat2, open_aedat4
from mixtac_core.recordings.bag import BagFile, find_bags, is_storage
from mixtac_core.recordings.event_arrays import EVENT_ARRAYS, EventArray, read_event_array
from mixtac_core.recordings.recording import (
    AEDAT2,
    AEDAT4,
    AEDAT4_FILE,
    HDF5,
    NPZ,
    ROS1_SUFFIX,
    TEXT,
    Piece,
    ReadCounters,
    Recording,
    RecordingError,
    RecordingInfo,
    Selection,
    Wrenches,
    choose,
    file_format,
    not_a_recording,
)
from mixtac_core.recordings.table_recording import open_table_recording
from mixtac_core.recordings.tables import HDF5_FILE, TableOptions

OTHER_CLOCK_US = 60_000_000
"""Event times that differ by more than this from the stamp of their packet are on another clock."""
WRENCHES = 1000
"""Wrenches that are read at once."""


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
        self._arrays = False
        self._images: str | None = None
        self._temperatures: str | None = None
        self._celsius = (0, math.nan)
        self._unreadable: dict[str, str] = {}
        self._decoder = StreamDecoder()
        try:
            self._choose(selection or Selection())
            self._offset_us = 0
            self._corner = (0, 0)
            self._info = self._inspect()
            self.counters = ReadCounters()
        except RecordingError:
            self.close()
            raise

    @property
    def info(self) -> RecordingInfo:
        """Description; its damage is what has been found so far."""
        unreadable = [f'{topic} is left out: {why}' for topic, why in self._unreadable.items()]
        damage = '; '.join(filter(None, (self._bag.damage, *unreadable)))
        return replace(self._info, damage=damage)

    def wrenches(self) -> Mapping[str, Wrenches]:
        """Return the recorded forces by their topics."""
        topics_of_forces = self._bag.topics(topics.REFERENCE_WRENCH.type_name)
        return {topic: _bag_wrenches(self._path, topic) for topic in topics_of_forces}

    def close(self) -> None:
        """Close the files."""
        self._bag.close()

    def pieces(self) -> Generator[Piece, None, None]:
        """Yield the recorded data in the order in which they were received.

        Raises:
            RecordingError: The bag is damaged, or a packet is in an unknown encoding.
        """
        counter = SequenceCounter()
        named = [self._events, self._images, self._imu, self._exposures, self._edges]
        named.append(self._temperatures)
        chosen = [topic for topic in named if topic]
        self._decoder = StreamDecoder()
        # A frame waits for the message with its exposure, at most until the next frame.
        held: Piece | None = None
        for topic, _, message in self._messages(*chosen):
            if topic == self._exposures:
                if held is not None and (exposed := self._exposed(held, message)):
                    yield exposed
                    held = None
                continue
            piece = self._piece(topic, message)
            if topic == self._images and self._exposures:
                if held is not None:
                    yield held
                held = piece
                continue
            if topic == self._events:
                self.counters.packets_missing += counter.update(message.seq)
                if not self._decoder.timed:
                    continue
            yield piece
        if held is not None:
            yield held

    def _messages(self, *wanted: str) -> Any:  # noqa: ANN401
        """Yield the messages of some topics, event arrays of ROS 1 decoded; note temperatures."""
        raw = {topic for topic in wanted if self._arrays and topic == self._events}
        for topic, received_ns, message in self._bag.messages(*wanted, raw=raw):
            if topic == self._images and not stamp_to_us(message.header.stamp):
                self.counters.frames_without_time += 1
            elif topic == self._temperatures:
                self._celsius = stamp_to_us(message.header.stamp), float(message.temperature)
            else:
                yield topic, received_ns, read_event_array(message) if topic in raw else message

    def _exposed(self, piece: Piece, message: Any) -> Piece | None:  # noqa: ANN401
        """Return the piece of a frame with the times of its exposure; None for another frame's."""
        (frame,) = piece.frames
        if stamp_to_us(message.header.stamp) - self._offset_us != frame.middle_us:
            return None
        exposed = convert.exposed_frame(frame, message, offset_us=self._offset_us)
        return replace(piece, frames=(exposed,))

    def _choose(self, selection: Selection) -> None:
        path = self._path
        events = self._readable(topics.EVENTS.type_name, selection.events, _check_packet)
        events += self._bag.topics(*EVENT_ARRAYS) if self._bag.is_ros1 else []
        self._events = choose(events, selection.events, kind='events', path=path)
        self._arrays = self._bag.types.get(self._events or '') in EVENT_ARRAYS
        beside = self._events or ''
        images = self._readable(topics.IMAGE_RAW.type_name, selection.image, convert.check_image)
        self._images = choose(images, selection.image, kind='image', path=path, beside=beside)
        if self._images and next(self._messages(self._images), None) is None:
            count = self._bag.counts[self._images]
            self._unreadable[self._images] = f'the stamps of its {count} images are zero'
            self._images = None
        samples = self._bag.topics(topics.IMU.type_name)
        self._imu = choose(samples, selection.imu, kind='imu', path=path, beside=beside)
        self._exposures = self._beside(topics.IMAGE_EXPOSURE.type_name, self._images)
        self._edges = self._beside(topics.EXTERNAL_EDGES.type_name, self._events)
        self._temperatures = self._beside(
            topics.TEMPERATURE.type_name, self._events or self._images
        )
        # Frames set the pace if there are no events, inertial samples if there is neither.
        self._leader = self._events or self._images or self._imu
        if self._leader is None:
            why = ''.join(f'; {topic}: {reason}' for topic, reason in self._unreadable.items())
            raise RecordingError(
                f'{path} holds no event packets, images or inertial samples that can be read{why}',
                remedy='choose a bag of a camera, or check the playback_..._topic parameters',
            )

    def _readable(self, type_name: str, wanted: str, check: Callable[[Any], None]) -> list[str]:
        """Return the topics of a type that can be read; note the others, unless one is named."""
        found = []
        for topic in self._bag.topics(type_name):
            try:
                check(self._first(topic))
            except (RecordingError, CodecError) as error:
                if topic == wanted:
                    raise RecordingError(f'{self._path}, {topic}: {error}') from error
                self._unreadable[topic] = str(error)
            else:
                found.append(topic)
        return found

    def _on_host_clock(self, start_us: int, apart_us: int) -> bool:
        """Return whether data other than events are stamped on the host clock."""
        beside = self._images or self._imu
        if beside is None or abs(apart_us) <= OTHER_CLOCK_US:
            return False
        later_us = stamp_to_us(self._first(beside).header.stamp) - start_us
        return abs(later_us - apart_us) < abs(later_us)

    def _inspect(self) -> RecordingInfo:
        first = self._first(self._leader)
        size = self._first_info()
        start_us = _stamp_us(first)
        if self._events:
            for _, _, first in self._messages(self._events):
                start_us = self._piece(self._events, first).start_us
                if self._decoder.timed:
                    break
            apart_us = _stamp_us(first) - start_us
            self._offset_us = apart_us if self._on_host_clock(start_us, apart_us) else 0
            size = (int(first.width), int(first.height))
        color_filter = 0
        if self._images:
            image = self._first(self._images)
            color_filter = convert.color_filter(image.encoding, *self._corner)
            size = size or (int(image.width), int(image.height))
        names = (('events', self._events), ('image', self._images), ('imu', self._imu))
        return RecordingInfo(
            path=self._path,
            kind='ROS 1 bag' if self._bag.is_ros1 else 'rosbag2 bag',
            camera=self._serial(),
            width=size[0] if size else 0,
            height=size[1] if size else 0,
            color_filter=color_filter,
            start_us=start_us,
            length_us=self._bag.duration_ns // 1000,
            contents=tuple((kind, topic) for kind, topic in names if topic),
        )

    def _first_info(self) -> tuple[int, int] | None:
        """Return the size from the camera information, and note its region of interest."""
        topic = self._beside(topics.CAMERA_INFO.type_name, self._images)
        if topic is None:
            return None
        info = self._first(topic)
        self._corner = (int(info.roi.x_offset), int(info.roi.y_offset))
        return int(info.width), int(info.height)

    def _serial(self) -> str:
        """Return the serial number that this driver records with the clock; empty without one."""
        clock = f'{(self._leader or "").rpartition("/")[0]}/{topics.CAMERA_CLOCK.name}'
        known = clock in self._bag.topics(topics.CAMERA_CLOCK.type_name)
        return str(self._first(clock).source) if known else ''

    def _beside(self, kind: str, topic: str | None) -> str | None:
        """Return a topic of a type in the namespace of another topic."""
        space = (topic or '').rpartition('/')[0]
        found = [name for name in self._bag.topics(kind) if name.rpartition('/')[0] == space]
        return found[0] if found and topic else None

    def _first(self, topic: str | None) -> Any:  # noqa: ANN401
        for _, _, message in self._messages(topic or ''):
            return message
        raise RecordingError(f'{self._path} has no messages on {topic}')

    def _piece(self, topic: str, message: Any) -> Piece:  # noqa: ANN401
        try:
            piece = self._converted(topic, message)
            piece.check()
        except (RecordingError, CodecError) as error:
            raise RecordingError(f'{self._path}, {topic}: {error}') from error
        return piece

    def _converted(self, topic: str, message: Any) -> Piece:  # noqa: ANN401
        if isinstance(message, EventArray):
            self.counters.events_outside += message.outside
            self.counters.events_unsorted += message.unsorted
            t = message.events.t
            times = (int(t[0]), int(t[-1])) if len(t) else (message.stamp_us, message.stamp_us)
            return Piece(*times, advances=True, events=message.events)
        if topic == self._events:
            packet = self._decoder.decode(message)
            return Piece(
                packet.start_us, packet.complete_until, advances=True, events=packet.events
            )
        advances = topic == self._leader
        if topic == self._imu:
            stamp_us, celsius = self._celsius
            known = stamp_us == stamp_to_us(message.header.stamp)
            imu = convert.read_samples(
                message, offset_us=self._offset_us, celsius=celsius if known else math.nan
            )
            t_us = int(imu.t[0])
            return Piece(t_us, t_us, advances=advances, imu=imu)
        if topic == self._edges:
            edges = convert.read_edges(message, offset_us=self._offset_us)
            t_us = int(edges.t[0])
            return Piece(t_us, t_us, advances=False, edges=edges)
        frame = convert.read_frame(message, offset_us=self._offset_us, corner=self._corner)
        return Piece(frame.middle_us, frame.middle_us, advances=advances, frames=(frame,))


def _stamp_us(message: Any) -> int:  # noqa: ANN401
    if isinstance(message, EventArray):
        return message.stamp_us
    return stamp_to_us(message.header.stamp)


def _check_packet(message: Any) -> None:  # noqa: ANN401
    if message.encoding not in READABLE:
        raise RecordingError(
            f'encoding {message.encoding!r} cannot be decoded, only {", ".join(READABLE)}'
        )


def _bag_wrenches(path: Path, topic: str) -> Wrenches:
    """Yield the wrenches of a topic from a reader of its own: others read on meanwhile."""
    with BagFile(path) as bag:
        messages = (message for _, _, message in bag.messages(topic))
        while found := list(itertools.islice(messages, WRENCHES)):
            stamps = np.array([stamp_to_ns(each.header.stamp) for each in found], np.int64)
            yield stamps, np.array([_six(each.wrench) for each in found])


def _six(wrench: Any) -> tuple[float, ...]:  # noqa: ANN401
    force, torque = wrench.force, wrench.torque
    return force.x, force.y, force.z, torque.x, torque.y, torque.z


def open_recording(
    path: Path, selection: Selection | None = None, options: TableOptions | None = None
) -> Recording:
    """Open a recording: a bag, an AEDAT file, tables, or a folder that an export made.

    Args:
        path: The file or the folder.
        selection: Which of its topics to read; None for the only one of each kind.
        options: Units of times and size of the camera, for files that do not state them.

    Raises:
        RecordingError: There is none, it cannot be read, is empty, or the choice is ambiguous.
    """
    path, selection = path.expanduser(), selection or Selection()
    options = options or TableOptions()
    if not path.exists():
        raise RecordingError(f'no recording at {path}', remedy='check the path')
    if path.is_dir() and [each.name for each in path.iterdir()] in ([AEDAT4_FILE], [HDF5_FILE]):
        path = next(path.iterdir())
    known = file_format(path) if path.is_file() else None
    suffix = path.suffix.lower()
    if known in (AEDAT2, AEDAT4) and suffix in known.suffixes:
        if known is AEDAT2:
            return open_aedat2(path, selection, options.size)
        return open_aedat4(path, selection)
    if find_bags(path, 0) if path.is_dir() else is_storage(path) or suffix == ROS1_SUFFIX:
        return BagRecording(path, selection)
    if known in (None, HDF5, NPZ, TEXT) and (
        tables := open_table_recording(path, selection, options)
    ):
        return tables
    raise not_a_recording(path)
