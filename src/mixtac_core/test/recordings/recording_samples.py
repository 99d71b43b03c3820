# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Recordings to test with: scenes, the bags that hold them, and their content read back."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode

from mixtac_core.events.arrays import Events
from mixtac_core.events.codec import encode
from mixtac_core.recordings.bag import typestore
from mixtac_core.recordings.camera_stream import open_recording
from mixtac_core.recordings.recording import ReadCounters, RecordingInfo, Selection, from_time

EVENT_PACKET = 'event_camera_msgs/msg/EventPacket'
IMAGE = 'sensor_msgs/msg/Image'
IMU = 'sensor_msgs/msg/Imu'
CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'
FRAME_EXPOSURE = 'mixtac_msgs/msg/FrameExposure'
EXTERNAL_EDGE = 'mixtac_msgs/msg/ExternalEdge'
TEMPERATURE = 'sensor_msgs/msg/Temperature'
TIME_REFERENCE = 'sensor_msgs/msg/TimeReference'
START_US = 1_700_000_000_123_456
TYPES = typestore()
HEADER = TYPES.types['std_msgs/msg/Header']
TIME = TYPES.types['builtin_interfaces/msg/Time']


def some_events(seed=0, count=5000, length_us=50_000, start_us=START_US, size=(346, 260)):
    rng = np.random.default_rng(seed)
    t = np.sort(rng.integers(0, length_us, count)) + start_us
    t[0], t[-1] = start_us, start_us + length_us - 1
    return Events(
        t.astype(np.int64),
        rng.integers(0, size[0], count).astype(np.uint16),
        rng.integers(0, size[1], count).astype(np.uint16),
        rng.integers(0, 2, count).astype(np.bool_),
    )


def header(t_us):
    return HEADER(TIME(int(t_us // 1_000_000), int(t_us % 1_000_000) * 1000), 'camera')


class Bag:
    """Writes a bag; every message is received when its stamp says, or a little later."""

    def __init__(self, path, plugin=StoragePlugin.MCAP, *, compressed=False):
        self.writer = Writer(path, version=9, storage_plugin=plugin)
        if compressed:
            self.writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
        self.writer.open()
        self.connections = {}
        self.sequence = 0

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self.writer.close()

    def write(self, topic, kind, received_us, message):
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=TYPES)
        data = TYPES.serialize_cdr(message, kind)
        self.writer.write(self.connections[topic], int(received_us) * 1000, data)

    def packet(
        self,
        events,
        until_us,
        *,
        encoding='libcaer_cmp',
        topic='/mixtac/events',
        stamp_us=None,
        size=(346, 260),
        encoded=None,
    ):
        encoded = encoded or encode(events, encoding, complete_until=until_us)
        stamp_us = until_us if stamp_us is None else stamp_us
        message = TYPES.types[EVENT_PACKET](
            header(stamp_us),
            size[1],
            size[0],
            self.sequence,
            encoded.time_base,
            encoding,
            False,
            np.asarray(encoded.payload, np.uint8),
        )
        self.sequence += 1
        self.write(topic, EVENT_PACKET, stamp_us, message)

    def events(self, events, period_us=1000, **options):
        """Write events in packets on a grid, also where none are."""
        first, last = int(events.t[0]) // period_us, int(events.t[-1]) // period_us
        for cell in range(first, last + 1):
            end_us = (cell + 1) * period_us
            self.packet(events.between(cell * period_us, end_us), end_us, **options)

    def image(
        self,
        pixels,
        t_us,
        received_us=None,
        *,
        encoding='mono16',
        topic='/mixtac/image_raw',
        big=False,
    ):
        height, width = pixels.shape
        octets = np.ascontiguousarray(pixels).view(np.uint8).reshape(-1)
        message = TYPES.types[IMAGE](
            header(t_us), height, width, encoding, big, octets.size // height, octets
        )
        self.write(topic, IMAGE, t_us if received_us is None else received_us, message)

    def imu(self, t_us, acceleration, rotation=None, topic='/mixtac/imu'):
        vector, quaternion = (
            TYPES.types[f'geometry_msgs/msg/{name}'] for name in ('Vector3', 'Quaternion')
        )
        missing = np.zeros(9)
        missing[0] = -1
        message = TYPES.types[IMU](
            header(t_us),
            quaternion(0, 0, 0, 1),
            missing,
            vector(*(rotation or (0.0, 0.0, 0.0))),
            missing if rotation is None else np.zeros(9),
            vector(*acceleration),
            np.zeros(9),
        )
        self.write(topic, IMU, t_us, message)

    def temperature(self, t_us, celsius, topic='/mixtac/temperature'):
        message = TYPES.types[TEMPERATURE](header(t_us), celsius, 0.0)
        self.write(topic, TEMPERATURE, t_us, message)

    def exposure(self, t_us, times, shutter=0, received_us=None, topic='/mixtac/image_exposure'):
        stamps = [header(time_us).stamp for time_us in times]
        message = TYPES.types[FRAME_EXPOSURE](header(t_us), *stamps, shutter)
        self.write(topic, FRAME_EXPOSURE, t_us if received_us is None else received_us, message)

    def edge(self, t_us, kind, topic='/mixtac/external_edges'):
        message = TYPES.types[EXTERNAL_EDGE](header(t_us), kind, 0)
        self.write(topic, EXTERNAL_EDGE, t_us, message)

    def info(self, t_us, size=(346, 260), corner=(0, 0), topic='/mixtac/camera_info'):
        region = TYPES.types['sensor_msgs/msg/RegionOfInterest'](*corner, 0, 0, False)
        message = TYPES.types[CAMERA_INFO](
            header(t_us),
            size[1],
            size[0],
            '',
            np.zeros(0),
            np.zeros(9),
            np.zeros(9),
            np.zeros(12),
            0,
            0,
            region,
        )
        self.write(topic, CAMERA_INFO, t_us, message)

    def clock(self, t_us, serial, topic='/mixtac/camera_clock'):
        stamp = header(t_us)
        message = TYPES.types[TIME_REFERENCE](stamp, stamp.stamp, serial)
        self.write(topic, TIME_REFERENCE, t_us, message)


@dataclass
class Read:
    """Everything a recording held."""

    info: RecordingInfo
    counters: ReadCounters
    events: Events = field(default_factory=Events.empty)
    times: list = field(default_factory=list)
    frames: list = field(default_factory=list)
    frame_times: list = field(default_factory=list)
    imu: list = field(default_factory=list)
    edges: list = field(default_factory=list)


def read(path, from_us=0, **selection):
    """Read a recording to its end; times are those of the recorded clock.

    Args:
        path: The recording.
        from_us: Where to begin [us].
        selection: Fields of `Selection`.
    """
    with contextlib.closing(open_recording(path, Selection(**selection))) as recording:
        found, parts = Read(recording.info, recording.counters), []
        for piece in from_time(recording.pieces(), from_us):
            parts.append(piece.events)
            if piece.advances:
                found.times.append(piece.until_us)
            found.frames += piece.frames
            found.frame_times += [frame.middle_us for frame in piece.frames]
            imu = piece.imu
            found.imu += zip(
                imu.t.tolist(), imu.acceleration, imu.angular_velocity, imu.temperature, strict=True
            )
            found.edges += zip(piece.edges.t.tolist(), piece.edges.kind.tolist(), strict=True)
    found.events = Events.concatenate(parts)
    return found


def scene(path, **options):
    """A bag with events, two frames and three inertial samples; returns what is in it."""
    events = some_events()
    rng = np.random.default_rng(3)
    frames = [rng.integers(0, 1024, (260, 346)).astype(np.uint16) for _ in range(2)]
    with Bag(path, **options) as bag:
        bag.info(START_US)
        bag.events(events)
        for number, frame in enumerate(frames):
            t_us = START_US + 20_000 * number + 5000
            bag.image(frame << 6, t_us, t_us + 3000)
        for number in range(3):
            bag.imu(START_US + 1000 * number, (0.5, number, 9.8), (0.1, 0.2, 0.3))
    return events, frames


def assert_equal(found, expected):
    assert len(found) == len(expected)
    for name in ('t', 'x', 'y', 'polarity'):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), name)
