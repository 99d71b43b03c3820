# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Shows a virtual camera to unmodified libusb programs as a kernel USB device, through umockdev.

Run by Debian's Python, which has gi and umockdev, under ``umockdev-wrapper``::

    umockdev-wrapper /usr/bin/python3 umockdev_bridge.py --socket PATH --wire wire.py -- CLIENT ...

It makes a test bed with one USB device, answers the usbfs requests of the client's libusb by
forwarding them to the camera's socket, runs the client and ends with its exit status.
"""

from __future__ import annotations

import argparse
import errno
import importlib.util
import socket
import struct
import subprocess
import sys
import threading
from collections import deque
from pathlib import Path

import gi

gi.require_version('UMockdev', '1.0')
from gi.repository import GLib, UMockdev  # noqa: E402

NODE = '/dev/bus/usb/001/002'
DEVICE = '/devices/pci0000:00/0000:00:14.0/usb1/1-1'
URB = struct.Struct('<BB2xiI4xQiiiiiIQ')
URB_SIZE = 56
STATUS_AT, ACTUAL_AT, BUFFER_AT = 4, 28, 16
CONTROL_URB = 2
SUBMIT, DISCARD = 0x8038550A, 0x0000550B
REAP, REAP_NO_WAIT = 0x4008550C, 0x4008550D
CAPABILITIES, GET_DRIVER, CLAIM, RELEASE = 0x8004551A, 0x41045508, 0x8004550F, 0x80045510
SET_INTERFACE, SET_CONFIGURATION, CLEAR_HALT, RESET = 0x80085504, 0x80045505, 0x80045515, 0x5514
# Zero-length packets, no packet size limit, reap after disconnect: what a plain host offers.
CAPABILITY_BITS = 0x01 | 0x04 | 0x10
POLL_MS = 10
SETTLE_S = 0.1


def load_wire(path):
    """Import the wire protocol from its file: its package needs modules Debian lacks."""
    spec = importlib.util.spec_from_file_location('wire', path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Camera:
    """One host session on the camera's socket."""

    def __init__(self, wire, path):
        self.wire = wire
        self.path = path
        self.begin()

    def begin(self):
        """Begin a session; the one before ends with its connections."""
        self.control_channel = self.connect()

    def connect(self):
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        connection.connect(self.path)
        return connection

    def call(self, connection, operation, **fields):
        """Return the kernel's status (0 or a negative errno) and the data."""
        try:
            return 0, self.wire.call(connection, operation, **fields)
        except OSError as error:
            refused = isinstance(error, self.wire.TransferError)
            number = error.errno if refused else errno.ENODEV
            if number == errno.ENODEV and connection is self.control_channel:
                # The camera was unplugged: once it is back, that is another session.
                connection.close()
                self.begin()
            return -number, b''

    def control(self, setup, data):
        kind, request, value, index, length = struct.unpack('<BBHHH', setup)
        wanted = length if kind & 0x80 else 0
        fields = (kind, request, value, index)
        sent = b'' if wanted else data[:length]
        return self.call(
            self.control_channel, self.wire.CONTROL, setup=fields, data=sent, wanted=wanted
        )


class Endpoint:
    """Serves the URBs of one IN endpoint, first come first served."""

    def __init__(self, camera, address, done):
        self.camera = camera
        self.address = address
        self.done = done
        self.changed = threading.Condition()
        self.waiting = deque()
        self.discarded = set()
        threading.Thread(target=self.serve, daemon=True).start()

    def submit(self, urb, length):
        with self.changed:
            self.waiting.append((urb, length))
            self.changed.notify()

    def discard(self, address):
        """Return whether the URB was still on its way; it then comes back as unlinked."""
        with self.changed:
            found = any(urb.client_addr == address for urb, _ in self.waiting)
            if found:
                self.discarded.add(address)
            return found

    def serve(self):
        self.connection = self.camera.connect()
        self.settle()
        while True:
            with self.changed:
                self.changed.wait_for(lambda: self.waiting)
                urb, length = self.waiting[0]
            result = self.read(urb.client_addr, length)
            if result[0] == -errno.ENODEV:
                self.connection.close()
                self.connection = self.camera.connect()
            with self.changed:
                self.waiting.popleft()
                self.discarded.discard(urb.client_addr)
                self.done.append((urb, *result))

    def settle(self):
        """Wait until the client has queued its first URBs.

        A kernel queues dozens in microseconds, before the first can complete; here each takes a
        round trip between processes, and clients that rely on the order would be confused.
        """
        with self.changed:
            count = 0
            while count != len(self.waiting) or not count:
                count = len(self.waiting)
                self.changed.wait_for(lambda: len(self.waiting) > count, SETTLE_S)  # noqa: B023

    def read(self, address, length):
        while address not in self.discarded:
            status, data = self.camera.call(
                self.connection,
                self.camera.wire.READ,
                setup=(self.address, 0, 0, 0),
                wanted=length,
                timeout_ms=POLL_MS,
            )
            if status != -errno.ETIMEDOUT:
                return status, data
        return -errno.ENOENT, b''


class UsbFs(UMockdev.IoctlBase):
    """Answers the usbfs requests of one client."""

    def __init__(self, camera):
        super().__init__()
        self.camera = camera
        self.done = deque()
        self.endpoints = {}

    def do_handle_ioctl(self, client):
        request = client.get_request() & 0xFFFFFFFF
        answer = {
            SUBMIT: self.submit,
            DISCARD: self.discard,
            REAP: self.reap,
            REAP_NO_WAIT: self.reap,
            CAPABILITIES: self.capabilities,
            GET_DRIVER: lambda _: -errno.ENODATA,
            CLAIM: lambda _: self.camera.call(self.camera.control_channel, self.camera.wire.CLAIM)[
                0
            ],
            RELEASE: lambda _: 0,
            SET_INTERFACE: lambda _: 0,
            SET_CONFIGURATION: lambda _: 0,
            CLEAR_HALT: self.clear_halt,
            RESET: lambda _: 0,
        }.get(request, lambda _: -errno.ENOTTY)
        self.complete(client, answer(client))
        return True

    def complete(self, client, result):
        if result is not None:
            client.complete(-1 if result < 0 else 0, max(0, -result))

    def capabilities(self, client):
        client.get_arg().resolve(0, 4).update(0, struct.pack('<I', CAPABILITY_BITS))
        return 0

    def clear_halt(self, client):
        (endpoint,) = struct.unpack('<I', bytes(client.get_arg().resolve(0, 4).retrieve()))
        return self.camera.control(struct.pack('<BBHHH', 0x02, 1, 0, endpoint, 0), b'')[0]

    def submit(self, client):
        urb = client.get_arg().resolve(0, URB_SIZE)
        kind, address, _, _, _, length, *_ = URB.unpack(bytes(urb.retrieve()))
        if kind != CONTROL_URB:
            if address not in self.endpoints:
                self.endpoints[address] = Endpoint(self.camera, address, self.done)
            self.endpoints[address].submit(urb, length)
            return 0
        buffer = bytes(urb.resolve(BUFFER_AT, length).retrieve())
        status, data = self.camera.control(buffer[:8], buffer[8:])
        self.done.append((urb, status, data if buffer[0] & 0x80 else length - 8))
        return 0

    def discard(self, client):
        address = struct.unpack('<Q', bytes(client.get_arg().retrieve())[:8])[0]
        found = any(endpoint.discard(address) for endpoint in self.endpoints.values())
        return 0 if found else -errno.EINVAL

    def reap(self, client):
        if not self.done:
            # Files of a test bed always poll as ready: answering at once would spin the client.
            GLib.timeout_add(1, self.reap_later, client)
            return None
        return self.deliver(client)

    def reap_later(self, client):
        self.complete(client, self.deliver(client) if self.done else -errno.EAGAIN)
        return False

    def deliver(self, client):
        urb, status, result = self.done.popleft()
        actual = result
        if isinstance(result, bytes):
            actual = len(result)
            kind, _, _, _, _, length, *_ = URB.unpack(bytes(urb.retrieve()))
            if actual:
                buffer = urb.resolve(BUFFER_AT, length)
                buffer.update(8 if kind == CONTROL_URB else 0, result)
        urb.update(STATUS_AT, struct.pack('<i', status))
        urb.update(ACTUAL_AT, struct.pack('<i', actual))
        client.get_arg().resolve(0, 8).set_ptr(0, urb)
        return 0


def describe(camera):
    """Return the text from which umockdev makes the device."""

    def get(value, index=0):
        setup = struct.pack('<BBHHH', 0x80, 6, value, index, 4096)
        return camera.control(setup, b'')[1]

    device, configuration = get(0x0100), get(0x0200)
    vendor, product, release = struct.unpack_from('<HHH', device, 8)
    texts = [get(0x0300 | k, 0x0409)[2:].decode('utf-16-le') for k in (1, 2, 3)]
    attributes = {
        'busnum': '1', 'devnum': '2', 'devpath': '1', 'speed': '5000', 'version': ' 3.00',
        'bConfigurationValue': '1', 'bNumConfigurations': '1', 'bDeviceClass': '00',
        'idVendor': f'{vendor:04x}', 'idProduct': f'{product:04x}', 'bcdDevice': f'{release:04x}',
        'manufacturer': texts[0], 'product': texts[1], 'serial': texts[2],
    }  # fmt: skip
    return '\n'.join(
        [
            f'P: {DEVICE}',
            f'N: {NODE.removeprefix("/dev/")}',
            'E: SUBSYSTEM=usb',
            'E: DEVTYPE=usb_device',
            f'E: DEVNAME={NODE}',
            'E: BUSNUM=001',
            'E: DEVNUM=002',
            'E: MAJOR=189',
            'E: MINOR=1',
            f'E: ID_SERIAL_SHORT={texts[2]}',
            *(f'A: {name}={value}\\n' for name, value in attributes.items()),
            f'H: descriptors={(device + configuration).hex()}',
            '',
            '',
        ]
    )


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument('--socket', required=True)
    parser.add_argument('--wire', required=True, type=Path)
    parser.add_argument('client', nargs='+')
    options = parser.parse_args()
    camera = Camera(load_wire(options.wire), options.socket)
    testbed = UMockdev.Testbed.new()
    testbed.add_from_string(describe(camera))
    handler = UsbFs(camera)
    testbed.attach_ioctl(NODE, handler)
    loop = GLib.MainLoop()
    client = subprocess.Popen(options.client)

    def wait():
        client.wait()
        loop.quit()

    threading.Thread(target=wait, daemon=True).start()
    loop.run()
    testbed.detach_ioctl(NODE)
    sys.exit(client.returncode)


if __name__ == '__main__':
    main()
