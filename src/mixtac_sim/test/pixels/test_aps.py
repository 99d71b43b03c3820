# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Frames: exposure, levels, schedule, and noise against the mean."""

import numpy as np
import pytest

from mixtac_sim.grids import TILE, TILES
from mixtac_sim.pixels.aps import READOUT_US, Aps, ApsSettings


def light(lux):
    return np.full((TILES, TILE), lux, np.float32)


def expose(aps, before, after, start, end):
    """Expose to two lights, at the start and at the end of a step."""
    for each, span_us in zip((before, after), aps.shares_us(start, end), strict=True):
        aps.expose(each, span_us)


def take(aps, light_at, until_us=60_000, step_us=500):
    """Return the frames of a course of even light."""
    frames = []
    for start in range(0, until_us, step_us):
        end = start + step_us
        expose(aps, light(light_at(start)), light(light_at(end)), start, end)
        frame = aps.finish(end, 1.0)
        if frame is not None:
            frames.append(frame)
    return frames


def test_schedule_and_times():
    frames = take(Aps(1, 2, 1.0, ApsSettings(7_000, 40_000, 5_000)), lambda _: 50.0, 100_000)
    assert [f.exposure_start_us for f in frames] == [5_000, 45_000, 85_000]
    for frame in frames:
        assert frame.frame_start_us < frame.exposure_start_us
        assert frame.exposure_end_us - frame.exposure_start_us == 7_000
        assert frame.frame_end_us - frame.exposure_end_us == READOUT_US


def test_response_is_linear_in_light_and_exposure():
    def mean(lux, exposure_us):
        aps = Aps(1, 2, 1.0, ApsSettings(exposure_us))
        return take(aps, lambda _: lux)[0].intensity.mean()

    assert mean(80.0, 7_000) - mean(40.0, 7_000) == pytest.approx(280.0, rel=0.01)
    assert mean(80.0, 3_500) == pytest.approx(0.5 * mean(80.0, 7_000), rel=0.01)


def test_ramp_of_light_is_seen_at_mid_exposure():
    settings = ApsSettings(7_000, 40_000, 5_130)
    ramp = take(Aps(1, 2, 1.0, settings), lambda t: 0.006 * t)[0].intensity.mean()
    middle = take(Aps(1, 2, 1.0, settings), lambda _: 0.006 * 8_630)[0].intensity.mean()
    assert ramp == pytest.approx(middle, abs=0.3)


def test_new_settings_wait_for_the_exposure_under_way():
    aps = Aps(1, 2, 1.0, ApsSettings(7_000, 40_000, 5_000))
    frames = take(aps, lambda _: 50.0, 8_000)
    aps.configure(ApsSettings(2_000, 20_000, 5_000))
    for start in range(8_000, 80_000, 500):
        expose(aps, light(50.0), light(50.0), start, start + 500)
        frame = aps.finish(start + 500, 1.0)
        frames += [frame] if frame is not None else []
    lengths = [f.exposure_end_us - f.exposure_start_us for f in frames]
    assert lengths[0] == 7_000
    assert set(lengths[1:]) == {2_000}
    assert np.all(np.diff([f.exposure_start_us for f in frames])[1:] == 20_000)
    assert frames[0].intensity.mean() == pytest.approx(353.7, rel=0.01)


def pair(lux):
    """Return two frames under the same even light."""
    aps = Aps(3, int(lux), 1.0, ApsSettings(7_000, 20_000, 5_000))
    light, frames = np.full((TILES, TILE), lux, np.float32), []
    for start in range(0, 60_000, 500):
        expose(aps, light, light, start, start + 500)
        frame = aps.finish(start + 500, 1.0)
        frames += [frame] if frame is not None else []
    return frames[:2]


@pytest.fixture(scope='module')
def curve():
    """Return mean [DN] and temporal variance [DN^2] of frames from dark to two thirds of full."""
    points = []
    for lux in (1.0, 5.0, 15.0, 30.0, 50.0, 70.0, 95.0):
        first, second = (frame.intensity.astype(np.float64) for frame in pair(lux))
        points.append((0.5 * (first + second).mean(), 0.5 * np.var(first - second)))
    return np.array(points).T


def test_slope_is_the_conversion_gain(curve):
    slope, _ = np.polyfit(*curve, 1)
    assert 1.0 / slope == pytest.approx(34.0, rel=0.05)  # e-/DN


def test_intercept_is_the_read_noise_of_both_samples(curve):
    _, dark = np.polyfit(*curve, 1)
    # Two readings of 55 e- and the steps of two conversions.
    assert dark == pytest.approx(2.0 * (55.0 / 34.0) ** 2 + 2.0 / 12.0, rel=0.06)


def test_dynamic_range_is_that_of_the_specification():
    # Full well over the noise of a dark frame: 56 dB for one reading, 3 dB less for two.
    first, second = (frame.intensity.astype(np.float64) for frame in pair(1.0))
    dark = np.sqrt(0.5 * np.var(first - second))
    assert 20.0 * np.log10(1023.0 / dark) == pytest.approx(53.0, abs=1.5)
