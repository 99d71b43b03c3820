# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The driver node: a camera in, ROS topics out."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

from event_camera_msgs.msg import EventPacket
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image, Imu, TimeReference

from mixtac_driver import messages
from mixtac_driver.backend import check_device, is_real
from mixtac_driver.camera import Davis346
from mixtac_driver.driver_parameters import (
    DriverParameters,
    camera_configuration,
    stream_settings,
)
from mixtac_driver.driver_status import DriverStatus
from mixtac_driver.packetizer import Packetizer
from mixtac_driver.supervisor import Supervisor
from mixtac_events.codec import warm_up
from mixtac_events.errors import MixtacError
from mixtac_node.base_node import QOS_EVENTS, QOS_LATCHED, QOS_SENSOR, declare, run
from mixtac_node.diagnostics import DiagnosticsPublisher, Status

if TYPE_CHECKING:
    from mixtac_driver.readings import Frame, InertialSamples
    from mixtac_driver.stream import CameraBatch

CLOCK_PERIOD_S = 1.0


class DriverNode(Node):  # type: ignore[misc]
    """Publishes what a DAVIS346 sees.

    Everything but events is made only for topics that somebody subscribes to.
    """

    def __init__(self) -> None:
        super().__init__('driver', namespace='mixtac')
        self._p = p = declare(self, DriverParameters, self._apply)
        check_device(p.device)
        warm_up()
        self._sequence = 0
        self._clock_due_s = 0.0
        self._events_publisher = self.create_publisher(EventPacket, 'events', QOS_EVENTS)
        self._image_publisher = self.create_publisher(Image, 'image_raw', QOS_SENSOR)
        self._info_publisher = self.create_publisher(CameraInfo, 'camera_info', QOS_SENSOR)
        self._imu_publisher = self.create_publisher(Imu, 'imu', QOS_SENSOR)
        self._clock_publisher = self.create_publisher(TimeReference, 'camera_clock', QOS_LATCHED)
        self._camera = Davis346(
            p.device,
            serial=p.serial,
            configuration=camera_configuration(p),
            stream=stream_settings(p),
        )
        self._open_once()
        self._packetizer = self._new_packetizer()
        self._supervisor = Supervisor(
            self._camera,
            on_start=self._on_start,
            on_batch=self._on_batch,
            on_error=self.get_logger().error,
        )
        self._status = DriverStatus(p.device, self._camera, self._supervisor)
        self._diagnostics = DiagnosticsPublisher(self, p.device, self._report)
        self._supervisor.start()

    def close(self) -> None:
        """Stop the camera."""
        if not self._supervisor.stop():
            self.get_logger().error('the camera did not stop in time; leaving it')

    def _open_once(self) -> None:
        try:
            self._camera.open()
        except MixtacError as error:
            if is_real(self._p.device):
                raise
            # What serves another device may well be starting at this moment.
            self.get_logger().info(f'waiting for the camera: {error}')

    def _apply(self, parameters: DriverParameters) -> None:
        self._camera.apply(camera_configuration(parameters))
        self._p = parameters

    def _new_packetizer(self) -> Packetizer:
        period_us = round(self._p.event_message_time_threshold * 1e6)
        return Packetizer(self._p.encoding, period_us, self._p.event_message_size_threshold)

    def _on_start(self) -> None:
        identity = self._camera.identity
        self._packetizer = self._new_packetizer()
        self._diagnostics.hardware_id = identity.serial
        kind = '' if is_real(self._p.device) else 'simulated '
        self.get_logger().info(f'streaming from {kind}{identity.chip} {identity.serial}')

    def _on_batch(self, batch: CameraBatch) -> None:
        decoded, origin_us = batch.decoded, batch.origin.us
        events = decoded.events.shifted(origin_us)
        size = self._camera.identity.geometry.event_size
        for packet in self._packetizer.push(events, batch.time_us, batch.arrival_ns):
            self._events_publisher.publish(
                messages.event_packet(packet, self._sequence, size, self._p.camera_frame_id)
            )
            self._sequence += 1
            self._status.packets.add()
            self._status.events.add(packet.events)
            self._status.ages_s.add((time.time_ns() - packet.arrival_ns) / 1e9)
        for frame in decoded.frames:
            self._publish_frame(frame, origin_us)
        if len(decoded.imu.t):
            self._publish_imu(decoded.imu, origin_us)
        self._publish_clock(batch)

    def _publish_frame(self, frame: Frame, origin_us: int) -> None:
        self._status.frames.add()
        if (
            not self._image_publisher.get_subscription_count()
            and not self._info_publisher.get_subscription_count()
        ):
            return
        identity = self._camera.identity
        image = messages.image(
            frame, origin_us, identity.features.color_filter, self._p.camera_frame_id
        )
        self._image_publisher.publish(image)
        self._info_publisher.publish(messages.camera_info(frame, identity, image))

    def _publish_imu(self, samples: InertialSamples, origin_us: int) -> None:
        self._status.samples.add(len(samples.t))
        self._status.temperature = float(samples.temperature[-1])
        if not self._imu_publisher.get_subscription_count():
            return
        for index in range(len(samples.t)):
            self._imu_publisher.publish(
                messages.imu(samples, index, origin_us, self._p.imu_frame_id)
            )

    def _publish_clock(self, batch: CameraBatch) -> None:
        now_s, clock = time.monotonic(), self._camera.clock
        if now_s < self._clock_due_s or not clock.ready:
            return
        self._clock_due_s = now_s + CLOCK_PERIOD_S
        self._status.clock = clock.estimate()
        host_ns = time.time_ns()
        camera_us = clock.to_camera_us(host_ns) + batch.origin.us
        self._clock_publisher.publish(
            messages.camera_clock(host_ns, camera_us, self._camera.identity.serial)
        )

    def _report(self) -> Status:
        return self._status.status()


def main(args: list[str] | None = None) -> int:
    """Run the driver node."""
    return run(DriverNode, args)


if __name__ == '__main__':
    sys.exit(main())
