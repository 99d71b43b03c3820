# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Thread-safe requests to an open camera: settings, exposure, frames, clock reset, statistics."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from mixtac_core.node.parameters import specs
from mixtac_driver.clock import ClockEpochs, Origin
from mixtac_driver.davis346.model import Features, Identity
from mixtac_driver.davis346.registers import Aps, Dvs, Module, Mux, SystemInfo
from mixtac_driver.davis346.settings import CameraParameters, SensorParameters
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


@dataclass(frozen=True, slots=True)
class CameraStatistics:
    """Totals since the logic was last reset; 0 where the logic does not count.

    Attributes:
        rows: Row addresses that the pixel array gave.
        columns: Column addresses, that is events, that it gave.
        dropped: Events dropped because the buffer of the event read-out was full.
        filtered_pixels: Events dropped by the pixel filters.
        filtered_background_activity: Events dropped by the background activity filter.
        filtered_refractory: Events dropped by the refractory period filter.
        external_input_dropped: Edges dropped because the path to the host was blocked.
        dvs_dropped: Event words dropped because the path to the host was blocked.
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
        """Total of unintended drops."""
        return self.dropped + self.external_input_dropped + self.dvs_dropped


def read_statistics(protocol: Protocol, features: Features) -> CameraStatistics:
    """Read the counters that a camera has.

    Args:
        protocol: Register access.
        features: Says which blocks count.

    Raises:
        UsbError: A request failed.
    """
    wanted: list[tuple[Module, Dvs | Mux]] = []
    if features.dvs_statistics:
        registers = [Dvs.STATISTICS_ROWS, Dvs.STATISTICS_COLUMNS, Dvs.STATISTICS_DROPPED]
        if features.pixel_filter:
            registers.append(Dvs.STATISTICS_FILTERED_PIXELS)
        if features.background_activity:
            registers.append(Dvs.STATISTICS_FILTERED_BACKGROUND_ACTIVITY)
            registers.append(Dvs.STATISTICS_FILTERED_REFRACTORY)
        wanted += [(Module.DVS, register) for register in registers]
    if features.mux_statistics:
        wanted.append((Module.MUX, Mux.STATISTICS_EXTERNAL_INPUT_DROPPED))
        wanted.append((Module.MUX, Mux.STATISTICS_DVS_DROPPED))
    values = {
        register.name.removeprefix('STATISTICS_').lower(): read_64(protocol, module, register)
        for module, register in wanted
    }
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


REGION = tuple((int(Module.APS), int(register)) for register in APS_REGION)
FRAMES_ON = Write(Module.APS, Aps.RUN, 1)
FRAMES_OFF = Write(Module.APS, Aps.RUN, 0)


PixelFilter = tuple[tuple[int, int], ...]
"""(column, row) of each pixel whose events the camera drops."""
Settings = tuple['CameraParameters', PixelFilter]
_EXPOSURE = {spec.name: spec for spec in specs(SensorParameters)}['aps_exposure']


class RegisterWriter:
    """Puts settings into a camera and remembers what it wrote. For one thread at a time.

    Args:
        protocol: Register access.
        identity: The camera.

    Attributes:
        protocol: As given.
        identity: As given.
        running: True between `started` and `stopped`: the sensors follow their run bits.
    """

    def __init__(self, protocol: Protocol, identity: Identity) -> None:
        self.protocol = protocol
        self.identity = identity
        self.running = False
        self._written: dict[tuple[int, int], int] = {}

    def configure(self, settings: Settings) -> None:
        """Write all settings in the order that cameras expect; nothing is started.

        Raises:
            MixtacError: A setting is out of range (nothing was written), or a request failed.
        """
        self._write_each(self._wanted(settings))

    def started(self, run: Sequence[Write]) -> None:
        """Note that the sensors were started by these writes."""
        self._written.update({(m, p): value for m, p, value in run})
        self.running = True

    def stopped(self) -> None:
        """Note that the sensors were stopped; they start with the stream."""
        self.running = False
        for address in map(_address, STOP_WRITES):
            self._written.pop(address, None)

    def change(self, old: Settings, new: Settings) -> None:
        """Write the differences from what the camera has.

        Args:
            old: Settings so far, to return to if a request fails.
            new: Wanted settings.

        Raises:
            ConfigurationError: A setting does not fit; nothing was written.
            UsbError: A request failed; what could be was set back.
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
        exposure = cycles(exposure_us, self.identity.clocks.adc)
        self._write_changes([Write(Module.APS, Aps.EXPOSURE, exposure)])

    def request_frame(self) -> None:
        """Make a camera whose frames are off take one.

        Raises:
            UsbError: The request failed.
        """
        self.protocol.write_at_once([FRAMES_ON, FRAMES_OFF])

    def _wanted(self, settings: Settings) -> list[Write]:
        parameters, pixel_filter = settings
        wanted = register_writes(parameters, self.identity, pixel_filter)
        return wanted + run_writes(parameters, self.identity.model) if self.running else wanted

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
        self.protocol.write_at_once([FRAMES_OFF, *region, *again])
        for write in region:
            self._written[_address(write)] = write.value

    def _write_each(self, writes: Sequence[Write]) -> None:
        for write in writes:
            # A request that failed may or may not have been obeyed.
            self._written.pop(_address(write), None)
            self.protocol.write(*write)
            self._written[_address(write)] = write.value


def _address(write: Write) -> tuple[int, int]:
    return int(write.module), int(write.parameter)


class CameraControl:
    """Keeps a camera to its settings, over any number of times that it is opened.

    One request runs at a time; the others wait, except `set_exposure`.

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
        self._writer: RegisterWriter | None = None

    @property
    def parameters(self) -> CameraParameters:
        """The settings."""
        return self._settings[0]

    def attach(self, protocol: Protocol, identity: Identity) -> None:
        """Put the settings into a camera that was just opened.

        Raises:
            ConfigurationError: A setting does not fit this camera.
            UsbError: A request failed; the camera is not attached.
        """
        with self._lock:
            writer = RegisterWriter(protocol, identity)
            writer.configure(self._settings)
            self._writer = writer

    def detach(self) -> None:
        """Forget the camera; returns when no request is under way."""
        with self._lock:
            self._writer = None

    def start(self, begin_reading: Callable[[], None]) -> None:
        """Start streaming and reset the camera's clock; published time continues.

        Args:
            begin_reading: Clears the data endpoint and starts to read it.

        Raises:
            UsbError: A request failed.
            DriverError: The camera is closed.
        """
        with self._lock:
            writer = self._attached()
            run = run_writes(self.parameters, writer.identity.model)
            start_streaming(writer.protocol, run, begin_reading)
            writer.started(run)
            reset = reset_clock(writer.protocol)
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
            writer = self._attached()
            writer.stopped()
            stop_streaming(writer.protocol, end_reading)

    def apply(self, parameters: CameraParameters, pixel_filter: PixelFilter = ()) -> None:
        """Change settings, at once while the camera is open, otherwise when it is opened.

        Args:
            parameters: Settings.
            pixel_filter: Pixels whose events the camera drops, most important first.

        Raises:
            ConfigurationError: A setting does not fit; nothing was changed.
            ParameterError: A setting is out of range; nothing was changed.
            UsbError: A request failed.
        """
        parameters.check()
        with self._lock:
            wanted: Settings = parameters, pixel_filter
            if self._writer is not None:
                self._writer.change(self._settings, wanted)
            self._settings = wanted

    def set_exposure(self, exposure_us: int) -> bool:
        """Change only the exposure [us]; for control loops, because it never waits.

        Returns:
            False if the camera was busy with another request: try again later.

        Raises:
            ParameterError: It is out of range; nothing was changed.
            UsbError: The request failed.
        """
        _EXPOSURE.check(exposure_us)
        if not self._lock.acquire(blocking=False):
            return False
        try:
            if self._writer is not None:
                self._writer.set_exposure(exposure_us)
            parameters, pixel_filter = self._settings
            self._settings = replace(parameters, aps_exposure=exposure_us), pixel_filter
        finally:
            self._lock.release()
        return True

    def request_frame(self) -> None:
        """Make the camera take one frame, unless it takes frames continuously.

        Raises:
            UsbError: The request failed.
            DriverError: The camera is closed or has no frames.
        """
        with self._lock:
            writer = self._attached()
            if not writer.identity.model.has_frames:
                raise DriverError(f'a {writer.identity.model.name} has no frames')
            if not self.parameters.aps_enabled:
                writer.request_frame()

    def reset_timestamps(self) -> None:
        """Set the camera's clock to zero; published time goes on.

        Raises:
            UsbError: The request failed.
            DriverError: The camera does not stream.
        """
        epochs = self.epochs
        if epochs is None or epochs.origin is None:
            raise DriverError(
                'the camera does not stream yet', remedy='reset its clock while it streams'
            )
        epochs.ask(self._reset_clock)

    def statistics(self) -> CameraStatistics | None:
        """Return the counters of the camera itself; None while it is closed.

        Raises:
            UsbError: A request failed.
        """
        with self._lock:
            if self._writer is None:
                return None
            return read_statistics(self._writer.protocol, self._writer.identity.features)

    def registers(self) -> dict[str, int]:
        """Return the value of every register that the driver knows, by `module:parameter`.

        Raises:
            UsbError: A request failed.
            DriverError: The camera is closed.
        """
        with self._lock:
            writer = self._attached()
            addresses = [*map(_address, register_writes(self.parameters, writer.identity))]
            described = ((Module.DVS, Dvs), (Module.APS, Aps), (Module.SYSTEM_INFO, SystemInfo))
            addresses += [(module, number) for module, kind in described for number in kind]
            read = writer.protocol.read
            return {f'{int(m)}:{int(p)}': read(m, p) for m, p in sorted(set(addresses))}

    def _reset_clock(self) -> Origin:
        with self._lock:
            return reset_clock(self._attached().protocol)

    def _attached(self) -> RegisterWriter:
        if self._writer is None:
            raise DriverError('the camera is closed', remedy='call open() first')
        return self._writer
