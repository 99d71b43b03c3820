# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The USB side of the virtual camera: descriptors and control requests.

The descriptors are copied from the camera and never imported from the driver: they are its oracle.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from types import SimpleNamespace
from typing import Final

from mixtac_sim.usb.faults import UsbStall
from mixtac_sim.usb.registers import RegisterFile

VENDOR_ID: Final = 0x152A
PRODUCT_ID: Final = 0x841A
FIRMWARE: Final = 0x0006
DATA_ENDPOINT: Final = 0x82
DEBUG_ENDPOINT: Final = 0x81
_DEVICE = struct.Struct('<BBHBBBBHHHBBBB')
_CONFIGURATION = struct.Struct('<BBHBBBBB')
_INTERFACE = struct.Struct('<BBBBBBBBB')
_ENDPOINT = struct.Struct('<BBBBHB')
# SuperSpeed endpoints carry a companion descriptor each; kernels and libusb skip it by its length.
_COMPANION = struct.pack('<BBBBH', 6, 0x30, 0, 0, 0)
_STRINGS: Final = ('iniVation', 'DAVIS346')


def serial_number(device_seed: int) -> str:
    """Return the eight-character serial number of the virtual camera with this seed."""
    return f'V{device_seed % 10**7:07d}'


def device_descriptor() -> bytes:
    """Return the 18-byte device descriptor."""
    return _DEVICE.pack(18, 1, 0x0300, 0, 0, 0, 9, VENDOR_ID, PRODUCT_ID, FIRMWARE, 1, 2, 3, 1)


def configuration_descriptor() -> bytes:
    """Return the only configuration, with its interface and endpoints."""
    body = _INTERFACE.pack(9, 4, 0, 0, 2, 0xFF, 0, 0, 0)
    body += _ENDPOINT.pack(7, 5, DATA_ENDPOINT, 2, 1024, 0) + _COMPANION
    body += _ENDPOINT.pack(7, 5, DEBUG_ENDPOINT, 3, 64, 1) + _COMPANION
    return _CONFIGURATION.pack(9, 2, 9 + len(body), 1, 1, 0, 0x80, 50) + body


def string_descriptor(index: int, serial: str) -> bytes | None:
    """Return the string descriptor of this index (0 lists the languages), none if there is none."""
    if index == 0:
        return struct.pack('<BBH', 4, 3, 0x0409)
    texts = (*_STRINGS, serial)
    if index > len(texts):
        return None
    data = texts[index - 1].encode('utf-16-le')
    return bytes((len(data) + 2, 3)) + data


_DEVICE_NAMES: Final = (
    'bLength bDescriptorType bcdUSB bDeviceClass bDeviceSubClass bDeviceProtocol bMaxPacketSize0 '
    'idVendor idProduct bcdDevice iManufacturer iProduct iSerialNumber bNumConfigurations'
)
_CONFIGURATION_NAMES: Final = (
    'bLength bDescriptorType wTotalLength bNumInterfaces bConfigurationValue iConfiguration '
    'bmAttributes bMaxPower'
)
_INTERFACE_NAMES: Final = (
    'bLength bDescriptorType bInterfaceNumber bAlternateSetting bNumEndpoints bInterfaceClass '
    'bInterfaceSubClass bInterfaceProtocol iInterface'
)
_ENDPOINT_NAMES: Final = (
    'bLength bDescriptorType bEndpointAddress bmAttributes wMaxPacketSize bInterval'
)
_LAYOUTS: Final = {
    1: (_DEVICE, _DEVICE_NAMES),
    2: (_CONFIGURATION, _CONFIGURATION_NAMES),
    4: (_INTERFACE, _INTERFACE_NAMES),
    5: (_ENDPOINT, _ENDPOINT_NAMES),
}


def parse(data: bytes) -> list[SimpleNamespace]:
    """Split concatenated descriptors into those of known types (device to endpoint).

    Returns:
        One object each, its fields under their names in the USB specification.
    """
    found = []
    offset = 0
    while offset + 2 <= len(data) and data[offset] >= 2:
        known = _LAYOUTS.get(data[offset + 1])
        if known is not None:
            layout, names = known
            values = layout.unpack_from(data, offset)
            fields = dict(zip(names.split(), values, strict=True))
            found.append(SimpleNamespace(**fields, extra_descriptors=[]))
        offset += data[offset]
    return found


REQUEST_REGISTER: Final = 0xBF
REQUEST_REGISTERS: Final = 0xC2
_VENDOR_OUT: Final = 0x40
_VENDOR_IN: Final = 0xC0
_TYPE_MASK: Final = 0x60
_VALUE: Final = struct.Struct('>I')
_ENTRY: Final = struct.Struct('>BBI')
# Standard requests (USB 3.0, table 9-4).
_GET_STATUS: Final = 0
_CLEAR_FEATURE: Final = 1
_SET_FEATURE: Final = 3
_SET_ADDRESS: Final = 5
_GET_DESCRIPTOR: Final = 6
_GET_CONFIGURATION: Final = 8
_SET_CONFIGURATION: Final = 9
_GET_INTERFACE: Final = 10
_SET_INTERFACE: Final = 11
_ACCEPTED: Final = {_CLEAR_FEATURE, _SET_FEATURE, _SET_ADDRESS}


class ControlEndpoint:
    """Decodes control requests. Not thread safe: the device guards it.

    Args:
        registers: The register file.
        serial: Serial number for the string descriptor.
        on_write: Called after each register write with module, parameter, old and new value.
    """

    def __init__(
        self,
        registers: RegisterFile,
        serial: str,
        on_write: Callable[[int, int, int, int], None],
    ) -> None:
        self._registers = registers
        self._serial = serial
        self._on_write = on_write
        self._configuration = 1

    def answer(self, request_type: int, request: int, value: int, index: int) -> bytes:
        """Answer a request for data.

        Raises:
            UsbStall: The camera does not know the request.
        """
        answer: bytes | None = None
        if request_type == _VENDOR_IN and request == REQUEST_REGISTER:
            answer = _VALUE.pack(self._registers.read(value, index))
        elif not request_type & _TYPE_MASK:
            answer = self._standard_answer(request, value)
        if answer is None:
            raise UsbStall(f'unknown request {request_type:#04x}/{request:#04x}')
        return answer

    def _standard_answer(self, request: int, value: int) -> bytes | None:
        if request == _GET_DESCRIPTOR:
            return self._descriptor(value >> 8, value & 0xFF)
        fixed = {
            _GET_STATUS: b'\0\0',
            _GET_CONFIGURATION: bytes((self._configuration,)),
            _GET_INTERFACE: b'\0',
        }
        return fixed.get(request)

    def _descriptor(self, kind: int, index: int) -> bytes | None:
        if kind == 1:
            return device_descriptor()
        if kind == 2 and index == 0:
            return configuration_descriptor()
        if kind == 3:
            return string_descriptor(index, self._serial)
        return None

    def obey(self, request_type: int, request: int, value: int, index: int, data: bytes) -> None:
        """Carry out a request that sends data or none.

        Raises:
            UsbStall: The camera does not know the request or its data have the wrong length.
        """
        if request_type == _VENDOR_OUT:
            self._write_registers(request, value, index, data)
        elif request_type & _TYPE_MASK:
            raise UsbStall(f'unknown request {request_type:#04x}/{request:#04x}')
        else:
            self._standard(request, value)

    def _standard(self, request: int, value: int) -> None:
        if request == _SET_CONFIGURATION and value in {0, 1}:
            self._configuration = value
        elif request not in _ACCEPTED and not (request == _SET_INTERFACE and value == 0):
            raise UsbStall(f'the camera refuses standard request {request} with value {value}')

    def _write_registers(self, request: int, value: int, index: int, data: bytes) -> None:
        if request == REQUEST_REGISTER and len(data) == _VALUE.size:
            self._write(value, index, _VALUE.unpack(data)[0])
        elif request == REQUEST_REGISTERS and len(data) == _ENTRY.size * value:
            for module, param, setting in _ENTRY.iter_unpack(data):
                self._write(module, param, setting)
        else:
            raise UsbStall(f'the camera refuses request {request:#04x} with {len(data)} bytes')

    def _write(self, module: int, param: int, value: int) -> None:
        before = self._registers.read(module, param)
        self._registers.write(module, param, value)
        self._on_write(module, param, before, value)
