# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Opening a recording, and bags as recordings: events, frames, samples, edges of one camera.

The camera clock is that of the event packets. Frames and samples of this driver are on it too.
Those of other drivers are stamped by the host: they are shifted by the difference between the
stamp of the first event packet and its events, which is right to within the transport delay.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mixtac_events.codec import decode_message
from mixtac_events.packets import CodecError
from mixtac_recordings import aedat4
from mixtac_recordings import bag as bag_file
from mixtac_recordings import bag_messages as convert
from mixtac_recordings.aedat4 import Aedat4Recording
from mixtac_recordings.bag import (
    CAMERA_INFO,
    EVENT_PACKET,
    EXTERNAL_EDGE,
    FRAME_EXPOSURE,
    IMAGE,
    IMU,
    SeekableBag,
)
from mixtac_recordings.recording import (
    RESTART_US,
    Piece,
    ReadCounters,
    RecordingError,
    RecordingInfo,
    choose,
)

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator

    from mixtac_recordings.recording import PlaybackParameters, Recording


PATIENCE = 20
"""Other messages that may pass before a frame goes on without its exposure: 20 ms of packets."""


class FramePairs:
    """Holds a frame back for a moment, until its exposure is there.

    Args:
        waits: False where exposures were not recorded.
    """

    def __init__(self, *, waits: bool) -> None:
        self._waits = waits
        self._held: Piece | None = None
        self._passed = 0
        self._ready: list[Piece] = []

    def add_frame(self, piece: Piece) -> None:
        """Take a piece of one frame."""
        self._release()
        self._held, self._passed = piece, 0
        if not self._waits:
            self._release()

    def add_exposure(self, message: Any, offset_us: int) -> None:  # noqa: ANN401
        """Take a FrameExposure message; that of another frame is left alone.

        Args:
            message: The message.
            offset_us: To subtract from its times to get the recorded camera clock.
        """
        if self._held is None:
            return
        (frame,) = self._held.frames
        if convert.stamp_us(message.header) - offset_us == frame.middle_us:
            exposed = convert.exposed_frame(frame, message, offset_us=offset_us)
            self._held = replace(self._held, frames=(exposed,))
            self._release()

    def pass_by(self) -> None:
        """Say that another message was recorded."""
        self._passed += 1
        if self._passed >= PATIENCE:
            self._release()

    def ready(self) -> Iterator[Piece]:
        """Yield what need not wait any more."""
        while self._ready:
            yield self._ready.pop(0)

    def rest(self) -> Iterator[Piece]:
        """Yield what is left at the end."""
        self._release()
        yield from self.ready()

    def _release(self) -> None:
        if self._held is not None:
            self._ready.append(self._held)
            self._held = None


OTHER_CLOCK_US = 60_000_000
"""Event times further than this from the stamp of their packet are on a clock of their own."""
MARGIN_NS = 2_000_000_000


class BagRecording:
    """A rosbag2 bag.

    Args:
        path: Folder, or one .mcap or .db3 file.
        parameters: Which of its topics to play.

    Attributes:
        info: What is known of it.
        counters: What was found amiss so far.

    Raises:
        RecordingError: It cannot be read, holds nothing to play, or leaves a choice of topics.
    """

    def __init__(self, path: Path, parameters: PlaybackParameters) -> None:
        self.counters = ReadCounters()
        self._path = path
        self._bag = SeekableBag(path)
        try:
            self._choose(parameters)
            self._offset_us = 0
            self._corner = (0, 0)
            self.info = self._inspect()
        except RecordingError:
            self.close()
            raise

    def close(self) -> None:
        """Give the files back."""
        self._bag.close()

    def pieces(self, from_us: int) -> Generator[Piece, None, None]:
        """Yield what was recorded, in the order in which it was received.

        Args:
            from_us: Time to begin at [us, recorded camera clock]; earlier pieces may come first.

        Raises:
            RecordingError: The bag is damaged, or a packet is in an unknown encoding.
        """
        expected: int | None = None
        named = (self._events, self._images, self._imu, self._exposures, self._edges)
        topics = [topic for topic in named if topic]
        frames = FramePairs(waits=self._exposures is not None)
        for topic, _, message in self._bag.messages(topics, self._received_before(from_us)):
            if topic == self._exposures:
                frames.add_exposure(message, self._offset_us)
            elif topic == self._images:
                frames.add_frame(self._piece(topic, message))
            else:
                frames.pass_by()
                yield self._piece(topic, message)
            yield from frames.ready()
            if topic == self._events:
                if expected is not None and message.seq > expected:
                    self.counters.packets_missing += int(message.seq) - expected
                expected = int(message.seq) + 1
        yield from frames.rest()

    def _choose(self, p: PlaybackParameters) -> None:
        bag, path = self._bag, self._path
        self._events = choose(
            bag.topics(EVENT_PACKET), p.playback_events_topic, kind='events', path=path
        )
        beside = self._events or ''
        self._images = choose(
            bag.topics(IMAGE), p.playback_image_topic, kind='image', path=path, beside=beside
        )
        self._imu = choose(
            bag.topics(IMU), p.playback_imu_topic, kind='imu', path=path, beside=beside
        )
        self._exposures = self._beside(FRAME_EXPOSURE, self._images)
        self._edges = self._beside(EXTERNAL_EDGE, self._events)
        # Frames set the pace where there are no events, samples where there is neither.
        self._leader = self._events or self._images or self._imu
        if self._leader is None:
            raise RecordingError(
                f'{path} holds no event packets, images or inertial samples to play: give a bag of '
                'a camera, or check the playback_..._topic parameters'
            )

    def _inspect(self) -> RecordingInfo:
        first = self._first(self._leader)
        size = self._first_info()
        if self._events:
            start_us = self._piece(self._events, first).start_us
            apart_us = convert.stamp_us(first.header) - start_us
            self._offset_us = apart_us if abs(apart_us) > OTHER_CLOCK_US else 0
            size = (int(first.width), int(first.height))
        else:
            start_us = convert.stamp_us(first.header)
        color_filter = 0
        if self._images:
            image = self._first(self._images)
            convert.image_depth(image.encoding)
            color_filter = convert.color_filter(image.encoding, self._corner)
            size = size or (int(image.width), int(image.height))
        names = (('events', self._events), ('image', self._images), ('imu', self._imu))
        return RecordingInfo(
            path=self._path,
            kind='rosbag2 bag',
            camera='',
            width=size[0] if size else 0,
            height=size[1] if size else 0,
            color_filter=color_filter,
            start_us=start_us,
            length_us=self._bag.duration_ns // 1000,
            contents=tuple((kind, topic) for kind, topic in names if topic),
        )

    def _first_info(self) -> tuple[int, int] | None:
        """Return the size that the camera information gives, and take its region of interest."""
        topic = self._beside(CAMERA_INFO, self._images)
        if topic is None:
            return None
        info = self._first(topic)
        self._corner = (int(info.roi.x_offset), int(info.roi.y_offset))
        return int(info.width), int(info.height)

    def _beside(self, kind: str, topic: str | None) -> str | None:
        """Return a topic of a type in the namespace of another topic."""
        space = (topic or '').rpartition('/')[0]
        found = [name for name in self._bag.topics(kind) if name.rpartition('/')[0] == space]
        return found[0] if found and topic else None

    def _first(self, topic: str | None) -> Any:  # noqa: ANN401
        for _, _, message in self._bag.messages([topic or '']):
            return message
        raise RecordingError(f'{self._path} has no messages on {topic}: record it again')

    def _received_before(self, from_us: int) -> int | None:
        """Return a time of receipt before everything later than a camera time; None for all."""
        if from_us <= self.info.start_us:
            return None
        margin_ns = MARGIN_NS
        while True:
            elapsed_ns = (from_us - self.info.start_us) * 1000
            start_ns = self._bag.start_ns + elapsed_ns - margin_ns
            if start_ns <= self._bag.start_ns:
                return None
            for _, _, message in self._bag.messages([self._leader or ''], start_ns):
                piece = self._piece(self._leader or '', message)
                if self._is_before(piece, from_us):
                    return start_ns
                break
            # The clocks drifted apart, or nothing was recorded for long: look further ahead.
            margin_ns *= 4

    def _is_before(self, piece: Piece, from_us: int) -> bool:
        earliest_us = self.info.start_us - RESTART_US
        return earliest_us <= piece.start_us <= from_us

    def _piece(self, topic: str, message: Any) -> Piece:  # noqa: ANN401
        try:
            piece = self._converted(topic, message)
            piece.check()
        except (RecordingError, CodecError) as error:
            raise RecordingError(f'{self._path}, {topic}: {error}') from error
        return piece

    def _converted(self, topic: str, message: Any) -> Piece:  # noqa: ANN401
        if topic == self._events:
            packet = decode_message(message)
            return Piece(
                packet.start_us, packet.complete_until, advances=True, events=packet.events
            )
        advances = topic == self._leader
        if topic == self._imu:
            imu = convert.samples(message, offset_us=self._offset_us)
            t_us = int(imu.t[0])
            return Piece(t_us, t_us, advances=advances, imu=imu)
        if topic == self._edges:
            edges = convert.edges(message, offset_us=self._offset_us)
            t_us = int(edges.t[0])
            return Piece(t_us, t_us, advances=False, edges=edges)
        frame = convert.frame(message, offset_us=self._offset_us, corner=self._corner)
        return Piece(frame.middle_us, frame.middle_us, advances=advances, frames=(frame,))


SUFFIXES = (aedat4.SUFFIX, *bag_file.SUFFIXES)


def looks_like_a_path(device: str) -> bool:
    """Return whether a device string can only be the path of a recording."""
    path = Path(device)
    return path.suffix in SUFFIXES or '/' in device or path.exists()


def open_recording(device: str, parameters: PlaybackParameters) -> Recording:
    """Open a recording.

    Args:
        device: Its path: an .aedat4, .mcap or .db3 file, or the folder of a bag.
        parameters: Which of its topics to play.

    Raises:
        RecordingError: There is none, it cannot be read, is empty, or leaves a choice of topics.
    """
    path = Path(device).expanduser()
    if not path.exists():
        raise RecordingError(
            f'no recording at {path}: give an .aedat4, .mcap or .db3 file or the folder of a bag'
        )
    if path.suffix == aedat4.SUFFIX:
        return Aedat4Recording(path, parameters)
    if path.is_dir() or path.suffix in bag_file.SUFFIXES:
        return BagRecording(path, parameters)
    raise RecordingError(
        f'{path} is no recording: give an .aedat4, .mcap or .db3 file or the folder of a bag'
    )
