# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Readings of a camera besides events: frames, inertial samples, edges."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from mixtac_events.arrays import Events

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
        return InertialSamples(
            self.t[rows],
            self.acceleration[rows],
            self.angular_velocity[rows],
            self.temperature[rows],
        )


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
    values = np.ascontiguousarray(raw[:, :14]).view('>i2').astype(np.float64)
    info = raw[:, 14]
    sign = np.where(flips, -1.0, 1.0)
    g_per_step = (4 << (info >> 2 & 3).astype(np.int64)) / 65536
    degrees_per_step = (500 << (info & 3).astype(np.int64)) / 65536
    acceleration = values[:, 0:3] * sign * (g_per_step * STANDARD_GRAVITY)[:, None]
    rotation = values[:, 4:7] * sign * np.deg2rad(degrees_per_step)[:, None]
    scale, offset = (340.0, 35.0) if imu_type == 1 else (333.87, 21.0)
    temperature = values[:, 3] / scale + offset
    acceleration[info & 0x80 == 0] = np.nan
    rotation[info & 0x40 == 0] = np.nan
    temperature[info & 0x20 == 0] = np.nan
    return InertialSamples(t.copy(), acceleration, rotation, temperature)


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
