# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The reader thread: queue bounds, errors, clean stop."""

from __future__ import annotations

import errno
import struct
import threading
import time

import pytest
from davis_fake import FakeBackend, FakeCamera
from usb.core import USBError

from mixtac_driver import transport
from mixtac_driver.connection import Connection
from mixtac_driver.errors import DisconnectedError, StreamError, UsbError
from mixtac_driver.transport import BulkReader


def wait_until(condition, seconds=5.0):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.002)


@pytest.fixture
def fake():
    return FakeCamera()


@pytest.fixture
def make_reader(fake):
    connection = Connection('davis346', backend=FakeBackend(fake))
    readers = []

    def make(**kwargs):
        readers.append(BulkReader(connection.read_data, connection.clear_halt, **kwargs))
        readers[-1].start()
        return readers[-1]

    yield make
    for reader in readers:
        reader.stop()
    connection.close()


def test_transfers_come_in_order_with_their_arrival(fake, make_reader):
    reader = make_reader(transfer_size=8)
    for k in range(5):
        fake.send([k] * (4 if k == 2 else 1))
    got = [reader.get(2.0) for _ in range(5)]
    assert [struct.unpack('<H', t.data[:2])[0] for t in got] == list(range(5))
    assert [t.short_packet for t in got] == [True, True, False, True, True]
    stamps = [t.arrival_ns for t in got]
    assert stamps == sorted(stamps)
    assert abs(stamps[0] - time.time_ns()) < 10**10


def test_full_queue_drops_the_newest_counts_them_and_keeps_the_time(fake, make_reader):
    reader = make_reader(queue_size=8)
    for k in range(10):
        fake.send([0x8000 | k, 0x7000 | k])
    wait_until(lambda: reader.counters.transfers == 10)
    counters = reader.counters
    assert (counters.dropped_transfers, counters.dropped_size) == (8, 32)
    assert counters.most_queued_size == 8
    reader.get(1.0)
    reader.get(1.0)
    fake.send([0x8001])
    after = reader.get(2.0)
    assert (after.gap.size, after.gap.wraps) == (32, sum(range(2, 10)))
    fake.send([0x8002])
    assert reader.get(2.0).gap.size == 0


def test_timeouts_are_normal(fake, make_reader, monkeypatch):
    monkeypatch.setattr(transport, 'READ_TIMEOUT_MS', 5)
    reader = make_reader()
    wait_until(lambda: reader.counters.timeouts > 3)
    fake.send([1])
    assert reader.get(2.0) is not None


def test_data_before_a_disconnect_come_first_then_the_error(fake, make_reader):
    reader = make_reader()
    fake.send([1])
    wait_until(lambda: reader.counters.transfers == 1)
    fake.unplug()
    assert reader.get(2.0) is not None
    for _ in range(2):
        with pytest.raises(DisconnectedError):
            reader.get(2.0)


@pytest.mark.parametrize(
    'error', [USBError('overflow', -8, errno.EOVERFLOW), OSError(5, 'socket'), USBError('odd')]
)
def test_other_failures_end_reading_with_an_error(fake, make_reader, error):
    reader = make_reader()
    fake.bulk_errors.put(error)
    with pytest.raises(UsbError, match='reading data'):
        reader.get(2.0)


def test_endless_stalls_end_reading(fake, make_reader):
    for _ in range(20):
        fake.bulk_errors.put(USBError('pipe', -9, errno.EPIPE))
    reader = make_reader()
    with pytest.raises(UsbError, match='stall'):
        reader.get(2.0)


def test_stop_wakes_a_waiting_consumer(make_reader):
    reader = make_reader()
    result = []
    consumer = threading.Thread(target=lambda: result.append(reader.get(30.0)))
    consumer.start()
    reader.stop()
    consumer.join(5.0)
    assert result == [None]


def test_read_that_never_returns_is_reported(monkeypatch):
    monkeypatch.setattr(transport, 'STOP_TIMEOUT_S', 0.05)
    release = threading.Event()

    def hang(_buffer, _timeout_ms):
        release.wait(10)
        return 0

    reader = BulkReader(hang, lambda: None)
    reader.start()
    with pytest.raises(StreamError, match='did not return'):
        reader.stop()
    release.set()
    reader.stop()


def test_reader_that_was_never_started_stops():
    reader = BulkReader(lambda _b, _t: 0, lambda: None)
    reader.stop()
    assert reader.get(0.0) is None
