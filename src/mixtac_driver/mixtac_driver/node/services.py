# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Services of the driver: snapshot, clock reset, hot pixels.

They run in the executor's thread and wait there, for a bounded time, for the decoding thread.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from std_srvs.srv import Trigger

from mixtac_driver.davis346.control import CameraControl
from mixtac_driver.errors import DriverError, StreamError, UsbError
from mixtac_driver.node.settings import DriverSettings
from mixtac_driver.pixels import PixelCounter, PixelMask, check_path, hot_pixels, save_mask
from mixtac_driver.source import Source
from mixtac_events.arrays import Events
from mixtac_events.errors import MixtacError
from mixtac_events.readings import Frame
from mixtac_node.base_node import answering
from mixtac_node.files import state_file

MARGIN_S = 1.0
"""Additional time allowed for a frame or a count."""
REPORT_PERIOD_S = 1.0
LISTED_PIXELS = 20


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

    def add(self, frame: Frame, origin_us: int) -> None:
        """Take a frame into account."""
        if not self.done.is_set() and frame.exposure_start_us + origin_us >= self._after_us:
            self.stamp_us = frame.middle_us + origin_us
            self.done.set()


class DriverServices:
    """Offers `~/snapshot`, `~/reset_timestamps` and `~/find_hot_pixels` (std_srvs/Trigger).

    Args:
        node: An rclpy node.
        source: The source.
        settings: Its settings.
        meanwhile: Called once a second while a service waits.
    """

    def __init__(
        self,
        node: Any,  # noqa: ANN401
        source: Source,
        settings: DriverSettings,
        meanwhile: Callable[[], None],
    ) -> None:
        self._source, self._settings, self._meanwhile = source, settings, meanwhile
        self._counter: PixelCounter | None = None
        self._next_frame: NextFrame | None = None
        self._time_us = 0
        offer = partial(node.create_service, Trigger)
        offer('~/snapshot', answering(lambda _: self.snapshot()))
        offer('~/reset_timestamps', answering(lambda _: self.reset_timestamps()))
        offer('~/find_hot_pixels', answering(lambda _: self.find_hot_pixels()))

    def watch_events(self, events: Events, time_us: int) -> None:
        """Take events into account, in the decoding thread.

        Args:
            events: Events before masking on the host; their times are not used.
            time_us: Time that the stream has reached [us, epoch-based camera clock].
        """
        self._time_us = time_us
        counter = self._counter
        if counter is not None:
            counter.add(events, time_us)

    def watch_frame(self, frame: Frame, origin_us: int) -> None:
        """Take a frame into account, in the decoding thread."""
        next_frame = self._next_frame
        if next_frame is not None:
            next_frame.add(frame, origin_us)

    def snapshot(self) -> str:
        """Take one frame, or wait for the next if frames are taken continuously.

        Raises:
            DriverError: There is no stream, or no frame came.
        """
        p = self._settings.parameters
        self._next_frame = next_frame = NextFrame(self._time_us)
        try:
            control = self._control('no frame can be requested')
            control.request_frame()
            exposure_us = control.parameters.aps_exposure
            self._wait(next_frame.done, (2 * exposure_us + p.aps_frame_interval) / 1e6, 'frame')
        finally:
            self._next_frame = None
        return f'frame of {next_frame.stamp_us / 1e6:.6f} s on the camera clock'

    def reset_timestamps(self) -> str:
        """Set the camera's clock to zero; published time goes on.

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
            FileError: The file of the mask is not in the state folder.
        """
        p, before = self._settings.parameters, self._settings.mask
        path = str(state_file(p.hot_pixels_file)) if p.hot_pixels_file else ''
        if path:
            check_path(path)
        identity = self._source.status().identity
        if identity is None:
            raise StreamError('no camera was opened yet', remedy='attach it and try again')
        size = identity.geometry.event_size
        # Pixels that the camera masks cannot be counted.
        self._settings.use_mask(before, self._source.apply, in_camera=False)
        try:
            counter = self._count(p.hot_pixels_duration, size)
            found = hot_pixels(
                counter.counts,
                p.hot_pixels_duration,
                p.hot_pixels_minimum_rate,
                p.hot_pixels_factor,
            )
            mask = PixelMask([*found, *self._settings.file_mask.pixels], size)
            self._settings.use_mask(mask, self._source.apply)
        except MixtacError:
            self._restore(before)
            raise
        if path:
            save_mask(mask, path)
        listed = ', '.join(str(pixel) for pixel in found[:LISTED_PIXELS])
        more = ', ...' if len(found) > LISTED_PIXELS else ''
        return (
            f'{len(found)} hot pixels{": " if found else ""}{listed}{more}; {len(mask.pixels)} '
            f'masked, {len(mask.in_camera)} of them by the camera'
        )

    def _control(self, otherwise: str) -> CameraControl:
        control = self._source.control
        if control is None:
            device = self._settings.parameters.device
            raise DriverError(f'{device} is a recording: {otherwise}')
        return control

    def _restore(self, mask: PixelMask) -> None:
        try:
            self._settings.use_mask(mask, self._source.apply)
        except UsbError:
            # It gets the mask when it is opened again.
            if self._source.control is not None:
                self._settings.use_mask(mask, self._source.control.keep)
            raise

    def _count(self, duration_s: float, size: tuple[int, int]) -> PixelCounter:
        self._counter = counter = PixelCounter(round(duration_s * 1e6), size)
        try:
            self._wait(counter.done, duration_s, 'end of the count')
        finally:
            self._counter = None
        return counter

    def _wait(self, done: threading.Event, seconds: float, what: str) -> None:
        deadline_s = time.monotonic() + seconds + MARGIN_S
        while not done.wait(min(REPORT_PERIOD_S, max(deadline_s - time.monotonic(), 0.0))):
            if time.monotonic() >= deadline_s:
                raise StreamError(
                    f'no {what} within {seconds + MARGIN_S:.1f} s',
                    remedy='see /diagnostics for the state of the camera',
                )
            self._meanwhile()
