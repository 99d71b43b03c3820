# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Register requests, and the errors of the bus."""

from __future__ import annotations

import errno

import pytest
from usb.core import USBError, USBTimeoutError

from mixtac_driver.errors import (
    AccessError,
    BusError,
    DisconnectedError,
    InUseError,
    NoAnswerError,
    StallError,
    UsbError,
)
from mixtac_driver.usb.protocol import Protocol, Write, usb_failure


@pytest.mark.parametrize(
    ('number', 'kind'),
    [
        (errno.ENODEV, DisconnectedError),
        (errno.EACCES, AccessError),
        (errno.EBUSY, InUseError),
        (errno.EPIPE, StallError),
        (errno.ETIMEDOUT, NoAnswerError),
        (errno.EOVERFLOW, BusError),
        (errno.EIO, BusError),
        (errno.ENOMEM, UsbError),
        (None, UsbError),
    ],
)
def test_each_error_of_the_bus_has_its_kind_and_remedy(number, kind):
    failure = usb_failure(USBError('what pyusb said', None, number), 'reading data')
    assert type(failure) is kind
    assert 'reading data' in failure.message
    assert bool(failure.remedy) == (kind not in {DisconnectedError, UsbError})


class Device:
    """Answers requests with the given answers, in turn."""

    def __init__(self, *answers):
        self.answers = list(answers)
        self.asked = []

    def ctrl_transfer(self, *request):
        self.asked.append(request)
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer


def late():
    return USBTimeoutError('late', -7, errno.ETIMEDOUT)


def test_requests_that_may_be_repeated_are_tried_once_more():
    device = Device(late(), b'\0\0\0\7', late(), 4)
    protocol = Protocol(device)
    assert protocol.read(6, 0) == 7
    protocol.write(5, 1, 9)
    assert device.asked[0] == device.asked[1]
    assert device.asked[2] == device.asked[3]


def test_many_writes_at_once_are_never_repeated():
    device = Device(late(), 12)
    with pytest.raises(NoAnswerError):
        Protocol(device).write_at_once([Write(0, 2, 1), Write(0, 2, 0)])
    assert len(device.asked) == 1
