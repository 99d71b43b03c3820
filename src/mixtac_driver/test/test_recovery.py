# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What each failure of the bus, the camera or its data leads to."""

from __future__ import annotations

import errno
import random

import pytest
import usb.util
from davis_fake import FakeBackend, FakeCamera
from usb.core import USBError, USBTimeoutError

from mixtac_driver.camera import Davis346
from mixtac_driver.device import attached_cameras, find_camera
from mixtac_driver.errors import (
    AccessError,
    BusError,
    DisconnectedError,
    DriverError,
    InUseError,
    NoAnswerError,
    NoCameraError,
    StallError,
    UsbError,
)
from mixtac_driver.usb.protocol import Protocol, Write, usb_failure


@pytest.mark.parametrize(
    ('number', 'kind'),
    [
        (errno.ENODEV, DisconnectedError),
        (errno.ENOENT, DisconnectedError),
        (errno.EACCES, AccessError),
        (errno.EPERM, AccessError),
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
    """Answers requests with what it is told, in turn."""

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
    assert protocol.retries == 2
    assert device.asked[0] == device.asked[1]
    assert device.asked[2] == device.asked[3]


def test_they_are_not_tried_a_third_time():
    protocol = Protocol(Device(late(), late(), b'\0\0\0\7'))
    with pytest.raises(NoAnswerError):
        protocol.read(6, 0)


def test_many_writes_at_once_are_never_repeated():
    device = Device(late(), 12)
    with pytest.raises(NoAnswerError):
        Protocol(device).write_at_once([Write(0, 2, 1), Write(0, 2, 0)])
    assert len(device.asked) == 1


@pytest.mark.parametrize(
    ('serial', 'preferred', 'got'),
    [('B', 'A', 'B'), ('', 'A', 'A'), ('', 'B', 'B'), ('', 'C', None), ('C', 'A', None)],
)
def test_camera_is_chosen_by_serial_then_by_what_it_was_before(serial, preferred, got):
    cameras = FakeCamera('A'), FakeCamera('B')
    if got is None:
        with pytest.raises(NoCameraError):
            find_camera(FakeBackend(*cameras), 'davis346', serial, preferred)
    else:
        camera, number = find_camera(FakeBackend(*cameras), 'davis346', serial, preferred)
        assert number == camera.serial_number == got
        usb.util.dispose_resources(camera)
    assert [camera.handles for camera in cameras] == [0, 0]


def test_another_single_camera_is_taken_where_the_former_is_gone():
    camera, number = find_camera(FakeBackend(FakeCamera('B')), 'davis346', '', 'A')
    assert number == 'B'
    usb.util.dispose_resources(camera)


def test_camera_that_may_not_be_opened_does_not_hide_the_wanted_one():
    broken, wanted = FakeCamera('A'), FakeCamera('B')
    broken.open_error = USBError('busy', -6, errno.EBUSY)
    backend = FakeBackend(broken, wanted)
    camera, number = find_camera(backend, 'davis346', 'B')
    assert number == 'B'
    usb.util.dispose_resources(camera)
    with pytest.raises(InUseError):
        find_camera(backend, 'davis346', 'A')


def test_attached_cameras_are_seen_without_opening_any():
    camera = FakeCamera()
    camera.open_error = USBError('no', -3, errno.EACCES)
    assert attached_cameras('davis346', FakeBackend(camera)) == {(1, 1)}
    assert attached_cameras('davis346', FakeBackend()) == frozenset()
    assert attached_cameras('nonsense') == frozenset()


@pytest.mark.parametrize('seed', range(30))
def test_registers_that_read_as_garbage_are_refused_in_clear_words(seed):
    rng = random.Random(seed)
    garbage = {}
    real = FakeCamera().registers
    # Some are left as they are, so that not always the first one is refused.
    for address, value in real.items():
        garbage[address] = value if rng.random() < 0.8 else rng.getrandbits(32)
    fake = FakeCamera(registers=garbage)
    camera = Davis346(backend=FakeBackend(fake))
    try:
        camera.open()
    except DriverError as error:
        assert len(str(error).splitlines()) == 1  # noqa: PT017 - not every garbage is refused
    camera.close()
    assert fake.handles == 0
