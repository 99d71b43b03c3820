# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Statistics of recordings: known ones come out as known, and the virtual sensor is not far off."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
import pytest

from mixtac_events.arrays import Events
from mixtac_lab.bench.realism import (
    COMPARED,
    far_apart,
    of_events,
    of_frames,
    of_recording,
    of_samples,
    of_virtual_sensor,
)
from mixtac_recordings.recording import RecordingError
from mixtac_sim.world.effects import preset

DATA = Path(os.environ.get('MIXTAC_TEST_DATA', Path(__file__).parents[5] / 'shared' / 'data'))
REAL = ('davis346_bag', 'davis346_sample.aedat4')
SIZE = (346, 260)


def noise(rate_hz, seconds, seed=0):
    rng = np.random.default_rng(seed)
    n = rng.poisson(rate_hz * seconds * SIZE[0] * SIZE[1])
    t = np.sort(rng.integers(0, round(1e6 * seconds), n))
    x, y = rng.integers(0, SIZE[0], n), rng.integers(0, SIZE[1], n)
    return Events(t, x.astype(np.uint16), y.astype(np.uint16), rng.random(n) < 0.6)


def test_noise_has_its_rate_and_balance():
    found = of_events(noise(0.2, 4.0), SIZE)
    # Of the neighbours' 1.6 events a second, 3 % come within 10 ms before or after.
    assert found['isolated [1/s/px]'] == pytest.approx(0.2, rel=0.06)
    assert found['ON / OFF'] == pytest.approx(1.5, rel=0.05)
    assert found['silent pixels'] == pytest.approx(math.exp(-0.8), abs=0.01)
    assert found['row length'] == pytest.approx(1.0, abs=0.01)
    assert found['hot pixels'] == 0


def test_bursts_are_not_isolated_and_hot_pixels_are_found():
    t = np.arange(0, 1_000_000, 5000)
    hot = np.full(len(t), 100, np.uint16)
    found = of_events(Events(t, hot, hot, np.ones(len(t), np.bool_)), SIZE)
    assert found['hot pixels'] == 1
    assert found['isolated [1/s/px]'] == 0
    pair = np.repeat(np.arange(0, 1_000_000, 20_000), 2)
    x = np.tile(np.array([10, 10], np.uint16), len(pair) // 2)
    y = np.tile(np.array([10, 11], np.uint16), len(pair) // 2)
    found = of_events(Events(pair, x, y, np.ones(len(pair), np.bool_)), SIZE)
    assert found['isolated [1/s/px]'] == 0
    assert found['row length'] == 2.0


def test_frames_and_samples_have_their_noise():
    rng = np.random.default_rng(1)
    frames = [
        np.clip(rng.normal(500, 6.0, (100, 100)), 0, 1023).astype(np.uint16) for _ in range(4)
    ]
    found = of_frames(frames, [0, 40_000, 80_000, 120_000])
    assert found['frame noise'] == pytest.approx(6.1, rel=0.05)
    assert found['frame interval [ms]'] == 40.0
    t = np.arange(0, 400_000, 1000)
    slow = np.stack([np.sin(t / 1e5)] * 3, axis=1)
    found = of_samples(t, slow + rng.normal(0, 0.03, (400, 3)), slow)
    assert found['IMU rate [Hz]'] == 1000.0
    assert found['accelerometer noise [m/s^2]'] == pytest.approx(0.03, rel=0.1)
    assert found['gyroscope noise [rad/s]'] < 0.006


def test_nothing_gives_no_figures():
    empty = of_events(Events.empty(), SIZE) | of_frames([], [])
    assert all(math.isnan(value) for value in empty.values())
    assert far_apart([dict.fromkeys(COMPARED, math.nan)], [dict.fromkeys(COMPARED, 1.0)]) == {}


def test_a_missing_recording_is_an_error(tmp_path):
    with pytest.raises(RecordingError):
        of_recording(tmp_path / 'none.aedat4')


def test_ranges_that_are_far_apart_are_named():
    real = [dict.fromkeys(COMPARED, 1.0), dict.fromkeys(COMPARED, 2.0)]
    virtual = [dict.fromkeys(COMPARED, 3.0) | {'ON / OFF': 5.0}]
    assert far_apart(real, virtual) == {'ON / OFF': pytest.approx(2.5)}


def test_the_virtual_sensor_is_within_a_factor_of_two_of_real_cameras():
    paths = [DATA / name for name in REAL]
    if not all(path.exists() for path in paths):
        pytest.skip(f'no real recordings in {DATA}')
    real = [of_recording(path) for path in paths]
    virtual = of_virtual_sensor('idle', 1.0, preset('easy'))
    # At rest no pixel fires twice within a few milliseconds, as pixels do that see something move.
    assert set(far_apart(real, [virtual])) <= {'interval p01 [ms]'}
