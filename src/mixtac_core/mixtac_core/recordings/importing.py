# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Make bags from CSV, NPZ, HDF5 or AEDAT files, with forces from a table.

Messages are those of the live graph, written without rclpy: topics, types, QoS and packets are
those of the driver. Times are kept as they are: nothing is aligned.
"""

from __future__ import annotations

import contextlib
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_core.events.packets import PacketWriter
from mixtac_core.events.readings import Edges, Frame, InertialSamples
from mixtac_core.events.windows import Packetizer
from mixtac_core.node import topics
from mixtac_core.node.files import new_folder
from mixtac_core.node.topics import REFERENCE, REFERENCE_FRAME, REFERENCE_WRENCH, Topic
from mixtac_core.recordings import messages
from mixtac_core.recordings.bag import blank_message, check_new, typestore
from mixtac_core.recordings.bag_writer import McapBag
from mixtac_core.recordings.camera_stream import Recording, open_recording
from mixtac_core.recordings.recording import RecordingError, Selection
from mixtac_core.recordings.summary import Counts
from mixtac_core.recordings.table_recording import table_wrenches
from mixtac_core.recordings.tables import TableOptions


def serialised(topic: Topic, message: Any) -> bytes:  # noqa: ANN401
    """Return a message of rosbags as bytes; what is serialised already stays as it is."""
    if isinstance(message, bytes):
        return message
    return bytes(typestore().serialize_cdr(message, topic.type_name))


class StreamWriter:
    """Writes one camera's stream to a bag; times are on its epoch-based clock [us].

    Args:
        bag: Where to write; the caller closes it.
        size: Width and height of the event array.
        color_filter: Colour filter of the camera, 0 for none.
    """

    def __init__(self, bag: McapBag, size: tuple[int, int], *, color_filter: int = 0) -> None:
        self._bag, self._size, self._color_filter = bag, size, color_filter
        self._packetizer, self._packets = Packetizer(), PacketWriter(topics.CAMERA_FRAME, size)
        self._sequence = self._edges = 0
        self._handles: dict[str, Any] = {}

    def put(self, topic: Topic, received_ns: int, message: Any) -> None:  # noqa: ANN401
        """Write a message.

        Args:
            topic: Its topic.
            received_ns: Host time of its reception [ns since the Unix epoch].
            message: The message of `blank_message`, or its bytes.
        """
        if topic.name not in self._handles:
            name = topic.resolved(topics.DEFAULT_NAMESPACE)
            self._handles[topic.name] = self._bag.add_topic(
                name, topic.type_name, latched=topic.latched
            )
        self._bag.write(self._handles[topic.name], received_ns, serialised(topic, message))

    def events(self, events: Events, until_us: int, arrival_ns: int, *, delay_ns: int = 0) -> None:
        """Write events in packets of a millisecond.

        Args:
            events: Events [us, published time], after those before.
            until_us: No later call adds earlier events.
            arrival_ns: When their data were received from the camera.
            delay_ns: From then to the reception of the packets.
        """
        for packet in self._packetizer.push(events, until_us, arrival_ns):
            data = self._packets.write(packet.encode(), self._sequence, packet.arrival_ns)
            self.put(topics.EVENTS, arrival_ns + delay_ns, data)
            self._sequence += 1

    def frame(self, frame: Frame, origin_us: int, received_ns: int) -> None:
        """Write a frame, its size and its exposure.

        Args:
            frame: The frame; its times are relative to `origin_us`.
            origin_us: See above [us since the Unix epoch].
            received_ns: Host time of its reception [ns since the Unix epoch].
        """
        image = messages.image(
            frame, origin_us, self._color_filter, topics.CAMERA_FRAME, blank_message
        )
        info = messages.camera_info(frame, self._size, image, blank_message)
        exposure = messages.frame_exposure(frame, origin_us, image, blank_message)
        self.put(topics.IMAGE_RAW, received_ns, image)
        self.put(topics.CAMERA_INFO, received_ns, info)
        self.put(topics.IMAGE_EXPOSURE, received_ns, exposure)

    def samples(self, samples: InertialSamples, origin_us: int, received_ns: int) -> None:
        """Write inertial samples, each after its temperature; arguments as in `frame`."""
        for index in range(len(samples.t)):
            celsius, t_us = float(samples.temperature[index]), int(samples.t[index]) + origin_us
            if not math.isnan(celsius):
                message = messages.temperature(celsius, t_us, topics.IMU_FRAME, blank_message)
                self.put(topics.TEMPERATURE, received_ns, message)
            message = messages.imu(samples, index, origin_us, topics.IMU_FRAME, blank_message)
            self.put(topics.IMU, received_ns, message)

    def edges(self, edges: Edges, origin_us: int, received_ns: int) -> None:
        """Write edges of the synchronisation connector; arguments as in `frame`."""
        for t_us, kind in zip(edges.t.tolist(), edges.kind.tolist(), strict=True):
            message = messages.external_edge(
                kind, t_us + origin_us, self._edges, topics.CAMERA_FRAME, blank_message
            )
            self.put(topics.EXTERNAL_EDGES, received_ns, message)
            self._edges += 1


def import_recording(
    path: Path,
    out: Path,
    *,
    forces: Path | None = None,
    same_clock: bool = False,
    options: TableOptions | None = None,
    selection: Selection | None = None,
) -> Counts:
    """Write camera data and forces of other files as a bag, whole or not at all.

    Args:
        path: An .aedat4, .csv, .npz or .h5 file, a bag, or a folder of tables.
        out: Folder of the new bag.
        forces: Table of the reference force, csv or NPZ; None for that of the bag or beside the
            tables, if any.
        same_clock: Forces are on the camera's clock.
        options: How to read tables.
        selection: Which topics or streams of a bag or an AEDAT4 file; None for the only one of each
            kind.

    Returns:
        What was written.

    Raises:
        RecordingError: A file cannot be read, the choice is ambiguous, times go backwards, forces
            on the camera's clock do not overlap its data in time, or the bag exists.
        FileError: The bag cannot be written.
    """
    options = options or TableOptions()
    check_new(out)
    with contextlib.closing(open_recording(path, selection, options)) as recording:
        recorded = recording.wrenches().get(REFERENCE, ())
        parts = list(table_wrenches(forces, options) if forces else recorded)
        if forces and not parts:
            raise RecordingError(f'{forces} holds no forces', remedy='give a table with rows')
        stamps_ns = np.concatenate([np.zeros(0, np.int64), *(stamps for stamps, _ in parts)])
        values = np.concatenate([np.zeros((0, 6)), *(rows for _, rows in parts)])
        info = recording.info
        with new_folder(out) as folder, McapBag(folder) as bag:
            writer = StreamWriter(bag, (info.width, info.height), color_filter=info.color_filter)
            counts = _write(recording, stamps_ns, values, writer, same_clock=same_clock)
        counts.info = recording.info
    return counts


def _write(
    recording: Recording,
    stamps_ns: NDArray[np.int64],
    values: NDArray[np.float64],
    writer: StreamWriter,
    *,
    same_clock: bool,
) -> Counts:
    counts = Counts(recording.info, recording.counters)
    # Of another clock only the time since the first sample can be compared.
    other_clock = len(stamps_ns) and not same_clock
    origin_ns = int(stamps_ns[0]) - 1000 * recording.info.start_us if other_clock else 0
    due_ns = np.maximum.accumulate(stamps_ns) - origin_ns
    written = received_ns = 0
    wrenches = topics.WrenchWriter(REFERENCE_FRAME)

    def write_forces(until: int) -> None:
        for row in range(written, until):
            data = wrenches.serialised(int(stamps_ns[row]), values[row].tolist())
            due = min(max(int(due_ns[row]), 0), received_ns)
            writer.put(REFERENCE_WRENCH, due, data)

    for piece in recording.pieces():
        counts.add(piece)
        if counts.backward_steps:
            raise RecordingError(
                f'events go back in time at {counts.back_us} us',
                remedy='sort them by time (unnamed columns are t, x, y, p), and cut a recording'
                ' where its clock was reset',
            )
        received_ns = 1000 * counts.last_us
        until = int(np.searchsorted(due_ns, received_ns, 'right'))
        write_forces(until)
        written = until
        if len(piece.events):
            writer.events(piece.events, piece.until_us, received_ns)
        for frame in piece.frames:
            writer.frame(frame, 0, received_ns)
        writer.samples(piece.imu, 0, received_ns)
        writer.edges(piece.edges, 0, received_ns)
    write_forces(len(stamps_ns))
    if len(stamps_ns):
        counts.wrenches[REFERENCE] = len(stamps_ns)
        forces_s, camera_s = stamps_ns[[0, -1]] / 1e9, (counts.first_us / 1e6, counts.last_us / 1e6)
        if same_clock and (forces_s[1] < camera_s[0] or forces_s[0] > camera_s[1]):
            forces, camera = ('{:.3f} to {:.3f} s'.format(*each) for each in (forces_s, camera_s))
            raise RecordingError(
                f'forces of {forces} and camera data of {camera} are not of one clock',
                remedy='give the units of the times, or leave --same-clock out and align the bag',
            )
    # Closes the packet of the last millisecond.
    writer.events(Events.empty(), counts.last_us + 1000, received_ns)
    return counts
