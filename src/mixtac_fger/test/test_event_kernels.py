# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Event features against least squares by NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_core.events.arrays import Events
from mixtac_fger.config import FgerConfig
from mixtac_fger.features import FramePreparation, WindowFeatures, bin_cells


@pytest.fixture
def image() -> np.ndarray:
    y, x = np.mgrid[0:260, 0:346]
    return (300 + 100 * np.sin(0.5 * x + 0.1 * y) + 100 * np.cos(0.4 * y)).astype(np.uint16)


def features_of(events: Events, image: np.ndarray, **options: object) -> np.ndarray:
    config = FgerConfig(**options)
    preparation, window = FramePreparation(config), WindowFeatures(config)
    out = np.full(window.shape, np.nan, np.float32)
    window.compute(events, preparation.guide(preparation.contrast(image)), out)
    return out


def random_events(count: int) -> Events:
    random = np.random.default_rng(1)
    return Events(
        np.arange(count, dtype=np.int64),
        random.integers(0, 346, count).astype(np.uint16),
        random.integers(0, 260, count).astype(np.uint16),
        random.random(count) > 0.3,
    )


def test_flow_is_the_regularised_least_squares_solution(image):
    config, events = FgerConfig(), random_events(5000)
    preparation = FramePreparation(config)
    guide = preparation.guide(preparation.contrast(image))
    out = features_of(events, image)
    row_cell, column_cell = bin_cells(config.gradient_shape, config.grid_shape)
    x, y = events.x.astype(int) // 2, events.y.astype(int) // 2
    sign = np.where(events.polarity, 1.0, -1.0)
    for row, column in [(0, 0), (2, 5), (5, 7)]:
        gx = guide.along_x[row_cell == row][:, column_cell == column].astype(float).ravel()
        gy = guide.along_y[row_cell == row][:, column_cell == column].astype(float).ravel()
        tensor = 4 * np.array([[gx @ gx, gx @ gy], [gx @ gy, gy @ gy]])
        tensor += 4 * len(gx) * config.cell_regularisation * np.eye(2)
        here = (row_cell[y] == row) & (column_cell[x] == column)
        sums = [(sign * guide.along_x[y, x])[here].sum(), (sign * guide.along_y[y, x])[here].sum()]
        assert out[row, column, :2] == pytest.approx(-np.linalg.solve(tensor, sums), rel=1e-3)
        assert np.expm1(out[row, column, 2]) == pytest.approx((sign[here] > 0).sum(), rel=1e-5)
        assert np.expm1(out[row, column, 3]) == pytest.approx((sign[here] < 0).sum(), rel=1e-5)


def test_no_events_are_zero_and_the_flow_is_limited(image):
    assert not features_of(Events.empty(), image).any()
    assert not features_of(Events.empty(), np.zeros_like(image)).any()
    flat = np.full_like(image, 300)
    flat[:, ::8] += 40
    out = features_of(random_events(90_000), flat, flow_limit=0.5)
    assert np.abs(out[..., :2]).max() == 0.5


def of_a_lamp(events: Events, image: np.ndarray) -> bool:
    """Return whether a window's events count as a change of the lamp."""
    config = FgerConfig()
    preparation, window = FramePreparation(config), WindowFeatures(config)
    out = np.zeros(window.shape, np.float32)
    return window.compute(events, preparation.guide(preparation.contrast(image)), out)


def drawn(count: int, brighter: float, seed: int, place: float = 0.0, near: float = 0.0) -> Events:
    """Return events everywhere, a share `near` of them within some 20 px of a place."""
    random = np.random.default_rng(seed)
    x, y = random.uniform(0, 346, count), random.uniform(0, 260, count)
    close = random.random(count) < near
    x[close] = random.normal(80 + place, 20, close.sum()).clip(0, 345)
    y[close] = random.normal(80 + place, 20, close.sum()).clip(0, 259)
    polarity = random.random(count) < brighter
    return Events(
        np.arange(count, dtype=np.int64), x.astype(np.uint16), y.astype(np.uint16), polarity
    )


@pytest.mark.parametrize('count', [60, 300, 3000])
def test_a_lamp_makes_events_of_one_polarity_everywhere(image, count):
    windows = range(40)
    for brighter in (0.95, 0.05):
        lamp = [of_a_lamp(drawn(count, brighter, seed), image) for seed in windows]
        assert np.mean(lamp) > 0.9
    motion = [of_a_lamp(drawn(count, 0.5, seed), image) for seed in windows]
    assert not any(motion)
    touch = [of_a_lamp(drawn(count, 0.95, seed, 10.0 * seed % 150, 0.5), image) for seed in windows]
    assert np.mean(touch) < 0.1
    assert not of_a_lamp(Events.empty(), image)


def run(windows: list[Events], image: np.ndarray) -> np.ndarray:
    """Return the features of the last of some windows."""
    config = FgerConfig()
    preparation, window = FramePreparation(config), WindowFeatures(config)
    guide, out = preparation.guide(preparation.contrast(image)), np.zeros(window.shape, np.float32)
    for events in windows:
        window.compute(events, guide, out)
    return out


def at(x: int, y: int, polarity: list[bool]) -> Events:
    count = len(polarity)
    places = np.full((2, count), [[x], [y]], np.uint16)
    return Events(np.arange(count, dtype=np.int64), places[0], places[1], np.array(polarity))


@pytest.mark.parametrize('brighter', [True, False])
def test_a_pixel_that_changes_one_way_without_end_is_ignored_until_it_is_quiet(image, brighter):
    hot, scene = at(100, 80, [brighter, brighter]), random_events(300)
    with_hot = run([hot] * 50 + [Events.concatenate([scene, hot])], image)
    assert np.array_equal(with_hot, run([Events.empty()] * 50 + [scene], image))
    later = run([hot] * 50 + [Events.empty()] * 100 + [hot], image)
    assert later[..., 2 if brighter else 3].max() == pytest.approx(np.log1p(2))


@pytest.mark.parametrize('brighter', [[True] * 4 + [False] * 2, [True] * 12 + [False] * 12])
def test_a_pixel_that_flickers_counts_whatever_its_thresholds(image, brighter):
    out = run([at(100, 80, brighter)] * 100, image)
    assert out[..., 2].max() == pytest.approx(np.log1p(sum(brighter)))
