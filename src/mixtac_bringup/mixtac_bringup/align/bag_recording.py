# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the alignment needs of a bag, read in one pass."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mixtac_alignment.align import align
from mixtac_alignment.edges import fit_edges
from mixtac_alignment.errors import NoImpulseError
from mixtac_alignment.frame_features import reduce_frame
from mixtac_alignment.frame_history import FrameHistory
from mixtac_alignment.rate_history import BIN_US, EventCounts
from mixtac_bringup.bag_reader import BagFile
from mixtac_bringup.errors import BagError
from mixtac_events.codec import decode_message

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from mixtac_alignment.clock_fit import ClockFit
    from mixtac_alignment.frame_features import FrameFeatures
    from mixtac_alignment.gel_lag import GelLag
    from mixtac_alignment.impulses import ImpulseSettings
    from mixtac_alignment.refinement import Refinement

REFERENCE: Final = '/ft_sensor/wrench'
NAMESPACE: Final = '/mixtac'
ENCODINGS: Final = {
    'mono8': (np.uint8, 255.0),
    '8UC1': (np.uint8, 255.0),
    'mono16': (None, 65535.0),
}
LONGEST_S: Final = 3600.0
"""Length of a recording of which frames are kept [s]."""
_NS: Final = 1_000_000_000


@dataclass(frozen=True, slots=True, eq=False)
class BagRecording:
    """A recording; camera times on the camera clock [us], the others on the reference clock [s].

    Attributes:
        counts: Event counts, with lost packets marked.
        frames: Frames, or none where the bag has no exposure times.
        force_t_s: Stamps of the reference sensor [s], ``float64 [n]``.
        force: Its normal force [N].
        edges_us: Edges at the camera's synchronisation input, camera clock [us].
    """

    counts: EventCounts
    frames: FrameFeatures | None
    force_t_s: NDArray[np.float64]
    force: NDArray[np.float64]
    edges_us: NDArray[np.int64]

    def fit(
        self,
        settings: ImpulseSettings | None = None,
        lag: GelLag | None = None,
        *,
        refined: bool = True,
        reference_edges_s: NDArray[np.float64] | None = None,
    ) -> tuple[ClockFit, Refinement | None]:
        """Return the clock map, and its refinement if it was refined.

        Args:
            settings: What counts as an impulse.
            lag: What is known of the gel.
            refined: Whether to refine over the whole recording.
            reference_edges_s: The camera's edges on the reference clock; used in place of impulses.

        Raises:
            AlignmentError: No trustworthy map.
        """
        if reference_edges_s is not None:
            if not len(self.edges_us):
                raise NoImpulseError('no external edges in the bag: record external_edges as well')
            return fit_edges(self.edges_us, reference_edges_s), None
        frames = self.frames if refined else None
        return align(self.counts, self.force_t_s, self.force, frames, settings, lag)


def read_recording(
    path: Path, reference: str = REFERENCE, namespace: str = NAMESPACE
) -> BagRecording:
    """Read a bag.

    Args:
        path: Folder of the bag.
        reference: Topic of the reference force.
        namespace: Namespace of the camera's topics.

    Raises:
        BagError: No bag, or a topic is missing.
        CodecError: Damaged packets.
    """
    events, image, exposure, edge = (
        f'{namespace}/{name}'
        for name in ('events', 'image_raw', 'image_exposure', 'external_edges')
    )
    counter, frames, edges = _Counter(), FrameHistory(LONGEST_S), []
    stamps: list[int] = []
    force: list[float] = []
    with BagFile(path) as bag:
        optional = [topic for topic in (image, exposure, edge) if bag.counts.get(topic)]
        for topic, _, message in bag.messages_of(events, reference, *optional, raw=(reference,)):
            if topic == events:
                counter.add(message)
            elif topic == reference:
                stamp, normal = _wrench(message)
                stamps.append(stamp)
                force.append(normal)
            elif topic == image:
                frames.push_image(_ns(message.header.stamp), _features(message))
            elif topic == exposure:
                start, end = _ns(message.exposure_start), _ns(message.exposure_end)
                frames.push_exposure(_ns(message.header.stamp), start // 1000, end // 1000)
            else:
                edges.append(_ns(message.header.stamp) // 1000)
    return BagRecording(
        counts=counter.counts(f'{path} topic {events}'),
        frames=frames.snapshot(),
        force_t_s=np.array(stamps, np.int64) / 1e9,
        force=np.array(force),
        edges_us=np.array(edges, np.int64),
    )


class _Counter:
    """Counts events packet by packet: all events of a bag would take gigabytes."""

    def __init__(self) -> None:
        self._parts: list[tuple[int, NDArray[np.int64]]] = []
        self._lost: list[tuple[int, int]] = []
        self._sequence: int | None = None
        self._first: int | None = None
        self._end = 0

    def add(self, message: Any) -> None:  # noqa: ANN401
        """Add an `EventPacket`."""
        packet = decode_message(message)
        start, until = packet.start_us // BIN_US, packet.complete_until // BIN_US
        if self._first is None:
            self._first = start
        elif self._sequence is not None and message.seq > self._sequence + 1:
            self._lost.append((self._end, start + 1))
        self._sequence = message.seq
        self._end = max(self._end, until)
        if len(packet.events.t):
            bins = packet.events.t // BIN_US
            low = int(bins.min())
            self._parts.append((low, np.bincount(bins - low)))

    def counts(self, where: str) -> EventCounts:
        """Return the counts of all packets."""
        if self._first is None:
            raise BagError(f'{where} is empty: the camera sent nothing during the recording')
        first, end = self._first, max(self._end, self._first + 1)
        total = np.zeros(end - first, np.int64)
        for low, part in self._parts:
            a, b = max(low, first), min(low + len(part), end)
            if b > a:
                total[a - first : b - first] += part[a - low : b - low]
        gaps = tuple((a - first, b - first) for a, b in self._lost)
        return EventCounts(first * BIN_US, BIN_US, total, gaps)


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
    if message.encoding not in ENCODINGS:
        raise BagError(
            f'images of encoding {message.encoding}; the alignment reads {", ".join(ENCODINGS)}'
        )
    kind, scale = ENCODINGS[message.encoding]
    order = '>u2' if message.is_bigendian else '<u2'
    pixels = np.frombuffer(message.data, kind or order).reshape(message.height, -1)
    return reduce_frame(pixels[:, : message.width], scale)


def _ns(stamp: Any) -> int:  # noqa: ANN401
    return int(stamp.sec) * _NS + int(stamp.nanosec)
