# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Publishing frames: the image, how the camera sees, and when it was exposed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sensor_msgs.msg import CameraInfo, Image

from mixtac_driver import messages
from mixtac_msgs.msg import FrameExposure
from mixtac_node.base_node import QOS_SENSOR

if TYPE_CHECKING:
    from collections.abc import Callable

    from mixtac_driver.identity import Identity
    from mixtac_driver.readings import Frame


class FramePublisher:
    """Publishes frames on `image_raw`, `camera_info` and `image_exposure`.

    Args:
        node: An rclpy node.
        frame_id: Frame of the camera.
        complete: Adds the calibration to camera information.
    """

    def __init__(
        self,
        node: Any,  # noqa: ANN401
        frame_id: str,
        complete: Callable[[CameraInfo], CameraInfo],
    ) -> None:
        self._frame_id = frame_id
        self._complete = complete
        self._image = node.create_publisher(Image, 'image_raw', QOS_SENSOR)
        self._info = node.create_publisher(CameraInfo, 'camera_info', QOS_SENSOR)
        self._exposure = node.create_publisher(FrameExposure, 'image_exposure', QOS_SENSOR)

    def publish(self, frame: Frame, origin_us: int, identity: Identity) -> None:
        """Publish a frame where somebody listens.

        Args:
            frame: The frame.
            origin_us: Origin of the camera's clock [us since the Unix epoch].
            identity: The camera.
        """
        image_wanted, info_wanted, exposure_wanted = (
            publisher.get_subscription_count() > 0
            for publisher in (self._image, self._info, self._exposure)
        )
        if image_wanted:
            color_filter = identity.features.color_filter
            image = messages.image(frame, origin_us, color_filter, self._frame_id)
            self._image.publish(image)
        elif info_wanted or exposure_wanted:
            image = messages.image_header(frame, origin_us, self._frame_id)
        if info_wanted:
            size = (identity.geometry.width, identity.geometry.height)
            self._info.publish(self._complete(messages.camera_info(frame, size, image)))
        if exposure_wanted:
            self._exposure.publish(messages.frame_exposure(frame, origin_us, image))
