# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Simulated bags have the defaults of the driver, which the simulator cannot import."""

from mixtac_core.events.windows import PACKET_BYTES, PACKET_PERIOD_US
from mixtac_core.node.topics import CAMERA_FRAME, IMU_FRAME
from mixtac_driver.parameters import DriverParameters
from mixtac_sim.usb.words import ImuSettings


def test_simulated_bags_use_the_defaults_of_the_driver():
    p = DriverParameters()
    assert round(1e6 * p.event_message_time_threshold) == PACKET_PERIOD_US
    assert p.event_message_size_threshold == PACKET_BYTES
    assert (p.camera_frame_id, p.imu_frame_id) == (CAMERA_FRAME, IMU_FRAME)
    assert ImuSettings() == ImuSettings(
        accel=p.imu_acc_enabled,
        gyro=p.imu_gyro_enabled,
        temperature=p.imu_temp_enabled,
        accel_scale=p.imu_acc_scale,
        gyro_scale=p.imu_gyro_scale,
    )
