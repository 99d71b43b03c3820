# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Readings of a camera besides events: frames, inertial samples, edges."""

from __future__ import annotations

import functools
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events

STANDARD_GRAVITY = 9.80665
"""[m/s^2]"""


class EdgeKind(IntEnum):
    """Kinds of edges at the synchronisation connector."""

    EXTERNAL_FALLING = 2
    EXTERNAL_RISING = 3
    EXTERNAL_PULSE = 4
    GENERATOR_FALLING = 16
    GENERATOR_RISING = 17


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """Edges of the external input and the generator.

    Attributes:
        t: `int64` [n], time [us, camera clock].
        kind: `uint8` [n], values of EdgeKind.
    """

    t: NDArray[np.int64]
    kind: NDArray[np.uint8]

    def __getitem__(self, rows: slice | NDArray[np.bool_]) -> Edges:
        """Return some of the edges."""
        return Edges(self.t[rows], self.kind[rows])


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A frame of the active pixel sensor; times [us] are on the camera clock.

    Attributes:
        image: `uint16` [height, width], 0 .. 1023.
        x: Column of the image's first column in the whole array.
        y: Row of the image's first row in the whole array.
        frame_start_us: Start of the frame.
        exposure_start_us: Start of the exposure.
        exposure_end_us: End of the exposure.
        frame_end_us: End of the read-out.
        exposure_cycles: Exposure that was set, in ADC cycles.
        global_shutter: True where all pixels are exposed at once.
    """

    image: NDArray[np.uint16]
    x: int
    y: int
    frame_start_us: int
    exposure_start_us: int
    exposure_end_us: int
    frame_end_us: int
    exposure_cycles: int
    global_shutter: bool

    @property
    def middle_us(self) -> int:
        """Middle of the exposure [us, camera clock]: the stamp of the published image."""
        return (self.exposure_start_us + self.exposure_end_us) // 2


@dataclass(frozen=True, slots=True, eq=False)
class InertialSamples:
    """Samples of the inertial unit in SI units; missing values are NaN.

    Attributes:
        t: `int64` [n], time [us, camera clock].
        acceleration: `float64` [n, 3], x, y, z [m/s^2].
        angular_velocity: `float64` [n, 3], x, y, z [rad/s].
        temperature: `float64` [n], [degrees Celsius].
    """

    t: NDArray[np.int64]
    acceleration: NDArray[np.float64]
    angular_velocity: NDArray[np.float64]
    temperature: NDArray[np.float64]

    def __getitem__(self, rows: slice | NDArray[np.bool_]) -> InertialSamples:
        """Return some of the samples."""
        return InertialSamples(*(each[rows] for each in self._fields))

    @classmethod
    def concatenate(cls, parts: Sequence[InertialSamples]) -> InertialSamples:
        """Return the samples of all parts, at least one, in the order given."""
        return cls(*map(np.concatenate, zip(*(part._fields for part in parts), strict=True)))

    @property
    def _fields(self) -> tuple[Any, ...]:
        return self.t, self.acceleration, self.angular_velocity, self.temperature


def inertial_samples(
    t: NDArray[np.int64], raw: NDArray[np.uint8], flips: tuple[bool, bool, bool], imu_type: int
) -> InertialSamples:
    """Convert inertial samples to SI units.

    Args:
        t: `int64` [n], times [us].
        raw: `uint8` [n, 15]: acceleration x, y, z, temperature, rotation x, y, z as big-endian
            16-bit integers, then the info byte (which groups are present, their scales).
        flips: Axes of the unit that are inverted.
        imu_type: 1 for MPU6050, 2 for MPU9250, whose temperature scales differ.
    """
    # A camera sends a sample per millisecond: numbers of Python are quicker than small arrays.
    rows = [
        [value * factor for value, factor in zip(row, _factors(row[7], flips), strict=False)]
        for row in struct.iter_unpack('>7hB', raw.tobytes())
    ]
    values = np.array(rows, np.float64).reshape(-1, 7)
    scale, offset = (340.0, 35.0) if imu_type == 1 else (333.87, 21.0)
    temperature = values[:, 3] / scale + offset
    return InertialSamples(t.copy(), values[:, :3], values[:, 4:], temperature)


@functools.cache
def _factors(info: int, flips: tuple[bool, bool, bool]) -> tuple[float, ...]:
    """Return the factors of seven integers with an info byte; NaN for groups that are not there."""
    m_s2 = (4 << (info >> 2 & 3)) / 65536 * STANDARD_GRAVITY if info & 0x80 else np.nan
    rad_s = (500 << (info & 3)) / 65536 * (np.pi / 180.0) if info & 0x40 else np.nan
    signs = [-1.0 if flip else 1.0 for flip in flips]
    celsius = 1.0 if info & 0x20 else np.nan
    return *(sign * m_s2 for sign in signs), celsius, *(sign * rad_s for sign in signs)


NO_EDGES = Edges(np.empty(0, np.int64), np.empty(0, np.uint8))
NO_SAMPLES = InertialSamples(np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3)), np.empty(0))


@dataclass(frozen=True, slots=True, eq=False)
class DecodedBatch:
    """Readings of one stretch of the stream.

    All times are [us] on the camera clock since its reset number `resets`.

    Attributes:
        events: Views into the decoder's arrays, valid until its next call; copy them to keep them.
        frames: Complete frames.
        imu: Inertial samples.
        edges: Edges of the external input and the generator.
        time_us: Time that the stream has reached.
        resets: Resets of the camera's clock before this stretch; it never spans one.
    """

    events: Events
    frames: tuple[Frame, ...]
    imu: InertialSamples
    edges: Edges
    time_us: int
    resets: int
