# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The driver node: publishes the data of a camera as ROS topics, and offers its services."""

from __future__ import annotations

import contextlib
import time
from functools import partial
from typing import Any

from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.srv import SetCameraInfo
from std_srvs.srv import Trigger

from mixtac_core.events.codec import warm_up
from mixtac_core.events.errors import MixtacError
from mixtac_core.events.readings import Frame
from mixtac_core.node import topics
from mixtac_core.node.base_node import BaseNode, answering, declare, run
from mixtac_core.node.diagnostics import DiagnosticsPublisher, Status
from mixtac_core.node.files import state_file
from mixtac_core.node.topics import us_to_stamp
from mixtac_core.recordings import messages
from mixtac_driver.camera import CameraBatch
from mixtac_driver.camera_info import CalibratedCamera
from mixtac_driver.davis346.control import CameraControl
from mixtac_driver.davis346.model import Identity
from mixtac_driver.errors import DriverError, StreamError, UsbError
from mixtac_driver.node.publishers import EventPublisher, ReadingPublisher
from mixtac_driver.node.settings import DriverSettings
from mixtac_driver.node.status import DriverMeters, DriverStatus
from mixtac_driver.parameters import DriverParameters
from mixtac_driver.pixels import PixelCounter, PixelMask, hot_pixels, save_mask
from mixtac_driver.pixels import warm_up as warm_up_mask
from mixtac_driver.supervisor import Source, SourceKind, Supervisor, make_source, source_kind

CLOCK_PERIOD_S = 1.0
"""Period of `camera_clock` [s]."""
TIME_PERIOD_US = 1000
"""Shortest period of the time of playback on `/clock` [us]."""
MARGIN_S = 1.0
"""Additional time allowed for a count [s]."""
LISTED_PIXELS = 20
"""Most hot pixels that an answer lists."""


class DriverServices:
    """Offers `~/snapshot`, `~/reset_timestamps`, `~/find_hot_pixels` and `~/set_camera_info`.

    They run in the executor's thread; a count waits there, for a bounded time, for the decoding
    thread.

    Args:
        node: An rclpy node.
        source: The source.
        settings: Its settings.
        calibration: Its calibration.
    """

    def __init__(
        self,
        node: Any,  # noqa: ANN401
        source: Source,
        settings: DriverSettings,
        calibration: CalibratedCamera,
    ) -> None:
        self._source, self._settings, self._calibration = source, settings, calibration
        self._counter: PixelCounter | None = None
        offer = partial(node.create_service, Trigger)
        offer('~/snapshot', answering(lambda _: self.snapshot()))
        offer('~/reset_timestamps', answering(lambda _: self.reset_timestamps()))
        offer('~/find_hot_pixels', answering(lambda _: self.find_hot_pixels()))
        node.create_service(SetCameraInfo, '~/set_camera_info', self.set_camera_info)

    def watch(self, batch: CameraBatch) -> None:
        """Count the events of a batch, before they are masked, while they are awaited."""
        counter = self._counter
        if counter is not None:
            counter.add(batch)

    def snapshot(self) -> str:
        """Request one frame, unless frames are taken continuously.

        Raises:
            DriverError: The camera is closed, or the request failed.
        """
        self._control('no frame can be requested').request_frame()
        return 'the next frame is published on image_raw'

    def reset_timestamps(self) -> str:
        """Set the camera's clock to zero; published time continues.

        Raises:
            DriverError: There is no stream, or the request failed.
        """
        self._control('its clock cannot be reset').reset_timestamps()
        return 'camera clock set to zero; published time continues'

    def find_hot_pixels(self) -> str:
        """Count events; mask the hot pixels, and those of the mask file.

        Pixels that were found before and are quiet now are no longer masked.

        Raises:
            DriverError: There is no stream, or a request failed; the mask stays unchanged.
            MixtacError: The file of the mask cannot be written; the pixels are masked.
        """
        p, before = self._settings.parameters, self._settings.mask
        identity = self._source.status().identity
        if identity is None:
            raise StreamError('no camera was opened yet', remedy='attach it and try again')
        size = identity.geometry.event_size
        # Pixels that the camera masks cannot be counted.
        self._settings.use_mask(before, self._source.apply, in_camera=False)
        try:
            counter = self._counter = PixelCounter(round(p.hot_pixels_duration * 1e6), size)
            if not counter.done.wait(p.hot_pixels_duration + MARGIN_S):
                raise StreamError(
                    f'too few data within {p.hot_pixels_duration + MARGIN_S:.1f} s',
                    remedy='see /diagnostics for the state of the camera',
                )
            found = hot_pixels(counter.counts, p.hot_pixels_duration)
            mask = PixelMask([*found, *self._settings.file_mask.pixels], size)
            self._settings.use_mask(mask, self._source.apply)
        except MixtacError:
            # Where the camera does not accept the filters, the host masks these pixels as well.
            with contextlib.suppress(UsbError):
                self._settings.use_mask(before, self._source.apply)
            raise
        finally:
            self._counter = None
        if p.hot_pixels_file:
            save_mask(mask, str(state_file(p.hot_pixels_file)))
        listed = ', '.join(str(pixel) for pixel in found[:LISTED_PIXELS])
        more = ', ...' if len(found) > LISTED_PIXELS else ''
        return (
            f'{len(found)} hot pixels{": " if found else ""}{listed}{more}; {len(mask.pixels)} '
            f'masked, {len(mask.in_camera)} of them by the camera'
        )

    def set_camera_info(self, request: Any, response: Any) -> Any:  # noqa: ANN401
        """Store a calibration and use it from now on (sensor_msgs/SetCameraInfo)."""
        try:
            path = self._calibration.save(request.camera_info)
            response.success, response.status_message = True, f'wrote {path}'
        except MixtacError as error:
            response.success, response.status_message = False, str(error)
        return response

    def _control(self, otherwise: str) -> CameraControl:
        control = self._source.control
        if control is None:
            device = self._settings.parameters.device
            raise DriverError(f'{device} is a recording: {otherwise}')
        return control


class DriverNode(BaseNode, Node):  # type: ignore[misc]
    """Publishes the data of a source, on topics that have subscribers."""

    def __init__(self) -> None:
        super().__init__('driver')
        p = declare(self, DriverParameters, lambda p: self._settings.apply(p, self._source.apply))
        self._kind = source_kind(p.device)
        self._settings = DriverSettings(p)
        self._diagnostics = DiagnosticsPublisher(self, p.device, self._report)
        with self._diagnostics.compiling('the packet codec'):
            warm_up()
        with self._diagnostics.compiling('the pixel mask'):
            warm_up_mask()
        self._clock_due_s = 0.0
        self._identity: Identity
        self._meters = DriverMeters()
        self._calibration = CalibratedCamera(p)
        self.get_logger().info(self._calibration.describe())
        self._event_publishers = [EventPublisher(self, p, topics.EVENTS, self._meters)]
        if p.undistort_events:
            move = self._calibration.undistort
            self._event_publishers.append(EventPublisher(self, p, topics.EVENTS_RECT, move=move))
        self._readings = ReadingPublisher(self, p, self._meters, self._calibration.complete)
        self._clock_publisher = self.publish_topic(topics.CAMERA_CLOCK)
        # Default QoS: subscribers with use_sim_time are best effort, others may be reliable.
        clock, self._time_due_us = p.playback_clock and self._kind is SourceKind.RECORDED, 0
        self._time = self.create_publisher(Clock, '/clock', 10) if clock else None
        parameters, pixel_filter = self._settings.camera_settings()
        self._source = make_source(parameters, pixel_filter=pixel_filter)
        self._open_once()
        self._supervisor = Supervisor(
            self._source,
            p,
            on_start=self._on_start,
            on_batch=self._on_batch,
            on_error=self.get_logger().error,
        )
        self._status = DriverStatus(self._source, self._supervisor, self._settings, self._meters)
        self._driver_services = DriverServices(
            self, self._source, self._settings, self._calibration
        )
        self._supervisor.start()

    def _report(self) -> Status:
        return self._status.status()

    def check(self) -> None:
        """Raise if the recovery policy ends the node.

        Raises:
            MixtacError: The reason.
        """
        if self._supervisor.failure is not None:
            raise self._supervisor.failure

    def close(self) -> None:
        """Stop the source."""
        if not self._supervisor.stop():
            self.get_logger().error('the camera did not stop in time; leaving it')

    def _open_once(self) -> None:
        try:
            self._source.open()
        except MixtacError as error:
            if self._kind is not SourceKind.SIMULATED:
                raise
            # The virtual sensor may be starting at this moment.
            self.get_logger().info(f'waiting for the camera: {error}')
            return
        self._use_identity()

    def _use_identity(self) -> Identity:
        identity = self._source.status().identity
        assert identity is not None  # noqa: S101  (the source is open)
        size = identity.geometry.event_size
        self._settings.use_size(size)
        self._calibration.use_size(size)
        self._identity = identity
        return identity

    def _on_start(self) -> None:
        identity = self._use_identity()
        for each in self._event_publishers:
            each.restart()
        self._diagnostics.hardware_id = identity.serial
        self.get_logger().info(f'streaming: {self._kind.value} {identity.chip} {identity.serial}')

    def _on_batch(self, batch: CameraBatch) -> None:
        decoded, origin_us, identity = batch.decoded, batch.origin.us, self._identity
        self._driver_services.watch(batch)
        self._meters.events.add(len(decoded.events))
        events = self._settings.mask.keep(decoded.events)
        for publisher in self._event_publishers:
            publisher.publish(events, batch, identity.geometry.event_size)
        if self._time is not None and batch.time_us >= self._time_due_us:
            self._time_due_us = batch.time_us + TIME_PERIOD_US
            self._time.publish(Clock(clock=us_to_stamp(batch.time_us)))
        for frame in decoded.frames:
            self._publish_frame(frame, origin_us, identity)
        if len(decoded.imu.t):
            self._meters.samples.add(len(decoded.imu.t))
            self._meters.temperature = float(decoded.imu.temperature[-1])
            self._readings.samples(decoded.imu, origin_us)
        self._readings.edges(decoded.edges, origin_us)
        if time.monotonic() >= self._clock_due_s:
            self._publish_clock(origin_us, identity.serial)

    def _publish_frame(self, frame: Frame, origin_us: int, identity: Identity) -> None:
        exposure_us = frame.exposure_cycles / identity.clocks.adc
        self._meters.frames.add()
        self._meters.exposure_us = exposure_us
        self._readings.frame(frame, origin_us, identity)
        if self._source.control is not None:
            self._settings.follow(frame, exposure_us, self._source.control)

    def _publish_clock(self, origin_us: int, serial: str) -> None:
        clock = self._source.status().clock
        if not clock.ready:
            return
        self._clock_due_s = time.monotonic() + CLOCK_PERIOD_S
        self._meters.clock = clock.estimate(), origin_us
        host_ns = time.time_ns()
        camera_us = clock.to_camera_us(host_ns) + origin_us
        self._clock_publisher.publish(messages.camera_clock(host_ns, camera_us, serial))


main = partial(run, DriverNode)
