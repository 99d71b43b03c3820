# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Device strings, and the choice among cameras."""

from __future__ import annotations

import errno
from types import SimpleNamespace

import pytest
import usb.util
from davis_fake import FakeBackend, FakeCamera
from usb.core import USBError

from mixtac_driver import device as backend
from mixtac_driver.device import attached_cameras, find_camera
from mixtac_driver.errors import InUseError, NoCameraError, UnknownDeviceError


@pytest.fixture
def shelf(monkeypatch):
    """One registered backend, `shelf`, which returns the device string."""
    point = SimpleNamespace(name='shelf', load=lambda: lambda device: f'opened {device}')

    def points(*, group, name='shelf'):
        return [point] if (group, name) == ('mixtac.usb_backends', 'shelf') else []

    monkeypatch.setattr(backend, 'entry_points', points)


def test_registered_names_get_the_whole_device_string(shelf):
    assert backend.open_backend('shelf:/tmp/x') == 'opened shelf:/tmp/x'
    backend.check_device('shelf')


@pytest.mark.parametrize('device', ['', 'davis', 'davis346:1', 'shelves:1', ':'])
def test_unknown_names_list_the_known_ones(shelf, device):
    with pytest.raises(UnknownDeviceError) as error:
        backend.open_backend(device)
    assert 'davis346, shelf' in error.value.remedy


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
