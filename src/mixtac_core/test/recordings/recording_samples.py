# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Recordings to test with: scenes, the bags that hold them, and their content read back."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer

from mixtac_core.events.arrays import Events
from mixtac_core.events.codec import encode
from mixtac_core.events.packets import EncodedPacket
from mixtac_core.recordings.bag import blank_message, typestore
from mixtac_core.recordings.camera_stream import open_recording
from mixtac_core.recordings.messages import set_header
from mixtac_core.recordings.recording import ReadCounters, RecordingInfo, Selection

START_US = 1_700_000_000_123_456
TYPES = typestore()


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


def plain_packet(events):
    """Return events in the encoding `libcaer`, by its layout."""
    x, y, on = (each.astype(np.uint32) for each in (events.x, events.y, events.polarity))
    data = x << 17 | y << 2 | on << 1 | 1
    payload = np.stack([data, (events.t & 0x7FFFFFFF).astype(np.uint32)], axis=1).view(np.uint8)
    return EncodedPacket((int(events.t[0]) >> 31 << 31) * 1000, payload.ravel(), 'libcaer')


class Bag:
    """Writes a bag; every message is received when its stamp says, or a little later."""

    def __init__(self, path, plugin=StoragePlugin.MCAP):
        self.writer = Writer(path, version=9, storage_plugin=plugin)
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

    def send(self, topic, type_name, t_us, received_us=None, **fields):
        """Write a message with a stamp and some fields, all others are zero."""
        message = blank_message(type_name)
        set_header(message, 1000 * t_us, 'camera')
        for name, value in fields.items():
            setattr(message, name, value)
        self.write(topic, type_name, t_us if received_us is None else received_us, message)

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
        if encoded is None and encoding == 'libcaer' and len(events):
            encoded = plain_packet(events)
        encoded = encoded or encode(events, complete_until=until_us)
        self.send(
            topic,
            'event_camera_msgs/msg/EventPacket',
            until_us if stamp_us is None else stamp_us,
            width=size[0],
            height=size[1],
            seq=self.sequence,
            time_base=encoded.time_base,
            encoding=encoding,
            events=np.asarray(encoded.payload, np.uint8),
        )
        self.sequence += 1

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
        (height, width), octets = pixels.shape, np.ascontiguousarray(pixels).view(np.uint8)
        fields = {'height': height, 'width': width, 'encoding': encoding, 'is_bigendian': big}
        fields |= {'step': octets.size // height, 'data': octets.reshape(-1)}
        self.send(topic, 'sensor_msgs/msg/Image', t_us, received_us, **fields)

    def imu(self, t_us, acceleration, rotation=None, topic='/mixtac/imu'):
        vector, missing = TYPES.types['geometry_msgs/msg/Vector3'], np.zeros(9)
        missing[0] = -1
        fields = {} if rotation else {'angular_velocity_covariance': missing}
        fields['angular_velocity'] = vector(*(rotation or (0.0, 0.0, 0.0)))
        fields['linear_acceleration'] = vector(*acceleration)
        self.send(topic, 'sensor_msgs/msg/Imu', t_us, **fields)

    def temperature(self, t_us, celsius, topic='/mixtac/temperature'):
        self.send(topic, 'sensor_msgs/msg/Temperature', t_us, temperature=celsius)

    def exposure(self, t_us, times, shutter=0, received_us=None, topic='/mixtac/image_exposure'):
        time = TYPES.types['builtin_interfaces/msg/Time']
        names = ('frame_start', 'exposure_start', 'exposure_end', 'frame_end')
        stamps = [time(each // 1_000_000, each % 1_000_000 * 1000) for each in times]
        fields = dict(zip(names, stamps, strict=True))
        kind = 'mixtac_msgs/msg/FrameExposure'
        self.send(topic, kind, t_us, received_us, **fields, shutter=shutter)

    def edge(self, t_us, kind, topic='/mixtac/external_edges'):
        self.send(topic, 'mixtac_msgs/msg/ExternalEdge', t_us, kind=kind)

    def info(self, t_us, size=(346, 260), corner=(0, 0), topic='/mixtac/camera_info'):
        region = TYPES.types['sensor_msgs/msg/RegionOfInterest'](*corner, 0, 0, False)
        kind = 'sensor_msgs/msg/CameraInfo'
        self.send(topic, kind, t_us, width=size[0], height=size[1], roi=region)

    def clock(self, t_us, serial, topic='/mixtac/camera_clock'):
        self.send(topic, 'sensor_msgs/msg/TimeReference', t_us, source=serial)


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


def read(path, **selection):
    """Read a recording to its end; times are those of the recorded clock.

    Args:
        path: The recording.
        selection: Fields of `Selection`.
    """
    with contextlib.closing(open_recording(path, Selection(**selection))) as recording:
        found, parts = Read(recording.info, recording.counters), []
        for piece in recording.pieces():
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
