# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Thread-safe requests to an open camera: settings, exposure, frames, clock reset, statistics."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from mixtac_driver.clock import ClockEpochs, Origin
from mixtac_driver.davis346.model import Identity
from mixtac_driver.davis346.registers import Aps, Dvs, Module, Mux, SystemInfo
from mixtac_driver.davis346.settings import CameraParameters
from mixtac_driver.davis346.writes import (
    APS_REGION,
    STOP_WRITES,
    cycles,
    register_writes,
    reset_clock,
    run_writes,
    start_streaming,
    stop_streaming,
)
from mixtac_driver.errors import DriverError, UsbError
from mixtac_driver.usb.protocol import Protocol, Write

COUNTERS = {
    'rows': (Module.DVS, Dvs.STATISTICS_ROWS),
    'columns': (Module.DVS, Dvs.STATISTICS_COLUMNS),
    'dropped': (Module.DVS, Dvs.STATISTICS_DROPPED),
    'filtered pixels': (Module.DVS, Dvs.STATISTICS_FILTERED_PIXELS),
    'filtered background activity': (Module.DVS, Dvs.STATISTICS_FILTERED_BACKGROUND_ACTIVITY),
    'filtered refractory': (Module.DVS, Dvs.STATISTICS_FILTERED_REFRACTORY),
    'external input dropped': (Module.MUX, Mux.STATISTICS_EXTERNAL_INPUT_DROPPED),
    'dvs dropped': (Module.MUX, Mux.STATISTICS_DVS_DROPPED),
}
"""64-bit counters of the camera since its logic was reset, by name."""
LOST = ('dropped', 'external input dropped', 'dvs dropped')
"""Counters of unintended drops: full buffers, and a blocked path to the host."""


def dropped(statistics: Mapping[str, int]) -> int:
    """Return how many data the camera dropped since its logic was reset, 0 while it is closed."""
    return sum(statistics.get(name, 0) for name in LOST)


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


REGION = tuple((int(Module.APS), int(register)) for register in APS_REGION)
FRAMES_ON = Write(Module.APS, Aps.RUN, 1)
FRAMES_OFF = Write(Module.APS, Aps.RUN, 0)


PixelFilter = tuple[tuple[int, int], ...]
"""(column, row) of each pixel whose events the camera drops."""
Settings = tuple['CameraParameters', PixelFilter]


def _address(write: Write) -> tuple[int, int]:
    return int(write.module), int(write.parameter)


class CameraControl:
    """Keeps a camera to its settings, over any number of times that it is opened.

    One request runs at a time; the others wait, except `set_exposure`. It remembers the written
    values, and later writes only values that differ.

    Args:
        parameters: Settings.
        pixel_filter: Pixels whose events the camera drops, most important first.

    Attributes:
        epochs: Clock of the latest stream; None before the first.

    Raises:
        ConfigurationError: Two settings contradict each other.
        ParameterError: A setting is out of range.
    """

    def __init__(self, parameters: CameraParameters, pixel_filter: PixelFilter = ()) -> None:
        parameters.check()
        self.epochs: ClockEpochs | None = None
        self._settings: Settings = parameters, pixel_filter
        self._lock = threading.Lock()
        self._opened: tuple[Protocol, Identity] | None = None
        # While it streams, the sensors follow their run bits.
        self._streams = False
        self._written: dict[tuple[int, int], int] = {}

    @property
    def parameters(self) -> CameraParameters:
        """The settings."""
        return self._settings[0]

    def attach(self, protocol: Protocol, identity: Identity) -> None:
        """Put the settings into a camera that was just opened, in the order that cameras expect.

        Raises:
            ConfigurationError: A setting does not fit this camera; nothing was written.
            UsbError: A request failed; the camera is not attached.
        """
        with self._lock:
            self._streams = False
            self._written.clear()
            self._write_each(protocol, self._wanted(identity, self._settings))
            self._opened = protocol, identity

    def detach(self) -> None:
        """Forget the camera; returns when no request is under way."""
        with self._lock:
            self._opened = None

    def start(self, begin_reading: Callable[[], None]) -> None:
        """Start streaming and reset the camera's clock; published time continues.

        Args:
            begin_reading: Clears the data endpoint and starts to read it.

        Raises:
            UsbError: A request failed.
            DriverError: The camera is closed.
        """
        with self._lock:
            protocol, identity = self._attached()
            run = run_writes(self.parameters, identity.model)
            start_streaming(protocol, run, begin_reading)
            self._written.update({_address(write): write.value for write in run})
            self._streams = True
            reset = reset_clock(protocol)
            latest_us = self.epochs.latest_us if self.epochs else 0
            self.epochs = ClockEpochs(reset, self.parameters.usb_early_packet_delay, latest_us)

    def stop(self, end_reading: Callable[[], None]) -> None:
        """Stop streaming.

        Args:
            end_reading: Ends the reads of the data endpoint.

        Raises:
            UsbError: A request failed; reading was ended nevertheless.
            DriverError: The camera is closed.
        """
        with self._lock:
            protocol, _ = self._attached()
            self._streams = False
            for write in STOP_WRITES:
                self._written.pop(_address(write), None)
            stop_streaming(protocol, end_reading)

    def apply(self, parameters: CameraParameters, pixel_filter: PixelFilter = ()) -> None:
        """Change settings, at once while the camera is open, otherwise when it is opened.

        Args:
            parameters: Settings.
            pixel_filter: Pixels whose events the camera drops, most important first.

        Raises:
            ConfigurationError: A setting does not fit; nothing was changed.
            ParameterError: A setting is out of range; nothing was changed.
            UsbError: A request failed; what could be was set back.
        """
        parameters.check()
        with self._lock:
            before, settings = self._settings, (parameters, pixel_filter)
            if self._opened is not None:
                protocol, identity = self._opened
                wanted = self._wanted(identity, settings)
                try:
                    self._write_changes(protocol, wanted)
                except UsbError:
                    with contextlib.suppress(UsbError):
                        self._write_changes(protocol, self._wanted(identity, before))
                    raise
            self._settings = settings

    def set_exposure(self, exposure_us: int) -> bool:
        """Change only the exposure [us]; for control loops, because it never waits.

        Args:
            exposure_us: A value within the range of the parameter `aps_exposure` [us].

        Returns:
            False if the camera was busy with another request: try again later.

        Raises:
            UsbError: The request failed.
        """
        if not self._lock.acquire(blocking=False):
            return False
        try:
            if self._opened is not None:
                protocol, identity = self._opened
                exposure = cycles(exposure_us, identity.clocks.adc)
                self._write_changes(protocol, [Write(Module.APS, Aps.EXPOSURE, exposure)])
            parameters, pixel_filter = self._settings
            self._settings = replace(parameters, aps_exposure=exposure_us), pixel_filter
        finally:
            self._lock.release()
        return True

    def request_frame(self) -> None:
        """Make the camera take one frame, unless it takes frames continuously.

        Raises:
            UsbError: The request failed.
            DriverError: The camera does not stream, or has no frames.
        """
        self._clock()
        with self._lock:
            protocol, identity = self._attached()
            if not identity.model.has_frames:
                raise DriverError(f'a {identity.model.name} has no frames')
            if not self.parameters.aps_enabled:
                protocol.write_at_once([FRAMES_ON, FRAMES_OFF])

    def reset_timestamps(self) -> None:
        """Set the camera's clock to zero; published time goes on.

        Raises:
            UsbError: The request failed.
            DriverError: The camera does not stream.
        """
        self._clock().ask(self._reset_clock)

    def statistics(self) -> dict[str, int]:
        """Return the counters of the camera itself by name (see `COUNTERS`), none while closed.

        Raises:
            UsbError: A request failed.
        """
        with self._lock:
            if self._opened is None:
                return {}
            protocol, _ = self._opened
            return {name: read_64(protocol, *address) for name, address in COUNTERS.items()}

    def registers(self) -> dict[str, int]:
        """Return the value of every register that the driver uses, by `module:parameter`.

        Raises:
            UsbError: A request failed.
            DriverError: The camera is closed.
        """
        with self._lock:
            protocol, identity = self._attached()
            addresses = [*map(_address, register_writes(self.parameters, identity))]
            described = ((Module.DVS, Dvs), (Module.APS, Aps), (Module.SYSTEM_INFO, SystemInfo))
            addresses += [(module, number) for module, kind in described for number in kind]
            return {f'{int(m)}:{int(p)}': protocol.read(m, p) for m, p in sorted(set(addresses))}

    def _clock(self) -> ClockEpochs:
        """Return the clock of the stream.

        Raises:
            DriverError: No data have arrived.
        """
        if self.epochs is None or self.epochs.origin is None:
            raise DriverError('the camera does not stream yet', remedy='try again when it does')
        return self.epochs

    def _reset_clock(self) -> Origin:
        with self._lock:
            return reset_clock(self._attached()[0])

    def _attached(self) -> tuple[Protocol, Identity]:
        if self._opened is None:
            raise DriverError('the camera is closed', remedy='call open() first')
        return self._opened

    def _wanted(self, identity: Identity, settings: Settings) -> list[Write]:
        parameters, pixel_filter = settings
        wanted = register_writes(parameters, identity, pixel_filter)
        return wanted + run_writes(parameters, identity.model) if self._streams else wanted

    def _write_changes(self, protocol: Protocol, wanted: Sequence[Write]) -> None:
        changed = [w for w in wanted if self._written.get(_address(w)) != w.value]
        self._write_each(protocol, [w for w in changed if _address(w) not in REGION])
        if any(_address(w) in REGION for w in changed):
            self._write_region(protocol, [w for w in wanted if _address(w) in REGION])

    def _write_region(self, protocol: Protocol, region: Sequence[Write]) -> None:
        # The read-out takes a new region only while it is idle, and all of it at once.
        again = [FRAMES_ON] if self._written.get(_address(FRAMES_ON), 0) else []
        for write in region:
            self._written.pop(_address(write), None)
        protocol.write_at_once([FRAMES_OFF, *region, *again])
        self._written.update({_address(write): write.value for write in region})

    def _write_each(self, protocol: Protocol, writes: Sequence[Write]) -> None:
        for write in writes:
            # A request that failed may or may not have been obeyed.
            self._written.pop(_address(write), None)
            protocol.write(*write)
            self._written[_address(write)] = write.value
