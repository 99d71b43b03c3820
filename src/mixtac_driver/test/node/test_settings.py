# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""From parameters, masks and frames to what the camera receives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixtac_core.events.readings import Frame
from mixtac_driver.errors import ConfigurationError
from mixtac_driver.node.settings import DriverSettings, right_exposure
from mixtac_driver.parameters import DriverParameters
from mixtac_driver.pixels import PixelMask, save_mask

SIZE = (346, 260)
AUTO = replace(DriverParameters(), aps_auto_exposure=True)


class Applied(list):
    """Settings that a source was given."""

    def __call__(self, parameters, pixel_filter):
        self.append((parameters, pixel_filter))


def test_a_mask_of_another_size_is_refused(tmp_path):
    path = str(tmp_path / 'mask.png')
    save_mask(PixelMask([(3, 4)], (10, 10)), path)
    masked = replace(DriverParameters(), dvs_pixel_mask=path)
    with pytest.raises(ConfigurationError):
        DriverSettings(masked).use_size(SIZE)
    settings = DriverSettings(DriverParameters())
    settings.use_size(SIZE)
    with pytest.raises(ConfigurationError):
        settings.apply(masked, Applied())


def test_hot_pixels_found_before_are_masked_from_the_start(tmp_path, monkeypatch):
    monkeypatch.setenv('MIXTAC_HOME', str(tmp_path))
    own = str(tmp_path / 'own.png')
    save_mask(PixelMask([(3, 4)], SIZE), own)
    named = replace(DriverParameters(), dvs_pixel_mask=own, hot_pixels_file='mask.png')
    assert DriverSettings(named).mask.pixels == ((3, 4),)
    save_mask(PixelMask([(7, 8)], SIZE), str(tmp_path / 'mask.png'))
    settings = DriverSettings(named)
    assert settings.mask.pixels == ((7, 8), (3, 4))
    # A new search starts from the user's own mask.
    assert settings.file_mask.pixels == ((3, 4),)


def frame(level):
    image = np.full((4, 4), level, np.uint16)
    return Frame(image, 0, 0, 0, 0, 0, 0, 0, global_shutter=True)


class Exposures(list):
    """A camera control that keeps the exposures it was given."""

    def set_exposure(self, exposure_us):
        self.append(exposure_us)
        return True


def test_parameters_and_mask_are_applied_together(tmp_path):
    path = str(tmp_path / 'mask.png')
    save_mask(PixelMask([(3, 4)], SIZE), path)
    settings, camera = DriverSettings(DriverParameters()), Applied()
    settings.apply(replace(DriverParameters(), dvs_pixel_mask=path, roi_end_col=9), camera)
    assert camera[0][1] == ((3, 4),)
    assert camera[0][0].roi_end_col == 9
    assert settings.mask.pixels == settings.file_mask.pixels == ((3, 4),)
    assert settings.camera_settings() == camera[0]


@pytest.mark.parametrize(
    'change', [{'dvs_pixel_mask': 'none.png'}, {'roi_start_row': 9, 'roi_end_row': 8}]
)
def test_what_cannot_be_leaves_everything_as_it_was(change):
    settings, camera = DriverSettings(DriverParameters()), Applied()
    with pytest.raises(ConfigurationError):
        settings.apply(replace(DriverParameters(), **change), camera)
    assert camera == []
    assert settings.parameters == DriverParameters()


def test_a_mask_in_use_survives_other_changes():
    settings, camera = DriverSettings(DriverParameters()), Applied()
    settings.use_mask(PixelMask([(k, 1) for k in range(10)], SIZE), camera)
    settings.apply(replace(DriverParameters(), aps_exposure=100), camera)
    assert camera[1][1] == tuple((k, 1) for k in range(8))
    settings.use_mask(settings.mask, camera, in_camera=False)
    assert camera[2][1] == ()
    assert len(settings.mask.pixels) == 10


def test_frames_set_the_exposure_and_other_changes_keep_it():
    settings, sent = DriverSettings(AUTO), Exposures()
    # A frame that does not say its exposure is left out.
    settings.follow(frame(800), 0.0, sent)
    DriverSettings(DriverParameters()).follow(frame(5), 7000.0, sent)
    assert sent == []
    settings.follow(frame(800), 7000.0, sent)
    assert sent[0] < 7000
    camera = Applied()
    settings.apply(replace(AUTO, roi_end_col=9), camera)
    settings.apply(replace(AUTO, aps_exposure=500), camera)
    settings.apply(DriverParameters(), camera)
    assert [p.aps_exposure for p, _ in camera] == [sent[0], 500, 7000]


class Sensor:
    """Pixels that saturate, seen with an exposure that takes effect after some frames."""

    def __init__(self, level, exposure_us, delay):
        self.brightness = level * np.exp(np.random.default_rng(3).normal(0, 0.5, (65, 87)))
        self.exposures = [exposure_us] * (delay + 1)

    def frame(self):
        """Return the next frame and its exposure."""
        self.exposures.append(self.exposures[-1])
        exposure_us = self.exposures.pop(0)
        signal = self.brightness * exposure_us
        return np.where(signal > 700, 1023, signal).astype(np.uint16), exposure_us

    def set_exposure(self, exposure_us):
        self.exposures[-1] = exposure_us
        return True


@pytest.mark.parametrize('start_us', [20, 7000, 30_000])
@pytest.mark.parametrize('level', [0.02, 0.1, 5.0])
@pytest.mark.parametrize('delay', [0, 4])
def test_exposure_comes_to_the_target_from_anywhere_and_rests(level, start_us, delay):
    settings = DriverSettings(replace(AUTO, aps_exposure=start_us))
    sensor, exposures = Sensor(level, start_us, delay), []
    for _ in range(80):
        image, exposure_us = sensor.frame()
        settings.follow(replace(frame(0), image=image), exposure_us, sensor)
        exposures.append(exposure_us)
    assert abs(image.mean() / 1023 - AUTO.aps_auto_exposure_target) < 0.05
    assert len(set(exposures[-20:])) == 1


@pytest.mark.parametrize(('level', 'limit_us'), [(0, 30_000), (1023, 20)])
def test_exposure_ends_at_the_limits(level, limit_us):
    assert right_exposure(frame(level).image, limit_us, AUTO) == limit_us
