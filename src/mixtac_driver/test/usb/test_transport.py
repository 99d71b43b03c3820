# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The synchronous reader: order, stalls and other failures."""

from __future__ import annotations

import errno
import struct
import time
from functools import partial

import pytest
from davis_fake import FakeBackend, FakeCamera
from usb.core import USBError

from mixtac_driver.device import Connection
from mixtac_driver.errors import UsbError
from mixtac_driver.usb.transport import BulkReader


@pytest.fixture
def fake():
    return FakeCamera()


@pytest.fixture
def make_reader(fake):
    connection = Connection('davis346', backend=FakeBackend(fake))
    readers = []

    def make(**kwargs):
        readers.append(BulkReader(partial(connection.read, 0x82), connection.clear_halt, **kwargs))
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


def got(reader, seconds=2.0):
    """Return the next transfer, however many time-outs it takes."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        transfer = reader.get(0.02)
        if transfer is not None:
            return transfer
    return None


@pytest.mark.parametrize(
    'error', [USBError('overflow', -8, errno.EOVERFLOW), OSError(5, 'socket'), USBError('odd')]
)
def test_other_failures_end_reading_with_an_error(fake, make_reader, error):
    reader = make_reader()
    fake.bulk_errors.put(error)
    with pytest.raises(UsbError):
        reader.get(2.0)


def test_a_stall_is_cleared(fake, make_reader):
    reader = make_reader()
    fake.bulk_errors.put(USBError('pipe', -9, errno.EPIPE))
    fake.send([7])
    assert reader.get(1.0) is None
    assert got(reader) is not None
    assert reader.counters.stalls == 1
