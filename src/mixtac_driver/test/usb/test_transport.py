# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The synchronous reader: order, stalls and other failures."""

from __future__ import annotations

import errno
import struct
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
def reader(fake):
    connection = Connection('davis346', backend=FakeBackend(fake))
    read = partial(connection.read, 0x82)
    yield BulkReader(read, connection.clear_halt, transfer_size=8)
    connection.close()


def test_transfers_come_in_order(fake, reader):
    for k in range(5):
        fake.send([k] * (4 if k == 2 else 1))
    got = [reader.get(2.0) for _ in range(5)]
    assert [struct.unpack('<H', t.data[:2])[0] for t in got] == list(range(5))


@pytest.mark.parametrize(
    'error', [USBError('overflow', -8, errno.EOVERFLOW), OSError(5, 'socket'), USBError('odd')]
)
def test_failures_end_reading_with_an_error(fake, reader, error):
    fake.bulk_errors.put(error)
    with pytest.raises(UsbError):
        reader.get(2.0)
