# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Thread-safe requests to an open camera: settings, exposure, frames, clock reset, statistics."""

from __future__ import annotations

import contextlib
import threading
import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from mixtac_driver.davis346 import writes as sequences
from mixtac_driver.davis346.registers import Aps, Dvs, Module, Mux
from mixtac_driver.davis346.writes import STOP_WRITES, exposure_write, register_writes, run_writes
from mixtac_driver.errors import DriverError, UsbError
from mixtac_driver.usb.protocol import Write

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mixtac_driver.clock import Origin
    from mixtac_driver.davis346.identity import Features, Identity
    from mixtac_driver.davis346.settings import Configuration
    from mixtac_driver.usb.protocol import Protocol


@dataclass(frozen=True, slots=True)
class CameraStatistics:
    """Totals since the logic was last reset; 0 where the logic does not count.

    Attributes:
        rows: Row addresses that the pixel array gave.
        columns: Column addresses, that is events, that it gave.
        dropped: Events that found the event read-out's buffer full.
        filtered_pixels: Events dropped by the pixel filters.
        filtered_background_activity: Events dropped by the background activity filter.
        filtered_refractory: Events dropped by the refractory period filter.
        external_input_dropped: Edges that found the way to the host blocked.
        dvs_dropped: Event words that found the way to the host blocked.
    """

    rows: int = 0
    columns: int = 0
    dropped: int = 0
    filtered_pixels: int = 0
    filtered_background_activity: int = 0
    filtered_refractory: int = 0
    external_input_dropped: int = 0
    dvs_dropped: int = 0

    @property
    def lost(self) -> int:
        """Everything that was dropped though nobody asked for it."""
        return self.dropped + self.external_input_dropped + self.dvs_dropped


def read_statistics(protocol: Protocol, features: Features) -> CameraStatistics:
    """Read the counters that a camera has.

    Args:
        protocol: Register access.
        features: Says which blocks count.

    Raises:
        UsbError: A request failed.
    """
    values: dict[str, int] = {}
    if features.dvs_statistics:
        values['rows'] = read_64(protocol, Module.DVS, Dvs.STATISTICS_ROWS)
        values['columns'] = read_64(protocol, Module.DVS, Dvs.STATISTICS_COLUMNS)
        values['dropped'] = read_64(protocol, Module.DVS, Dvs.STATISTICS_DROPPED)
        if features.pixel_filter:
            values['filtered_pixels'] = read_64(
                protocol, Module.DVS, Dvs.STATISTICS_FILTERED_PIXELS
            )
        if features.background_activity:
            values['filtered_background_activity'] = read_64(
                protocol, Module.DVS, Dvs.STATISTICS_FILTERED_BACKGROUND_ACTIVITY
            )
            values['filtered_refractory'] = read_64(
                protocol, Module.DVS, Dvs.STATISTICS_FILTERED_REFRACTORY
            )
    if features.mux_statistics:
        values['external_input_dropped'] = read_64(
            protocol, Module.MUX, Mux.STATISTICS_EXTERNAL_INPUT_DROPPED
        )
        values['dvs_dropped'] = read_64(protocol, Module.MUX, Mux.STATISTICS_DVS_DROPPED)
    return CameraStatistics(**values)


def read_64(protocol: Protocol, module: int, parameter: int) -> int:
    """Return a 64-bit counter: its upper half at `parameter`, its lower half at the next one.

    Raises:
        UsbError: A request failed.
    """
    upper = protocol.read(module, parameter)
    lower = protocol.read(module, parameter + 1)
    again = protocol.read(module, parameter)
    if again != upper:
        # The lower half overflowed in between; it cannot do so twice within a request.
        upper, lower = again, protocol.read(module, parameter + 1)
    return upper << 32 | lower


REGION = tuple(
    (int(Module.APS), int(parameter))
    for parameter in (Aps.START_COLUMN, Aps.START_ROW, Aps.END_COLUMN, Aps.END_ROW)
)
FRAMES_ON = Write(Module.APS, Aps.RUN, 1)
FRAMES_OFF = Write(Module.APS, Aps.RUN, 0)


class RegisterWriter:
    """Puts settings into a camera and remembers what it wrote. For one thread at a time.

    Args:
        protocol: Register access.
        identity: The camera.

    Attributes:
        running: True between `started` and `stopped`: the sensors follow their run bits.
    """

    def __init__(self, protocol: Protocol, identity: Identity) -> None:
        self.running = False
        self._protocol = protocol
        self._identity = identity
        self._written: dict[tuple[int, int], int] = {}

    def configure(self, configuration: Configuration) -> None:
        """Write all settings in the order that cameras know; nothing is started.

        Raises:
            ConfigurationError: A setting is out of range; nothing was written.
            UsbError: A request failed.
        """
        self._write_each(register_writes(configuration, self._identity))

    def started(self, configuration: Configuration) -> None:
        """Take note that the sensors of a configuration run."""
        self._written.update({(m, p): value for m, p, value in run_writes(configuration)})
        self.running = True

    def stopped(self) -> None:
        """Take note that the sensors were stopped; they start with the stream."""
        self.running = False
        for address in map(_address, STOP_WRITES):
            self._written.pop(address, None)

    def change(self, old: Configuration, new: Configuration) -> None:
        """Write what differs from what the camera has.

        Args:
            old: Settings so far, to go back to if a request fails.
            new: Wanted settings.

        Raises:
            ConfigurationError: A setting is out of range; nothing was written.
            UsbError: A request failed; what can be was set back.
        """
        wanted = self._wanted(new)
        try:
            self._write_changes(wanted)
        except UsbError:
            with contextlib.suppress(UsbError):
                self._write_changes(self._wanted(old))
            raise

    def set_exposure(self, exposure_us: int) -> None:
        """Write the exposure [us] and nothing else.

        Raises:
            UsbError: The request failed.
        """
        self._write_changes([exposure_write(exposure_us, self._identity.clocks)])

    def request_frame(self) -> None:
        """Make a camera whose frames are off take one.

        Raises:
            UsbError: The request failed.
        """
        self._protocol.write_at_once([FRAMES_ON, FRAMES_OFF])

    def _wanted(self, configuration: Configuration) -> list[Write]:
        wanted = register_writes(configuration, self._identity)
        return wanted + run_writes(configuration) if self.running else wanted

    def _write_changes(self, wanted: Sequence[Write]) -> None:
        changed = [w for w in wanted if self._written.get(_address(w)) != w.value]
        self._write_each([w for w in changed if _address(w) not in REGION])
        if any(_address(w) in REGION for w in changed):
            self._write_region([w for w in wanted if _address(w) in REGION])

    def _write_region(self, region: Sequence[Write]) -> None:
        # The read-out takes a new region only while it is idle, and all of it at once.
        running = self._written.get(_address(FRAMES_ON), 0)
        again = [FRAMES_ON] if running else []
        for write in region:
            self._written.pop(_address(write), None)
        self._protocol.write_at_once([FRAMES_OFF, *region, *again])
        for write in region:
            self._written[_address(write)] = write.value

    def _write_each(self, writes: Sequence[Write]) -> None:
        for write in writes:
            # A request that failed may or may not have been obeyed.
            self._written.pop(_address(write), None)
            self._protocol.write(*write)
            self._written[_address(write)] = write.value


def _address(write: Write) -> tuple[int, int]:
    return int(write.module), int(write.parameter)


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
