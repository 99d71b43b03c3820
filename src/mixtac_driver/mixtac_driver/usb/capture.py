# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Captures of what a camera and its host said to each other over USB: control requests and data.

A capture is a pcap file of Linux' USB monitor (link type 220, LINKTYPE_USB_LINUX_MMAPPED;
Documentation/usb/usbmon.rst), so Wireshark shows it, and one that `tcpdump -i usbmonN` wrote beside
another driver of the same camera is read as well. A control request is a submission with its set-up
packet and a completion with its answer; a read of the data endpoint is a completion.
"""

from __future__ import annotations

import contextlib
import errno
import struct
import threading
import time
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray
from usb.core import USBError

from mixtac_driver.usb.protocol import REQUEST_ONE, VENDOR_IN
from mixtac_recordings.recording import RecordingError

DATA_ENDPOINT = 0x82
LINK_TYPES = {189: 48, 220: 64}
"""Length of the header of a packet by link type; the shorter one is the beginning of the other."""
FILE = struct.Struct('<IHHiIII')
MAGICS = {0xA1B2C3D4: 1000, 0xA1B23C4D: 1}
"""Nanoseconds per unit of the second number of a stamp, by the first word of the file."""
PACKET = struct.Struct('<IIII')
HEADER = struct.Struct('<QBBBBHBBqiiII8s')
TAIL = struct.Struct('<iiII')
SETUP = struct.Struct('<BBHHH')
SUBMISSION, COMPLETION = ord('S'), ord('C')
CONTROL, BULK = 2, 3
PRESENT, ABSENT = 0, ord('-')
LARGEST_PACKET = 1 << 24
LARGEST_CAPTURE = 1 << 30
GET_DESCRIPTOR = (0x80, 6)
DEVICE, CONFIGURATION, STRING = 1, 2, 3
SERIAL = STRING << 8 | 3
ENGLISH = 0x0409
MEMBER = 'capture.pcap'
"""Name of the capture in a bundle of `mixtac doctor --bundle`."""


class Request(NamedTuple):
    """A control request.

    Attributes:
        time_ns: When it was made [ns since the Unix epoch].
        kind: bmRequestType.
        number: bRequest.
        value: wValue.
        w_index: wIndex.
        data: Bytes sent or received.
        status: 0, or the error number of a refusal.
    """

    time_ns: int
    kind: int
    number: int
    value: int
    w_index: int
    data: bytes
    status: int = 0


class Arrival(NamedTuple):
    """Data of one read: when they came [ns since the Unix epoch], and the bytes."""

    time_ns: int
    data: bytes


@dataclass(frozen=True)
class Capture:
    """What was captured.

    Attributes:
        requests: Control requests in order.
        arrivals: Data in order.
        missing: Bytes of data that the program that captured them cut off.
    """

    requests: tuple[Request, ...]
    arrivals: tuple[Arrival, ...]
    missing: int = 0

    @cached_property
    def words(self) -> NDArray[np.uint16]:
        """All stream words, `uint16`."""
        data = b''.join(arrival.data for arrival in self.arrivals)
        return np.frombuffer(data[: len(data) // 2 * 2], '<u2')

    def registers(self) -> dict[tuple[int, int], int]:
        """Return the first value that was read of each register, by module and parameter."""
        found: dict[tuple[int, int], int] = {}
        for r in self.requests:
            if (r.kind, r.number, r.status) == (VENDOR_IN, REQUEST_ONE, 0) and len(r.data) == 4:
                found.setdefault((r.value, r.w_index), int.from_bytes(r.data, 'big'))
        return found

    def descriptors(self) -> dict[int, bytes]:
        """Return the descriptors that were read, by type times 256 plus index; longest answers."""
        found: dict[int, bytes] = {}
        for r in self.requests:
            known = found.get(r.value, b'')
            if (r.kind, r.number, r.status) == (*GET_DESCRIPTOR, 0) and len(r.data) > len(known):
                found[r.value] = r.data
        return found


class CaptureWriter:
    """Writes a capture; may be used from several threads.

    Args:
        file: Where to write; stays open.
        rename: Returns what to write instead of the serial number of the camera.

    Attributes:
        counts: Packets written, by `requests` and `arrivals`, and `bytes` of data.
    """

    def __init__(self, file: BinaryIO, rename: Callable[[str], str] | None = None) -> None:
        self.counts: Counter[str] = Counter()
        self._file, self._rename = file, rename
        self._lock = threading.Lock()
        self._number = 0
        file.write(FILE.pack(0xA1B2C3D4, 2, 4, 0, 0, LARGEST_PACKET, 220))

    def request(self, request: Request) -> None:
        """Write a control request and its completion."""
        incoming = bool(request.kind & 0x80)
        setup = SETUP.pack(*request[1:5], len(request.data))
        sent, received = (b'', request.data) if incoming else (request.data, b'')
        with self._lock:
            self.counts['requests'] += 1
            self._number += 1
            stamp_ns = request.time_ns
            self._put(SUBMISSION, CONTROL, request.kind & 0x80, stamp_ns, sent, setup=setup)
            self._put(
                *(COMPLETION, CONTROL, request.kind & 0x80, stamp_ns, received),
                status=-request.status,
            )

    def arrival(self, data: bytes, arrival_ns: int) -> None:
        """Write the data of a read of the data endpoint.

        Args:
            data: Bytes.
            arrival_ns: When they came [ns since the Unix epoch].
        """
        with self._lock:
            self.counts['arrivals'] += 1
            self.counts['bytes'] += len(data)
            self._number += 1
            self._put(COMPLETION, BULK, DATA_ENDPOINT, arrival_ns, data)

    def describe(self, device: Any, serial: str) -> None:  # noqa: ANN401
        """Write the descriptors of a `usb.core.Device`, as far as it answers.

        Args:
            device: An open device.
            serial: Its serial number.
        """
        serial = self._rename(serial) if self._rename else serial
        texts = ((STRING << 8 | k, 255, ENGLISH) for k in (1, 2))
        wanted = (DEVICE << 8, 18, 0), (CONFIGURATION << 8, 4096, 0), *texts
        for value, size, index in wanted:
            with contextlib.suppress(USBError):
                answer = bytes(device.ctrl_transfer(*GET_DESCRIPTOR, value, index, size))
                self.request(Request(time.time_ns(), *GET_DESCRIPTOR, value, index, answer))
        text = string_descriptor(serial)
        self.request(Request(time.time_ns(), *GET_DESCRIPTOR, SERIAL, ENGLISH, text))

    def _put(
        self,
        event: int,
        kind: int,
        endpoint: int,
        stamp_ns: int,
        data: bytes,
        *,
        setup: bytes = bytes(8),
        status: int = 0,
    ) -> None:
        seconds, fraction_us = divmod(stamp_ns // 1000, 1_000_000)
        shown = PRESENT if event == SUBMISSION else ABSENT
        header = HEADER.pack(
            *(self._number, event, kind, endpoint, 1, 1, shown, PRESENT if data else ord('<')),
            *(seconds, fraction_us, status, len(data), len(data), setup),
        )
        packet = header + TAIL.pack(0, 0, 0, 0) + data
        self._file.write(PACKET.pack(seconds, fraction_us, len(packet), len(packet)) + packet)


def string_descriptor(text: str) -> bytes:
    """Return a USB string descriptor."""
    data = text.encode('utf-16-le')[:252]
    return bytes((len(data) + 2, STRING)) + data


class TappedDevice:
    """A `usb.core.Device` whose control requests are captured.

    Args:
        device: The device.
        capture: Where they go.
    """

    def __init__(self, device: Any, capture: CaptureWriter) -> None:  # noqa: ANN401
        self._device, self._capture = device, capture

    def ctrl_transfer(
        self, kind: int, number: int, value: int, index: int, data: bytes | int, timeout_ms: int
    ) -> Any:  # noqa: ANN401
        """Make a control request, as `usb.core.Device.ctrl_transfer`."""
        sent = b'' if isinstance(data, int) else bytes(data)
        made = time.time_ns(), kind, number, value, index
        try:
            answer = self._device.ctrl_transfer(kind, number, value, index, data, timeout_ms)
        except USBError as error:
            self._capture.request(Request(*made, sent, error.errno or errno.EIO))
            raise
        self._capture.request(Request(*made, bytes(answer) if isinstance(data, int) else sent))
        return answer


def read_capture(path: Path) -> Capture:
    """Return the capture in a pcap file, or in a bundle of `mixtac doctor --bundle`.

    Raises:
        RecordingError: It cannot be read, or shows no camera.
    """
    try:
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as bundle:
                if bundle.getinfo(MEMBER).file_size > LARGEST_CAPTURE:
                    raise RecordingError(f'{path}: its capture has more than 1 GiB')
                data = bundle.read(MEMBER)
        else:
            if path.stat().st_size > LARGEST_CAPTURE:
                raise RecordingError(f'{path} has more than 1 GiB', remedy='capture less')
            data = path.read_bytes()
    except KeyError as error:
        raise RecordingError(
            f'{path} is not a bundle: it holds no {MEMBER}', remedy='use mixtac doctor --bundle'
        ) from error
    # Archives that are encrypted or packed in another way: RuntimeError.
    except (OSError, zipfile.BadZipFile, EOFError, RuntimeError, zlib.error) as error:
        raise RecordingError(f'cannot read {path}: {error}') from error
    return _parse(data, path)


@dataclass
class _Device:
    """What one device of the bus said."""

    requests: list[Request] = field(default_factory=list)
    arrivals: list[Arrival] = field(default_factory=list)
    pending: dict[int, Request] = field(default_factory=dict)
    missing: int = 0


def _parse(data: bytes, path: Path) -> Capture:
    devices: dict[tuple[int, int], _Device] = {}
    for stamp_ns, fields, payload in _packets(data, path):
        number, event, kind, endpoint, address, bus, shown, *_ = fields
        status, length, setup = fields[10], fields[11], fields[13]
        device = devices.setdefault((bus, address), _Device())
        if kind == CONTROL and event == SUBMISSION and shown == PRESENT:
            request_type, request, value, index, _ = SETUP.unpack(setup)
            made = Request(stamp_ns, request_type, request, value, index, payload)
            device.pending[number] = made
        elif kind == CONTROL and event == COMPLETION and number in device.pending:
            made = device.pending.pop(number)
            answer = payload if made.kind & 0x80 else made.data
            device.requests.append(made._replace(data=answer, status=-status))
        elif (kind, event, endpoint) == (BULK, COMPLETION, DATA_ENDPOINT) and length:
            device.missing += max(length - len(payload), 0)
            device.arrivals.append(Arrival(stamp_ns, payload))
    if not devices:
        raise RecordingError(f'{path} holds no USB traffic')
    # A monitor shows the whole bus: the camera is the one that sends most.
    most = max(devices.values(), key=lambda each: sum(len(a.data) for a in each.arrivals))
    return Capture(tuple(most.requests), tuple(most.arrivals), most.missing)


def _packets(data: bytes, path: Path) -> Iterator[tuple[int, tuple[Any, ...], bytes]]:
    """Yield stamp [ns since the Unix epoch], header fields and payload of each whole packet."""
    if len(data) < FILE.size or FILE.unpack_from(data)[0] not in MAGICS:
        raise RecordingError(
            f'{path} is not a pcap file', remedy='convert others with editcap -F pcap'
        )
    magic, *_, link = FILE.unpack_from(data)
    if link not in LINK_TYPES:
        raise RecordingError(
            f'{path} is no capture of USB (link type {link})', remedy='capture usbmonN'
        )
    at, skip = FILE.size, LINK_TYPES[link]
    while at + PACKET.size <= len(data):
        seconds, fraction, size, _ = PACKET.unpack_from(data, at)
        at += PACKET.size
        # A packet that was cut is the end: its program was killed.
        if size > LARGEST_PACKET or at + size > len(data):
            return
        if size >= skip:
            stamp_ns = seconds * 1_000_000_000 + fraction * MAGICS[magic]
            yield stamp_ns, HEADER.unpack_from(data, at), data[at + skip : at + size]
        at += size
