# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Clock maps of bags: reading what a fit needs, and results on disk.

`read_recording` reduces a bag in one pass. A bag has a packet every millisecond; building a message
for each and reducing it by itself would take most of the time of `mixtac align`, so packets are
read in their serialised form, in batches.

`write_fit` writes a map beside its bag, `rewrite_bag` copies a bag onto one clock.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mixtac_alignment.align import Recording, arrived_together
from mixtac_alignment.clock_fit import ClockFit
from mixtac_alignment.errors import AlignmentError, GapError
from mixtac_alignment.histories import (
    BIN_US,
    RESTART_US,
    CellEvents,
    EventCounts,
    EventHistory,
    FrameHistory,
    by_cell,
    reduce_frame,
)
from mixtac_events.arrays import Events
from mixtac_events.codec import StreamDecoder
from mixtac_events.errors import MixtacError
from mixtac_events.packets import read_packet
from mixtac_events.sequence import SequenceCounter
from mixtac_node import topics
from mixtac_node.files import new_folder, read_data, write_json
from mixtac_node.images import ImageConversionError, grey
from mixtac_node.stamps import stamp_to_ns, stamp_to_us
from mixtac_recordings.bag import BagFile, check_new, custom_data, fit_path, typestore
from mixtac_recordings.bag_writer import McapBag, offered_qos
from mixtac_recordings.recording import RecordingError

RESTART_NS: Final = 1000 * RESTART_US
"""Step back of a stamp from which the clock has restarted [ns]."""
BATCH: Final = 256
"""Packets that are reduced at once."""


LONGEST_S: Final = 3600.0
"""Longest span of frames and events that is kept, and longest hole in the events [s]."""


class PacketCollector:
    """Counts events packet by packet and keeps them by cell: whole ones would take gigabytes.

    Args:
        span_s: Time to keep events for [s].
    """

    def __init__(self, span_s: float) -> None:
        self._history = EventHistory(span_s)
        self._decoder = StreamDecoder()
        self._parts: list[tuple[int, NDArray[np.int64]]] = []
        self._lost: list[tuple[int, int]] = []
        self._packets = SequenceCounter()
        self._first: int | None = None
        self._end = 0
        self._batch: list[Events] = []
        self._size = (0, 0)
        self._newest_us = 0

    def add(self, data: bytes) -> None:
        """Add a serialised `EventPacket`.

        Raises:
            CodecError: It is cut off, or its events are damaged.
            GapError: The camera clock went back, or ahead by more than is kept, or its driver was
                started anew.
        """
        message = read_packet(data)
        packet = self._decoder.decode(message)
        if not self._decoder.timed:
            return
        start_us = packet.start_us
        size = (message.width, message.height)
        ahead_us = start_us - self._newest_us if self._first is not None else 0
        if not -RESTART_US <= ahead_us <= 1e6 * LONGEST_S:
            raise GapError(
                f'the camera clock jumps by {ahead_us / 1e6:+.1f} s',
                remedy='record again, and do not restart the driver or set the clock of the host',
            )
        if size != self._size:
            self._reduce()
        self._size, self._newest_us = size, packet.complete_until
        if self._packets.update(message.seq):
            self._lost.append((self._end, start_us // BIN_US + 1))
        if self._packets.restarts:
            raise GapError(
                f'packet numbers jump to {message.seq}: the driver was started anew while the bag '
                'was recorded, and its clock with it',
                remedy='record again',
            )
        if self._first is None:
            self._first = start_us // BIN_US
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


EMPTY: Final = EventCounts(0, BIN_US, np.zeros(1, np.int64))
_NS: Final = 1_000_000_000


def read_recording(
    path: Path,
    reference: str = topics.REFERENCE,
    namespace: str = '/mixtac',
    *,
    edges_only: bool = False,
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
        GapError: A clock went back or began anew, or the camera's went ahead by hours.
    """
    names = ('events', 'image_raw', 'image_exposure', 'external_edges', 'reference_edges')
    events, image, exposure, edge, other = (topics.absolute(name, namespace) for name in names)
    needed = () if edges_only else (events, reference)
    packets, frames = PacketCollector(LONGEST_S), FrameHistory(LONGEST_S)
    images: dict[int, NDArray[np.float32]] = {}
    spans: dict[int, tuple[int, int]] = {}
    edges: list[int] = []
    reference_edges: list[float] = []
    arrived: tuple[list[int], list[int]] = ([], [])
    samples: list[tuple[int, float]] = []
    with BagFile(path) as bag:
        more = (edge, other) if edges_only else (image, exposure, edge, other)
        optional = [topic for topic in more if bag.counts.get(topic)]
        for topic, received_ns, message in bag.messages(*needed, *optional, raw=(events,)):
            if topic == events:
                packets.add(message)
            elif topic == reference:
                samples.append((stamp_to_ns(message.header.stamp), topics.normal_force(message)))
            elif topic in {image, exposure}:
                stamp = stamp_to_ns(message.header.stamp)
                if topic == image:
                    images[stamp] = _features(message)
                else:
                    start_us = stamp_to_us(message.exposure_start)
                    spans[stamp] = start_us, stamp_to_us(message.exposure_end)
                if stamp in images and stamp in spans:
                    frames.push(*spans.pop(stamp), images.pop(stamp))
            elif topic == edge:
                edges.append(stamp_to_us(message.header.stamp))
                arrived[0].append(received_ns)
            else:
                reference_edges.append(stamp_to_ns(message.time_ref) / 1e9)
                arrived[1].append(received_ns)
    force_t_s, force = _force(samples, f'{path} topic {reference}')
    return Recording(
        counts=EMPTY if edges_only else packets.counts(f'{path} topic {events}'),
        events=packets.events(),
        frames=frames.snapshot(),
        force_t_s=force_t_s,
        force=force,
        edges_us=np.array(edges, np.int64),
        reference_edges_s=np.array(reference_edges),
        damage=bag.damage,
        all_edges=arrived_together(*(np.array(each, np.int64) for each in arrived)),
    )


def _force(
    samples: list[tuple[int, float]], where: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the samples that the node would keep: times [s] and normal forces [N]."""
    stamps = np.array([stamp for stamp, _ in samples], np.int64)
    forces = np.array([normal for _, normal in samples], np.float64)
    known = np.isfinite(forces) & (stamps > 0)
    stamps, forces = stamps[known], forces[known]
    back = np.diff(stamps)
    if (back < -RESTART_NS).any():
        raise GapError(
            f'{where}: the clock of the force sensor went back',
            remedy='record again, and do not restart the force sensor between the taps',
        )
    # Late samples are sorted in, repeated ones dropped.
    stamps, first = np.unique(stamps, return_index=True)
    return stamps / 1e9, forces[first]


def _features(message: Any) -> NDArray[np.float32]:  # noqa: ANN401
    try:
        pixels = grey(message)
    except ImageConversionError as error:
        raise RecordingError(f'frames cannot be read: {error}') from error
    return reduce_frame(pixels, float(np.iinfo(pixels.dtype).max))


SCHEMA: Final = 1


def write_fit(fit: ClockFit, bag: Path) -> Path:
    """Write a fit beside its bag and return the file: the fields of `mixtac_msgs/ClockFit`."""
    path = fit_path(bag)
    write_json(path, {'schema': SCHEMA, 'bag': bag.name, **fit.to_fields()})
    return path


def read_fit(bag: Path) -> ClockFit:
    """Return the fit beside a bag.

    Raises:
        AlignmentError: No such file, another schema, or a file that describes no map.
    """
    path, remedy = fit_path(bag), f'run `mixtac align {bag}`'
    try:
        content = dict(read_data(path))
        schema = content['schema']
    except (MixtacError, TypeError, ValueError, KeyError) as error:
        raise AlignmentError(f'no clock fit in {path} ({error})', remedy=remedy) from error
    if schema != SCHEMA:
        raise AlignmentError(f'{path} has schema {schema}, not {SCHEMA}', remedy=remedy)
    try:
        return ClockFit.from_fields(content)
    except AlignmentError as error:
        raise AlignmentError(f'{path}: {error.message}', remedy=remedy) from error


def rewrite_bag(bag: Path, fit: ClockFit, out: Path, reference: str, namespace: str) -> int:
    """Copy a bag with the reference force stamped on the camera clock; return its samples.

    The first message of `clock_fit` is the map of the copy, from the camera clock to itself, with
    the uncertainty of the fit: a reader maps the stamps by it as those of any bag.

    Args:
        bag: Folder of the bag.
        fit: Its clock map.
        out: Folder of the new bag; must not exist.
        reference: Topic whose stamps change.
        namespace: Namespace of the camera's topics.

    Raises:
        RecordingError: The new bag or a clock fit of its name exists.
        FileError: It cannot be written.
    """
    check_new(out)
    types, changed = typestore(), 0
    fit_topic = topics.CLOCK_FIT.resolved(namespace)
    with BagFile(bag) as source, new_folder(out) as made, McapBag(made) as writer:
        writer.custom_data.update(custom_data(bag))
        copied = {c.topic: c for c in source.connections if c.topic != fit_topic}
        handles = {topic: writer.add_like(connection) for topic, connection in copied.items()}
        fit_handle = writer.add_connection(
            fit_topic,
            topics.CLOCK_FIT.type_name,
            typestore=types,
            offered_qos_profiles=(offered_qos(latched=True),),
        )
        own = _fit_message(types, _of_one_clock(fit), source.start_ns)
        writer.write(fit_handle, source.start_ns, own)
        raw = copied.keys() - {reference}
        for topic, received_ns, message in source.messages(*copied, raw=raw):
            data = message
            if topic == reference:
                stamp = message.header.stamp
                seconds = stamp.sec - fit.reference_epoch_s + stamp.nanosec * 1e-9
                moved_ns = round((seconds - fit.b) / fit.a * 1e9) + 1000 * fit.camera_epoch_us
                stamp.sec, stamp.nanosec = divmod(moved_ns, _NS)
                data = types.serialize_cdr(message, copied[topic].msgtype)
                changed += 1
            writer.write(handles[topic], received_ns, data)
    return changed


def _of_one_clock(fit: ClockFit) -> ClockFit:
    """Return the map of a bag whose reference has been brought to the camera clock by a fit."""
    anchors = tuple(
        replace(anchor, reference_s=int(fit.to_camera(anchor.reference_s)) * 1e-6)
        for anchor in fit.anchors
    )
    moved = replace(fit, reference_epoch_s=fit.camera_epoch_us * 1e-6, anchors=anchors)
    return moved.with_map(1.0, 0.0, fit.covariance)


def _fit_message(types: Any, fit: ClockFit, now_ns: int) -> Any:  # noqa: ANN401
    fields: dict[str, Any] = {
        name: np.array(value) if isinstance(value, list) else value
        for name, value in fit.to_fields().items()
    }
    time = types.types['builtin_interfaces/msg/Time'](*divmod(now_ns, _NS))
    header = types.types['std_msgs/msg/Header'](stamp=time, frame_id='')
    kind = topics.CLOCK_FIT.type_name
    return types.serialize_cdr(types.types[kind](header=header, **fields), kind)
