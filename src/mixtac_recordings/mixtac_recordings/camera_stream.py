# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Opening a recording, and bags as recordings: events, frames, samples, edges of one camera.

The camera clock is that of the event packets. This driver stamps frames and samples on it as well.
Other drivers stamp them with host time: they are shifted by the difference between the stamp of the
first event packet and its events, which is correct to within the transport delay.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import replace
from pathlib import Path
from typing import Any

from mixtac_events.codec import READABLE, StreamDecoder
from mixtac_events.foreign import EVT3
from mixtac_events.packets import CodecError
from mixtac_events.sequence import SequenceCounter
from mixtac_events.windows import RESTART_US
from mixtac_node import topics
from mixtac_node.stamps import stamp_to_us
from mixtac_recordings import messages as convert
from mixtac_recordings.aedat4 import Aedat4Recording
from mixtac_recordings.bag import BagFile
from mixtac_recordings.recording import (
    AEDAT4_SUFFIX,
    BAG_SUFFIXES,
    Piece,
    ReadCounters,
    Recording,
    RecordingError,
    RecordingInfo,
    Selection,
    choose,
)

PATIENCE = 20
"""Messages to wait for the exposure of a frame: 20 ms of packets."""


OTHER_CLOCK_US = 60_000_000
"""Event times that differ by more than this from the stamp of their packet are on another clock."""
MARGIN_NS = 2_000_000_000


class BagRecording:
    """A rosbag2 bag.

    Args:
        path: Folder, or one .mcap or .db3 file.
        selection: Which of its topics to read; None for the only one of each kind.
        whole: As in `BagFile`.

    Attributes:
        info: Its description.
        counters: Losses found so far.

    Raises:
        RecordingError: It cannot be read, holds no camera data, or the choice is ambiguous.
    """

    def __init__(
        self, path: Path, selection: Selection | None = None, *, whole: bool = False
    ) -> None:
        self.counters = ReadCounters()
        self._path = path
        self._bag = BagFile(path, whole=whole)
        self._unreadable: dict[str, str] = {}
        self._decoder = StreamDecoder()
        self._seekable = True
        try:
            self._choose(selection or Selection())
            self._offset_us = 0
            self._corner = (0, 0)
            self.info = self._inspect()
        except RecordingError:
            self.close()
            raise

    def close(self) -> None:
        """Close the files."""
        self._bag.close()

    def pieces(self, from_us: int) -> Generator[Piece, None, None]:
        """Yield the recorded data in the order in which they were received.

        Args:
            from_us: Time to begin at [us, recorded camera clock]; earlier pieces may come first.

        Raises:
            RecordingError: The bag is damaged, or a packet is in an unknown encoding.
        """
        counter = SequenceCounter()
        named = (self._events, self._images, self._imu, self._exposures, self._edges)
        chosen = [topic for topic in named if topic]
        start_ns = self._received_before(from_us)
        self._decoder = StreamDecoder()
        # A frame waits for the message with its exposure, at most PATIENCE messages.
        held: Piece | None = None
        passed = 0
        for topic, _, message in self._bag.messages(*chosen, start_ns=start_ns):
            if topic == self._exposures:
                if held is not None and (exposed := self._exposed(held, message)):
                    yield exposed
                    held = None
                continue
            piece = self._piece(topic, message)
            if topic == self._images and self._exposures:
                if held is not None:
                    yield held
                held, passed = piece, 0
                continue
            if topic == self._events:
                self.counters.packets_missing += counter.update(message.seq)
                if not self._decoder.timed:
                    continue
            yield piece
            passed += 1
            if held is not None and passed >= PATIENCE:
                yield held
                held = None
        if held is not None:
            yield held

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
        self._events = choose(events, selection.events, kind='events', path=path)
        beside = self._events or ''
        images = self._readable(topics.IMAGE_RAW.type_name, selection.image, convert.check_image)
        self._images = choose(images, selection.image, kind='image', path=path, beside=beside)
        samples = self._bag.topics(topics.IMU.type_name)
        self._imu = choose(samples, selection.imu, kind='imu', path=path, beside=beside)
        self._exposures = self._beside(topics.IMAGE_EXPOSURE.type_name, self._images)
        self._edges = self._beside(topics.EXTERNAL_EDGES.type_name, self._events)
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
        """Return whether what is beside the events has stamps of the host, not of their clock."""
        beside = self._images or self._imu
        if beside is None or abs(apart_us) <= OTHER_CLOCK_US:
            return False
        later_us = stamp_to_us(self._first(beside).header.stamp) - start_us
        return abs(later_us - apart_us) < abs(later_us)

    def _inspect(self) -> RecordingInfo:
        first = self._first(self._leader)
        size = self._first_info()
        if self._events:
            for _, _, first in self._bag.messages(self._events):
                start_us = self._piece(self._events, first).start_us
                if self._decoder.timed:
                    break
            apart_us = stamp_to_us(first.header.stamp) - start_us
            self._offset_us = apart_us if self._on_host_clock(start_us, apart_us) else 0
            size = (int(first.width), int(first.height))
            # Times roll over every 17 s: they are known only from the beginning on.
            self._seekable = first.encoding != EVT3
        else:
            start_us = stamp_to_us(first.header.stamp)
        color_filter = 0
        if self._images:
            image = self._first(self._images)
            color_filter = convert.color_filter(image.encoding, *self._corner)
            size = size or (int(image.width), int(image.height))
        unreadable = [f'{topic} is left out: {why}' for topic, why in self._unreadable.items()]
        names = (('events', self._events), ('image', self._images), ('imu', self._imu))
        return RecordingInfo(
            path=self._path,
            kind='rosbag2 bag',
            camera=self._serial(),
            width=size[0] if size else 0,
            height=size[1] if size else 0,
            color_filter=color_filter,
            start_us=start_us,
            length_us=self._bag.duration_ns // 1000,
            contents=tuple((kind, topic) for kind, topic in names if topic),
            damage='; '.join(filter(None, (self._bag.damage, *unreadable))),
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
        for _, _, message in self._bag.messages(topic or ''):
            return message
        raise RecordingError(f'{self._path} has no messages on {topic}')

    def _received_before(self, from_us: int) -> int | None:
        """Return a time of reception before all data after a camera time; None for the start."""
        if from_us <= self.info.start_us or not self._seekable:
            return None
        margin_ns = MARGIN_NS
        while True:
            elapsed_ns = (from_us - self.info.start_us) * 1000
            start_ns = self._bag.start_ns + elapsed_ns - margin_ns
            if start_ns <= self._bag.start_ns:
                return None
            for _, _, message in self._bag.messages(self._leader or '', start_ns=start_ns):
                found_us = self._piece(self._leader or '', message).start_us
                if self.info.start_us - RESTART_US <= found_us <= from_us:
                    return start_ns
                break
            # The clocks drifted apart, or there was a long pause: begin earlier.
            margin_ns *= 4

    def _piece(self, topic: str, message: Any) -> Piece:  # noqa: ANN401
        try:
            piece = self._converted(topic, message)
            piece.check()
        except (RecordingError, CodecError) as error:
            raise RecordingError(f'{self._path}, {topic}: {error}') from error
        return piece

    def _converted(self, topic: str, message: Any) -> Piece:  # noqa: ANN401
        if topic == self._events:
            packet = self._decoder.decode(message)
            return Piece(
                packet.start_us, packet.complete_until, advances=True, events=packet.events
            )
        advances = topic == self._leader
        if topic == self._imu:
            imu = convert.read_samples(message, offset_us=self._offset_us)
            t_us = int(imu.t[0])
            return Piece(t_us, t_us, advances=advances, imu=imu)
        if topic == self._edges:
            edges = convert.read_edges(message, offset_us=self._offset_us)
            t_us = int(edges.t[0])
            return Piece(t_us, t_us, advances=False, edges=edges)
        frame = convert.read_frame(message, offset_us=self._offset_us, corner=self._corner)
        return Piece(frame.middle_us, frame.middle_us, advances=advances, frames=(frame,))


def _check_packet(message: Any) -> None:  # noqa: ANN401
    if message.encoding not in READABLE:
        raise RecordingError(
            f'encoding {message.encoding!r} cannot be decoded, only {", ".join(READABLE)}'
        )


def open_recording(
    path: Path, selection: Selection | None = None, *, whole: bool = False
) -> Recording:
    """Open a recording.

    Args:
        path: An .aedat4, .mcap or .db3 file, or the folder of a bag.
        selection: Which of its topics to read; None for the only one of each kind.
        whole: Leave out what is damaged, instead of failing, and note it in `info.damage`.

    Raises:
        RecordingError: There is none, it cannot be read, is empty, or the choice is ambiguous.
    """
    path = path.expanduser()
    remedy = 'give an .aedat4, .mcap or .db3 file or the folder of a bag'
    if not path.exists():
        raise RecordingError(f'no recording at {path}', remedy=remedy)
    if path.suffix.lower() == AEDAT4_SUFFIX:
        return Aedat4Recording(path, selection, whole=whole)
    if path.is_dir() or path.suffix in BAG_SUFFIXES:
        return BagRecording(path, selection, whole=whole)
    raise RecordingError(f'{path} is not a recording', remedy=remedy)
