# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Noise events against the light, and the readout queue."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixtac_sim.grids import PADDED, PIXELS, TILES
from mixtac_sim.optics.scene import Scene
from mixtac_sim.pixels.biases import PixelSettings, PixelSpread
from mixtac_sim.pixels.dvs import Dvs
from mixtac_sim.pixels.noise import NoiseSource, Readout, pack

LUX = np.array([1.0, 4.0, 16.0, 64.0, 200.0])
SETTINGS = PixelSettings(leak_hz=0.1, leak_hz_per_lux=0.002, shot_hz=8.0, shot_lux=4.0)
ONES = np.ones(PADDED, np.float32)
SPREAD = PixelSpread(ONES, ONES, ONES, np.array([7]), np.array([0.0]))


def rates(lux, blocks=100):
    """Return leak and shot events per second and pixel under even light."""
    floor = np.full(PADDED, lux, np.float32)
    scene = Scene(floor, np.zeros(PADDED, np.float32))
    dvs = Dvs(scene, SPREAD, SETTINGS, np.random.default_rng(int(lux)))
    noise = NoiseSource(floor[:PIXELS], SETTINGS, SPREAD, 0.0, int(lux))
    cover, dirty, ns = np.zeros(PADDED, np.int32), np.zeros(TILES, np.uint8), 20_000_000
    leak = shot = 0
    for k in range(blocks):
        dvs.step(cover, dirty, k * ns, (k + 1) * ns, k * ns)
        leak += len(dvs.take())
        shot += len(noise.block(k, ns, []))
    seconds = 1e-9 * ns * blocks
    return leak / PIXELS / seconds, shot / PIXELS / seconds


@pytest.fixture(scope='module')
def measured():
    return np.array([rates(lux) for lux in LUX]).T


def test_leak_is_a_line_over_the_light(measured):
    slope, dark = np.polyfit(LUX, measured[0], 1)
    assert dark == pytest.approx(0.1, rel=0.05)
    assert slope == pytest.approx(0.002, rel=0.05)


def test_shot_noise_falls_with_the_light_to_half_at_its_constant(measured):
    shot = measured[1]
    np.testing.assert_allclose(shot * (1.0 + LUX / 4.0), 8.0, rtol=0.05)
    assert shot[1] == pytest.approx(4.0, rel=0.05)
    # Dim 10 Hz, good light below 1 Hz: the ratio measured on DAVIS cameras is about 50.
    assert 20.0 < shot[0] / shot[-1] < 80.0


# Service time, latency and jitter [ns].
QUEUE = (80, 20_000, 15_000.0)


def keys(times, pixels):
    times, pixels = np.asarray(times, np.int64), np.asarray(pixels, np.int64)
    return pack(times, pixels, np.ones_like(pixels))


class Still(np.random.Generator):
    """Draws no jitter."""

    def __init__(self):
        super().__init__(np.random.PCG64(0))

    def normal(self, *args, **kwargs):
        return np.zeros(args[2])


def test_simultaneous_events_take_80_ns_each_row_by_row():
    pixels = np.random.default_rng(0).permutation(89_960)[:10_000]
    events = Readout(*QUEUE).read(keys(np.zeros(10_000), pixels), 0, 4_000_000, Still())
    assert len(events) == 10_000
    assert events.t[-1] - events.t[0] == 10_000 * 80 // 1000
    assert np.all(np.diff(events.t) >= 0)
    assert np.all(np.diff(events.y.astype(int)) >= 0)


def test_pixel_that_waits_cannot_fire_again():
    readout = Readout(*QUEUE)
    crowd = keys(np.zeros(20_000), np.arange(20_000))
    again = keys([500_000], [19_999])
    events = readout.read(np.concatenate([crowd, again]), 0, 4_000_000, Still())
    assert len(events) == 20_000
    assert readout.lost == 1


@settings(max_examples=30)
@given(
    st.lists(st.tuples(st.integers(0, 7_999_999), st.integers(0, 89_959)), max_size=200),
    st.integers(0, 1_000),
)
def test_blocks_join_without_disorder(requests, seed):
    readout = Readout(*QUEUE)
    rng = np.random.default_rng(seed)
    parts = []
    for block in (0, 1, 2):
        mine = [(t - block * 4_000_000, p) for t, p in requests if t // 4_000_000 == block]
        packed = keys([t for t, _ in mine], [p for _, p in mine])
        parts.append(readout.read(packed, block * 4_000_000, 4_000_000, rng))
    t = np.concatenate([part.t for part in parts])
    assert len(t) + readout.lost == len(requests)
    assert np.all(np.diff(t) >= 0)
