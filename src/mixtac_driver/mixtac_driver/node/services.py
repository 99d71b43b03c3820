# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Services of the driver: snapshot, clock reset, hot pixels, calibration.

They run in the executor's thread and wait there, for a bounded time, for the decoding thread.
"""

from __future__ import annotations

import contextlib
import threading
from functools import partial
from typing import Any

from sensor_msgs.srv import SetCameraInfo
from std_srvs.srv import Trigger

from mixtac_core.events.errors import MixtacError
from mixtac_core.node.base_node import answering
from mixtac_core.node.files import state_file
from mixtac_driver.camera import CameraBatch
from mixtac_driver.camera_info import CalibratedCamera
from mixtac_driver.davis346.control import CameraControl
from mixtac_driver.errors import DriverError, StreamError, UsbError
from mixtac_driver.node.settings import DriverSettings
from mixtac_driver.pixels import PixelCounter, PixelMask, hot_pixels, save_mask
from mixtac_driver.source import Source

MARGIN_S = 1.0
"""Additional time allowed for a frame or a count [s]."""
LISTED_PIXELS = 20
"""Most hot pixels that an answer lists."""


class NextFrame:
    """Waits for a frame.

    Args:
        after_us: Earliest start of the exposure [us, epoch-based camera clock].

    Attributes:
        done: Set when the frame is there.
        stamp_us: Middle of its exposure [us, epoch-based camera clock].
    """

    def __init__(self, after_us: int) -> None:
        self.done = threading.Event()
        self.stamp_us = 0
        self._after_us = after_us

    def add(self, batch: CameraBatch) -> None:
        """Look for the frame in a batch."""
        for frame in batch.decoded.frames:
            late_enough = frame.exposure_start_us + batch.origin.us >= self._after_us
            if late_enough and not self.done.is_set():
                self.stamp_us = frame.middle_us + batch.origin.us
                self.done.set()


class DriverServices:
    """Offers `~/snapshot`, `~/reset_timestamps`, `~/find_hot_pixels` and `~/set_camera_info`.

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
        self._watcher: PixelCounter | NextFrame | None = None
        self._time_us = 0
        offer = partial(node.create_service, Trigger)
        offer('~/snapshot', answering(lambda _: self.snapshot()))
        offer('~/reset_timestamps', answering(lambda _: self.reset_timestamps()))
        offer('~/find_hot_pixels', answering(lambda _: self.find_hot_pixels()))
        node.create_service(SetCameraInfo, '~/set_camera_info', self.set_camera_info)

    def watch(self, batch: CameraBatch) -> None:
        """Pass a batch, before its events are masked, to a waiting service; never waits."""
        self._time_us = batch.time_us
        watcher = self._watcher
        if watcher is not None:
            watcher.add(batch)

    def snapshot(self) -> str:
        """Take one frame, or wait for the next if frames are taken continuously.

        Raises:
            DriverError: There is no stream, or no frame came.
        """
        control = self._control('no frame can be requested')
        p, frame = self._settings.parameters, NextFrame(self._time_us)
        seconds = (2 * control.parameters.aps_exposure + p.aps_frame_interval) / 1e6
        self._watch_with(frame, seconds, 'frame', before=control.request_frame)
        return f'frame of {frame.stamp_us / 1e6:.6f} s on the camera clock'

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
            counter = PixelCounter(round(p.hot_pixels_duration * 1e6), size)
            self._watch_with(counter, p.hot_pixels_duration, 'end of the count')
            found = hot_pixels(counter.counts, p.hot_pixels_duration)
            mask = PixelMask([*found, *self._settings.file_mask.pixels], size)
            self._settings.use_mask(mask, self._source.apply)
        except MixtacError:
            # Where the camera does not accept the filters, the host masks these pixels as well.
            with contextlib.suppress(UsbError):
                self._settings.use_mask(before, self._source.apply)
            raise
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

    def _watch_with(
        self,
        watcher: PixelCounter | NextFrame,
        seconds: float,
        what: str,
        before: Any = None,  # noqa: ANN401
    ) -> None:
        """Pass batches to a watcher until it is done; `before` runs once it watches."""
        self._watcher = watcher
        try:
            if before is not None:
                before()
            if not watcher.done.wait(seconds + MARGIN_S):
                raise StreamError(
                    f'no {what} within {seconds + MARGIN_S:.1f} s',
                    remedy='see /diagnostics for the state of the camera',
                )
        finally:
            self._watcher = None
