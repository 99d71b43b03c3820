# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A captured camera as a pyusb backend: it answers and sends what the real one did.

Registers read as they did then, unless the host has written them since. Data come at the pace of
the capture, with the same transfers: those before the first reset of the clock when the stream is
started, those from it on when the host resets the clock.
"""
# ruff: noqa: ARG002 - pyusb fixes the signatures

from __future__ import annotations

import errno
import struct
import threading
import time
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
from usb.backend import IBackend
from usb.core import USBError, USBTimeoutError

from mixtac_driver.davis346.model import DAVIS346
from mixtac_driver.davis346.registers import Module, Mux, Usb
from mixtac_driver.errors import EndOfStream
from mixtac_driver.usb.capture import (
    CONFIGURATION,
    DATA_ENDPOINT,
    DEVICE,
    ENGLISH,
    GET_DESCRIPTOR,
    SERIAL,
    STRING,
    Capture,
    string_descriptor,
)
from mixtac_driver.usb.protocol import REQUEST_MANY, REQUEST_ONE, VENDOR_IN, VENDOR_OUT
from mixtac_recordings.recording import RecordingError

RESET_WORD = 0x0001
RUN = ((Module.USB, Usb.RUN), (Module.MUX, Mux.TIMESTAMP_RUN), (Module.MUX, Mux.RUN))
WITHOUT_RESET_S = 0.5
"""A host that does not reset the clock gets the data so long after it started the stream [s]."""
LONGEST_SLEEP_S = 0.01
DESCRIPTOR = struct.Struct('<BBHBBBBHHHBBBB')
DESCRIPTOR_FIELDS = (
    *('bLength', 'bDescriptorType', 'bcdUSB', 'bDeviceClass', 'bDeviceSubClass'),
    *('bDeviceProtocol', 'bMaxPacketSize0', 'idVendor', 'idProduct', 'bcdDevice'),
    *('iManufacturer', 'iProduct', 'iSerialNumber', 'bNumConfigurations'),
)
FIRMWARE = 0x0006


class ReplayedCamera:
    """A camera that does what a captured one did; may be used from several threads.

    Args:
        capture: The capture.
        loop: Begin again at the first reset of the clock when all was sent.

    Raises:
        RecordingError: The capture holds no data, or not the beginning of the stream.
    """

    def __init__(self, capture: Capture, *, loop: bool = False) -> None:
        known = capture.registers()
        if not capture.arrivals or (Module.SYSTEM_INFO, 0) not in known:
            raise RecordingError(
                'the capture does not show a camera being opened and read',
                remedy='start the capture before the program that opens the camera',
            )
        self._known, self._written = known, dict[tuple[int, int], int]()
        self.descriptors = _descriptors(capture)
        self._chunks, self._first = _chunks(capture)
        self._loop, self._lock = loop, threading.Lock()
        self._position = self._offset = 0
        self._began_s = self._reset_s = 0.0

    @property
    def running(self) -> bool:
        """Whether the host has started the stream."""
        return all(self._written.get(place) for place in RUN)

    def control(self, kind: int, number: int, value: int, index: int, data: bytes | int) -> bytes:
        """Answer a control request.

        Args:
            kind: bmRequestType.
            number: bRequest.
            value: wValue.
            index: wIndex.
            data: Bytes from the host, or how many it wants.

        Raises:
            usb.core.USBError: The camera does not know the request (EPIPE).
        """
        with self._lock:
            if (kind, number) == GET_DESCRIPTOR and value in self.descriptors:
                return self.descriptors[value][: data if isinstance(data, int) else 0]
            if (kind, number) == (VENDOR_IN, REQUEST_ONE):
                place = value, index
                answer = self._written.get(place, self._known.get(place, 0))
                return answer.to_bytes(4, 'big')
            if kind == VENDOR_OUT and isinstance(data, bytes):
                if number == REQUEST_ONE and len(data) == 4:
                    self._write(value, index, int.from_bytes(data, 'big'))
                    return b''
                if number == REQUEST_MANY and len(data) == 6 * value:
                    for write in struct.iter_unpack('>BBI', data):
                        self._write(*write)
                    return b''
            if not kind & 0x60 and not kind & 0x80:
                return b''
            if not kind & 0x60:
                return bytes((1, 0))[: data if isinstance(data, int) else 0]
        raise USBError('the captured camera does not know the request', -9, errno.EPIPE)

    def read(self, endpoint: int, buffer: Any, timeout_s: float) -> int:  # noqa: ANN401
        """Read the next data when they are due; return the number of bytes.

        Args:
            endpoint: Its address; only the data endpoint sends.
            buffer: Takes the bytes of at most one captured read.
            timeout_s: Longest time to wait [s].

        Raises:
            usb.core.USBTimeoutError: None are due in time.
            EndOfStream: All were sent.
        """
        until_s = time.monotonic() + timeout_s
        while True:
            if endpoint == DATA_ENDPOINT:
                with self._lock:
                    count = self._take(memoryview(buffer).cast('B'))
                if count:
                    return count
            left_s = until_s - time.monotonic()
            if left_s <= 0:
                raise USBTimeoutError('no data in time', -7, errno.ETIMEDOUT)
            time.sleep(min(left_s, LONGEST_SLEEP_S))

    def _write(self, module: int, parameter: int, value: int) -> None:
        was_running = self.running
        self._written[module, parameter] = value
        now_s = time.monotonic()
        if self.running and not was_running:
            self._position = self._offset = 0
            self._began_s, self._reset_s = now_s, now_s + WITHOUT_RESET_S
        reset = (module, parameter) == (Module.MUX, Mux.TIMESTAMP_RESET) and value
        if reset and self._position <= self._first:
            self._reset_s = min(self._reset_s, now_s)

    def _take(self, view: memoryview) -> int:
        if not self.running:
            return 0
        if self._position == len(self._chunks):
            if not self._loop:
                raise EndOfStream('all of the capture was sent')
            self._position = self._first
            self._reset_s = time.monotonic()
        due_ns, data = self._chunks[self._position]
        start_s = self._began_s if self._position < self._first else self._reset_s
        if time.monotonic() < start_s + due_ns / 1e9:
            return 0
        count = min(len(view), len(data) - self._offset)
        view[:count] = data[self._offset : self._offset + count]
        self._offset += count
        if self._offset == len(data):
            self._position, self._offset = self._position + 1, 0
        return count


def _descriptors(capture: Capture) -> dict[int, bytes]:
    """Return the captured descriptors; a host may have had them from its kernel unseen."""
    usual = DESCRIPTOR.pack(
        *(18, 1, 0x0300, 0, 0, 0, 9, DAVIS346.vendor, DAVIS346.product, FIRMWARE, 1, 2, 3, 1)
    )
    captured = capture.descriptors()
    if len(captured.get(DEVICE << 8, b'')) < DESCRIPTOR.size:
        # Hosts may ask for the first eight bytes alone.
        captured[DEVICE << 8] = usual
    return {
        STRING << 8: bytes((4, STRING)) + struct.pack('<H', ENGLISH),
        STRING << 8 | 1: string_descriptor('iniVation'),
        STRING << 8 | 2: string_descriptor(DAVIS346.name.upper()),
        SERIAL: string_descriptor('captured'),
        **captured,
    }


def _chunks(capture: Capture) -> tuple[list[tuple[int, bytes]], int]:
    """Return (time when due [ns], data) of each transfer, and the number of the first one after.

    That is the one which begins with the first reset of the clock; times count from it, before it
    from the first transfer.
    """
    resets = np.flatnonzero(capture.words == RESET_WORD)
    cut = 2 * int(resets[0]) if len(resets) else 0
    begin_ns, chunks, first, at = capture.arrivals[0].time_ns, [], -1, 0
    for time_ns, data in capture.arrivals:
        if first < 0 and at + len(data) > cut:
            if head := data[: cut - at]:
                chunks.append((time_ns - begin_ns, head))
            data, first, begin_ns = data[cut - at :], len(chunks), time_ns  # noqa: PLW2901
        chunks.append((max(time_ns - begin_ns, 0), data))
        at += len(data)
    return chunks, max(first, 0)


class ReplayBackend(IBackend):  # type: ignore[misc]
    """A pyusb backend that finds one captured camera.

    Args:
        camera: The camera.
    """

    def __init__(self, camera: ReplayedCamera) -> None:
        self._camera = camera

    def enumerate_devices(self) -> Iterator[ReplayedCamera]:
        """Yield the camera."""
        yield self._camera

    def get_parent(self, dev: object) -> None:
        """Return None: there is no hub."""

    def get_device_descriptor(self, dev: object) -> SimpleNamespace:
        """Return the device descriptor."""
        values = DESCRIPTOR.unpack(self._camera.descriptors[DEVICE << 8][: DESCRIPTOR.size])
        fields = dict(zip(DESCRIPTOR_FIELDS, values, strict=True))
        where = {'bus': 0, 'address': 0, 'port_number': 0, 'port_numbers': (), 'speed': 4}
        return SimpleNamespace(**fields, **where)

    def get_configuration_descriptor(self, dev: object, config: int) -> SimpleNamespace:
        """Return the configuration; `IndexError` if there is none of this index."""
        return _only(
            config,
            bDescriptorType=CONFIGURATION,
            bNumInterfaces=1,
            bConfigurationValue=1,
            iConfiguration=0,
            bmAttributes=0x80,
            bMaxPower=50,
        )

    def get_interface_descriptor(
        self, dev: object, intf: int, alt: int, config: int
    ) -> SimpleNamespace:
        """Return the interface; `IndexError` if there is none of this index."""
        return _only(
            intf + alt + config,
            bDescriptorType=4,
            bInterfaceNumber=0,
            bAlternateSetting=0,
            bNumEndpoints=2,
        )

    def get_endpoint_descriptor(
        self, dev: object, ep: int, intf: int, alt: int, config: int
    ) -> SimpleNamespace:
        """Return an endpoint: data or debug messages."""
        address, kind, size = ((DATA_ENDPOINT, 2, 1024), (0x81, 3, 64))[ep]
        return _only(
            0, bDescriptorType=5, bEndpointAddress=address, bmAttributes=kind, wMaxPacketSize=size
        )

    def open_device(self, dev: ReplayedCamera) -> ReplayedCamera:
        """Return the camera as its own handle."""
        return dev

    def close_device(self, dev_handle: object) -> None:
        """Do nothing."""

    def get_configuration(self, dev_handle: object) -> int:
        """Return the value of the configuration."""
        return 1

    def set_configuration(self, dev_handle: object, config_value: int) -> None:
        """Do nothing."""

    def claim_interface(self, dev_handle: object, intf: int) -> None:
        """Do nothing."""

    def release_interface(self, dev_handle: object, intf: int) -> None:
        """Do nothing."""

    def clear_halt(self, dev_handle: object, ep: int) -> None:
        """Do nothing."""

    def ctrl_transfer(
        self,
        dev_handle: ReplayedCamera,
        bmRequestType: int,
        bRequest: int,
        wValue: int,
        wIndex: int,
        data: Any,  # noqa: ANN401
        timeout: int,
    ) -> int:
        """Make a control request; return the number of bytes moved."""
        view = memoryview(data).cast('B')
        incoming = bool(bmRequestType & 0x80)
        sent = len(view) if incoming else bytes(view)
        answer = dev_handle.control(bmRequestType, bRequest, wValue, wIndex, sent)
        view[: len(answer)] = answer
        return len(answer) if incoming else len(view)

    def bulk_read(
        self,
        dev_handle: ReplayedCamera,
        ep: int,
        intf: int,
        buff: Any,  # noqa: ANN401
        timeout: int,
    ) -> int:
        """Read from an endpoint; return the number of bytes."""
        return dev_handle.read(ep, buff, timeout / 1000)

    intr_read = bulk_read


def _only(index: int, **fields: int) -> SimpleNamespace:
    if index:
        raise IndexError(index)
    usual = {'bLength': 9, 'bInterval': 0, 'bRefresh': 0, 'bSynchAddress': 0, 'iInterface': 0}
    usual |= {'bInterfaceClass': 255, 'bInterfaceSubClass': 0, 'bInterfaceProtocol': 0}
    return SimpleNamespace(**{**usual, **fields}, wTotalLength=46, extra_descriptors=[])
