# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which source a device string names."""

from __future__ import annotations

import pytest

from mixtac_driver.camera import Davis346
from mixtac_driver.errors import UnknownDeviceError
from mixtac_driver.parameters import DriverParameters
from mixtac_driver.playback import RecordedSource
from mixtac_driver.supervisor import SourceKind, make_source, source_kind


def make(device):
    return make_source(DriverParameters(device=device))


@pytest.mark.parametrize(
    ('device', 'kind'),
    [
        ('davis346', SourceKind.CAMERA),
        ('virtual', SourceKind.SIMULATED),
        ('virtual:/tmp/camera.sock', SourceKind.SIMULATED),
        ('recording.aedat4', SourceKind.RECORDED),
        ('recording.mcap', SourceKind.RECORDED),
        ('recording.db3', SourceKind.RECORDED),
        ('/data/trial_7', SourceKind.RECORDED),
        ('data/trial_7', SourceKind.RECORDED),
        ('./trial_7', SourceKind.RECORDED),
    ],
)
def test_the_name_of_a_device_or_the_path_of_a_recording(device, kind):
    pytest.importorskip('mixtac_sim.usb.server')
    assert source_kind(device) is kind
    expected = RecordedSource if kind is SourceKind.RECORDED else Davis346
    assert isinstance(make(device), expected)


def test_a_folder_is_a_recording_without_any_slash(tmp_path, monkeypatch):
    (tmp_path / 'trial_7').mkdir()
    monkeypatch.chdir(tmp_path)
    assert source_kind('trial_7') is SourceKind.RECORDED


def test_anything_else_is_unknown():
    for call in (source_kind, make):
        with pytest.raises(UnknownDeviceError) as error:
            call('nonsense')
        assert 'nonsense' in str(error.value)
