# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the calibration of the lens is for: camera_info, and topics without its distortion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sensor_msgs.msg import CameraInfo, Image
from sensor_msgs.srv import SetCameraInfo

from mixtac_driver import messages
from mixtac_driver.calibration.calibrated_camera import CalibratedCamera
from mixtac_driver.calibration.errors import CalibrationError
from mixtac_driver.driver_meters import DriverMeters
from mixtac_driver.event_publisher import EventPublisher
from mixtac_events.errors import MixtacError
from mixtac_node.base_node import QOS_SENSOR

if TYPE_CHECKING:
    from mixtac_driver.driver_parameters import DriverParameters
    from mixtac_driver.identity import Identity
    from mixtac_driver.readings import Frame
    from mixtac_events.arrays import Events


class RectifiedPublisher:
    """Serves a calibration: on `camera_info`, by `~/set_camera_info`, and applied.

    `image_rect` and `events_rect` exist where the parameters ask for them. They go with the same
    `camera_info` as the raw topics, whose P is that of the undistorted pixels (REP 104).

    Args:
        node: An rclpy node.
        p: Where the calibration is and what it is used for.
    """

    def __init__(self, node: Any, p: DriverParameters) -> None:  # noqa: ANN401
        self._logger = node.get_logger()
        self._p = p
        self._camera: CalibratedCamera | None = None
        # Its packets are not those that diagnostics count.
        self._events = (
            EventPublisher(node, p, DriverMeters(), 'events_rect') if p.undistort_events else None
        )
        self._image = (
            node.create_publisher(Image, 'image_rect', QOS_SENSOR) if p.undistort_frames else None
        )
        node.create_service(SetCameraInfo, '~/set_camera_info', self._save)

    def use(self, size: tuple[int, int]) -> None:
        """Load the calibration of a camera, once its size is known.

        Args:
            size: Columns and rows.

        Raises:
            CalibrationError: It is damaged or of another camera, or is missing and needed.
        """
        if self._camera is None:
            self._camera = CalibratedCamera(self._p, size)
            self._logger.info(self._camera.describe())

    def restart(self) -> None:
        """Forget what was not published: another stream begins."""
        if self._events is not None:
            self._events.restart()

    def complete(self, info: CameraInfo) -> CameraInfo:
        """Write the calibration, if there is one, into camera information."""
        if self._camera is not None:
            for name, value in self._camera.camera_info_fields().items():
                setattr(info, name, value)
        return info

    def publish_events(
        self, events: Events, time_us: int, arrival_ns: int, shift_us: int, size: tuple[int, int]
    ) -> None:
        """Publish events at their undistorted pixels; arguments as in `EventPublisher.publish`."""
        if self._events is None or self._camera is None:
            return
        if not self._events.wanted:
            self._events.restart()
            return
        moved = self._camera.events(events)
        self._events.publish(moved, time_us, arrival_ns, shift_us, size)

    def publish_frame(self, frame: Frame, origin_us: int, identity: Identity) -> None:
        """Publish a frame without distortion, in the size of the whole array."""
        if self._image is None or self._camera is None:
            return
        if not self._image.get_subscription_count():
            return
        color_filter, frame_id = identity.features.color_filter, self._p.camera_frame_id
        encoding = messages.image_encoding(color_filter, frame.x, frame.y)
        pixels, encoding = self._camera.image(
            messages.left_aligned(frame.image), encoding, frame.x, frame.y
        )
        message = messages.image_header(frame, origin_us, frame_id)
        self._image.publish(messages.filled(message, pixels, encoding))

    def _save(self, request: Any, response: Any) -> Any:  # noqa: ANN401
        info = request.camera_info
        try:
            if self._camera is None:
                raise CalibrationError('no camera was opened yet: attach it and try again')
            path = self._camera.save(
                width=info.width,
                height=info.height,
                distortion_model=info.distortion_model,
                d=info.d,
                k=info.k,
                r=info.r,
                p=info.p,
            )
            response.success, response.status_message = True, f'wrote {path}'
        except MixtacError as error:
            response.success, response.status_message = False, str(error)
        return response
