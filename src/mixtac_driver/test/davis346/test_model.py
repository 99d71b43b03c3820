# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Other camera models, registered from outside of the package and opened on a fake USB camera."""

from __future__ import annotations

import itertools

import pytest
from davis_fake import FakeBackend, FakeCamera

from mixtac_driver.camera import Davis346
from mixtac_driver.davis346 import model as model_module
from mixtac_driver.errors import ConfigurationError
from mixtac_driver.parameters import DriverParameters

MODULE = """
from dataclasses import replace
from mixtac_driver.davis346.model import DAVIS346

DAVIS240 = replace(
    DAVIS346, name='davis240', product=0x841B, chips=(0, 1, 2), width=240, height=180,
    biases={name: DAVIS346.biases[name] for name in ('DiffBn', 'OnBn', 'OffBn')},
)
DVS240 = replace(DAVIS240, name='dvs240', chips=(77,), has_frames=False)
"""
POINTS = """
[mixtac.camera_models]
davis240 = other_cameras:DAVIS240
dvs240 = other_cameras:DVS240
"""
SIZES = {(1, 0): 180, (1, 1): 240, (2, 0): 180, (2, 1): 240}


@pytest.fixture(autouse=True)
def registered(monkeypatch, tmp_path):
    """A distribution with two more models on the import path."""
    monkeypatch.setattr('mixtac_driver.davis346.writes.BIASES_SETTLE_S', 0.0)
    monkeypatch.setattr('mixtac_driver.davis346.writes.LOGIC_SETTLE_S', 0.0)
    info = tmp_path / 'other_cameras-1.0.dist-info'
    info.mkdir()
    (info / 'METADATA').write_text('Metadata-Version: 2.1\nName: other-cameras\nVersion: 1.0\n')
    (info / 'entry_points.txt').write_text(POINTS)
    (tmp_path / 'other_cameras.py').write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    model_module.camera_models.cache_clear()
    yield
    model_module.camera_models.cache_clear()


class OtherBackend(FakeBackend):
    """Shows cameras with the product number of the other models."""

    def get_device_descriptor(self, dev):
        descriptor = super().get_device_descriptor(dev)
        descriptor.idProduct = 0x841B
        return descriptor


def camera(chip, device='davis240', **parameters):
    fake = FakeCamera(registers={**SIZES, (6, 1): chip})
    p = DriverParameters(device=device, **parameters)
    return fake, Davis346(p, backend=OtherBackend(fake))


def test_a_smaller_camera_is_opened_with_its_sizes_and_biases():
    fake, opened = camera(2)
    with opened:
        identity = opened.identity
        assert (identity.model.name, identity.chip) == ('davis240', 'davis240')
        assert identity.geometry.event_size == (240, 180)
        # Regions reach to its last pixel, unused filters lie one beyond it.
        assert (fake.registers[1, 43], fake.registers[1, 44]) == (239, 179)
        assert (fake.registers[1, 12], fake.registers[1, 11]) == (240, 180)
        assert {w[1] for w in fake.writes() if w[0] == 5 and w[1] < 128} == {10, 11, 12}
        opened.start()
        fake.send([0x8007, 0x1000 | 239, 0x2000 | 179, 0x2000 | 180])
        batches = itertools.islice(opened.batches(), 5)
        events = next(b.decoded.events for b in batches if len(b.decoded.events))
        assert (events.x.tolist(), events.y.tolist()) == ([239], [179])
        with pytest.raises(ConfigurationError):
            opened.apply(DriverParameters(roi_start_col=240))


def test_a_camera_without_frames_is_not_asked_for_any():
    fake, opened = camera(77, 'dvs240')
    with opened:
        opened.start()
        asked = {entry[1:3] for entry in fake.log if entry[0] == 'read'}
        written = {w[:2] for w in fake.writes()}
    assert not asked & {(2, 0), (2, 1), (2, 2)}
    assert not {address for address in written if address[0] == 2} - {(2, 4)}
    assert fake.registers[2, 4] == 0
