# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A camera behind pyusb's backend interface: registers, strings, bulk data, faults on demand."""

from __future__ import annotations

import errno
import queue
import struct
import threading
from types import SimpleNamespace

import usb.backend
from usb.core import USBError, USBTimeoutError

REGISTERS = {
    (6, 0): 18, (6, 1): 5, (6, 2): 1, (6, 3): 120, (6, 4): 30, (6, 5): 80, (6, 6): 1008, (6, 7): 1,
    (1, 0): 260, (1, 1): 346, (1, 2): 4, (2, 0): 260, (2, 1): 346, (2, 2): 4,
    (2, 3): 0, (3, 0): 2, (3, 1): 0, (1, 30): 1, (1, 50): 1, (4, 10): 1,
}  # fmt: skip


class FakeCamera:
    """One camera: what it was asked, and what it will send."""

    def __init__(self, serial='00000123', bcd_device=0x0006, registers=()):
        self.serial = serial
        self.bcd_device = bcd_device
        self.registers = {**REGISTERS, **dict(registers)}
        self.log = []
        self.data = queue.Queue()
        self.configuration = 1
        self.claimed = False
        self.answers_reset = True
        self.error = None
        self.refused = set()
        self.open_error = None
        self.bulk_errors = queue.Queue()
        self.handles = 0
        self.lock = threading.Lock()

    def send(self, words):
        self.data.put(struct.pack(f'<{len(words)}H', *words))

    def writes(self):
        return [entry[1:] for entry in self.log if entry[0] == 'write']

    def control(self, kind, request, value, index, data):
        if self.error:
            raise self.error
        if (kind, request, value >> 8) == (0x80, 6, 3):
            return self.string(value & 0xFF)
        with self.lock:
            if (kind, request) == (0xC0, 0xBF):
                self.log.append(('read', value, index))
                return struct.pack('>I', self.registers.get((value, index), 0))
            if (kind, request) == (0x40, 0xBF):
                self.write(value, index, struct.unpack('>I', data)[0])
                return b''
            if (kind, request) == (0x40, 0xC2):
                assert len(data) == 6 * value
                self.log.append(('many', value))
                for module, param, number in struct.iter_unpack('>BBI', data):
                    self.write(module, param, number)
                return b''
        raise USBError('stall', -9, errno.EPIPE)

    def write(self, module, param, value):
        if (module, param) in self.refused:
            raise USBError('stall', -9, errno.EPIPE)
        self.log.append(('write', module, param, value))
        before = self.registers.get((module, param), 0)
        self.registers[module, param] = value
        if (module, param) == (0, 2) and before and not value and self.answers_reset:
            self.send([1])

    def string(self, index):
        text = {0: b'\x09\x04', 3: self.serial.encode('utf-16-le')}[index]
        return bytes([2 + len(text), 3]) + text

    def bulk(self, length, timeout_ms):
        if self.error:
            raise self.error
        if not self.bulk_errors.empty():
            raise self.bulk_errors.get()
        try:
            data = self.data.get(timeout=timeout_ms / 1000)
        except queue.Empty:
            if self.error:
                raise self.error from None
            raise USBTimeoutError('timeout', -7, errno.ETIMEDOUT) from None
        assert len(data) <= length
        return data

    def unplug(self):
        self.error = USBError('no device', -4, errno.ENODEV)


class FakeBackend(usb.backend.IBackend):
    """Shows cameras to pyusb."""

    def __init__(self, *cameras):
        self.cameras = cameras

    def enumerate_devices(self):
        return iter(self.cameras)

    def get_parent(self, dev):
        return None

    def get_device_descriptor(self, dev):
        return SimpleNamespace(
            bcdUSB=0x300, bDeviceClass=0, bDeviceSubClass=0, bDeviceProtocol=0, bMaxPacketSize0=9,
            idVendor=0x152A, idProduct=0x841A, bcdDevice=dev.bcd_device, iManufacturer=1,
            iProduct=2, iSerialNumber=3, bNumConfigurations=1, bus=1, address=1, port_number=1,
            port_numbers=(1,), speed=4, bLength=18, bDescriptorType=1,
        )  # fmt: skip

    def _descriptor(self, *indices):
        """Return the fields of configuration, interface and endpoint, the only ones there are."""
        if any(indices):
            raise IndexError(indices)
        return SimpleNamespace(
            bLength=9, wTotalLength=25, bNumInterfaces=1, bConfigurationValue=1, iConfiguration=0,
            bMaxPower=50, bInterfaceNumber=0, bAlternateSetting=0, bNumEndpoints=1,
            bInterfaceClass=255, bInterfaceSubClass=0, bInterfaceProtocol=0, iInterface=0,
            bDescriptorType=2, bEndpointAddress=0x82, bmAttributes=2, wMaxPacketSize=1024,
            bInterval=0, bRefresh=0, bSynchAddress=0, extra_descriptors=[],
        )  # fmt: skip

    def get_configuration_descriptor(self, dev, config):
        return self._descriptor(config)

    def get_interface_descriptor(self, dev, *indices):
        return self._descriptor(*indices)

    get_endpoint_descriptor = get_interface_descriptor

    def open_device(self, dev):
        if dev.open_error:
            raise dev.open_error
        dev.handles += 1
        return dev

    def close_device(self, handle):
        handle.handles -= 1

    def get_configuration(self, handle):
        return handle.configuration

    def set_configuration(self, handle, value):
        handle.log.append(('configuration', value))
        handle.configuration = value

    def claim_interface(self, handle, intf):
        if handle.claimed:
            raise USBError('busy', -6, errno.EBUSY)
        handle.claimed = True

    def release_interface(self, handle, intf):
        handle.claimed = False
        if handle.error:
            raise handle.error

    def clear_halt(self, handle, ep):
        handle.log.append(('clear_halt', ep))

    def ctrl_transfer(self, handle, kind, request, value, index, data, timeout):
        if kind & 0x80:
            answer = handle.control(kind, request, value, index, len(data))[: len(data)]
            memoryview(data)[: len(answer)] = answer
            return len(answer)
        handle.control(kind, request, value, index, bytes(data))
        return len(data)

    def bulk_read(self, handle, ep, intf, buff, timeout):
        assert ep == 0x82
        data = handle.bulk(len(buff), timeout)
        memoryview(buff)[: len(data)] = data
        return len(data)
