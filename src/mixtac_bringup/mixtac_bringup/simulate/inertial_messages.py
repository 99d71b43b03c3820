# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Inertial samples as the driver publishes them, after the camera's sixteen bits."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from mixtac_driver.driver_parameters import DriverParameters
from mixtac_driver.readings import NO_SAMPLES, InertialSamples, inertial_samples
from mixtac_sim.usb.imu_words import ImuReading, ImuSettings, raw_values

if TYPE_CHECKING:
    from numpy.typing import NDArray

MPU9250: Final = 2
_ANGULAR, _LINEAR = slice(13, 16), slice(25, 28)


class InertialConverter:
    """Turns readings into what the driver decodes from the camera's words.

    The settings are the driver's defaults.
    """

    def __init__(self) -> None:
        p = DriverParameters()
        self._settings = ImuSettings(
            accel=p.imu_acc_enabled,
            gyro=p.imu_gyro_enabled,
            temperature=p.imu_temp_enabled,
            accel_scale=p.imu_acc_scale,
            gyro_scale=p.imu_gyro_scale,
        )
        self._info = 0xE0 | p.imu_acc_scale << 2 | p.imu_gyro_scale

    def samples(self, readings: list[ImuReading], camera_us: NDArray[np.int64]) -> InertialSamples:
        """Return samples in SI units.

        Args:
            readings: What the unit felt.
            camera_us: Times of the readings [n] [us, camera clock].
        """
        if not readings:
            return NO_SAMPLES
        values = [raw_values(reading, self._settings) for reading in readings]
        raw = np.empty((len(readings), 15), np.uint8)
        raw[:, :14] = np.array(values, '>i2').view(np.uint8)
        raw[:, 14] = self._info
        return inertial_samples(camera_us, raw, (False, False, False), MPU9250)


def imu_numbers(samples: InertialSamples, example: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the doubles of `sensor_msgs/msg/Imu` from the orientation on [n, 37].

    Args:
        samples: The samples.
        example: The doubles of a message whose two vectors are to be replaced [37].
    """
    numbers = np.tile(example, (len(samples.t), 1))
    numbers[:, _ANGULAR] = samples.angular_velocity
    numbers[:, _LINEAR] = samples.acceleration
    return numbers
