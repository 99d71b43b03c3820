# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Auto-exposure in a closed loop with a simple model of the pixels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_driver.node.settings import AutoExposure, right_exposure
from mixtac_driver.parameters import DriverParameters


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


def test_flicker_within_the_dead_band_is_left_alone():
    controller = control_from(3000)
    base = scene(0.1)
    sensor = Sensor(base, 3000)
    run(sensor, controller)
    changes = 0
    for k in range(50):
        sensor.brightness = base * (1 + 0.05 * np.sin(k))
        image, exposure_us = sensor.frame()
        changes += controller.update(image, exposure_us) is not None
    assert changes == 0


@given(st.integers(0, 1023), st.integers(0, 100), st.floats(1, 1e6), st.floats(0.05, 0.9))
def test_one_step_is_bounded_and_goes_the_right_way(value, saturated, exposure_us, target):
    image = np.full(100, value, np.uint16)
    image[:saturated] = 1023
    right = right_exposure(image, exposure_us, target)
    assert exposure_us / 4.0001 <= right <= exposure_us * 4.0001
    if image.mean() / 1023 > target:
        assert right < exposure_us * 1.0001
