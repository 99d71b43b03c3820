# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Messages of the camera's USB controller."""

from __future__ import annotations

import queue
import struct
import threading

import pytest
from davis_fake import FakeBackend, FakeCamera
from hypothesis import given
from hypothesis import strategies as st
from usb.core import USBTimeoutError

from mixtac_driver.camera import Davis346
from mixtac_driver.usb.transport import DebugMessage, DebugReader, decode_message


def names():
    return [thread.name for thread in threading.enumerate()]


@given(st.integers(0, 255), st.integers(0, 2**32 - 1), st.text('abc DEF', min_size=1, max_size=58))
def test_messages_come_back(code, time, text):
    data = struct.pack('<BBI', 0, code, time) + text.encode()
    assert decode_message(data) == DebugMessage(code, time, text)


@given(st.binary(max_size=70))
def test_garbage_is_no_message_or_some_text(data):
    message = decode_message(data)
    assert (message is None) == (len(data) < 7 or len(data) > 64 or data[0] != 0)


def test_messages_of_a_camera_arrive_and_the_thread_ends_with_it():
    fake = FakeCamera()
    fake.debug = queue.Queue()
    got = queue.Queue()
    with Davis346(backend=FakeBackend(fake), on_debug=got.put) as camera:
        camera.start()
        fake.debug.put(b'\x01' + bytes(20))
        fake.debug.put(struct.pack('<BBI', 0, 3, 77) + b'FIFO full\0\0')
        assert got.get(timeout=10) == DebugMessage(3, 77, 'FIFO full')
        assert 'davis-debug' in names()
    assert 'davis-debug' not in names()


@pytest.mark.parametrize('gone', ['absent', 'unplugged'])
def test_without_the_endpoint_or_the_camera_the_thread_ends_by_itself(gone):
    fake = FakeCamera()
    if gone == 'unplugged':
        fake.debug = queue.Queue()
    with Davis346(backend=FakeBackend(fake), on_debug=print) as camera:
        camera.start()
        if gone == 'unplugged':
            fake.unplug()
        for thread in threading.enumerate():
            if thread.name == 'davis-debug':
                thread.join(10)
        assert 'davis-debug' not in names()


def test_a_backend_without_interrupt_transfers_is_harmless():
    def read(_buffer, _timeout):
        raise NotImplementedError

    reader = DebugReader(read, print)
    reader.start()
    reader.stop()
    assert 'davis-debug' not in names()


def test_it_goes_on_after_time_outs():
    answers = [USBTimeoutError('t'), USBTimeoutError('t'), struct.pack('<BBI', 0, 0, 1) + b'x']
    got = queue.Queue()

    def read(buffer, _timeout):
        answer = answers.pop(0) if answers else USBTimeoutError('t')
        if isinstance(answer, Exception):
            raise answer
        memoryview(buffer)[: len(answer)] = answer
        return len(answer)

    reader = DebugReader(read, got.put)
    reader.start()
    assert got.get(timeout=10) == DebugMessage(0, 1, 'x')
    reader.stop()
