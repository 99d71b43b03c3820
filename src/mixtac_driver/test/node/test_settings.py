# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""From parameters, masks and frames to what the camera is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixtac_core.events.readings import Frame
from mixtac_driver.errors import ConfigurationError
from mixtac_driver.node.settings import AutoExposure, DriverSettings
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


def frame(level):
    image = np.full((4, 4), level, np.uint16)
    return Frame(image, 0, 0, 0, 0, 0, 0, 0, global_shutter=True)


class Exposures(list):
    """A camera control that keeps the exposures it was given."""

    busy = False

    def set_exposure(self, exposure_us):
        if not self.busy:
            self.append(exposure_us)
        return not self.busy


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
    settings, told = DriverSettings(AUTO), Exposures()
    # A frame that does not say its exposure is left out.
    settings.follow(frame(800), 0.0, told)
    DriverSettings(DriverParameters()).follow(frame(5), 7000.0, told)
    assert told == []
    settings.follow(frame(800), 7000.0, told)
    assert told[0] < 7000
    camera = Applied()
    settings.apply(replace(AUTO, roi_end_col=9), camera)
    settings.apply(replace(AUTO, aps_exposure=500), camera)
    settings.apply(DriverParameters(), camera)
    assert [p.aps_exposure for p, _ in camera] == [told[0], 500, 7000]


def test_a_busy_camera_is_told_with_a_later_frame():
    settings, told = DriverSettings(AUTO), Exposures()
    told.busy = True
    settings.follow(frame(800), 7000.0, told)
    assert settings.camera_settings()[0].aps_exposure == 7000
    told.busy = False
    settings.follow(frame(800), 7000.0, told)
    assert settings.camera_settings()[0].aps_exposure == told[0] < 7000


def control_from(exposure_us):
    return AutoExposure(
        DriverParameters(
            aps_exposure=exposure_us,
            aps_auto_exposure_target=0.35,
            aps_auto_exposure_minimum=20,
            aps_auto_exposure_maximum=30_000,
        )
    )


class Sensor:
    """Pixels of given brightness that saturate; requests take effect after some frames.

    Args:
        brightness: Signal per microsecond of exposure, any shape.
        exposure_us: To begin with.
        delay: Frames between a request and the first frame that shows it.
    """

    def __init__(self, brightness, exposure_us, delay=2, seed=0):
        self.brightness = brightness
        self.exposures = [exposure_us] * delay
        self.latest = exposure_us
        self.rng = np.random.default_rng(seed)

    def frame(self):
        self.exposures.append(self.latest)
        exposure_us = self.exposures.pop(0)
        signal = self.brightness * exposure_us + self.rng.normal(0, 2, self.brightness.shape)
        image = np.clip(np.round(signal), 0, 1023).astype(np.uint16)
        # As in the camera: from some signal on a pixel reads as over-exposed.
        image[signal > 700] = 1023
        return image, exposure_us

    def request(self, exposure_us):
        self.latest = exposure_us


def scene(level, contrast=0.5, seed=3):
    return level * np.exp(np.random.default_rng(seed).normal(0, contrast, (65, 87)))


def run(sensor, controller, frames=60):
    exposures, means = [], []
    for _ in range(frames):
        image, exposure_us = sensor.frame()
        wanted = controller.update(image, exposure_us)
        if wanted is not None:
            sensor.request(wanted)
            controller.accept(wanted)
        exposures.append(exposure_us)
        means.append(image.mean() / 1023)
    return np.array(exposures), np.array(means)


@pytest.mark.parametrize('start_us', [20, 7000, 30_000])
@pytest.mark.parametrize('level', [0.02, 0.1, 5.0])
@pytest.mark.parametrize('delay', [0, 4])
def test_it_comes_to_the_target_from_anywhere_and_rests(level, start_us, delay):
    controller = control_from(start_us)
    exposures, means = run(Sensor(scene(level), start_us, delay), controller, 80)
    assert abs(means[-1] - 0.35) < 0.05
    assert len(set(exposures[-20:])) == 1


def test_darkness_and_glare_end_at_the_limits():
    for level, end_us in ((0.0, 30_000), (1000.0, 20)):
        controller = control_from(7000)
        exposures, _ = run(Sensor(scene(level), 7000), controller)
        assert exposures[-1] == end_us
        assert len(set(exposures[-20:])) == 1
