# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Current settings of the driver: parameters, masked pixels and automatic exposure."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from mixtac_driver.errors import UsbError
from mixtac_driver.parameters import DriverParameters, camera_configuration
from mixtac_driver.pixels import PixelMask, load_mask

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from mixtac_driver.davis346.control import CameraControl
    from mixtac_driver.davis346.settings import Configuration
    from mixtac_events.readings import Frame


FULL_SCALE = 1023
LARGEST_STEP = 4.0
DEAD_BAND = 0.08
"""Relative change below which the exposure stays."""
SMOOTHING = 0.5
"""Weight of the latest frame."""


@dataclass(frozen=True, slots=True)
class ExposureLimits:
    """What the controller aims at and where it stops.

    Attributes:
        target: Mean brightness, 0 .. 1 of full scale.
        minimum_us: Shortest exposure [us].
        maximum_us: Longest exposure [us].
    """

    target: float
    minimum_us: int
    maximum_us: int


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
        exposure_us: Exposure to begin with [us].
        limits: Target and limits.

    Attributes:
        exposure_us: Exposure that was asked for last [us].
    """

    def __init__(self, exposure_us: int, limits: ExposureLimits) -> None:
        self.limits = limits
        self.exposure_us = self._limited(exposure_us)
        self._wish = math.log(self.exposure_us)

    def update(self, image: NDArray[np.uint16], exposure_us: float) -> int | None:
        """Take a frame; return the exposure to ask for [us], or None where it may stay.

        Ask again with the next frame if the camera could not be told: until `accept` is called
        the exposure counts as unchanged.

        Args:
            image: `uint16`, 0 .. 1023.
            exposure_us: Exposure of the frame [us].
        """
        right = self._limited(right_exposure(image, exposure_us, self.limits.target))
        self._wish += SMOOTHING * (math.log(right) - self._wish)
        wish = self._limited(math.exp(self._wish))
        at_limit = wish in {self.limits.minimum_us, self.limits.maximum_us}
        change = abs(math.log(wish / self.exposure_us))
        if change == 0 or (change < DEAD_BAND and not at_limit):
            return None
        return wish

    def accept(self, exposure_us: int) -> None:
        """Take note that the camera was told this exposure [us]."""
        self.exposure_us = exposure_us

    def _limited(self, exposure_us: float) -> int:
        return round(min(max(exposure_us, self.limits.minimum_us), self.limits.maximum_us))


class DriverSettings:
    """Turns parameters into settings of the camera, from any thread.

    Args:
        parameters: To begin with.

    Attributes:
        parameters: The latest that were applied.
        mask: Pixels whose events are dropped.
        file_mask: Those of them that the file names.

    Raises:
        ConfigurationError: The parameters contradict each other, or the mask cannot be read.
    """

    def __init__(self, parameters: DriverParameters) -> None:
        self.parameters = parameters
        self.mask = self.file_mask = load_mask(parameters.dvs_pixel_mask)
        self._auto_exposure = _auto_exposure(parameters)
        self._lock = threading.Lock()

    def configuration(self) -> Configuration:
        """Return the settings of the camera."""
        return _configuration(self.parameters, self.mask, self._auto_exposure)

    def apply(self, parameters: DriverParameters, tell: Callable[[Configuration], None]) -> None:
        """Take new parameters.

        Args:
            parameters: All of them.
            tell: Hands new settings to the camera.

        Raises:
            ConfigurationError: They contradict each other, or the mask cannot be read; nothing was
                changed.
            UsbError: The camera could not be told.
        """
        with self._lock:
            old, mask, file_mask = self.parameters, self.mask, self.file_mask
            if parameters.dvs_pixel_mask != old.dvs_pixel_mask:
                mask = file_mask = load_mask(parameters.dvs_pixel_mask)
                mask.dropped = self.mask.dropped
            auto_exposure = self._auto_exposure
            if _exposure_parameters(parameters) != _exposure_parameters(old):
                auto_exposure = _auto_exposure(parameters)
            tell(_configuration(parameters, mask, auto_exposure))
            self.parameters, self.mask, self.file_mask = parameters, mask, file_mask
            self._auto_exposure = auto_exposure

    def use_mask(
        self, mask: PixelMask, tell: Callable[[Configuration], None], *, in_camera: bool = True
    ) -> None:
        """Mask other pixels.

        Args:
            mask: The pixels.
            tell: Hands new settings to the camera.
            in_camera: False leaves the filters of the camera open.

        Raises:
            UsbError: The camera could not be told.
        """
        with self._lock:
            parts = mask if in_camera else PixelMask()
            tell(_configuration(self.parameters, parts, self._auto_exposure))
            mask.dropped = self.mask.dropped
            self.mask = mask

    def follow(self, frame: Frame, exposure_us: float, control: CameraControl) -> None:
        """Set the exposure by a frame, where that is wanted; returns soon.

        Args:
            frame: The frame.
            exposure_us: Its exposure [us].
            control: Of the camera.
        """
        if self._auto_exposure is None or exposure_us <= 0:
            return
        # Others who change settings have the word; the next frame is soon here.
        if not self._lock.acquire(blocking=False):
            return
        try:
            self._set_exposure(self._auto_exposure, frame, exposure_us, control)
        finally:
            self._lock.release()

    def _set_exposure(
        self,
        auto_exposure: AutoExposure | None,
        frame: Frame,
        exposure_us: float,
        control: CameraControl,
    ) -> None:
        if auto_exposure is None:
            return
        wanted_us = auto_exposure.update(frame.image, exposure_us)
        if wanted_us is None:
            return
        try:
            told = control.set_exposure(wanted_us)
        except UsbError:
            # What reads the data says what is wrong with the camera.
            return
        if told:
            auto_exposure.accept(wanted_us)


def _exposure_parameters(p: DriverParameters) -> tuple[object, ...]:
    return p.aps_exposure, p.aps_auto_exposure, _limits(p)


def _limits(p: DriverParameters) -> ExposureLimits:
    return ExposureLimits(
        p.aps_auto_exposure_target, p.aps_auto_exposure_minimum, p.aps_auto_exposure_maximum
    )


def _auto_exposure(p: DriverParameters) -> AutoExposure | None:
    return AutoExposure(p.aps_exposure, _limits(p)) if p.aps_auto_exposure else None


def _configuration(
    p: DriverParameters, mask: PixelMask, auto_exposure: AutoExposure | None
) -> Configuration:
    configuration = camera_configuration(p, mask.in_camera)
    if auto_exposure is None:
        return configuration
    return replace(configuration, aps_exposure_us=auto_exposure.exposure_us)
