# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The virtual camera's control requests and endpoints."""

from __future__ import annotations

import errno
import struct
import threading
import time

import numpy as np
import pytest
from usb.core import USBError, USBTimeoutError

from mixtac_sim.usb.device import VirtualDavis346


@pytest.fixture
def device():
    return VirtualDavis346('V0000042')


def test_its_stamps_count_from_the_host_time_of_the_last_reset_at_the_pace_of_the_camera():
    now_us = 7_000_000
    device = VirtualDavis346('V0000042', skew_ppm=500.0, clock=lambda: now_us)
    start(device)
    before_us = time.time_ns() // 1000
    write(device, 0, 2, 1)
    after_us = time.time_ns() // 1000
    reset_us = device.stamp_us(now_us)
    assert before_us <= reset_us <= after_us
    assert device.stamp_us(now_us + 60_000_000) == reset_us + 60_030_000


def write(device, module, param, value):
    device.control(0x40, 0xBF, module, param, struct.pack('>I', value))


def read(device, module, param):
    return struct.unpack('>I', device.control(0xC0, 0xBF, module, param, 4))[0]


def start(device):
    for module, param in ((0, 3), (9, 0), (0, 1), (0, 0)):
        write(device, module, param, 1)


def test_identity_registers(device):
    expected = {
        (6, 0): 18, (6, 7): 1, (6, 1): 5, (6, 2): 1, (6, 4): 30, (6, 5): 80, (6, 6): 1008,
        (1, 0): 260, (1, 1): 346, (1, 2): 4, (2, 0): 260, (2, 1): 346, (2, 2): 4,
        (2, 6): 1, (3, 0): 2, (1, 10): 1, (1, 40): 1, (1, 60): 1, (1, 80): 1, (0, 80): 1,
    }  # fmt: skip
    assert {key: read(device, *key) for key in expected} == expected


def test_registers_are_written_alone_or_together_and_read_only_ones_stay(device):
    entries = ((5, 0, 411), (5, 36, 33808), (2, 12, 0xFFFFFFFF), (77, 3, 5))
    for entry in entries[:2]:
        write(device, *entry)
    device.control(0x40, 0xC2, 2, 0, b''.join(struct.pack('>BBI', *each) for each in entries[2:]))
    assert [read(device, module, param) for module, param, _ in entries] == [e[2] for e in entries]
    write(device, 6, 0, 99)
    write(device, 1, 82, 99)
    assert (read(device, 6, 0), read(device, 1, 82)) == (18, 0)


@pytest.mark.parametrize(
    'request_',
    [
        (0x40, 0xB1, 2, 0, b''),
        (0x40, 0xC6, 0, 0, b''),
        (0x40, 0xBF, 1, 3, b'\0\1'),
        (0x40, 0xC2, 2, 0, b'\0' * 6),
        (0xC0, 0xC2, 0, 0, 4),
        (0xC0, 0x10, 0, 0, 4),
        (0x80, 6, 0x0F00, 0, 5),
        (0x80, 6, 0x0309, 0, 5),
        (0x00, 9, 2, 0, b''),
    ],
)
def test_unknown_requests_stall(device, request_):
    with pytest.raises(USBError) as failure:
        device.control(*request_)
    assert failure.value.errno == errno.EPIPE


def test_descriptors_are_those_of_the_camera(device):
    data = device.control(0x80, 6, 0x0100, 0, 64)
    assert (len(data), struct.unpack_from('<HHH', data, 8)) == (18, (0x152A, 0x841A, 6))
    data = device.control(0x80, 6, 0x0200, 0, 4096)
    assert struct.unpack_from('<BBHBB', data) == (9, 2, len(data), 1, 1)
    kinds, endpoints, at = [], [], 0
    while at < len(data):
        kinds.append(data[at + 1])
        if data[at + 1] == 5:
            endpoints.append((data[at + 2], data[at + 3]))
        at += data[at]
    assert kinds == [2, 4, 5, 0x30, 5, 0x30]
    assert endpoints == [(0x82, 2), (0x81, 3)]
    assert device.control(0x80, 6, 0x0200, 0, 9) == data[:9]
    serial = device.control(0x80, 6, 0x0303, 0x0409, 255)
    assert serial[2:].decode('utf-16-le') == 'V0000042'
    assert (serial[0], serial[1]) == (len(serial), 3)


def test_the_configuration_is_remembered(device):
    for value in (1, 0):
        device.control(0x00, 9, value, 0, b'')
        assert device.control(0x80, 8, 0, 0, 1) == bytes((value,))


def test_raw_words_pass_only_while_running(device):
    words = np.arange(5, dtype=np.uint16)
    assert not device.feed(words)
    start(device)
    write(device, 9, 1, 0)
    assert device.feed(words)
    assert device.read_bulk(0x82, 7, 1.0) == words.astype('<u2').tobytes()[:6]
    assert device.read_bulk(0x82, 64, 1.0) == words.astype('<u2').tobytes()[6:]
    device.feed(words)
    write(device, 9, 0, 0)
    with pytest.raises(USBTimeoutError):
        device.read_bulk(0x82, 64, 0.0)


def test_short_packet_only_after_the_early_packet_delay(device):
    start(device)
    write(device, 9, 1, 80 * 1008 * 3600)  # an hour
    device.feed(np.arange(4, dtype=np.uint16))
    with pytest.raises(USBTimeoutError):
        device.read_bulk(0x82, 64, 0.01)
    assert len(device.read_bulk(0x82, 8, 0.01)) == 8
    write(device, 9, 1, 80 * 1008 // 1000)  # a microsecond
    device.feed(np.arange(4, dtype=np.uint16))
    assert len(device.read_bulk(0x82, 64, 5.0)) == 8


def test_a_waiting_read_ends_when_data_come_or_the_camera_goes(device):
    start(device)
    results = []

    def host():
        results.append(device.read_bulk(0x82, 64, None))
        with pytest.raises(USBError) as failure:
            device.read_bulk(0x82, 64, None)
        results.append(failure.value.errno)

    thread = threading.Thread(target=host)
    thread.start()
    device.feed(np.arange(3, dtype=np.uint16))
    while not results:
        thread.join(0.01)
    device.unplug()
    thread.join(5.0)
    assert results == [b'\0\0\1\0\2\0', errno.ENODEV]
