# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The driver node: a camera in, ROS topics out."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

from rclpy.node import Node
from sensor_msgs.msg import TimeReference

from mixtac_driver.davis346.model import HEIGHT, WIDTH
from mixtac_driver.node.publishers import (
    ClockPublisher,
    EdgePublisher,
    EventPublisher,
    FramePublisher,
    InertialPublisher,
    RectifiedPublisher,
)
from mixtac_driver.node.services import DriverServices
from mixtac_driver.node.settings import DriverSettings
from mixtac_driver.node.status import DriverMeters, DriverStatus
from mixtac_driver.parameters import DriverParameters, stream_settings
from mixtac_driver.pixels import warm_up as warm_up_mask
from mixtac_driver.playback.source import RecordedSource
from mixtac_driver.source import SourceKind, make_source, source_kind
from mixtac_driver.supervisor import Supervisor, recovery_settings
from mixtac_events.codec import warm_up
from mixtac_events.errors import MixtacError
from mixtac_node.base_node import QOS_LATCHED, BaseNode, declare, run
from mixtac_node.diagnostics import DiagnosticsPublisher, Status
from mixtac_recordings import messages

if TYPE_CHECKING:
    from mixtac_driver.camera import CameraBatch
    from mixtac_driver.usb.transport import DebugMessage
    from mixtac_events.readings import Frame, InertialSamples


CLOCK_PERIOD_S = 1.0


class DriverNode(BaseNode, Node):  # type: ignore[misc]
    """Publishes what a DAVIS346 sees, on topics that somebody subscribes to."""

    def __init__(self) -> None:
        super().__init__('driver')
        self._p = p = declare(self, DriverParameters, self._apply)
        self._kind = source_kind(p.device)
        self._settings = DriverSettings(p)
        warm_up()
        warm_up_mask()
        self._clock_due_s = 0.0
        self._meters = DriverMeters()
        self._events = EventPublisher(self, p, self._meters)
        self._rectified = RectifiedPublisher(self, p)
        self._frames = FramePublisher(self, p.camera_frame_id, self._rectified.complete)
        self._inertial = InertialPublisher(self, p.imu_frame_id)
        self._edges = EdgePublisher(self, p.camera_frame_id, self._meters)
        self._clock_publisher = self.create_publisher(TimeReference, 'camera_clock', QOS_LATCHED)
        replayed = self._kind is SourceKind.RECORDED
        self._time = ClockPublisher(self) if p.playback_clock and replayed else None
        self._camera = make_source(
            p.device,
            serial=p.serial,
            configuration=self._settings.configuration(),
            stream=stream_settings(p),
            playback=p,
            on_debug=self._on_debug,
        )
        self._open_once()
        self._supervisor = Supervisor(
            self._camera,
            on_start=self._on_start,
            on_batch=self._on_batch,
            on_error=self.get_logger().error,
            recovery=recovery_settings(p),
        )
        self._status = DriverStatus(
            p.device, self._camera, self._supervisor, self._settings, self._meters
        )
        self._diagnostics = DiagnosticsPublisher(self, p.device, self._report)
        self._driver_services = DriverServices(
            self, self._camera, self._settings, self._diagnostics.publish
        )
        self._supervisor.start()

    def check(self) -> None:
        """End the node where the recovery policy says so.

        Raises:
            MixtacError: Why there is no camera any more.
        """
        if self._supervisor.failure is not None:
            raise self._supervisor.failure

    def close(self) -> None:
        """Stop the camera."""
        if not self._supervisor.stop():
            self.get_logger().error('the camera did not stop in time; leaving it')

    def _open_once(self) -> None:
        try:
            self._camera.open()
        except MixtacError as error:
            if self._kind is not SourceKind.SIMULATED:
                raise
            # What serves it may well be starting at this moment.
            self.get_logger().info(f'waiting for the camera: {error}')
            return
        self._rectified.use(self._camera.identity.geometry.event_size)

    def _apply(self, parameters: DriverParameters) -> None:
        self._settings.apply(parameters, self._camera.apply)
        if isinstance(self._camera, RecordedSource):
            self._camera.play_as(parameters)

    def _on_start(self) -> None:
        identity = self._camera.identity
        self._rectified.use(identity.geometry.event_size)
        self._events.restart()
        self._rectified.restart()
        self._diagnostics.hardware_id = identity.serial
        self.get_logger().info(f'streaming: {self._kind.value} {identity.chip} {identity.serial}')

    def _on_batch(self, batch: CameraBatch) -> None:
        decoded, origin_us = batch.decoded, batch.origin.us
        self._publish_events(batch)
        if self._time is not None:
            self._time.publish(batch)
        for frame in decoded.frames:
            self._publish_frame(frame, origin_us)
        if len(decoded.imu.t):
            self._publish_imu(decoded.imu, origin_us)
        if len(decoded.edges.t):
            self._edges.publish(decoded.edges, origin_us)
        self._publish_clock(batch)

    def _publish_events(self, batch: CameraBatch) -> None:
        events = batch.decoded.events
        self._meters.events.add(len(events))
        size = self._camera.identity.geometry.event_size
        kept = events
        # Recordings may come from other sensors, for which no mask was made.
        if size == (WIDTH, HEIGHT):
            self._driver_services.watch_events(events, batch.time_us)
            kept = self._settings.mask.keep(events)
        when = (batch.time_us, batch.arrival_ns, batch.origin.us)
        if self._events.wanted:
            self._events.publish(kept, *when, size)
        else:
            self._events.restart()
        self._rectified.publish_events(kept, *when, size)

    def _publish_frame(self, frame: Frame, origin_us: int) -> None:
        identity = self._camera.identity
        exposure_us = frame.exposure_cycles / identity.clocks.adc
        self._meters.frames.add()
        self._meters.exposure_us = exposure_us
        self._frames.publish(frame, origin_us, identity)
        self._rectified.publish_frame(frame, origin_us, identity)
        self._driver_services.watch_frame(frame, origin_us)
        self._settings.follow(frame, exposure_us, self._camera.control)

    def _publish_imu(self, samples: InertialSamples, origin_us: int) -> None:
        self._meters.samples.add(len(samples.t))
        self._meters.temperature = float(samples.temperature[-1])
        self._inertial.publish(samples, origin_us)

    def _publish_clock(self, batch: CameraBatch) -> None:
        now_s, clock = time.monotonic(), self._camera.clock
        if now_s < self._clock_due_s or not clock.ready:
            return
        self._clock_due_s = now_s + CLOCK_PERIOD_S
        self._meters.clock = clock.estimate()
        host_ns = time.time_ns()
        camera_us = clock.to_camera_us(host_ns) + batch.origin.us
        self._clock_publisher.publish(
            messages.camera_clock(host_ns, camera_us, self._camera.identity.serial)
        )

    def _on_debug(self, message: DebugMessage) -> None:
        line = f'camera firmware at {message.time}: {message.text} (code {message.code})'
        if message.code:
            self.get_logger().warning(line)
        else:
            self.get_logger().info(line)

    def _report(self) -> Status:
        return self._status.status()


def main(args: list[str] | None = None) -> int:
    """Run the driver node."""
    return run(DriverNode, args)


if __name__ == '__main__':
    sys.exit(main())
