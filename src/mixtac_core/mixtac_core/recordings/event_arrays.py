# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Event messages of ROS 1: arrays of events with a time each, as they are serialised in bags.

`dvs_msgs`, `dv_ros_msgs` and `prophesee_event_msgs` have the same fields: a header, rows, columns,
and per event 13 bytes with column, row, seconds, nanoseconds and polarity.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

from mixtac_core.events.arrays import Events
from mixtac_core.recordings.recording import DamagedRecordingError

EVENT_ARRAYS = tuple(
    f'{package}/msg/EventArray' for package in ('dvs_msgs', 'dv_ros_msgs', 'prophesee_event_msgs')
)
"""Names of the message types, as rosbags gives them."""
_HEADER = struct.Struct('<4I')
_SIZES = struct.Struct('<3I')
_EVENT = np.dtype([('x', '<u2'), ('y', '<u2'), ('s', '<u4'), ('ns', '<u4'), ('polarity', 'u1')])


@dataclass(frozen=True, slots=True, eq=False)
class EventArray:
    """One message.

    Attributes:
        seq: Number of the message.
        stamp_us: Its stamp [us].
        width: Columns of the sensor.
        height: Rows of the sensor.
        events: Events inside the sensor, sorted by time [us].
        outside: Events left out because they lie outside the sensor.
        unsorted: Events that were older than the one before.
    """

    seq: int
    stamp_us: int
    width: int
    height: int
    events: Events
    outside: int
    unsorted: int


def read_event_array(data: bytes) -> EventArray:
    """Return the content of a serialised message.

    Args:
        data: The message, as ROS 1 serialises it.

    Raises:
        DamagedRecordingError: It is cut off.
    """
    try:
        seq, seconds, nanoseconds, length = _HEADER.unpack_from(data)
        at = _HEADER.size + length
        height, width, count = _SIZES.unpack_from(data, at)
        rows = np.frombuffer(data, _EVENT, count, at + _SIZES.size)
    except (struct.error, ValueError) as error:
        raise DamagedRecordingError(f'message of {len(data)} bytes is cut off: {error}') from error
    inside = rows[(rows['x'] < width) & (rows['y'] < height)]
    t = inside['s'].astype(np.int64) * 1_000_000 + inside['ns'] // 1000
    order = np.argsort(t, kind='stable')
    rows = inside[order]
    events = Events(t[order], rows['x'].copy(), rows['y'].copy(), rows['polarity'] != 0)
    stamp_us = seconds * 1_000_000 + nanoseconds // 1000
    unsorted = int(np.count_nonzero(np.diff(t) < 0))
    return EventArray(seq, stamp_us, width, height, events, count - len(inside), unsorted)
