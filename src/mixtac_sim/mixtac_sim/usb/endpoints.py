# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The USB side of the virtual camera: descriptors and control requests.

The descriptors are copied from the camera and never imported from the driver: they are its oracle.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final

from mixtac_sim.usb.faults import UsbStall
from mixtac_sim.usb.registers import RegisterFile

VENDOR_ID: Final = 0x152A
PRODUCT_ID: Final = 0x841A
FIRMWARE: Final = 0x0006
DATA_ENDPOINT: Final = 0x82
DEBUG_ENDPOINT: Final = 0x81


def serial_number(device_seed: int) -> str:
    """Return the eight-character serial number of the virtual camera with this seed."""
    return f'V{device_seed % 10**7:07d}'


def _fields(names: str, *values: int) -> Mapping[str, int]:
    return MappingProxyType(dict(zip(names.split(), values, strict=True)))


DEVICE: Final = _fields(
    'bLength bDescriptorType bcdUSB bDeviceClass bDeviceSubClass bDeviceProtocol bMaxPacketSize0 '
    'idVendor idProduct bcdDevice iManufacturer iProduct iSerialNumber bNumConfigurations',
    *(18, 1, 0x0300, 0, 0, 0, 9, VENDOR_ID, PRODUCT_ID, FIRMWARE, 1, 2, 3, 1),
)
"""The device descriptor, under the names of the USB specification like those below."""
CONFIGURATION: Final = _fields(
    'bLength bDescriptorType wTotalLength bNumInterfaces bConfigurationValue iConfiguration '
    'bmAttributes bMaxPower',
    *(9, 2, 44, 1, 1, 0, 0x80, 50),
)
"""The only configuration."""
INTERFACE: Final = _fields(
    'bLength bDescriptorType bInterfaceNumber bAlternateSetting bNumEndpoints bInterfaceClass '
    'bInterfaceSubClass bInterfaceProtocol iInterface',
    *(9, 4, 0, 0, 2, 0xFF, 0, 0, 0),
)
"""Its only interface."""
ENDPOINTS: Final = tuple(
    _fields('bLength bDescriptorType bEndpointAddress bmAttributes wMaxPacketSize bInterval', *each)
    for each in ((7, 5, DATA_ENDPOINT, 2, 1024, 0), (7, 5, DEBUG_ENDPOINT, 3, 64, 1))
)
"""Its endpoints."""
# SuperSpeed endpoints carry a companion descriptor each; kernels and libusb skip it by its length.
_COMPANION: Final = struct.pack('<BBBBH', 6, 0x30, 0, 0, 0)


def descriptor(kind: int, index: int, serial: str) -> bytes | None:
    """Return a descriptor as a host reads it, None if there is none.

    Args:
        kind: 1 the device, 2 the configuration with all that belongs to it, 3 a string.
        index: Number of the string; 0 lists the languages.
        serial: Serial number, the third string.
    """
    texts = ('', 'iniVation', 'DAVIS346', serial)
    if kind == 1:
        return struct.pack('<BBHBBBBHHHBBBB', *DEVICE.values())
    if kind == 2 and index == 0:
        data = struct.pack('<BBHBBBBB', *CONFIGURATION.values())
        data += struct.pack('<BBBBBBBBB', *INTERFACE.values())
        packed = (struct.pack('<BBBBHB', *each.values()) for each in ENDPOINTS)
        return data + b''.join(each + _COMPANION for each in packed)
    if kind == 3 and index < len(texts):
        text = texts[index].encode('utf-16-le') if index else struct.pack('<H', 0x0409)
        return bytes((len(text) + 2, 3)) + text
    return None


REQUEST_REGISTER: Final = 0xBF
REQUEST_REGISTERS: Final = 0xC2
_VENDOR_OUT: Final = 0x40
_VENDOR_IN: Final = 0xC0
_TYPE_MASK: Final = 0x60
_VALUE: Final = struct.Struct('>I')
_ENTRY: Final = struct.Struct('>BBI')
# Standard requests (USB 3.0, table 9-4).
_CLEAR_FEATURE: Final = 1
_GET_DESCRIPTOR: Final = 6
_GET_CONFIGURATION: Final = 8
_SET_CONFIGURATION: Final = 9


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
        if (request_type, request) == (_VENDOR_IN, REQUEST_REGISTER):
            answer = _VALUE.pack(self._registers.read(value, index))
        elif not request_type & _TYPE_MASK and request == _GET_DESCRIPTOR:
            answer = descriptor(value >> 8, value & 0xFF, self._serial)
        elif not request_type & _TYPE_MASK and request == _GET_CONFIGURATION:
            answer = bytes((self._configuration,))
        if answer is None:
            raise UsbStall(f'unknown request {request_type:#04x}/{request:#04x}')
        return answer

    def obey(self, request_type: int, request: int, value: int, index: int, data: bytes) -> None:
        """Carry out a request that sends data or none.

        Raises:
            UsbStall: The camera does not know the request or its data have the wrong length.
        """
        if request_type == _VENDOR_OUT:
            self._write_registers(request, value, index, data)
        elif not request_type & _TYPE_MASK and request == _SET_CONFIGURATION and value < 2:
            self._configuration = value
        elif request_type & _TYPE_MASK or request != _CLEAR_FEATURE:
            raise UsbStall(f'unknown request {request_type:#04x}/{request:#04x} with value {value}')

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
