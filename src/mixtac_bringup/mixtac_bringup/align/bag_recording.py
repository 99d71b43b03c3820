# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the alignment needs of a bag, read in one pass."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from mixtac_alignment.align import align
from mixtac_alignment.edges import fit_edges
from mixtac_alignment.errors import NoImpulseError
from mixtac_alignment.frame_features import reduce_frame
from mixtac_alignment.frame_history import FrameHistory
from mixtac_alignment.rate_history import BIN_US, EventCounts
from mixtac_alignment.tap_anchors import FEWEST_FRAMES, fit_taps
from mixtac_alignment.two_impulse import fit_counts
from mixtac_bringup.align.packet_collector import PacketCollector
from mixtac_bringup.bag_reader import BagFile
from mixtac_bringup.errors import BagError
from mixtac_node.image_conversion import ImageConversionError, grey

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from mixtac_alignment.clock_fit import ClockFit
    from mixtac_alignment.event_history import CellEvents
    from mixtac_alignment.frame_features import FrameFeatures
    from mixtac_alignment.gel_lag import GelLag
    from mixtac_alignment.impulses import ImpulseSettings
    from mixtac_alignment.refinement import Refinement

REFERENCE: Final = '/ft_sensor/wrench'
NAMESPACE: Final = '/mixtac'
LONGEST_S: Final = 3600.0
"""Length of a recording of which frames are kept [s]."""
EMPTY: Final = EventCounts(0, BIN_US, np.zeros(1, np.int64))
Method = Literal['refined', 'two_impulse', 'paper', 'edges']
_NS: Final = 1_000_000_000


@dataclass(frozen=True, slots=True, eq=False)
class BagRecording:
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
) -> BagRecording:
    """Read a bag.

    Args:
        path: Folder of the bag.
        reference: Topic of the reference force.
        namespace: Namespace of the camera's topics.
        edges_only: Read the edges of the trigger line and nothing else.

    Raises:
        BagError: No bag, or a topic is missing.
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
        for topic, _, message in bag.messages_of(*needed, *optional, raw=(events, reference)):
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
    return BagRecording(
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
        raise BagError(f'frames cannot be read: {error}') from error
    return reduce_frame(pixels, float(np.iinfo(pixels.dtype).max))


def _ns(stamp: Any) -> int:  # noqa: ANN401
    return int(stamp.sec) * _NS + int(stamp.nanosec)
