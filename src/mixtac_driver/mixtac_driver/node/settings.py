# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Current settings of the driver: parameters, masked pixels and automatic exposure."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.readings import Frame
from mixtac_core.node.files import state_file
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


def right_exposure(image: NDArray[np.uint16], exposure_us: float, p: CameraParameters) -> int:
    """Return the exposure that would have brought a frame to the wanted brightness [us].

    Args:
        image: `uint16`, any shape, 0 .. 1023.
        exposure_us: Exposure of the frame [us].
        p: Wanted brightness, shortest and longest exposure (`aps_auto_exposure_*`).
    """
    factor = p.aps_auto_exposure_target * FULL_SCALE / max(float(image.mean()), 1e-3)
    right_us = exposure_us * min(max(factor, 1 / LARGEST_STEP), LARGEST_STEP)
    return round(min(max(right_us, p.aps_auto_exposure_minimum), p.aps_auto_exposure_maximum))


class DriverSettings:
    """Turns parameters into settings of the camera, from any thread.

    Args:
        parameters: The start values; where the file of hot pixels exists, they are masked.

    Attributes:
        parameters: Those in effect.
        mask: Pixels that are masked now.
        file_mask: Pixels of `dvs_pixel_mask`.

    Raises:
        ConfigurationError: They contradict each other, or a mask cannot be read.
    """

    def __init__(self, parameters: DriverParameters) -> None:
        parameters.check()
        self.parameters = parameters
        self.mask = self.file_mask = load_mask(parameters.dvs_pixel_mask)
        name = parameters.hot_pixels_file
        if name and (path := state_file(name)).exists():
            found = load_mask(str(path))
            self.mask = PixelMask([*found.pixels, *self.file_mask.pixels], found.size)
        self._size: tuple[int, int] | None = None
        # That of the parameters, or set by automatic exposure [us].
        self._exposure_us = parameters.aps_exposure
        self._lock = threading.Lock()

    def camera_settings(self) -> tuple[DriverParameters, PixelFilter]:
        """Return the settings of the camera."""
        return replace(self.parameters, aps_exposure=self._exposure_us), self.mask.in_camera

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
            kept = parameters.aps_auto_exposure and parameters.aps_exposure == old.aps_exposure
            exposure_us = self._exposure_us if kept else parameters.aps_exposure
            apply(replace(parameters, aps_exposure=exposure_us), mask.in_camera)
            self.parameters, self.mask, self.file_mask = parameters, mask, file_mask
            self._exposure_us = exposure_us

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
            parameters, _ = self.camera_settings()
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
            if not self.parameters.aps_auto_exposure:
                return
            right_us = right_exposure(frame.image, exposure_us, self.parameters)
            changed = abs(right_us - self._exposure_us) > DEAD_BAND * self._exposure_us
            if changed and control.set_exposure(right_us):
                self._exposure_us = right_us
        except UsbError:
            # The thread that reads the data reports failures of the camera.
            pass
        finally:
            self._lock.release()
