# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A camera of LeRobot (`type: mixtac`) whose image is the difference to the untouched sensor.

Grey is no difference. `MixtacCamera.read_wrench` returns the force of the same sensor. LeRobot 0.6
has no class for tactile sensors yet; its pull request 4469 proposes `find_sensors`, `connect`,
`is_connected` and the shape of the wrench.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from lerobot.cameras.camera import Camera
from lerobot.cameras.configs import CameraConfig
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError
from numpy.typing import NDArray

from mixtac import Picture, Sensor, SensorError
from mixtac_driver.device import attached_cameras

GREY = 128


@CameraConfig.register_subclass('mixtac')
@dataclass(kw_only=True)
class MixtacCameraConfig(CameraConfig):
    """Configuration of the camera.

    Attributes:
        source: `usb`, `usb:SERIAL`, `virtual`, `virtual:press`, or a recording, as for
            `mixtac.Sensor`.
        model: Weight file, or name of a shipped model; empty for the default.
        contrast: Change of log contrast that is white or black.
        fps: Pictures per second that the sensor sends; LeRobot records at its own rate.
        width: Columns of the image.
        height: Rows of the image.
    """

    source: str = 'usb'
    model: str = ''
    contrast: float = 1.0
    fps: int | None = 25
    width: int | None = 346
    height: int | None = 260


class MixtacCamera(Camera):
    """A sensor that LeRobot reads as a camera; see `lerobot.cameras.Camera` for the methods.

    Args:
        config: Its configuration.

    Attributes:
        sensor: The sensor, for forces: `sensor.read_latest().force`.
    """

    def __init__(self, config: MixtacCameraConfig) -> None:
        super().__init__(config)
        self.config = config
        self.sensor = Sensor(config.source, model=config.model)

    def __str__(self) -> str:
        """Return the name for messages."""
        return f'MixtacCamera({self.config.source})'

    @property
    def is_connected(self) -> bool:
        """Whether the sensor is open."""
        return self.sensor.is_open

    @staticmethod
    def find_cameras() -> list[dict[str, Any]]:
        """Return the cameras that are attached by USB."""
        return [
            {'name': 'DAVIS346', 'type': 'mixtac', 'id': 'usb', 'bus': bus, 'address': address}
            for bus, address in sorted(attached_cameras('davis346'))
        ]

    find_sensors = find_cameras

    def connect(self, warmup: bool = True) -> None:
        """Open the sensor, and wait for its first picture if `warmup` is set.

        Raises:
            DeviceAlreadyConnectedError: It is open.
            MixtacError: It cannot be opened.
        """
        if self.is_connected:
            raise DeviceAlreadyConnectedError(f'{self} is already connected.')
        self.sensor.open()
        if warmup:
            try:
                self._image(self.sensor.pictures.read())
            except BaseException:
                self.sensor.close()
                raise

    def read(self) -> NDArray[np.uint8]:
        """Wait for the next picture and return it, uint8 [height, width, 3]."""
        self._check()
        return self._image(self.sensor.pictures.read())

    def async_read(self, timeout_ms: float = 200) -> NDArray[np.uint8]:
        """Return the latest picture that was not returned yet; waits for it if need be.

        Raises:
            TimeoutError: None came in time.
        """
        self._check()
        return self._image(self.sensor.pictures.async_read(timeout_ms))

    def read_latest(self, max_age_ms: int = 500) -> NDArray[np.uint8]:
        """Return the latest picture at once.

        Raises:
            TimeoutError: It is older.
        """
        self._check()
        return self._image(self.sensor.pictures.read_latest(max_age_ms))

    def read_wrench(self, max_age_ms: int = 500) -> NDArray[np.float32]:
        """Return the latest force at once, without a wait: the picture sets the pace of a loop.

        Returns:
            Force [N] and torque [N m] at one point, float32 [1, 6], in the frame `mixtac_contact`:
            z points from the contact into the gel, so that a press is positive. Only z is
            measured, the others are 0. z is NaN while the force is withheld.

        Raises:
            NoReadingError: No force has come yet.
            TimeoutError: It is older.
        """
        self._check()
        return np.array([[0, 0, self.sensor.read_latest(max_age_ms).force, 0, 0, 0]], np.float32)

    def disconnect(self) -> None:
        """Close the sensor."""
        self._check()
        self.sensor.close()

    def _check(self) -> None:
        if not self.is_connected:
            raise DeviceNotConnectedError(f'{self} is not connected.')

    def _image(self, picture: Picture) -> NDArray[np.uint8]:
        if picture.difference is None:
            raise SensorError(
                f'the model {self.config.model!r} does not compare pictures',
                remedy='use the model that comes with mixtac_fger',
            )
        scaled = GREY + (GREY - 1) / self.config.contrast * picture.difference
        grey = np.clip(np.rint(scaled), 0, 255).astype(np.uint8)
        size = (self.width or 346, self.height or 260)
        resized = cv2.resize(grey, size, interpolation=cv2.INTER_LINEAR)
        return np.repeat(resized[:, :, None], 3, axis=2)
