# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Publishing inertial samples and the temperature of their unit."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from sensor_msgs.msg import Imu, Temperature

from mixtac_driver import messages
from mixtac_node.base_node import QOS_SENSOR

if TYPE_CHECKING:
    from mixtac_driver.readings import InertialSamples

TEMPERATURE_PERIOD_US = 100_000


class InertialPublisher:
    """Publishes samples on `imu` and, ten times a second, on `temperature`.

    Args:
        node: An rclpy node.
        frame_id: Frame of the unit.
    """

    def __init__(self, node: Any, frame_id: str) -> None:  # noqa: ANN401
        self._frame_id = frame_id
        self._imu = node.create_publisher(Imu, 'imu', QOS_SENSOR)
        self._temperature = node.create_publisher(Temperature, 'temperature', QOS_SENSOR)
        self._temperature_due_us = 0

    def publish(self, samples: InertialSamples, origin_us: int) -> None:
        """Publish samples where somebody listens.

        Args:
            samples: At least one sample.
            origin_us: Origin of the camera's clock [us since the Unix epoch].
        """
        if self._imu.get_subscription_count():
            for index in range(len(samples.t)):
                self._imu.publish(messages.imu(samples, index, origin_us, self._frame_id))
        self._publish_temperature(float(samples.temperature[-1]), int(samples.t[-1]) + origin_us)

    def _publish_temperature(self, celsius: float, time_us: int) -> None:
        if time_us < self._temperature_due_us or math.isnan(celsius):
            return
        self._temperature_due_us = time_us + TEMPERATURE_PERIOD_US
        if self._temperature.get_subscription_count():
            self._temperature.publish(messages.temperature(celsius, time_us, self._frame_id))
