# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The DAVIS346 as an object: open it, start it, and iterate over batches of decoded data."""

from __future__ import annotations

import ctypes
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Any

from mixtac_core.events.clock_map import ClockMap
from mixtac_core.events.readings import DecodedBatch
from mixtac_driver.clock import ClockEpochs, Origin
from mixtac_driver.davis346.control import CameraControl, PixelFilter
from mixtac_driver.davis346.model import Identity, models_for, read_identity, read_is_master
from mixtac_driver.decode.decoder import StreamDecoder
from mixtac_driver.decode.state import DecoderCounters
from mixtac_driver.device import DATA_ENDPOINT, Connection
from mixtac_driver.errors import DriverError, HungReadError, StreamError
from mixtac_driver.parameters import DriverParameters
from mixtac_driver.usb.libusb import AsynchronousReader
from mixtac_driver.usb.transport import BulkReader, Transfer, TransportCounters


@dataclass(frozen=True, slots=True, eq=False)
class CameraBatch:
    """A stretch of the stream.

    Attributes:
        decoded: Events, frames, inertial samples and edges [us on the camera clock since its
            reset]. The events are views that the next batch overwrites.
        origin: Add `origin.us` to those times to get them on the epoch-based camera clock, which
            never goes back, not even when the camera's own clock is reset.
        arrival_ns: Host time of the transfer's arrival [ns since the Unix epoch].
    """

    decoded: DecodedBatch
    origin: Origin
    arrival_ns: int

    @property
    def time_us(self) -> int:
        """Time that the stream has reached [us, epoch-based camera clock]."""
        return self.decoded.time_us + self.origin.us


@dataclass(frozen=True)
class SourceStatus:
    """State of a source; figures are named as on `/diagnostics`.

    Attributes:
        is_open: True between `open` and `close`.
        identity: The camera, also after closing; None before it was first opened.
        clock: Map from the camera's clock [us since its reset] to the host's.
        origin: Add it to the camera's clock for published times; None before it is known.
        losses: Data lost or damaged since the start, by kind.
        figures: Everything else.
        paused: True while playback is paused.
        trouble: What is wrong although data come, or empty.
    """

    is_open: bool
    identity: Identity | None
    clock: ClockMap
    origin: Origin | None
    losses: Mapping[str, int] = field(default_factory=dict)
    figures: Mapping[str, object] = field(default_factory=dict)
    paused: bool = False
    trouble: str = ''


LONGEST_GET_S = 0.1
LONGEST_HELD_US = 2000
"""Camera time over which data are collected at most, where event packets are longer [us]."""


class Davis346:
    """A DAVIS camera, as a context manager that opens and closes it.

    `batches` is for one thread; everything else may be used from others too.

    Args:
        parameters: Device, transport and settings.
        pixel_filter: Pixels whose events the camera drops, most important first.
        backend: A pyusb backend to use instead of the one that the device string names.
        on_transfer: Called with the data of each transfer, before they are decoded.

    Attributes:
        control: Settings and requests; usable from any thread, open or not.
        clock: Map from the camera's clock [us since its reset] to the host's.
        is_master: True where the camera runs on its own clock, not on one from the sync cable.
    """

    def __init__(
        self,
        parameters: DriverParameters | None = None,
        *,
        pixel_filter: PixelFilter = (),
        backend: Any = None,  # noqa: ANN401
        on_transfer: Callable[[bytes], None] | None = None,
    ) -> None:
        self._on_transfer = on_transfer
        self._p = p = parameters or DriverParameters()
        self.clock = ClockMap()
        self.is_master = True
        self.control = CameraControl(p, pixel_filter)
        self._backend = backend
        self._stopping = threading.Event()
        self._connection: Connection | None = None
        self._identity: Identity | None = None
        # Of the latest stream; its counters stay readable after it ends.
        self._reader: AsynchronousReader | BulkReader | None = None
        self._decoder: StreamDecoder | None = None
        self._period_us = round(p.event_message_time_threshold * 1e6)
        self._due_us = 0

    def __enter__(self) -> Davis346:
        """Open the camera."""
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop and close the camera."""
        self.close()

    @property
    def identity(self) -> Identity:
        """The camera, also after closing.

        Raises:
            DriverError: It was not opened.
        """
        if self._identity is None:
            raise DriverError(
                'the camera is not open', remedy='call open() or use it in a with statement'
            )
        return self._identity

    @property
    def clock_resets(self) -> int:
        """Resets of the camera's clock since the start that this driver did not request."""
        return self.control.epochs.unasked if self.control.epochs else 0

    @property
    def transport_counters(self) -> TransportCounters:
        """Counters of the USB reader since the start."""
        return self._reader.counters if self._reader else TransportCounters()

    @property
    def decoder_counters(self) -> DecoderCounters | None:
        """Counters of the decoder since the start; None before it."""
        return self._decoder.counters if self._decoder else None

    def status(self) -> SourceStatus:
        """Return the state of the camera and its stream."""
        usb, counted = self.transport_counters, self.decoder_counters or DecoderCounters()
        return SourceStatus(
            is_open=self._connection is not None,
            identity=self._identity,
            clock=self.clock,
            origin=self.control.epochs.origin if self.control.epochs else None,
            losses={name.replace('_', ' '): n for name, n in asdict(counted).items()},
            figures={
                'usb bytes': usb.size,
                'usb stalls': usb.stalls,
                'clock resets': self.clock_resets,
                'clock master': self.is_master,
            },
        )

    def open(self) -> None:
        """Find, claim, identify and configure the camera.

        Raises:
            UnknownDeviceError: The device string names nothing known.
            NoCameraError: No such camera is attached.
            UnsupportedCameraError: The camera fits no model.
            UsbError: A request failed.
        """
        p, known = self._p, self._identity.serial if self._identity else ''
        connection = Connection(p.device, p.serial, self._backend, known)
        try:
            identity = read_identity(
                connection.protocol,
                models_for(p.device),
                bcd_device=connection.bcd_device,
                serial=connection.serial,
            )
            self._identity, self.is_master = identity, identity.is_master
            self.control.attach(connection.protocol, identity)
            self._connection = connection
        except Exception:
            connection.close()
            raise

    def start(self) -> None:
        """Start streaming and reset the camera's clock.

        Raises:
            UsbError: A request failed.
            DriverError: The camera is not open.
        """
        identity, connection = self.identity, self._connection
        if connection is None:
            raise DriverError('the camera is closed', remedy='call open() first')
        self._stopping.clear()
        self.clock.restart()
        self._due_us = 0
        decoder = StreamDecoder(
            identity.geometry, imu_flips=identity.imu_flips, imu_type=identity.imu_type
        )
        reader = self._make_reader(connection)

        def begin_reading() -> None:
            connection.clear_halt()
            reader.start()

        self._reader, self._decoder = reader, decoder
        self.control.start(begin_reading)

    def batches(self) -> Iterator[CameraBatch]:
        """Yield the data from the reset of the camera's clock on, until stopped.

        Data come together at the end of each event packet, or with a frame, or once the camera has
        fallen silent. Until shortly before that no read is made: it costs more than what it brings.

        Raises:
            UsbError: The camera went away, or no longer answers.
            StreamError: No data came for too long, or the reset was not confirmed.
        """
        reader, decoder, connection = self._reader, self._decoder, self._connection
        epochs = self.control.epochs
        if reader is None or decoder is None or connection is None or epochs is None:
            return
        exact_sleeps()
        timeout_s = self._p.stream_timeout
        started_s = heard_s = time.monotonic()
        while not self._stopping.is_set():
            connection.check()
            self._sleep()
            transfer = reader.get(LONGEST_GET_S)
            now_s = time.monotonic()
            if transfer is not None:
                heard_s = now_s
                if self._on_transfer is not None:
                    self._on_transfer(transfer.data)
                yield from self._decode(decoder, epochs, connection, transfer)
            elif decoder.waiting:
                # The end of the packet will not come soon.
                self._due_us = 0
                nothing = Transfer(b'', time.time_ns())
                yield from self._decode(decoder, epochs, connection, nothing)
            elif now_s - heard_s > timeout_s and not self._stopping.is_set():
                raise StreamError(
                    f'no data for {timeout_s:g} s: the stream died',
                    remedy='check the cable and the power of the USB port',
                )
            if epochs.origin is None and now_s > started_s + timeout_s:
                raise StreamError(
                    f'the camera did not confirm the reset of its clock within {timeout_s:g} s',
                    remedy='unplug and reconnect the camera',
                )

    def apply(self, parameters: DriverParameters, pixel_filter: PixelFilter = ()) -> None:
        """Change settings, at once while the camera is open, otherwise when it is opened.

        Args:
            parameters: Settings; device and transport stay as they are.
            pixel_filter: Pixels whose events the camera drops, most important first.

        Raises:
            ConfigurationError: A setting does not fit; nothing was changed.
            UsbError: A request failed.
        """
        self.control.apply(parameters, pixel_filter)

    def request_stop(self) -> None:
        """Make `batches` end soon; returns at once."""
        self._stopping.set()

    def stop(self) -> None:
        """Stop streaming.

        Raises:
            UsbError: A request failed, as it does when the camera is gone.
            HungReadError: A read does not return.
        """
        self.request_stop()
        if self._reader is not None and self._connection is not None:
            self.control.stop(self._reader.stop)

    def close(self) -> None:
        """Stop streaming if necessary and close the camera; harmless when it is gone.

        Raises:
            HungReadError: A read does not return: end the process.
        """
        try:
            self.stop()
        except HungReadError:
            # Closing the handle below a read could crash the process.
            raise
        except DriverError:
            # It is gone and cannot be stopped; the handle below is closed.
            self.request_stop()
        self.control.detach()
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()

    def _make_reader(self, connection: Connection) -> AsynchronousReader | BulkReader:
        """Return a reader of the data: asynchronous through libusb, else one read at a time."""
        port, clear_halt = connection.libusb_port(), connection.clear_halt
        if port is None:
            return BulkReader(partial(connection.read, DATA_ENDPOINT), clear_halt)
        transfers = self._p.usb_transfers
        return AsynchronousReader(port, DATA_ENDPOINT, clear_halt, transfers=transfers)

    def _decode(
        self,
        decoder: StreamDecoder,
        epochs: ClockEpochs,
        connection: Connection,
        transfer: Transfer,
    ) -> Iterator[CameraBatch]:
        origin_before, came, was_reset = epochs.origin, False, False
        for batch in decoder.push(transfer.data, until_us=self._due_us):
            origin = epochs.follow(batch.resets, batch.time_us, transfer.arrival_ns)
            if origin is None:
                continue
            if origin_before is not None and origin is not origin_before:
                # Before the batch: who takes it finds no map of the clock that was.
                self.clock.restart()
                was_reset = True
            origin_before = origin
            yield CameraBatch(batch, origin, transfer.arrival_ns)
            end_us = (batch.time_us + origin.us) // self._period_us * self._period_us
            held_us = min(end_us + self._period_us - origin.us - batch.time_us, LONGEST_HELD_US)
            self._due_us = batch.time_us + held_us
            came = True
        if was_reset:
            # Resets may come over the synchronisation cable: the master may have changed.
            self.is_master = read_is_master(connection.protocol)
        if came:
            self.clock.add(decoder.time_us, transfer.arrival_ns)

    def _sleep(self) -> None:
        """Sleep until the next data can have arrived."""
        if not self.clock.ready:
            return
        due_us = self._due_us
        if isinstance(self._reader, BulkReader):
            # Its only read must be waiting when data come; queued reads of libusb always are.
            due_us -= self.control.parameters.usb_early_packet_delay
        early_s = (self.clock.to_host_ns(due_us) - time.time_ns()) / 1e9
        if early_s > 0.0:
            time.sleep(min(early_s, LONGEST_HELD_US / 1e6))


_SET_TIMER_SLACK = 29
"""Number of this option of `prctl`."""
_SLACK_NS = 1000
"""Longest extension of a sleep [ns]."""


def exact_sleeps() -> None:
    """Have sleeps of the calling thread end on time: Linux lets them last up to 50 us longer."""
    if sys.platform == 'linux':
        ctypes.CDLL(None).prctl(_SET_TIMER_SLACK, _SLACK_NS, 0, 0, 0)
