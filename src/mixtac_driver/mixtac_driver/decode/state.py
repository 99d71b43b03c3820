# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Memory of the decoder: its state from word to word, its counters, and its output arrays.

State, counters, readings and pixels are structured arrays of one element. Compiled code takes that
element, a record, and works on its fields by name (`s.time`, `c.events`), in place. Passing records
between compiled functions is cheap; for arrays, numba counts references at every call.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixtac_driver.davis346.model import Geometry

RESET_COLUMN = 0
"""Type of a column of reset samples."""
SIGNAL_COLUMN = 1
"""Type of a column of signal samples."""
NO_COLUMN = -1
"""Column type between two columns."""
IMU_BYTES = 14
"""Payload of an inertial sample [bytes]."""
IMU_OUTSIDE = -1
"""Index of the next byte between two inertial samples."""
IMU_AWAITS_INFO = -2
"""Index of the next byte between start word and info byte."""
READINGS_CAPACITY = 256
"""Inertial samples, and edges, that wait to be taken at most."""


@dataclass(frozen=True, slots=True)
class DecoderCounters:
    """Counts of dropped and unknown data since the decoder was created: 0 on an intact stream.

    Attributes:
        words_unexpected: Words ignored because they are unknown, name no pixel of the array, do not
            belong where they are, or would set the time back.
        frames_dropped: Frames dropped because they were incomplete.
        imu_dropped: Inertial samples dropped because they were incomplete.
        bytes_dropped: Odd bytes dropped at the end of transfers.
    """

    words_unexpected: int = 0
    frames_dropped: int = 0
    imu_dropped: int = 0
    bytes_dropped: int = 0


COUNTERS = np.dtype([(each.name, np.int64) for each in fields(DecoderCounters)], align=True)
"""Record of the counters, in the order of DecoderCounters."""

STATE = np.dtype(
    [
        ('time', np.int64),  # latest time [us, camera clock since its latest reset]
        ('wrap_base', np.int64),  # time of the latest wrap [us]
        ('time_before_reset', np.int64),
        ('row', np.int64),  # row of the next events, -1 if unknown
        # Pixel arrays, as on the wire.
        ('dvs_rows', np.int64),
        ('dvs_columns', np.int64),
        ('aps_columns', np.int64),
        ('aps_rows', np.int64),
        ('aps_inverted', np.int64),
        # The frame in progress, or the latest complete one.
        ('frame_open', np.int64),  # 1 between start and end
        ('frame_broken', np.int64),  # 1 if anything is missing
        ('frame_global', np.int64),  # 1 global, 0 rolling shutter
        ('frame_start', np.int64),
        ('exposure_start', np.int64),  # -1 until seen
        ('exposure_end', np.int64),
        ('frame_end', np.int64),
        ('exposure_cycles', np.int64),
        ('exposure_words', np.int64),
        ('roi_high', np.int64),  # high byte, until its low byte arrives
        ('roi_values', np.int64),  # values of `roi` received, complete at 4
        ('roi', np.int64, 4),  # start column, start row, end column, end row; user orientation
        ('width', np.int64),  # size of the region, user orientation
        ('height', np.int64),
        ('columns', np.int64),  # columns expected and samples per column, wire orientation
        ('column_size', np.int64),
        ('column_type', np.int64),  # RESET_COLUMN, SIGNAL_COLUMN or NO_COLUMN
        ('columns_done', np.int64, 2),  # by column type
        ('column_fill', np.int64),  # samples received of the open column
        # The inertial sample in progress.
        ('imu_index', np.int64),  # next byte, IMU_OUTSIDE or IMU_AWAITS_INFO
        ('imu_info', np.int64),
    ],
    align=True,
)
"""Record of everything that a word can change for the words after it."""

READINGS = np.dtype(
    [
        ('imu_count', np.int64),  # complete samples
        ('imu_t', np.int64, READINGS_CAPACITY),  # [us]
        # Payload and info byte of each sample; the sample in progress follows the complete ones.
        ('imu_raw', np.uint8, (READINGS_CAPACITY + 1, IMU_BYTES + 1)),
        ('edge_count', np.int64),
        ('edge_t', np.int64, READINGS_CAPACITY),  # [us]
        ('edge_kind', np.uint8, READINGS_CAPACITY),
    ],
    align=True,
)
"""Record of inertial samples and edges that have been decoded but not yet taken."""


class Buffers(NamedTuple):
    """Memory that the compiled decoder works on.

    Attributes:
        state: STATE [1].
        counters: COUNTERS [1].
        readings: READINGS [1].
        t: `int64` [N], event times [us on the camera clock since its latest reset].
        row: `uint16` [N], event rows, as on the wire.
        column: `uint16` [N], event columns, as on the wire.
        polarity: `uint8` [N], 1 for ON.
        pixels: [1], the frame in progress, column by column: `resets` `uint16` [P], its reset
            samples, and `image` `uint16` [P], 0 .. 1023.
    """

    state: NDArray[Any]
    counters: NDArray[Any]
    readings: NDArray[Any]
    t: NDArray[np.int64]
    row: NDArray[np.uint16]
    column: NDArray[np.uint16]
    polarity: NDArray[np.uint8]
    pixels: NDArray[Any]


def new_buffers(geometry: Geometry, capacity: int) -> Buffers:
    """Return the memory of a decoder that has not seen any words.

    Args:
        geometry: Pixel arrays of the camera.
        capacity: Events that the output arrays hold.
    """
    size = max(geometry.aps_columns * geometry.aps_rows, 1)
    pixels = np.dtype([('resets', np.uint16, size), ('image', np.uint16, size)])
    state = np.zeros(1, STATE)
    for name in ('dvs_rows', 'dvs_columns', 'aps_columns', 'aps_rows', 'aps_inverted'):
        state[name] = getattr(geometry, name)
    state['row'] = -1
    state['column_type'] = NO_COLUMN
    state['imu_index'] = IMU_OUTSIDE
    return Buffers(
        state=state,
        counters=np.zeros(1, COUNTERS),
        readings=np.zeros(1, READINGS),
        t=np.zeros(capacity, np.int64),
        row=np.zeros(capacity, np.uint16),
        column=np.zeros(capacity, np.uint16),
        polarity=np.zeros(capacity, np.uint8),
        pixels=np.zeros(1, pixels),
    )
