# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The DAVIS346 as an object: open it, start it, and iterate over batches of decoded data."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mixtac_driver.clock import ClockEpochs
from mixtac_driver.davis346.control import CameraControl
from mixtac_driver.davis346.identity import Identity, read_identity, read_is_master
from mixtac_driver.davis346.settings import Configuration
from mixtac_driver.decode.decoder import DEFAULT_CAPACITY, StreamDecoder
from mixtac_driver.errors import DriverError, StreamError
from mixtac_driver.usb.device import DATA_ENDPOINT, Connection, attached_cameras
from mixtac_driver.usb.libusb import AsynchronousReader
from mixtac_driver.usb.transport import (
    BulkReader,
    DebugMessage,
    DebugReader,
    Transfer,
    TransportCounters,
)
from mixtac_events.clock_map import ClockMap

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import TracebackType

    from mixtac_driver.clock import Origin
    from mixtac_driver.decode.state import DecoderCounters
    from mixtac_events.readings import DecodedBatch


@dataclass(frozen=True, slots=True)
class StreamSettings:
    """How data are taken from the camera.

    Attributes:
        transfers: Reads that wait at the endpoint at once, where the backend can do that.
        transfer_size: Bytes asked for per read.
        queue_size: Bytes that may wait to be decoded, besides those in the transfers.
        event_capacity: Events per batch.
        silence_s: Time without any data [s] after which the stream counts as dead; a running
            camera sends time wraps every 33 ms.
        confirmation_s: Time [s] within which the camera has to confirm the reset of its clock.
    """

    transfers: int = 128
    transfer_size: int = 65536
    queue_size: int = 32 << 20
    event_capacity: int = DEFAULT_CAPACITY
    silence_s: float = 3.0
    confirmation_s: float = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class CameraBatch:
    """A stretch of what the camera saw.

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


Reader = AsynchronousReader | BulkReader
"""What reads the data endpoint."""


def make_reader(
    connection: Connection, settings: StreamSettings, now_ns: Callable[[], int]
) -> Reader:
    """Return a reader of a camera's data: asynchronous through libusb, else one read at a time.

    Args:
        connection: The open camera.
        settings: How data are taken.
        now_ns: Host clock [ns since the Unix epoch].
    """
    port = connection.libusb_port()
    if port is not None:
        return AsynchronousReader(
            port,
            DATA_ENDPOINT,
            connection.clear_halt,
            transfers=settings.transfers,
            transfer_size=settings.transfer_size,
            queue_size=settings.queue_size,
            now_ns=now_ns,
        )
    return BulkReader(
        connection.read_data,
        connection.clear_halt,
        transfer_size=settings.transfer_size,
        now_ns=now_ns,
    )


POLL_S = 0.1


class Davis346:
    """A DAVIS346 camera, as a context manager that opens and closes it.

    `batches` is for one thread; everything else may be used from others too.

    Args:
        device: Device string (see `mixtac_driver.usb.device`).
        serial: Serial number, or empty for the only camera.
        configuration: Settings.
        stream: How data are taken.
        on_debug: Called, in a thread of its own, with messages of the camera's USB controller.
        backend: A pyusb backend to use instead of the one that `device` names.
        now_ns: Host clock [ns since the Unix epoch].

    Attributes:
        control: Settings and requests; usable from any thread, open or not.
        clock: Map from the camera's clock [us since its reset] to the host's.
        is_master: True where the camera runs on its own clock, not on one from the sync cable.
    """

    def __init__(
        self,
        device: str = 'davis346',
        *,
        serial: str = '',
        configuration: Configuration | None = None,
        stream: StreamSettings | None = None,
        on_debug: Callable[[DebugMessage], None] | None = None,
        backend: Any = None,  # noqa: ANN401
        now_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self.clock = ClockMap()
        self.is_master = True
        self._device, self._serial, self._backend = device, serial, backend
        self.control = CameraControl(configuration or Configuration(), now_ns)
        self._stream = stream or StreamSettings()
        self._now_ns = now_ns
        self._stopping = threading.Event()
        self._connection: Connection | None = None
        self._identity: Identity | None = None
        self._reader: Reader | None = None
        self._on_debug = on_debug
        self._debug_reader: DebugReader | None = None
        self._decoder: StreamDecoder | None = None
        self._epochs: ClockEpochs | None = None

    def __enter__(self) -> Davis346:
        """Open the camera."""
        self.open()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Stop and close the camera."""
        self.close()

    @property
    def identity(self) -> Identity:
        """What the camera is.

        Raises:
            DriverError: It was not opened.
        """
        if self._identity is None:
            raise DriverError('the camera is not open: call open() or use it in a with statement')
        return self._identity

    @property
    def known_identity(self) -> Identity | None:
        """What the camera is, or was when last open; None before."""
        return self._identity

    @property
    def is_open(self) -> bool:
        """True between `open` and `close`."""
        return self._connection is not None

    def attached(self) -> frozenset[tuple[int, int]]:
        """Return bus and address of every camera that could be opened."""
        return attached_cameras(self._device, self._backend)

    @property
    def origin(self) -> Origin | None:
        """Host time at which the camera's clock read zero; None before it said so."""
        return self._epochs.origin if self._epochs else None

    @property
    def clock_resets(self) -> int:
        """Resets of the camera's clock since the start that this driver did not ask for."""
        return self._epochs.unasked if self._epochs else 0

    @property
    def transport_counters(self) -> TransportCounters:
        """What the USB reader did since the start."""
        return self._reader.counters if self._reader else TransportCounters()

    @property
    def decoder_counters(self) -> DecoderCounters | None:
        """What the decoder saw and dropped since the start; None before it."""
        return self._decoder.counters if self._decoder else None

    def open(self) -> None:
        """Find, claim, identify and configure the camera.

        Raises:
            UnknownDeviceError: Nothing is known by that device string.
            NoCameraError: No such camera is attached.
            UnsupportedCameraError: It is none that this driver speaks to.
            UsbError: A request failed.
        """
        known = self._identity.serial if self._identity else ''
        connection = Connection(self._device, self._serial, self._backend, known)
        try:
            self._identity = read_identity(
                connection.protocol, bcd_device=connection.bcd_device, serial=connection.serial
            )
            self.is_master = self._identity.is_master
            self.control.attach(connection.protocol, self._identity)
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
        identity, connection = self.identity, self._opened()
        self._stopping.clear()
        self.clock.restart()
        self._decoder = StreamDecoder(
            identity.geometry,
            imu_flips=identity.imu_flips,
            imu_type=identity.imu_type,
            capacity=self._stream.event_capacity,
        )
        reader = self._reader = make_reader(connection, self._stream, self._now_ns)
        self._listen(connection)

        def begin_reading() -> None:
            connection.clear_halt()
            reader.start()

        asked = self.control.start(begin_reading)
        latest_us = self._epochs.latest_us if self._epochs else 0
        delay_us = self.control.configuration.early_packet_delay_us
        self._epochs = ClockEpochs(asked, delay_us, latest_us)

    def batches(self) -> Iterator[CameraBatch]:
        """Yield what the camera sees from the reset of its clock on, until it is stopped.

        Raises:
            UsbError: The camera went away, or does not answer any more.
            StreamError: No data came for too long, or the reset was not confirmed.
        """
        reader, deadline_s = self._reader, time.monotonic() + self._stream.confirmation_s
        heard_s, connection = time.monotonic(), self._connection
        while reader is not None and connection is not None and not self._stopping.is_set():
            connection.check()
            transfer = reader.get(POLL_S)
            now_s = time.monotonic()
            if transfer is not None:
                heard_s = now_s
                yield from self._decode(transfer)
            elif now_s - heard_s > self._stream.silence_s and not self._stopping.is_set():
                raise StreamError(
                    f'no data for {self._stream.silence_s:g} s: the stream died; '
                    'check the cable and the power of the USB port'
                )
            if self.origin is None and now_s > deadline_s:
                raise StreamError(
                    'the camera did not confirm the reset of its clock within '
                    f'{self._stream.confirmation_s:g} s; plug it anew'
                )

    def apply(self, configuration: Configuration) -> None:
        """Change settings, at once while the camera is open, else when it is opened.

        Raises:
            ConfigurationError: A setting is out of range; nothing was changed.
            UsbError: A request failed.
        """
        self.control.apply(configuration)

    def reset_timestamps(self) -> None:
        """Set the camera's clock to zero; published time goes on.

        Raises:
            UsbError: The request failed.
            DriverError: The camera does not stream.
        """
        epochs = self._epochs
        if epochs is None or epochs.origin is None:
            raise DriverError('the camera does not stream yet: reset its clock when it does')
        epochs.ask(self.control.reset_timestamps)

    def request_stop(self) -> None:
        """Make `batches` end soon; returns at once."""
        self._stopping.set()

    def stop(self) -> None:
        """Stop streaming.

        Raises:
            UsbError: A request failed, as it does when the camera is gone.
            StreamError: The read in progress does not return.
        """
        self.request_stop()
        debug_reader, self._debug_reader = self._debug_reader, None
        if debug_reader is not None:
            debug_reader.stop()
        reader = self._reader
        if reader is not None and self._connection is not None:
            self.control.stop(reader.stop)

    def close(self) -> None:
        """Stop if need be and give the camera back; harmless when it is gone."""
        try:
            self.stop()
        except DriverError:
            # Gone or stuck: it cannot be told to stop, and the handle below is given back.
            self.request_stop()
        self.control.detach()
        connection, self._connection = self._connection, None
        self._reader = None
        if connection is not None:
            connection.close()

    def _opened(self) -> Connection:
        if self._connection is None:
            raise DriverError('the camera is closed: call open() first')
        return self._connection

    def _listen(self, connection: Connection) -> None:
        if self._on_debug is not None and self._debug_reader is None:
            self._debug_reader = DebugReader(connection.read_debug, self._on_debug)
            self._debug_reader.start()

    def _decode(self, transfer: Transfer) -> Iterator[CameraBatch]:
        decoder, epochs = self._decoder, self._epochs
        if decoder is None or epochs is None:
            return
        if transfer.gap.size:
            decoder.skip(transfer.gap)
        origin_before = epochs.origin
        for batch in decoder.push(transfer.data, short_packet=transfer.short_packet):
            origin = epochs.follow(batch.resets, batch.time_us, transfer.arrival_ns)
            if origin is not None:
                yield CameraBatch(batch, origin, transfer.arrival_ns)
        if origin_before is not None and epochs.origin is not origin_before:
            self.clock.restart()
            # Resets may come over the synchronisation cable: who leads may just have changed.
            self.is_master = read_is_master(self._opened().protocol)
        if epochs.origin is not None:
            self.clock.add(decoder.time_us, transfer.arrival_ns)
