# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Clock maps of bags: reading what a fit needs, and results on disk.

`read_recording` reduces a bag in one pass. A bag has a packet every millisecond; packets are read
in their serialised form, because a message for each would take most of the time.

`write_fit` writes a map beside its bag, `rewrite_bag` copies a bag onto one clock.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.codec import StreamDecoder
from mixtac_core.events.errors import MixtacError
from mixtac_core.events.packets import read_packet
from mixtac_core.node import topics
from mixtac_core.node.files import new_folder, read_data, write_json
from mixtac_core.node.images import ImageConversionError, grey
from mixtac_core.node.topics import stamp_to_ns, stamp_to_us
from mixtac_core.recordings.bag import BagFile, check_new, fit_path, typestore
from mixtac_core.recordings.bag_writer import McapBag
from mixtac_core.recordings.recording import RecordingError
from mixtac_fger.alignment.align import arrived_together
from mixtac_fger.alignment.clock_fit import ClockFit
from mixtac_fger.alignment.errors import AlignmentError, GapError
from mixtac_fger.alignment.histories import (
    RESTART_US,
    EventHistory,
    FrameHistory,
    Recording,
    reduce_frame,
)

LONGEST_S: Final = 3600.0
"""Longest span of frames and events that is kept [s]."""


def add_packet(data: bytes, decoder: StreamDecoder, history: EventHistory) -> None:
    """Add a serialised `EventPacket` to a history.

    Raises:
        CodecError: It is cut off, or its events are damaged.
        GapError: The camera clock or its driver started anew, or jumped ahead by hours.
    """
    message = read_packet(data)
    packet = decoder.decode(message)
    if decoder.timed and history.add(packet, message.seq, message.width, message.height):
        raise GapError(
            f'the camera clock or its driver started anew at {packet.start_us * 1e-6:.1f} s, in'
            f' packet {message.seq}',
            remedy='record again, and do not restart the driver or set the clock of the host',
        )


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
    history, frames = EventHistory(LONGEST_S), FrameHistory(LONGEST_S)
    decoder = StreamDecoder()
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
                add_packet(message, decoder, history)
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
    if not (edges_only or history.packets.received):
        raise RecordingError(f'{path} topic {events} is empty: the camera sent nothing')
    force_t_s, force = _force(samples, f'{path} topic {reference}')
    return Recording(
        counts=history.counts(),
        events=history.events(),
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
    if (back < -1000 * RESTART_US).any():
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


def rewrite_bag(bag: Path, fit: ClockFit, out: Path, reference: str, namespace: str) -> None:
    """Copy a bag with the reference force stamped on the camera clock.

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
    types = typestore()
    fit_topic = topics.CLOCK_FIT.resolved(namespace)
    with BagFile(bag) as source, new_folder(out) as made, McapBag(made) as writer:
        handles = writer.add_topics_of(source, fit_topic)
        fit_handle = writer.add_topic(fit_topic, topics.CLOCK_FIT.type_name, latched=True)
        own = _fit_message(types, _of_one_clock(fit), source.start_ns)
        writer.write(fit_handle, source.start_ns, own)
        raw = handles.keys() - {reference}
        for topic, received_ns, message in source.messages(*handles, raw=raw):
            data = message
            if topic == reference:
                stamp = message.header.stamp
                seconds = stamp.sec - fit.reference_epoch_s + stamp.nanosec * 1e-9
                moved_ns = round((seconds - fit.b) / fit.a * 1e9) + 1000 * fit.camera_epoch_us
                stamp.sec, stamp.nanosec = divmod(moved_ns, _NS)
                data = types.serialize_cdr(message, source.types[reference])
            writer.write(handles[topic], received_ns, data)


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
