# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A recorded bag reduced to what the alignment needs, read in one pass.

A bag has a packet every millisecond. Building a message for each and reducing it by itself would
take most of the time of `mixtac align`; packets are therefore read in their serialised form, in
batches.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from mixtac_alignment.align import align
from mixtac_alignment.edges import fit_edges
from mixtac_alignment.errors import NoImpulseError
from mixtac_alignment.histories import (
    BIN_US,
    EventCounts,
    EventHistory,
    FrameHistory,
    by_cell,
    reduce_frame,
)
from mixtac_alignment.taps import FEWEST_FRAMES, fit_taps
from mixtac_alignment.two_impulse import fit_counts
from mixtac_events.arrays import Events
from mixtac_events.codec import decode
from mixtac_events.packets import CodecError, read_packet
from mixtac_node.images import ImageConversionError, grey
from mixtac_recordings.bag import BagFile
from mixtac_recordings.recording import RecordingError

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from mixtac_alignment.clock_fit import ClockFit
    from mixtac_alignment.gel_lag import GelLag
    from mixtac_alignment.histories import CellEvents, FrameFeatures
    from mixtac_alignment.impulses import ImpulseSettings
    from mixtac_alignment.refinement import Refinement


BATCH: Final = 256
"""Packets that are reduced at once."""
STEP_BACK_US: Final = 1_000_000
"""A step back of the stream beyond this is a restarted clock."""


class PacketCollector:
    """Counts events packet by packet and keeps them by cell: whole ones would take gigabytes.

    Args:
        span_s: Time to keep events for [s].
    """

    def __init__(self, span_s: float) -> None:
        self._history = EventHistory(span_s)
        self._parts: list[tuple[int, NDArray[np.int64]]] = []
        self._lost: list[tuple[int, int]] = []
        self._sequence: int | None = None
        self._first: int | None = None
        self._end = 0
        self._batch: list[Events] = []
        self._size = (0, 0)
        self._newest_us = 0

    def add(self, data: bytes) -> None:
        """Add a serialised `EventPacket`.

        Raises:
            CodecError: It is cut off, or its events are damaged.
        """
        message = read_packet(data)
        if message.is_bigendian:
            raise CodecError('event packet is big-endian: record or publish it little-endian')
        packet = decode(
            # A copy lies at an aligned address, for which the decoders are compiled already.
            bytes(message.events),
            message.encoding,
            message.time_base,
            width=message.width,
            height=message.height,
        )
        start_us = packet.start_us
        size = (message.width, message.height)
        if size != self._size or start_us < self._newest_us - STEP_BACK_US:
            self._reduce()
        self._size, self._newest_us = size, packet.complete_until
        if self._first is None:
            self._first = start_us // BIN_US
        elif self._sequence is not None and message.seq > self._sequence + 1:
            self._lost.append((self._end, start_us // BIN_US + 1))
        self._sequence = message.seq
        self._end = max(self._end, packet.complete_until // BIN_US)
        if len(packet.events.t):
            self._batch.append(packet.events)
        if len(self._batch) >= BATCH:
            self._reduce()

    def events(self) -> CellEvents:
        """Return the events by cell."""
        self._reduce()
        return self._history.snapshot()

    def counts(self, where: str) -> EventCounts:
        """Return the counts of all packets.

        Args:
            where: What the packets came from, for the message.

        Raises:
            RecordingError: There were none.
        """
        if self._first is None:
            raise RecordingError(f'{where} is empty: the camera sent nothing during the recording')
        self._reduce()
        first, end = self._first, max(self._end, self._first + 1)
        total = np.zeros(end - first, np.int64)
        for low, part in self._parts:
            a, b = max(low, first), min(low + len(part), end)
            if b > a:
                total[a - first : b - first] += part[a - low : b - low]
        gaps = tuple((a - first, b - first) for a, b in self._lost)
        return EventCounts(first * BIN_US, BIN_US, total, gaps)

    def _reduce(self) -> None:
        if not self._batch:
            return
        events = Events.concatenate(self._batch)
        self._batch = []
        self._history.push(by_cell(events, *self._size))
        bins = events.t // BIN_US
        low = int(bins.min())
        self._parts.append((low, np.bincount(bins - low)))


REFERENCE: Final = '/ft_sensor/wrench'
NAMESPACE: Final = '/mixtac'
LONGEST_S: Final = 3600.0
"""Length of a recording of which frames are kept [s]."""
EMPTY: Final = EventCounts(0, BIN_US, np.zeros(1, np.int64))
Method = Literal['refined', 'two_impulse', 'paper', 'edges']
_NS: Final = 1_000_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A recording; camera times on the camera clock [us], the others on the reference clock [s].

    Attributes:
        counts: Event counts, with lost packets marked.
        events: Events by cell; the latest ones where there are very many.
        frames: Frames, or none where the bag has no exposure times.
        force_t_s: Stamps of the reference sensor [s], ``float64 [n]``.
        force: Its normal force [N].
        edges_us: Edges at the camera's synchronisation input, camera clock [us].
        reference_edges_s: The same edges on the reference clock [s].
    """

    counts: EventCounts
    events: CellEvents
    frames: FrameFeatures | None
    force_t_s: NDArray[np.float64]
    force: NDArray[np.float64]
    edges_us: NDArray[np.int64]
    reference_edges_s: NDArray[np.float64]

    def fit(
        self,
        settings: ImpulseSettings | None = None,
        lag: GelLag | None = None,
        *,
        method: Method = 'refined',
    ) -> tuple[ClockFit, Refinement | None]:
        """Return the clock map, and its refinement if it was refined.

        Args:
            settings: What counts as an impulse.
            lag: What is known of the gel.
            method: `refined`; `two_impulse`, the taps alone; `paper`, their troughs and peaks
                alone; or `edges`, the edges of a trigger line in place of taps.

        Raises:
            AlignmentError: No trustworthy map.
        """
        if method == 'edges':
            return self._fit_edges(), None
        force = (self.force_t_s, self.force)
        if method == 'paper' or self.frames is None:
            return fit_counts(self.counts, *force, settings), None
        if method == 'two_impulse' and len(self.frames.start_us) >= FEWEST_FRAMES:
            return fit_taps(self.counts, self.events, self.frames, *force, settings, lag), None
        frames = self.frames if method == 'refined' else None
        return align(self.counts, *force, frames, settings, lag, events=self.events)

    def _fit_edges(self) -> ClockFit:
        for name, edges in (
            ('external_edges, from the camera', self.edges_us),
            ('reference_edges, on the reference clock', self.reference_edges_s),
        ):
            if not len(edges):
                raise NoImpulseError(
                    f'no {name}, in the bag: record both topics with the trigger line connected, '
                    'or align by taps'
                )
        return fit_edges(self.edges_us, self.reference_edges_s)


def read_recording(
    path: Path, reference: str = REFERENCE, namespace: str = NAMESPACE, *, edges_only: bool = False
) -> Recording:
    """Read a bag.

    Args:
        path: Folder of the bag.
        reference: Topic of the reference force.
        namespace: Namespace of the camera's topics.
        edges_only: Read the edges of the trigger line and nothing else.

    Raises:
        RecordingError: No bag, or a topic is missing.
        CodecError: Damaged packets.
    """
    names = ('events', 'image_raw', 'image_exposure', 'external_edges', 'reference_edges')
    events, image, exposure, edge, other = (f'{namespace}/{name}' for name in names)
    needed = () if edges_only else (events, reference)
    packets, frames = PacketCollector(LONGEST_S), FrameHistory(LONGEST_S)
    edges: list[int] = []
    reference_edges: list[float] = []
    stamps: list[int] = []
    force: list[float] = []
    with BagFile(path) as bag:
        more = (edge, other) if edges_only else (image, exposure, edge, other)
        optional = [topic for topic in more if bag.counts.get(topic)]
        for topic, _, message in bag.messages(*needed, *optional, raw=(events, reference)):
            if topic == events:
                packets.add(message)
            elif topic == reference:
                stamp, normal = _wrench(message)
                stamps.append(stamp)
                force.append(normal)
            elif topic == image:
                frames.push_image(_ns(message.header.stamp), _features(message))
            elif topic == exposure:
                start, end = _ns(message.exposure_start), _ns(message.exposure_end)
                frames.push_exposure(_ns(message.header.stamp), start // 1000, end // 1000)
            elif topic == edge:
                edges.append(_ns(message.header.stamp) // 1000)
            else:
                reference_edges.append(_ns(message.time_ref) / 1e9)
    return Recording(
        counts=EMPTY if edges_only else packets.counts(f'{path} topic {events}'),
        events=packets.events(),
        frames=frames.snapshot(),
        force_t_s=np.array(stamps, np.int64) / 1e9,
        force=np.array(force),
        edges_us=np.array(edges, np.int64),
        reference_edges_s=np.array(reference_edges),
    )


def _wrench(data: bytes) -> tuple[int, float]:
    """Return stamp [ns] and normal force [N] of a serialised `WrenchStamped`.

    There are 800 a second, and building the message takes ten times as long.
    """
    order = '<' if data[1] & 1 else '>'
    seconds, nanoseconds, length = struct.unpack_from(f'{order}iII', data, 4)
    # CDR aligns numbers of eight bytes to the end of its own header of four.
    at = 4 + (12 + length + 7) // 8 * 8
    (normal,) = struct.unpack_from(f'{order}d', data, at + 16)
    return seconds * _NS + nanoseconds, normal


def _features(message: Any) -> NDArray[np.float32]:  # noqa: ANN401
    try:
        pixels = grey(message)
    except ImageConversionError as error:
        raise RecordingError(f'frames cannot be read: {error}') from error
    return reduce_frame(pixels, float(np.iinfo(pixels.dtype).max))


def _ns(stamp: Any) -> int:  # noqa: ANN401
    return int(stamp.sec) * _NS + int(stamp.nanosec)
