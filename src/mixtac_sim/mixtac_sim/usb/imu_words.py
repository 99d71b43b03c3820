# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Inertial samples to readout blocks."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final

from mixtac_sim.usb.word_encoder import Blocks

_START: Final = 5
_END: Final = 7
_BYTE: Final = 0x5000
_INFO: Final = 0x5300


@dataclass(frozen=True, slots=True)
class ImuReading:
    """What the inertial sensor feels at one instant.

    Attributes:
        t_us: True time [us].
        acceleration_g: Specific force along x, y, z [g].
        rate_dps: Turn rate about x, y, z [deg/s].
        temperature_c: Die temperature [deg C].
    """

    t_us: int
    acceleration_g: tuple[float, float, float]
    rate_dps: tuple[float, float, float]
    temperature_c: float


@dataclass(frozen=True, slots=True)
class ImuSettings:
    """The inertial registers that shape a sample.

    Attributes:
        accel: Send acceleration.
        gyro: Send turn rates.
        temperature: Send the temperature.
        accel_scale: 0 to 3 for 2, 4, 8, 16 g.
        gyro_scale: 0 to 3 for 250, 500, 1000, 2000 deg/s.
    """

    accel: bool
    gyro: bool
    temperature: bool
    accel_scale: int
    gyro_scale: int

    @property
    def running(self) -> bool:
        """Whether any group is sent."""
        return self.accel or self.gyro or self.temperature


def _raw(value: float) -> int:
    return max(-32768, min(32767, round(value)))


def raw_values(reading: ImuReading, settings: ImuSettings) -> list[int]:
    """Return the signed 16-bit values of the groups that run, in the order of the wire.

    Values beyond the full scale saturate. The temperature is 333.87 per kelvin above 21 deg C, as
    in an MPU-9250.
    """
    values: list[int] = []
    if settings.accel:
        per_g = 65536 / (4 << settings.accel_scale)
        values += [_raw(value * per_g) for value in reading.acceleration_g]
    if settings.temperature:
        values.append(_raw((reading.temperature_c - 21.0) * 333.87))
    if settings.gyro:
        per_dps = 65536 / (500 << settings.gyro_scale)
        values += [_raw(value * per_dps) for value in reading.rate_dps]
    return values


def imu_blocks(reading: ImuReading, camera_us: int, settings: ImuSettings) -> Blocks:
    """Lay one sample out: start, info byte, big-endian values, end.

    Args:
        reading: The sample.
        camera_us: Its time [us, camera clock].
        settings: Registers now; at least one group runs.
    """
    present = settings.accel << 7 | settings.gyro << 6 | settings.temperature << 5
    info = present | settings.accel_scale << 2 | settings.gyro_scale
    values = raw_values(reading, settings)
    data = struct.pack(f'>{len(values)}h', *values)
    words = [_START, _INFO | info, *(_BYTE | byte for byte in data)]
    return Blocks.from_lists([camera_us, camera_us], [True, True], [words, [_END]])
