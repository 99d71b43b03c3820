# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The USB descriptors of the virtual camera.

They are copied from the camera and never imported from the driver: they are its oracle.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

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
