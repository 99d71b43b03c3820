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

from mixtac_core.events.codec import StreamDecoder
from mixtac_core.events.errors import MixtacError
from mixtac_core.events.packets import read_packet
from mixtac_core.node import topics
from mixtac_core.node.files import new_folder, read_data, write_json
from mixtac_core.node.topics import stamp_to_ns
from mixtac_core.recordings.bag import BagFile, blank_message, check_new, fit_path, typestore
from mixtac_core.recordings.bag_writer import McapBag
from mixtac_core.recordings.messages import set_header
from mixtac_core.recordings.recording import RecordingError
from mixtac_fger.alignment.align import arrived_together
from mixtac_fger.alignment.clock_fit import AlignmentError, ClockFit, GapError
from mixtac_fger.alignment.histories import F64, EventHistory, FrameHistory, Recording, force_arrays

LONGEST_S: Final = 3600.0
"""Longest span of frames and events that is kept [s]."""


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
        ImageConversionError: Frames that cannot be read.
        GapError: A clock went back or began anew, or the camera's went ahead by hours.
    """
    names = ('events', 'image_raw', 'image_exposure', 'external_edges', 'reference_edges')
    events, image, exposure, edge, other = (topics.absolute(name, namespace) for name in names)
    needed = () if edges_only else (events, reference)
    more = (edge, other) if edges_only else (image, exposure, edge, other)
    history, frames, decoder = EventHistory(LONGEST_S), FrameHistory(LONGEST_S), StreamDecoder()
    # Stamp and arrival [ns] of each edge.
    edges: dict[str, list[tuple[int, int]]] = {edge: [], other: []}
    samples: list[tuple[int, float]] = []
    with BagFile(path) as bag:
        optional = [topic for topic in more if bag.counts.get(topic)]
        for topic, received_ns, message in bag.messages(*needed, *optional, raw=(events,)):
            if topic == events:
                read = read_packet(message)
                packet = decoder.decode(read)
                if decoder.timed and history.add(packet, read.seq, read.width, read.height):
                    raise GapError(
                        'the camera clock or its driver started anew at'
                        f' {packet.start_us * 1e-6:.1f} s, in packet {read.seq}',
                        remedy='record again, and do not restart the driver or set the clock of the'
                        ' host',
                    )
            elif topic == reference:
                samples.append((stamp_to_ns(message.header.stamp), topics.normal_force(message)))
            elif topic == image:
                frames.add_image(message)
            elif topic == exposure:
                frames.add_exposure(message)
            else:
                stamp = message.header.stamp if topic == edge else message.time_ref
                edges[topic].append((stamp_to_ns(stamp), received_ns))
    if not (edges_only or history.packets.received):
        raise RecordingError(f'{path} topic {events} is empty: the camera sent nothing')
    camera, trigger = (np.array(each, np.int64).reshape(-1, 2) for each in edges.values())
    measured = force_arrays(samples)
    return Recording(
        *history.snapshot(),
        frames.snapshot(),
        *measured,
        camera[:, 0] // 1000,
        trigger[:, 0] / 1e9,
        '; '.join(filter(None, (bag.damage, stuck(*measured)))),
        arrived_together(camera[:, 1], trigger[:, 1]),
    )


def stuck(stamps_s: F64, forces: F64, most_s: float = 3.0) -> str:
    """Return a remark if the force of a reference sensor stays the same for long, else ''.

    Args:
        stamps_s: Increasing times [s], [n].
        forces: Forces [N], [n].
        most_s: Longest time for which a sensor that works repeats a value, despite its noise [s].
    """
    changed_s = stamps_s[np.flatnonzero(np.diff(forces, append=np.inf))]
    longest_s = np.diff(changed_s, prepend=stamps_s[:1]).max(initial=0.0)
    return f'the reference does not move for {longest_s:.1f} s' if longest_s > most_s else ''


def write_fit(fit: ClockFit, bag: Path) -> Path:
    """Write a fit beside its bag and return the file: the fields of `mixtac_msgs/ClockFit`."""
    path = fit_path(bag)
    write_json(path, {'schema': 1, 'bag': bag.name, **fit.to_fields()})
    return path


def read_fit(bag: Path) -> ClockFit:
    """Return the fit beside a bag.

    Raises:
        AlignmentError: No such file, or a file that describes no map.
    """
    path = fit_path(bag)
    try:
        return ClockFit.from_fields(dict(read_data(path)))
    except (MixtacError, TypeError, ValueError) as error:
        text = f'no clock fit in {path} ({error})'
        raise AlignmentError(text, remedy=f'run `mixtac align {bag}`') from error


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
    fit_topic = topics.CLOCK_FIT.resolved(namespace)
    with BagFile(bag) as source, new_folder(out) as made, McapBag(made) as writer:
        handles = writer.add_topics_of(source, fit_topic)
        fit_handle = writer.add_topic(fit_topic, topics.CLOCK_FIT.type_name, latched=True)
        anchors = tuple(
            replace(anchor, reference_s=int(fit.to_camera(anchor.reference_s)) * 1e-6)
            for anchor in fit.anchors
        )
        own = replace(fit, reference_epoch_s=fit.camera_epoch_us * 1e-6, anchors=anchors)
        own = own.with_map(1.0, 0.0, fit.covariance)
        writer.write(fit_handle, source.start_ns, _fit_message(own, source.start_ns))
        raw = handles.keys() - {reference}
        for topic, received_ns, message in source.messages(*handles, raw=raw):
            data = message
            if topic == reference:
                stamp = message.header.stamp
                seconds = stamp.sec - fit.reference_epoch_s + stamp.nanosec * 1e-9
                moved_ns = round((seconds - fit.b) / fit.a * 1e9) + 1000 * fit.camera_epoch_us
                set_header(message, moved_ns, message.header.frame_id)
                data = typestore().serialize_cdr(message, source.types[reference])
            writer.write(handles[topic], received_ns, data)


def _fit_message(fit: ClockFit, now_ns: int) -> Any:  # noqa: ANN401
    message = set_header(blank_message(topics.CLOCK_FIT.type_name), now_ns, '')
    for name, value in fit.to_fields().items():
        setattr(message, name, np.array(value) if isinstance(value, list) else value)
    return typestore().serialize_cdr(message, topics.CLOCK_FIT.type_name)
