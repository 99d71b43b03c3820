# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Current settings of the driver: parameters, masked pixels and automatic exposure."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.readings import Frame
from mixtac_driver.davis346.control import CameraControl, PixelFilter
from mixtac_driver.davis346.settings import CameraParameters
from mixtac_driver.errors import UsbError
from mixtac_driver.parameters import DriverParameters
from mixtac_driver.pixels import PixelMask, load_mask

Apply = Callable[[DriverParameters, PixelFilter], None]
FULL_SCALE = 1023
"""Largest value of a pixel."""
LARGEST_STEP = 4.0
"""Largest factor by which one frame changes the exposure."""
DEAD_BAND = 0.08
"""Relative change below which the exposure stays."""
SMOOTHING = 0.5
"""Weight of the latest frame."""


def right_exposure(image: NDArray[np.uint16], exposure_us: float, target: float) -> float:
    """Return the exposure that would have brought a frame to the target [us].

    Args:
        image: `uint16`, any shape, 0 .. 1023.
        exposure_us: Exposure of the frame [us].
        target: Wanted mean, 0 .. 1 of full scale.
    """
    factor = target * FULL_SCALE / max(float(image.mean()), 1e-3)
    return exposure_us * min(max(factor, 1 / LARGEST_STEP), LARGEST_STEP)


class AutoExposure:
    """Follows the frames of one camera.

    Args:
        p: Exposure to start with, target and limits (`aps_exposure`, `aps_auto_exposure_*`).

    Attributes:
        exposure_us: Exposure that was set last [us].
    """

    def __init__(self, p: CameraParameters) -> None:
        self._target = p.aps_auto_exposure_target
        self._limits = p.aps_auto_exposure_minimum, p.aps_auto_exposure_maximum
        self.exposure_us = self._limited(p.aps_exposure)
        self._wish = math.log(self.exposure_us)

    def update(self, image: NDArray[np.uint16], exposure_us: float) -> int | None:
        """Return the exposure to set after a frame [us], or None if it may stay.

        Until `accept` is called the exposure counts as unchanged: if the camera is busy, the next
        frame leads to another request.

        Args:
            image: `uint16`, 0 .. 1023.
            exposure_us: Exposure of the frame [us].
        """
        right = self._limited(right_exposure(image, exposure_us, self._target))
        self._wish += SMOOTHING * (math.log(right) - self._wish)
        wish = self._limited(math.exp(self._wish))
        change = abs(math.log(wish / self.exposure_us))
        if change == 0 or (change < DEAD_BAND and wish not in self._limits):
            return None
        return wish

    def accept(self, exposure_us: int) -> None:
        """Note that the camera accepted this exposure [us]."""
        self.exposure_us = exposure_us

    def _limited(self, exposure_us: float) -> int:
        minimum_us, maximum_us = self._limits
        return round(min(max(exposure_us, minimum_us), maximum_us))


_AUTO_EXPOSURE = (
    'aps_exposure',
    'aps_auto_exposure',
    'aps_auto_exposure_target',
    'aps_auto_exposure_minimum',
    'aps_auto_exposure_maximum',
)
"""Parameters that restart automatic exposure when they change."""


class DriverSettings:
    """Turns parameters into settings of the camera, from any thread.

    Args:
        parameters: The start values.

    Attributes:
        parameters: Those in effect.
        mask: Pixels that are masked now.
        file_mask: Pixels of the file that the parameters name.

    Raises:
        ConfigurationError: They contradict each other, or the mask cannot be read.
    """

    def __init__(self, parameters: DriverParameters) -> None:
        parameters.check()
        self.parameters = parameters
        self.mask = self.file_mask = load_mask(parameters.dvs_pixel_mask)
        self._size: tuple[int, int] | None = None
        self._auto_exposure = AutoExposure(parameters) if parameters.aps_auto_exposure else None
        self._lock = threading.Lock()

    def camera_settings(self) -> tuple[DriverParameters, PixelFilter]:
        """Return the settings of the camera."""
        return _with_exposure(self.parameters, self._auto_exposure), self.mask.in_camera

    def use_size(self, size: tuple[int, int]) -> None:
        """Check the mask against the pixel array of a camera that was opened.

        Args:
            size: Columns and rows of the array.

        Raises:
            ConfigurationError: The mask has another size.
        """
        self._size = size
        self.mask.check_size(size)

    def apply(self, parameters: DriverParameters, apply: Apply) -> None:
        """Use new parameters.

        Args:
            parameters: All of them.
            apply: Sends settings to the source.

        Raises:
            ConfigurationError: They contradict each other, or the mask cannot be read; nothing was
                changed.
            UsbError: A request to the camera failed.
        """
        parameters.check()
        with self._lock:
            old, mask, file_mask = self.parameters, self.mask, self.file_mask
            if parameters.dvs_pixel_mask != old.dvs_pixel_mask:
                mask = file_mask = load_mask(parameters.dvs_pixel_mask)
                if self._size is not None:
                    mask.check_size(self._size)
                mask.dropped = self.mask.dropped
            auto_exposure = self._auto_exposure
            if any(getattr(parameters, name) != getattr(old, name) for name in _AUTO_EXPOSURE):
                auto_exposure = AutoExposure(parameters) if parameters.aps_auto_exposure else None
            apply(_with_exposure(parameters, auto_exposure), mask.in_camera)
            self.parameters, self.mask, self.file_mask = parameters, mask, file_mask
            self._auto_exposure = auto_exposure

    def use_mask(self, mask: PixelMask, apply: Apply, *, in_camera: bool = True) -> None:
        """Mask other pixels.

        Args:
            mask: The pixels.
            apply: Sends settings to the source.
            in_camera: False leaves the filters of the camera open.

        Raises:
            UsbError: A request to the camera failed.
        """
        with self._lock:
            parameters = _with_exposure(self.parameters, self._auto_exposure)
            apply(parameters, mask.in_camera if in_camera else ())
            mask.dropped = self.mask.dropped
            self.mask = mask

    def follow(self, frame: Frame, exposure_us: float, control: CameraControl) -> None:
        """Set the exposure by a frame if automatic exposure is enabled; never waits.

        Args:
            frame: The frame.
            exposure_us: Its exposure [us].
            control: Requests to the camera.
        """
        # Skip if another thread holds the lock; retry on the next frame.
        if exposure_us <= 0 or not self._lock.acquire(blocking=False):
            return
        try:
            auto_exposure = self._auto_exposure
            if auto_exposure is None:
                return
            wanted_us = auto_exposure.update(frame.image, exposure_us)
            if wanted_us is not None and control.set_exposure(wanted_us):
                auto_exposure.accept(wanted_us)
        except UsbError:
            # The thread that reads the data reports failures of the camera.
            pass
        finally:
            self._lock.release()


def _with_exposure(p: DriverParameters, auto_exposure: AutoExposure | None) -> DriverParameters:
    """Return parameters with the exposure that automatic exposure has found."""
    return p if auto_exposure is None else replace(p, aps_exposure=auto_exposure.exposure_us)
