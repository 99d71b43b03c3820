# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""libcaer through ctypes, from the library that the wheel ``event-camera-drivers`` carries.

That wheel's own Python interface passes on events only. Layouts and numbers are those of libcaer's
headers ``events/*.h`` and ``devices/device.h``.
"""

from __future__ import annotations

import ctypes
import importlib.util
from dataclasses import dataclass
from pathlib import Path

import numpy as np

DAVIS = 4
DATA_EXCHANGE, PACKETS = -2, -3
BUFFER_SIZE, BLOCKING = 0, 1
MOST_EVENTS, LONGEST_INTERVAL_US = 0, 1
EXTERNAL_INPUT, DETECT_RISING, DETECT_FALLING = 4, 1, 2
KINDS = {0: 'special', 1: 'polarity', 2: 'frame', 3: 'imu'}
HEADER = np.dtype(
    [
        *(('kind', '<i2'), ('source', '<i2'), ('size', '<i4'), ('time_at', '<i4')),
        *(('overflow', '<i4'), ('capacity', '<i4'), ('number', '<i4'), ('valid', '<i4')),
    ]
)
CONTAINER = np.dtype(
    [*(('lowest', '<i8'), ('highest', '<i8'), ('events', '<i4'), ('valid', '<i4')), ('n', '<i4')]
)
FRAME = np.dtype(
    [('info', '<u4'), ('t', '<i4', 4), *((name, '<i4') for name in ('width', 'height', 'x', 'y'))]
)
IMU = np.dtype([('info', '<u4'), ('t', '<i4'), ('values', '<f4', 7)])
SHORT = np.dtype([('data', '<u4'), ('t', '<i4')])


@dataclass
class Packet:
    """A copy of an event packet: what kind of events, and their bytes."""

    kind: str
    size: int
    overflow: int
    data: bytes

    def rows(self, layout):
        rows = np.frombuffer(self.data, np.uint8).reshape(-1, self.size)
        return np.ascontiguousarray(rows[:, : layout.itemsize]).view(layout)[:, 0]

    def times(self, t):
        return t.astype(np.int64) | self.overflow << 31

    def events(self):
        rows = self.rows(SHORT)
        data = rows['data'][rows['data'] & 1 == 1]
        assert len(data) == len(rows)
        return self.times(rows['t']), data >> 17, data >> 2 & 0x7FFF, data >> 1 & 1

    def specials(self):
        rows = self.rows(SHORT)
        return zip(self.times(rows['t']).tolist(), (rows['data'] >> 1 & 0x7F).tolist(), strict=True)

    def samples(self):
        rows = self.rows(IMU)
        for t, values in zip(self.times(rows['t']).tolist(), rows['values'], strict=True):
            yield t, values[:3], values[3:6], values[6]

    def frames(self):
        """Yield pixels, times (frame start, exposure start and end, frame end), corner."""
        for k, row in enumerate(self.rows(FRAME)):
            start, end, exposed, closed = self.times(row['t']).tolist()
            size = (int(row['height']), int(row['width']))
            at = k * self.size + FRAME.itemsize
            pixels = np.frombuffer(self.data, '<u2', size[0] * size[1], at).reshape(size)
            yield pixels, (start, exposed, closed, end), (int(row['x']), int(row['y']))


class Libcaer:
    """The first DAVIS that libcaer finds."""

    def __init__(self):
        # The wheel's extension brings the shared library and what that one needs into the process.
        wheel = importlib.util.find_spec('event_camera_drivers')
        importlib.import_module('event_camera_drivers')
        folder = Path(wheel.origin).parent.parent / 'event_camera_drivers.libs'
        (path,) = folder.glob('libcaer-*.so*')
        self.library = ctypes.CDLL(str(path))
        # libcaer returns memory that it allocated with malloc.
        self.release = ctypes.CDLL(None).free
        self.release.argtypes = [ctypes.c_void_p]
        self.library.caerDeviceOpen.restype = ctypes.c_void_p
        self.library.caerDeviceDataGet.restype = ctypes.c_void_p
        self.library.caerDeviceDataGet.argtypes = [ctypes.c_void_p]
        handle = self.library.caerDeviceOpen(1, DAVIS, 0, 0, None)
        assert handle, 'libcaer cannot open the camera'
        self.handle = ctypes.c_void_p(handle)

    def start(self):
        assert self.library.caerDeviceSendDefaultConfig(self.handle)
        # Room for everything: a full exchange buffer makes libcaer drop packets.
        self.set(DATA_EXCHANGE, BUFFER_SIZE, 4096)
        self.set(DATA_EXCHANGE, BLOCKING, 0)
        self.set(PACKETS, MOST_EVENTS, 0)
        self.set(PACKETS, LONGEST_INTERVAL_US, 10_000)
        self.set(EXTERNAL_INPUT, DETECT_RISING, 1)
        self.set(EXTERNAL_INPUT, DETECT_FALLING, 1)
        assert self.library.caerDeviceDataStart(self.handle, None, None, None, None, None)

    def set(self, module, parameter, value):
        number = ctypes.c_int8(module), ctypes.c_uint8(parameter), ctypes.c_uint32(value)
        assert self.library.caerDeviceConfigSet(self.handle, *number)

    def packets(self):
        """Return copies of the packets of the next container, if there is one."""
        container = self.library.caerDeviceDataGet(self.handle)
        if not container:
            ctypes.CDLL(None).usleep(1000)
            return []
        head = np.frombuffer(ctypes.string_at(container, CONTAINER.itemsize), CONTAINER)[0]
        count = int(head['n'])
        pointers = ctypes.string_at(container + CONTAINER.itemsize, 8 * count)
        packets = [self.take(int(at)) for at in np.frombuffer(pointers, '<u8') if at]
        self.release(container)
        return packets

    def take(self, at):
        head = np.frombuffer(ctypes.string_at(at, HEADER.itemsize), HEADER)[0]
        size = int(head['size'])
        data = ctypes.string_at(at + HEADER.itemsize, size * int(head['number']))
        self.release(at)
        return Packet(KINDS[int(head['kind'])], size, int(head['overflow']), data)

    def close(self):
        self.library.caerDeviceDataStop(self.handle)
        self.library.caerDeviceClose(ctypes.byref(self.handle))
