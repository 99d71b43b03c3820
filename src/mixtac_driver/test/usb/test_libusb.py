# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Many reads at once: order, stalls, disconnects, memory."""

from __future__ import annotations

import threading
import time

import fake_libusb
import pytest
from fake_libusb import FakeLibusb
from hypothesis import given, settings
from hypothesis import strategies as st

from mixtac_driver.errors import DisconnectedError, HungReadError, UsbError
from mixtac_driver.usb import libusb as async_transport
from mixtac_driver.usb import transport
from mixtac_driver.usb.libusb import AsynchronousReader, LibusbPort


class Rig:
    """A reader on a fake library."""

    def __init__(self, **settings):
        self.lib = FakeLibusb()
        self.cleared = 0
        values = {'transfers': 4, 'transfer_size': 8, **settings}
        port = LibusbPort(self.lib, None, None)
        self.reader = AsynchronousReader(port, 0x82, self._clear_halt, **values)

    def _clear_halt(self):
        assert not self.lib.submitted, 'the endpoint is cleared while reads wait'
        self.cleared += 1


@pytest.fixture
def make_rig():
    rigs = []

    def make(**settings):
        rigs.append(Rig(**settings))
        return rigs[-1]

    yield make
    for rig in rigs:
        rig.lib.gives_back = True
        rig.reader.stop()
        assert not rig.lib.allocated


def test_data_come_in_order_and_the_reads_wait_again(make_rig):
    rig = make_rig()
    rig.reader.start()
    for k in range(3):
        rig.lib.send(bytes([k]) * (8 if k == 1 else 2))
    got = [rig.reader.get(1.0) for _ in range(3)]
    assert [transfer.data[0] for transfer in got] == [0, 1, 2]
    assert len(rig.lib.submitted) == 4
    assert rig.reader.counters.size == 12


@settings(max_examples=50)
@given(st.lists(st.one_of(st.binary(min_size=0, max_size=8), st.just('get')), max_size=60))
def test_no_byte_is_lost_whatever_the_consumer_does(steps):
    rig = Rig()
    rig.reader.start()
    sent, got = b'', b''

    def take():
        transfer = rig.reader.get(0.0)
        return transfer.data if transfer else b''

    for step in steps:
        if step == 'get' or not rig.lib.submitted:
            got += take()
        else:
            sent += step
            rig.lib.send(step)
    for _ in range(2 * len(steps) + 8):
        got += take()
    assert got == sent
    rig.reader.stop()
    assert not rig.lib.allocated


def test_a_stall_is_cleared_and_what_came_before_it_is_kept(make_rig):
    rig = make_rig()
    rig.reader.start()
    rig.lib.send(b'\1\1')
    rig.lib.send(b'\2\2', fake_libusb.STALLED)
    assert rig.reader.get(1.0).data == b'\1\1'
    assert rig.reader.get(1.0).data == b'\2\2'
    assert rig.reader.get(1.0) is None
    assert (rig.cleared, rig.reader.counters.stalls) == (1, 1)
    rig.lib.send(b'\3\3')
    assert rig.reader.get(1.0).data == b'\3\3'


def test_endless_stalls_end_reading(make_rig):
    rig = make_rig()
    rig.reader.start()
    for _ in range(transport.MOST_STALLS):
        rig.lib.send(b'', fake_libusb.STALLED)
        assert rig.reader.get(1.0) is None
    rig.lib.send(b'', fake_libusb.STALLED)
    with pytest.raises(UsbError):
        rig.reader.get(1.0)


def test_data_before_a_disconnect_come_first_then_the_error(make_rig):
    rig = make_rig()
    rig.reader.start()
    rig.lib.send(b'\1\1')
    for _ in range(3):
        rig.lib.send(b'', fake_libusb.NO_DEVICE)
    assert rig.reader.get(1.0).data == b'\1\1'
    for _ in range(2):
        with pytest.raises(DisconnectedError):
            rig.reader.get(1.0)


def test_reads_wait_for_a_slow_consumer_and_no_byte_is_lost(make_rig):
    rig = make_rig()
    rig.reader.start()
    for k in range(4):
        rig.lib.send(bytes([k]))
    assert rig.reader.get(1.0).data == b'\0'
    # The camera can send no more than the consumer has made room for.
    assert len(rig.lib.submitted) == 1
    rig.lib.send(b'\4')
    assert [rig.reader.get(1.0).data[0] for _ in range(4)] == [1, 2, 3, 4]


def test_too_little_memory_in_the_kernel_is_said(make_rig):
    rig = make_rig()
    rig.lib.submit_error = fake_libusb.ERROR_NO_MEMORY
    with pytest.raises(UsbError):
        rig.reader.start()


def test_a_camera_that_leaves_while_reads_are_queued_again_is_noticed(make_rig):
    rig = make_rig()
    rig.reader.start()
    rig.lib.send(b'\1\1')
    rig.lib.submit_error = fake_libusb.ERROR_NO_DEVICE
    assert rig.reader.get(1.0).data == b'\1\1'
    with pytest.raises(DisconnectedError):
        rig.reader.get(1.0)


def test_stop_from_another_thread_ends_a_waiting_get(make_rig):
    rig = make_rig()
    rig.reader.start()
    result = []
    consumer = threading.Thread(target=lambda: result.append(rig.reader.get(60.0)))
    consumer.start()
    time.sleep(0.05)
    rig.reader.stop()
    consumer.join(60.0)
    assert result == [None]
    assert rig.reader.get(1.0) is None


def test_reads_that_the_kernel_keeps_are_reported_and_their_memory_stays(make_rig, monkeypatch):
    monkeypatch.setattr(async_transport, 'DRAIN_TIMEOUT_S', 0.05)
    rig = make_rig()
    rig.reader.start()
    rig.lib.gives_back = False
    with pytest.raises(HungReadError):
        rig.reader.stop()
    assert len(rig.lib.allocated) == 4
