# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""USB descriptors of the camera: device, configuration, interface, endpoints and strings."""

from __future__ import annotations

import struct
from types import SimpleNamespace
from typing import Final

VENDOR_ID: Final = 0x152A
PRODUCT_ID: Final = 0x841A
FIRMWARE: Final = 0x0006
DATA_ENDPOINT: Final = 0x82
DEBUG_ENDPOINT: Final = 0x81
MAX_SERIAL_LENGTH: Final = 8
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
    """Return the only configuration with everything that belongs to it."""
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
