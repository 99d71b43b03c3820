# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Device strings."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from mixtac_driver import device as backend
from mixtac_driver.errors import UnknownDeviceError, UsbError


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


def test_missing_libusb_is_named(monkeypatch):
    monkeypatch.setattr(backend.importlib.util, 'find_spec', lambda _name: None)
    monkeypatch.setattr('usb.backend.libusb1.get_backend', lambda: None)
    with pytest.raises(UsbError) as error:
        backend.open_backend('davis346')
    assert 'libusb' in error.value.remedy
