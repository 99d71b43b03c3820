# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Everything one can ask of a camera through its registers, from any thread."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from typing import TYPE_CHECKING

from mixtac_driver import sequences
from mixtac_driver.errors import DriverError
from mixtac_driver.register_writer import RegisterWriter
from mixtac_driver.statistics import CameraStatistics, read_statistics

if TYPE_CHECKING:
    from collections.abc import Callable

    from mixtac_driver.configuration import Configuration
    from mixtac_driver.identity import Identity
    from mixtac_driver.protocol import Protocol
    from mixtac_driver.sequences import Origin


class CameraControl:
    """Keeps a camera to its settings, over any number of times that it is opened.

    One request goes on at a time; the others wait, but for `set_exposure`.

    Args:
        configuration: Settings.
        now_ns: Host clock [ns since the Unix epoch].

    Raises:
        ConfigurationError: A setting is out of range.
    """

    def __init__(
        self, configuration: Configuration, now_ns: Callable[[], int] = time.time_ns
    ) -> None:
        configuration.check()
        self._configuration = configuration
        self._now_ns = now_ns
        self._lock = threading.Lock()
        self._protocol: Protocol | None = None
        self._identity: Identity | None = None
        self._writer: RegisterWriter | None = None

    @property
    def configuration(self) -> Configuration:
        """The settings."""
        return self._configuration

    def attach(self, protocol: Protocol, identity: Identity) -> None:
        """Put the settings into a camera that was just opened.

        Raises:
            UsbError: A request failed; the camera is not attached.
        """
        with self._lock:
            writer = RegisterWriter(protocol, identity)
            writer.configure(self._configuration)
            self._protocol, self._identity, self._writer = protocol, identity, writer

    def detach(self) -> None:
        """Forget the camera; returns when no request is under way any more."""
        with self._lock:
            self._protocol = self._identity = self._writer = None

    def start(self, begin_reading: Callable[[], None]) -> Origin:
        """Start streaming and reset the camera's clock.

        Args:
            begin_reading: Clears the data endpoint and begins to read it.

        Returns:
            When the clock read zero.

        Raises:
            UsbError: A request failed.
            DriverError: The camera is closed.
        """
        with self._lock:
            protocol, _, writer = self._attached()
            sequences.start(protocol, self._configuration, begin_reading)
            writer.started(self._configuration)
            return sequences.reset_timestamps(protocol, self._now_ns)

    def stop(self, end_reading: Callable[[], None]) -> None:
        """Stop streaming.

        Args:
            end_reading: Ends the reads of the data endpoint.

        Raises:
            UsbError: A request failed; reading was ended all the same.
            DriverError: The camera is closed.
        """
        with self._lock:
            protocol, _, writer = self._attached()
            writer.stopped()
            sequences.stop(protocol, end_reading)

    def apply(self, configuration: Configuration) -> None:
        """Change settings, at once while the camera is open, else when it is opened.

        Raises:
            ConfigurationError: A setting is out of range; nothing was changed.
            UsbError: A request failed.
        """
        configuration.check()
        with self._lock:
            if self._writer is not None:
                self._writer.change(self._configuration, configuration)
            self._configuration = configuration

    def set_exposure(self, exposure_us: int) -> bool:
        """Change nothing but the exposure [us]; for control loops, as it waits for nobody.

        Returns:
            False where the camera was busy with another request: try again later.

        Raises:
            ConfigurationError: It is out of range; nothing was changed.
            UsbError: The request failed.
        """
        if not self._lock.acquire(blocking=False):
            return False
        try:
            configuration = replace(self._configuration, aps_exposure_us=exposure_us)
            configuration.check()
            if self._writer is not None:
                self._writer.set_exposure(exposure_us)
            self._configuration = configuration
        finally:
            self._lock.release()
        return True

    def request_frame(self) -> None:
        """Make the camera take one frame, unless it takes frames all the time.

        Raises:
            UsbError: The request failed.
            DriverError: The camera is closed.
        """
        with self._lock:
            _, _, writer = self._attached()
            if not self._configuration.aps_enabled:
                writer.request_frame()

    def reset_timestamps(self) -> Origin:
        """Set the camera's clock to zero and return when that was.

        Raises:
            UsbError: The request failed.
            DriverError: The camera is closed.
        """
        with self._lock:
            protocol, _, _ = self._attached()
            return sequences.reset_timestamps(protocol, self._now_ns)

    def statistics(self) -> CameraStatistics | None:
        """Return the counters of the camera itself; None while it is closed.

        Raises:
            UsbError: A request failed.
        """
        with self._lock:
            if self._protocol is None or self._identity is None:
                return None
            return read_statistics(self._protocol, self._identity.features)

    def _attached(self) -> tuple[Protocol, Identity, RegisterWriter]:
        if self._protocol is None or self._identity is None or self._writer is None:
            raise DriverError('the camera is closed: call open() first')
        return self._protocol, self._identity, self._writer
