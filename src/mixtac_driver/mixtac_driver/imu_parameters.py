# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the inertial unit."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_driver.parameter_fields import number, switch


@dataclass(frozen=True)
class ImuParameters:
    """Inertial unit: all of it may change while the node runs."""

    imu_acc_enabled: bool = switch(True, 'Acceleration on')
    imu_gyro_enabled: bool = switch(True, 'Angular velocity on')
    imu_temp_enabled: bool = switch(True, 'Temperature on')
    imu_acc_scale: int = number(1, 'Range of acceleration: 0 .. 3 are 2, 4, 8, 16 g', 3)
    imu_gyro_scale: int = number(
        1, 'Range of angular velocity: 0 .. 3 are 250, 500, 1000, 2000 deg/s', 3
    )
    imu_low_pass_filter: int = number(
        1, 'Low-pass filter of acceleration; in an MPU6050 of angular velocity too', 7
    )
    imu_gyro_low_pass_filter: int = number(
        1, 'Low-pass filter of angular velocity in an MPU9250', 7
    )
    imu_sample_rate_divider: int = number(
        0,
        'Sample rate is 1 kHz divided by this number plus one (8 kHz where the filter is 0 or 7)',
        255,
    )
